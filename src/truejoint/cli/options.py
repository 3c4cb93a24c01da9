"""Options that several commands share, so that they read the same everywhere."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from truejoint.cli import complete
from truejoint.errors import CommandRefused

RobotName = Annotated[
    str,
    typer.Option(
        "--robot", help="Robot model, or a robot file (.toml).", autocompletion=complete.robots
    ),
]
Arm = Annotated[
    str,
    typer.Option(
        "--arm", help="Which arm; default: the robot's first.", autocompletion=complete.arms
    ),
]
Force = Annotated[bool, typer.Option("--force", help="Overwrite what is there.")]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
Seed = Annotated[int, typer.Option("--seed", min=0, max=2**31 - 1, help="Same seed, same result.")]

TouchSd = Annotated[
    float, typer.Option(min=1e-3, help="How far off its dimple a tip rests, per axis [mm].")
]
Model = Annotated[
    Path, typer.Argument(metavar="MODEL", help="Model file, from `truejoint calibrate`.")
]
Level = Annotated[
    float | None,
    typer.Option(
        "--level",
        help="Probability of the stated interval [%]; default: 90.",
        autocompletion=complete.levels,
    ),
]
DatasetName = Annotated[
    str,
    typer.Argument(metavar="NAME", help="Name of the data set.", autocompletion=complete.datasets),
]


def share(percent: float | None) -> float | None:
    """Probability of so many percent, where they are given; raises CommandRefused if it is none."""
    if percent is None:
        return None
    if not 0.0 < percent < 100.0:
        raise CommandRefused(f"--level {percent:g}: give a probability between 0 and 100 %, as 90")
    return percent / 100.0


def recordings(name: str, help: str) -> Any:  # noqa: A002  # as typer calls it
    """Option that takes recordings as the argument of a command does."""
    return typer.Option(name, help=help, autocompletion=complete.recordings)


Recordings = Annotated[
    list[str],
    typer.Argument(
        metavar="RECORDING",
        help="Recording files, folders of a data set, or NAME:PATTERN of a public data set "
        "(`truejoint datasets` lists them).",
        autocompletion=complete.recordings,
    ),
]

RobotFile = Annotated[
    str,
    typer.Argument(
        metavar="ROBOT",
        help="Recording of the robot, without truth, or its bag.",
        autocompletion=complete.recordings,
    ),
]
OutRecording = Annotated[Path, typer.Option("--out", "-o", help="Recording to write, .parquet.")]


def _of_files(name: str, help: str, **more: Any) -> Any:  # noqa: A002
    """Option that says what recordings' files do not say themselves."""
    return typer.Option(name, help=help, rich_help_panel="What files do not say", **more)


Format = Annotated[
    str | None,
    _of_files(
        "--format",
        "Reader by name; default: found from the file.",
        autocompletion=complete.formats,
    ),
]
Columns = Annotated[
    Path | None,
    _of_files("--columns", "TOML file that names a file's columns; see `truejoint columns`."),
]
FilesRobot = Annotated[
    str | None,
    _of_files("--robot", "For files that do not say it.", autocompletion=complete.robots),
]
FilesArm = Annotated[
    str,
    _of_files("--arm", "Which arm; default: the robot's first.", autocompletion=complete.arms),
]
RateHz = Annotated[
    float | None, _of_files("--rate-hz", "Rate of the rows of a file without time stamps [Hz].")
]
TruthUnit = Annotated[
    str | None,
    _of_files("--truth-unit", "Of RAVEN's external encoders: rad_m, deg_m, deg_mm, ravenstate."),
]
HomingId = Annotated[
    str | None, _of_files("--homing-id", "Name of the homing that the positions refer to.")
]
LoadGrams = Annotated[float | None, _of_files("--load-grams", "Mass hung on the tool [g].")]
Session = Annotated[
    str | None, _of_files("--session", "Name of what was recorded in one go; default: the file's.")
]
Part = Annotated[
    str | None,
    typer.Option(
        "--part",
        metavar="FROM:TO",
        help="Only this part of each recording by time, for instance 0:0.7 or 0.7:1.",
    ),
]
Split = Annotated[
    str | None,
    typer.Option(
        "--split",
        help="Recommended split of a public data set: calibrate takes its training side, "
        "evaluate its held-out side.",
        autocompletion=complete.splits,
    ),
]
Tolerance = Annotated[
    list[str] | None,
    typer.Option(
        "--tolerance",
        metavar="JOINT=VALUE",
        help="Largest RMSE that you accept, in deg or mm, for instance elbow=0.2. Without "
        "one, a joint must beat raw position, fixed offset and any simpler model.",
        autocompletion=complete.tolerances,
    ),
]
JudgedAfter = Annotated[
    float,
    typer.Option(
        "--rezero-s",
        help="Re-zero on so much truth at the start of each recording, and judge the rest [s].",
    ),
]
