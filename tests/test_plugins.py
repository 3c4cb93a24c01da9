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

CODE = """
import os
import sys
os.chdir(sys.argv[1])
from truejoint import read_recording
from truejoint.cli.app import main
from truejoint.errors import TruejointError
from truejoint.estimators import get_estimator
from truejoint.recordings import format_names
from truejoint.robots import get_robot, robot_names
for words in {words}:
    sys.argv[1:] = words
    try:
        main()
    except SystemExit as end:
        print(f"ended with {{end.code or 0}}")
    print("next", file=sys.stderr)
print("next")
print(*robot_names(), *format_names())
for call in {calls}:
    try:
        print(eval(call))
    except TruejointError as error:
        print(error)
"""
RAISES = """
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
TWICE = {"truejoint.robots": {"twice": "math:pi"}}
POINTS = {
    "broken-one": {"truejoint.robots": {"broken": "broken_one:ROBOT", "number": "math:pi"}},
    "other-one": {
        "truejoint.robots": {"twice": "math:pi", "bros": "math:pi"},
        "truejoint.estimators": {"dnn": "math:pi"},
    },
    "third-one": TWICE,
    "raises": {
        "truejoint.robots": {"raises": "raises:robot", "leaves": "leaves:ROBOT"},
        "truejoint.formats": {"raises": "raises:FORMAT"},
        "truejoint.estimators": {"raises": "raises:Estimator", "nothing": "raises:Nothing"},
    },
}
SAID = {
    "get_robot('broken')": "robots 'broken' of package broken-one does not work (Module",
    "get_robot('number')": "robots 'number' of package broken-one is a float",
    "get_robot('twice')": "no robot called 'twice'",
    "get_robot('twice') ": "no robot called 'twice'",  # nor where it is asked for again
    "'found ' + get_robot('bros').name": "found bros",
    "'found ' + get_robot('example_lever').name": "found example_lever",
    "get_robot('raven2').title": "raven2 (left arm)",
    "get_robot('raises', 'left')":
        "robots 'raises' of package raises does not work with left (ValueError: no lever)",
    "get_robot('leaves')": "robots 'leaves' of package raises does not work (SystemExit: 3)",
    "read_recording('run.txt', 'raises')":
        "formats 'raises' of package raises does not work with run.txt (KeyError: 'motor')",
    "get_estimator('raises')": "estimators 'raises' of package raises does not work (TypeErr",
    "get_estimator('nothing')": "estimators 'nothing' of package raises: <raises.Nothing",
}  # fmt: skip


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


@pytest.fixture(scope="module")
def said(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    """What one process prints, and what it says, of commands and calls beside several packages."""
    folder = tmp_path_factory.mktemp("plugins")
    project = tomllib.loads((EXAMPLE / "pyproject.toml").read_text())["project"]
    for name, points in {project["name"]: project["entry-points"], **POINTS}.items():
        install(folder, name, points)
    (folder / "broken_one.py").write_text("import nothing_of_that_name\n")
    (folder / "raises.py").write_text(RAISES)
    (folder / "leaves.py").write_text("raise SystemExit(3)\n")
    steps = np.arange(600)
    motor = 3000 * np.sin(steps / 40.0)
    counts = np.column_stack([steps * 10, motor, motor * (8192 / 4096 / 50) * 0.9 + 5])
    np.savetxt(folder / "run.txt", counts)
    (folder / "run.csv").write_text("t,measured/lever,truth/lever\n0,0,0\n1,0.1,0.1\n2,0.2,0.2\n")
    words = [
        ["datasets"],
        ["calibrate", "run.txt", "-e", "dnn", "-o", "m.st"],
        ["calibrate", "run.txt", "--metadata", "format=example_counts", "-e", "example_ridge",
         "-o", "lever.safetensors"],
        ["evaluate", "lever.safetensors", "run.csv", "--robot", "example_lever"],
    ]  # fmt: skip
    paths = [str(folder), str(EXAMPLE / "src"), os.environ.get("PYTHONPATH", "")]
    done = subprocess.run(  # noqa: S603 - our own code
        [sys.executable, "-c", CODE.format(words=words, calls=list(SAID)), str(folder)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))},
        capture_output=True,
        text=True,
        check=False,
    )
    return done.stdout, done.stderr


def test_the_example_serves_the_command_line(said: tuple[str, str]) -> None:
    printed, errors = said
    codes = re.findall(r"^ended with (\d)$", printed, flags=re.MULTILINE)
    assert codes[:3] == ["0", "2", "0"], errors
    assert codes[3] in {"0", "1"}, errors
    assert "joints       lever" in printed
    # A clash is told where the name is looked up, and nowhere else.
    told = "truejoint.estimators 'dnn' of other-one: the name is taken"
    listed, *others, _ = errors.split("next\n")
    assert listed == ""
    assert [told in each for each in others] == [True, False, False]


def test_what_cannot_be_used_or_is_there_twice_is_named_and_the_rest_works(
    said: tuple[str, str],
) -> None:
    names, *lines = said[0].partition("next\n")[2].splitlines()
    assert {"broken", "example_lever", "example_counts"} <= {*names.split()}
    for line, text in zip(lines, SAID.values(), strict=True):
        assert text in line
    assert said[1].endswith("next\n"), "what calls raise is said nowhere else"
    clashes = (line for line in said[1].splitlines() if "truejoint.robots" in line)
    first, second = sorted(clashes)  # each is told once
    assert "'bros' of other-one" in first
    assert "that of truejoint is used" in first
    assert "'twice' of" in second
    assert "none of them is used" in second
