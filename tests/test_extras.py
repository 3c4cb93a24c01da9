"""What a plain install does without the extras, and what it says where it needs one."""

import json
import subprocess
import sys
from importlib.metadata import packages_distributions
from pathlib import Path

import numpy as np
import pytest

EXTRAS = (
    "matplotlib", "mpl_toolkits", "onnx", "onnxruntime", "plotly", "pytransform3d", "viser",
    "xarray",
)  # fmt: skip

WITHOUT = """
import sys

class Blocked:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if name.partition(".")[0] in {blocked}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Blocked)
"""
COMMANDS = """
import json
from truejoint.cli.app import main
for arguments in json.loads(sys.argv[1]):
    sys.argv[1:] = arguments
    try:
        main()
    except SystemExit as end:
        print(f"ended with {end.code or 0}", file=sys.stderr)
import truejoint
recording = truejoint.read_recording("run.csv", robot="davinci_grasper")
for call in (recording.plot, recording.to_xarray):
    try:
        call()
    except truejoint.TruejointError as error:
        print(error, file=sys.stderr)
"""


def run(
    code: str, *arguments: str, cwd: Path, without: tuple[str, ...] = EXTRAS
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(  # noqa: S603 - our own code
        [sys.executable, "-c", WITHOUT.format(blocked=without) + code, *arguments],
        cwd=cwd,
        capture_output=True,
        text=True,
        check=False,
    )


NEEDED = {
    "plots": "which",
    "urdf": "a URDF needs pytransform3d, which",
    "onnx": "an ONNX graph needs onnx, which",
    "monitor": "the monitor needs viser, which",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording, a robot with a URDF."""
    folder = tmp_path_factory.mktemp("plain")
    t = np.arange(400) * 0.01
    table = np.column_stack([t, np.sin(t), 1.1 * np.sin(t) + 0.02])
    header = "t,measured/jaw,truth/jaw"
    np.savetxt(folder / "run.csv", table, delimiter=",", header=header, comments="")
    (folder / "arm.toml").write_text(
        'name = "arm"\njoints = [{ name = "jaw" }]\nkinematics = { urdf = "arm.urdf" }\n'
    )
    return folder


@pytest.fixture(scope="module")
def told(folder: Path) -> list[str]:
    """What a plain install says on stderr to each of a few commands and calls, how each ended."""
    robot = ["--robot", "davinci_grasper"]
    commands = [
        ["calibrate", "run.csv", *robot, "-e", "linear", "-o", "jaw.safetensors"],
        ["evaluate", "jaw.safetensors", "run.csv", *robot],
        ["trajectory", "zigzag", "-o", "zigzag.csv", "--plot", "zigzag.html"],
        ["calibrate", "run.csv", "--robot", "arm.toml", "-o", "other.safetensors"],
        ["export", "jaw.safetensors", "--to", "onnx", "--out", "graph"],
        ["monitor", "run.csv", *robot],
    ]
    result = run(COMMANDS, json.dumps(commands), cwd=folder)
    assert "Traceback" not in result.stderr
    return result.stderr.split("ended with ")


def test_a_plain_install_calibrates_and_evaluates(told: list[str]) -> None:
    assert len(told) == 7, told
    assert told[1][0] == "0", told
    assert told[2][0] in "01", told


def test_what_needs_an_extra_says_which(told: list[str]) -> None:
    for (extra, needs), text, after in zip(NEEDED.items(), told[2:6], told[3:], strict=True):
        assert f'{needs} is not installed: pip install "truejoint[{extra}]"' in text
        assert after[0] == "2"


def test_a_call_that_needs_an_extra_is_refused_in_a_line(told: list[str]) -> None:
    assert told[6].splitlines()[1:] == [
        'a figure needs matplotlib, which is not installed: pip install "truejoint[plots]"',
        'to_xarray needs xarray, which is not installed: pip install "truejoint[xarray]"',
    ]


def test_the_loop_needs_neither_extras_nor_the_training_stack(
    folder: Path, told: list[str]
) -> None:
    code = "from truejoint.runtime import Corrector; Corrector(sys.argv[1])"
    needed = {"lazy_loader", "llvmlite", "numba", "numpy", "safetensors", "scipy", "truejoint"}
    others = tuple(name for name in packages_distributions() if name.split(".")[0] not in needed)
    loop = run(code, "jaw.safetensors", without=others, cwd=folder)
    assert loop.returncode == 0, loop.stderr
