"""Options that several commands share, so that they read the same everywhere."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from truejoint.cli import complete

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
Seed = Annotated[int, typer.Option("--seed", help="Same seed, same result.")]

Model = Annotated[
    Path, typer.Argument(metavar="MODEL", help="Model file, from `truejoint calibrate`.")
]
DatasetName = Annotated[
    str, typer.Argument(help="Name of the data set.", autocompletion=complete.datasets)
]


def recordings(name: str, help: str) -> Any:  # noqa: A002  # as typer calls it
    """Option that takes recordings as the argument of a command does."""
    return typer.Option(name, help=help, autocompletion=complete.recordings)


Recordings = Annotated[
    list[str],
    typer.Argument(
        metavar="RECORDING...",
        help="Recording files, folders of a data set, or NAME:PATTERN of a public data set "
        "(`truejoint datasets` lists them).",
        autocompletion=complete.recordings,
    ),
]
Format = Annotated[
    str | None,
    typer.Option(
        "--format",
        help="Reader by name; default: found from the file.",
        autocompletion=complete.formats,
    ),
]
Columns = Annotated[
    Path | None,
    typer.Option("--columns", help="TOML file that names a CSV file's columns and units."),
]
FilesRobot = Annotated[
    str | None,
    typer.Option("--robot", help="For files that do not say it.", autocompletion=complete.robots),
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
