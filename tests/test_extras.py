"""What a plain install does without the extras, and what it says where it needs one."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.metadata import packages_distributions
from pathlib import Path

import numpy as np
import pytest

EXTRAS = ("matplotlib", "mpl_toolkits", "onnx", "onnxruntime", "plotly", "pytransform3d")

WITHOUT = """
import sys

class Blocked:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if name.partition(".")[0] in {blocked}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Blocked)
"""
COMMAND = "from truejoint.cli.app import main; main()"


def run(
    code: str, *arguments: str | Path, without: tuple[str, ...] = EXTRAS
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(  # noqa: S603 - our own code
        [sys.executable, "-c", WITHOUT.format(blocked=without) + code, *map(str, arguments)],
        env=dict(os.environ),
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording and a model that a plain install has made of it."""
    folder = tmp_path_factory.mktemp("plain")
    t = np.arange(400) * 0.01
    table = np.column_stack([t, np.sin(t), 1.1 * np.sin(t) + 0.02])
    header = "t,measured/jaw,truth/jaw"
    np.savetxt(folder / "run.csv", table, delimiter=",", header=header, comments="")
    made = run(
        COMMAND, "calibrate", folder / "run.csv", "--robot", "davinci_grasper", "-e", "linear",
        "-o", folder / "jaw.safetensors",
    )  # fmt: skip
    assert made.returncode == 0, made.stderr
    return folder


def test_a_plain_install_evaluates(folder: Path) -> None:
    judged = run(
        COMMAND, "evaluate", folder / "jaw.safetensors", folder / "run.csv",
        "--robot", "davinci_grasper",
    )  # fmt: skip
    assert judged.returncode in {0, 1}, judged.stderr
    assert "Traceback" not in judged.stderr


def test_the_loop_needs_neither_extras_nor_the_training_stack(folder: Path) -> None:
    code = "from truejoint.runtime import Corrector; Corrector(sys.argv[1])"
    needed = {"lazy_loader", "llvmlite", "numba", "numpy", "safetensors", "scipy", "truejoint"}
    others = tuple(name for name in packages_distributions() if name.split(".")[0] not in needed)
    loop = run(code, folder / "jaw.safetensors", without=others)
    assert loop.returncode == 0, loop.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["trajectory", "zigzag", "-o", "zigzag.csv", "--plot", "zigzag.png"],
            'which is not installed: pip install "truejoint[plots]"',
        ),
        (
            ["calibrate", "run.csv", "--robot", "arm.toml", "-o", "other.safetensors"],
            'a URDF needs pytransform3d, which is not installed: pip install "truejoint[urdf]"',
        ),
        (
            ["export", "jaw.safetensors", "--to", "onnx", "--out", "graph"],
            'an ONNX graph needs onnx, which is not installed: pip install "truejoint[onnx]"',
        ),
    ],
)  # fmt: skip
def test_what_needs_an_extra_says_which(
    folder: Path, arguments: list[str], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "arm.toml").write_text(
        'name = "arm"\njoints = [{ name = "jaw" }]\nkinematics = { urdf = "arm.urdf" }\n'
    )
    monkeypatch.chdir(folder)
    result = run(COMMAND, *arguments)
    assert result.returncode == 2
    assert message in result.stderr
    assert "Traceback" not in result.stderr
