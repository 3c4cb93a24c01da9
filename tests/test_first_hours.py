"""The first hour of four people: what their page shows, run in an empty folder, and no more.

The commands run in this process, by the entry point of the installed package. ``make wheel`` runs
them in a new environment that holds the wheel and not the sources.
"""

import os
import re
import shlex
import subprocess
import sys
import zipfile
from collections.abc import Callable
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from tests.filters.linear import linear_model

import truejoint

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "src" / "truejoint"
(ENTRY,) = entry_points(group="console_scripts", name="truejoint")
TABLES = r"[\s│┃]+"


def blocks(page: str, kind: str = "") -> list[str]:
    """Fenced blocks of one language on a page of the manual."""
    text = (ROOT / "docs" / page).read_text("utf-8")
    fenced = re.findall(r"^```(\w*)\n(.*?)^```$", text, flags=re.DOTALL | re.MULTILINE)
    return [block for language, block in fenced if language == kind]


def lines(block: str) -> list[str]:
    """What a shell would make of a block."""
    return [line for line in block.replace("\\\n", " ").splitlines() if line.strip()]


def values(text: str) -> str:
    """Text without the lines and spaces of its tables."""
    return re.sub(TABLES, " ", text)


@pytest.fixture
def run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[[str], str]:
    """Run a line in an empty folder, or fail; give what it printed."""
    monkeypatch.chdir(tmp_path)

    def typed(line: str) -> str:
        words = shlex.split(line, comments=True)
        if words[0] != "truejoint":
            done = subprocess.run(  # noqa: S602 - our own page
                line, shell=True, capture_output=True, text=True, check=False
            )
            assert done.returncode == 0, f"{line}: {done.stderr}"
            return done.stdout
        monkeypatch.setattr(sys, "argv", words)
        with pytest.raises(SystemExit) as stop:
            ENTRY.load()()
        said = "".join(capsys.readouterr())
        assert stop.value.code in (0, None), f"{line}: {said}"
        return said

    return typed


def execute(block: str) -> dict[str, Any]:
    names: dict[str, Any] = {}
    exec(compile(block, "page.py", "exec"), names)  # noqa: S102 - our own page
    return names


def test_a_csv_from_another_robot(run: Callable[[str], str]) -> None:
    page = "recordings.md"
    guessed, table, corrected = blocks(page)
    install, *commands = lines(blocks(page, "sh")[0])
    assert install.startswith("pip install")
    assert 1 + len(commands) <= 6
    execute(blocks(page, "python")[0])
    said = {}
    for command in commands:
        said[command.split()[1]] = run(command)
        if command.startswith("truejoint columns"):
            map_toml = Path("map.toml")
            assert set(guessed.splitlines()) <= set(map_toml.read_text("utf-8").splitlines())
            map_toml.write_text(blocks(page, "toml")[0], "utf-8")  # which a person mends
    (row,) = re.findall(r"^ wrist .*$", table, flags=re.MULTILINE)
    assert values(row).strip() in values(said["evaluate"])
    assert set(lines(table)[-2:]) <= set(said["evaluate"].splitlines())
    assert Path("corrected.csv").read_text("utf-8").startswith(corrected)
    truth = pd.read_csv("day4.csv", sep=";")["JointAngle_deg"]
    error = pd.read_csv("corrected.csv")["corrected/wrist [deg]"] - truth
    assert np.sqrt((error**2).mean()) < 0.05


@pytest.mark.parametrize("name", ["directions", "forceps-unloaded"])
def test_a_student_repeats_a_table_of_each_paper(name: str, run: Callable[[str], str]) -> None:
    page = "studies.md"
    (command,) = (line for line in lines(blocks(page, "sh")[0]) if name in line)
    kept = Path(os.environ["TRUEJOINT_TEST_MODELS"]) / "parts"  # by tests of the studies
    kept.mkdir(exist_ok=True)
    Path("studies").mkdir()
    Path("studies", "parts").symlink_to(kept)
    said = values(run(command))
    overview = Path("studies/index.html").read_text("utf-8")
    assert name in overview
    if name == "directions":
        for joint in ("shoulder [deg]", "elbow [deg]", "insertion [mm]"):
            assert f"J2-J3, {joint}" in said
        return
    rows = [row for row in lines(blocks(page)[0]) if re.search(r"\d\.\d+", row)]
    assert len(rows) == 4
    for row in rows:
        assert values(row).strip() in said


