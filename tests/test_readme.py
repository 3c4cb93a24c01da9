"""What README and the first steps show, run: the demo, shortened, then every Python block."""

import json
import re
import shlex
import sys
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from truejoint.cli import demo
from truejoint.cli.app import main
from truejoint.errors import RecordingError
from truejoint.estimators import registry
from truejoint.recordings import datasets

ROOT = Path(__file__).parents[1]
README, STEPS = (
    (ROOT / name).read_text(encoding="utf-8") for name in ("README.md", "docs/first_steps.md")
)
PYTHON = re.findall(r"```python\n(.*?)```", README + STEPS, flags=re.DOTALL)
REAL = "datasets.fetch"
# Motions long enough for what the blocks need, short enough for a test.
SHORTER = {
    "SPARSITY": 1.0,
    "NETWORKS": 2,
    "MAKING": 9,
    "JUDGING": 2,
    "SHORT": 0.5,
    "LONG": 0.5,
    "PAPER": 0.5,
    "NETWORK": "linear",
}


@cache
def have_real() -> bool:
    try:
        datasets.read_dataset(demo.REAL)
    except RecordingError:
        return False
    return True


def no_network(*_: Any, **__: Any) -> None:
    if not have_real():
        raise RecordingError("no network in the tests")


@pytest.fixture(scope="module")
def workplace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder in which a shortened demo ran."""
    folder = tmp_path_factory.mktemp("readme")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for name, value in SHORTER.items():
            patch.setattr(demo, name, value)
        patch.setattr(datasets, "fetch", no_network)
        patch.setattr(sys, "argv", ["truejoint", "demo", "--json"])
        with (folder / "said.json").open("w") as file:
            patch.setattr(sys, "stdout", file)
            with pytest.raises(SystemExit) as stop:
                main()
    assert stop.value.code in (None, 0, 1)
    return folder


def test_the_demo_judges_four_tests_and_says_what_to_deploy(workplace: Path) -> None:
    said = json.loads((workplace / "said.json").read_text())
    assert list(said["tests"]) == ["inside", "all over", "new homing", "500 g"]
    assert said["deploy"] in {"", "raw", "offset", "linear", "poly2", "dnn"}
    assert said["tolerance"]["insertion"] == 0.25e-3
    assert np.isfinite(said["interval"]["half_width"]).all()
    assert (np.array(said["interval"]["coverage"]) > 0.5).all()
    assert isinstance(said["real"], list) == have_real()
    assert (workplace / "demo" / "report.html").stat().st_size > 1e5


def test_every_python_block_runs_and_corrects(
    workplace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(workplace)
    monkeypatch.setattr(datasets, "fetch", no_network)
    hasty = registry.PRESETS["dnn"]._replace(params={"epochs": 2})  # what is judged is the demo's
    monkeypatch.setitem(registry.PRESETS, "dnn", hasty)
    names: dict[str, Any] = {}
    positions, allowed = [], []
    for block in PYTHON:
        if REAL in block and not have_real():
            continue
        # What the loop leaves of every sample is kept for the check below.
        code = block.replace(
            "    corrector.position, corrector.half_width",
            "    keep(status, corrector.position.copy(), corrector.half_width.copy())",
        )

        def keep(status: int, position: Any, half_width: Any) -> None:
            positions.append(position if status == 0 else np.full(3, np.nan))
            allowed.append(half_width)

        names["keep"] = keep
        exec(compile(code, "README.md", "exec"), names)  # noqa: S102
    morning = names["morning"]
    truth = morning.columns("truth", names["today"].joints)
    error = np.array(positions) - truth
    ok = np.isfinite(error).all(axis=1)
    assert ok.mean() > 0.5
    assert np.isfinite(np.array(allowed)[ok]).all()
    raw = np.abs(morning.error(names["today"].joints)[ok]).mean(axis=0)
    assert (np.abs(error[ok]).mean(axis=0) < 0.3 * raw).all()
    assert (names["lower"] < names["upper"]).all()


def test_every_command_of_the_readme_is_one_that_is_understood(
    workplace: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    block = STEPS.split("## Step by step")[1].split("```sh\n")[1].split("```")[0]
    for long, brief in (("\\\n", " "), ("--duration-s 600", "--duration-s 60"), (" 1/4 ", " 1/2 ")):
        block = block.replace(long, brief)
    monkeypatch.chdir(workplace)
    for line in block.splitlines():
        words = shlex.split(line, comments=True)
        if words[1] == "calibrate":
            words += ["--set", "epochs=2"]
        monkeypatch.setattr(sys, "argv", words)
        with pytest.raises(SystemExit) as stop:
            main()
        # A brief fit may miss the tolerance that `evaluate` is given.
        assert stop.value.code in ((0, None, 1) if words[1] == "evaluate" else (0, None)), line
        capsys.readouterr()
    assert (workplace / "report.html").exists()
