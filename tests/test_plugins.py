"""Packages that add robots and formats: found by name, loaded when asked for."""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

EXAMPLE = Path(__file__).parents[1] / "examples" / "truejoint_example_plugin"

READ = """
import sys
from truejoint.errors import TruejointError
from truejoint.recordings import format_names, read_recording
from truejoint.robots import get_robot, robot_names
print(*robot_names(), *format_names())
for name in sys.argv[1:]:
    try:
        print(get_robot(name).title)
    except TruejointError as error:
        print(error)
"""


COMMANDS = """
import sys
from truejoint.cli.app import main
for words in {words}:
    sys.argv[1:] = words
    try:
        main()
    except SystemExit as end:
        print(f"ended with {{end.code or 0}}")
    print("next", file=sys.stderr)
"""


def install(folder: Path, name: str, points: dict[str, dict[str, str]]) -> None:
    """What an installer leaves behind beside a package's modules."""
    about = folder / f"{name.replace('-', '_')}-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    groups = [
        "\n".join([f"[{group}]", *(f"{key} = {value}" for key, value in entries.items())])
        for group, entries in points.items()
    ]
    (about / "entry_points.txt").write_text("\n".join(groups) + "\n")


def run(folder: Path, *command: str) -> subprocess.CompletedProcess[str]:
    paths = [str(folder), str(EXAMPLE / "src"), os.environ.get("PYTHONPATH", "")]
    return subprocess.run(  # noqa: S603 - our own code
        [sys.executable, *command],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.fixture
def example(tmp_path: Path) -> Path:
    project = tomllib.loads((EXAMPLE / "pyproject.toml").read_text())["project"]
    install(tmp_path, project["name"], project["entry-points"])
    return tmp_path


def test_the_example_serves_the_command_line(example: Path) -> None:
    steps = np.arange(600)
    motor = 3000 * np.sin(steps / 40.0)
    counts = np.column_stack([steps * 10, motor, motor * (8192 / 4096 / 50) * 0.9 + 5])
    np.savetxt(example / "run.txt", counts)
    model = example / "lever.safetensors"
    (example / "run.csv").write_text("t,measured/lever,truth/lever\n0,0,0\n1,0.1,0.1\n2,0.2,0.2\n")
    fit = [
        "calibrate", str(example / "run.txt"), "--metadata", "format=example_counts",
        "-e", "example_ridge", "-o", str(model),
    ]  # fmt: skip
    judge = ["evaluate", str(model), str(example / "run.csv"), "--robot", "example_lever"]
    install(example, "other-one", {"truejoint.estimators": {"dnn": "math:pi"}})
    clash = ["calibrate", str(example), "-e", "dnn", "-o", "m.st"]
    result = run(example, "-c", COMMANDS.format(words=[["datasets"], clash, fit, judge]))
    codes = re.findall(r"^ended with (\d)$", result.stdout, flags=re.MULTILINE)
    assert codes[:3] == ["0", "2", "0"], result.stderr
    assert codes[3] in {"0", "1"}, result.stderr
    assert "joints       lever" in result.stdout
    # A clash is told where the name is looked up, and nowhere else.
    told = "truejoint.estimators 'dnn' of other-one: the name is taken"
    listed, *others, _ = result.stderr.split("next\n")
    assert listed == ""
    assert [told in said for said in others] == [True, False, False]


def test_what_cannot_be_loaded_or_is_there_twice_is_named_and_the_rest_works(example: Path) -> None:
    (example / "broken_one.py").write_text("import nothing_of_that_name\n")
    robots = {"broken": "broken_one:ROBOT", "number": "math:pi"}
    install(example, "broken-one", {"truejoint.robots": robots})
    install(example, "other-one", {"truejoint.robots": {"twice": "math:pi", "bros": "math:pi"}})
    install(example, "third-one", {"truejoint.robots": {"twice": "math:pi"}})
    asked = ("broken", "number", "twice", "twice", "bros", "example_lever", "raven2")
    result = run(example, "-c", READ, *asked)
    names, broken, number, twice, again, *works = result.stdout.splitlines()
    assert {"broken", "example_lever", "example_counts"} <= {*names.split()}
    assert "truejoint.robots 'broken' of package broken-one does not work (Module" in broken
    assert "truejoint.robots 'number' of package broken-one is a float" in number
    assert "no robot called 'twice'" in twice
    assert "no robot called 'twice'" in again
    assert works[0] == "bros"
    assert works[-1] == "raven2 (left arm)"
    first, second = sorted(result.stderr.splitlines())
    assert "'bros' of other-one" in first
    assert "that of truejoint is used" in first
    assert "'twice' of" in second
    assert "none of them is used" in second


RAISES = """
from pathlib import Path
from truejoint.recordings import Format
def robot(arm):
    raise ValueError("no\\nlever")
class Nothing:
    pass
def read(path):
    raise KeyError("motor")
FORMAT = Format("raises", "nothing", read)
class Estimator:
    def __init__(self, needed):
        pass
"""


SAID = {
    "get_robot('raises', 'left')":
        "robots 'raises' of package raises does not work with left (ValueError: no lever)",
    "get_robot('leaves')": "robots 'leaves' of package raises does not work (SystemExit: 3)",
    "read_recording('run.txt', 'raises')":
        "formats 'raises' of package raises does not work with run.txt (KeyError: 'motor')",
    "get_estimator('raises')": "estimators 'raises' of package raises does not work (TypeErr",
    "get_estimator('nothing')": "estimators 'nothing' of package raises: <raises.Nothing",
}  # fmt: skip


def test_what_code_of_others_raises_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "raises.py").write_text(RAISES)
    (tmp_path / "leaves.py").write_text("raise SystemExit(3)\n")
    (tmp_path / "run.txt").write_text("1 2\n")
    install(
        tmp_path,
        "raises",
        {
            "truejoint.robots": {"raises": "raises:robot", "leaves": "leaves:ROBOT"},
            "truejoint.formats": {"raises": "raises:FORMAT"},
            "truejoint.estimators": {"raises": "raises:Estimator", "nothing": "raises:Nothing"},
        },
    )
    code = f"""
import os
from truejoint import get_robot, read_recording
from truejoint.estimators import get_estimator
from truejoint.errors import TruejointError
os.chdir({str(tmp_path)!r})
for call in {list(SAID)}:
    try:
        eval(call)
    except TruejointError as error:
        print(error)
"""
    result = run(tmp_path, "-c", code)
    assert result.stderr == ""
    for line, said in zip(result.stdout.splitlines(), SAID.values(), strict=True):
        assert said in line