def test_a_user_of_the_filter_alone(run: Callable[[str], str]) -> None:
    Path("pendulum.py").write_text(blocks("filter.md", "python")[0], "utf-8")
    code = "import runpy, sys; runpy.run_path('pendulum.py'); print(*sys.modules, file=sys.stderr)"
    done = subprocess.run(  # noqa: S603
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert done.stdout == blocks("filter.md")[0]
    assert not {"truejoint.cli", "truejoint.robots", "pandas", "sklearn"} & {*done.stderr.split()}


@pytest.mark.filterwarnings("ignore:.*plain Python")
def test_who_comes_from_filterpy(run: Callable[[str], str], capsys: Any) -> None:
    names = execute(blocks("filter.md", "python")[1])
    assert capsys.readouterr().out == blocks("filter.md")[1]

    same = linear_model([[1.0, 0.1], [0.0, 1.0]], [[], []], [[1.0, 0.0]],
                        names["model"].process_noise, [[1e-2]])  # fmt: skip
    result = truejoint.UKF(same).run(names["zs"], x0=[0.0, 0.0], P0=np.eye(2), dt=0.1)
    np.testing.assert_allclose(names["result"].x, result.x, rtol=1e-9, atol=1e-12)
    with pytest.raises(truejoint.TruejointError, match=r"f\(x, u, dt, parameters\) that returns"):
        truejoint.filters.StateSpaceModel(
            lambda x, dt: x, names["hx"], states=("x",), measurements=("x",), process_noise=[[1.0]],
            measurement_noise=[[1.0]],
        )  # fmt: skip


def test_a_control_engineer_with_the_c(run: Callable[[str], str]) -> None:
    page = "export.md"
    first, loop = blocks(page, "sh")[:2]
    for command in lines(first):
        said = run(command)
    # How many are corrected hangs on the twin's friction, and so on last bits of the processor.
    counted = r"(?<= samples, )\d+"
    assert re.sub(counted, "", said) == re.sub(counted, "", blocks(page)[0])
    corrected = re.search(counted, said)
    assert corrected
    assert 2 * int(corrected[0]) >= int(said.split()[0])
    (main,) = blocks(page, "c")
    assert main.count("\n") <= 24
    Path("main.c").write_text(main, "utf-8")
    names = execute(blocks(page, "python")[0])
    for command in lines(loop):
        run(command)
    positions = np.loadtxt("positions.txt")
    recording = names["recording"]
    names["corrector"].set_homing(True)
    expected = names["corrector"].run(recording)
    ok = expected.status == 0
    assert ok.mean() > 0.5
    elbow = list(names["corrector"].joints).index("elbow")
    np.testing.assert_allclose(positions[ok, 2], expected.position[ok, elbow], atol=1e-6)
    np.testing.assert_array_equal(positions[:, 1], expected.status)


@pytest.mark.skipif(find_spec("hatchling") is None, reason="the builder of wheels is not installed")
def test_a_wheel_runs_by_itself(tmp_path: Path) -> None:
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)  # noqa: S603
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as packed:
        held = set(packed.namelist())
        packed.extractall(tmp_path / "site")
    files = {path.relative_to(PACKAGE.parent) for path in PACKAGE.rglob("*") if path.is_file()}
    missing = {str(path) for path in files if "__pycache__" not in path.parts} - held
    assert not missing
    code = "import truejoint; print(truejoint.__file__); from truejoint.cli.app import main; main()"
    done = subprocess.run(  # noqa: S603
        [sys.executable, "-c", code, "robots", "raven2"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(tmp_path / "site")},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.startswith(str(tmp_path / "site"))
    assert "insertion" in done.stdout
