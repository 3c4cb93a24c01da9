"""Options that several commands share, so that they read the same everywhere."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

RobotName = Annotated[str, typer.Option("--robot", help="Robot model, or a robot file (.toml).")]
Arm = Annotated[str, typer.Option("--arm", help="Which arm; default: the robot's first.")]
Force = Annotated[bool, typer.Option("--force", help="Overwrite what is there.")]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
Seed = Annotated[int, typer.Option("--seed", help="Same seed, same result.")]

Recordings = Annotated[
    list[str],
    typer.Argument(
        metavar="RECORDING...",
        help="Recording files, folders of a data set, or NAME:PATTERN of a public data set "
        "(`truejoint datasets` lists them).",
    ),
]
Format = Annotated[
    str | None, typer.Option("--format", help="Reader by name; default: found from the file.")
]
Columns = Annotated[
    Path | None,
    typer.Option("--columns", help="TOML file that names a CSV file's columns and units."),
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
    ),
]
