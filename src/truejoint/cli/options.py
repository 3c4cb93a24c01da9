"""Options that several commands share, so that they read the same everywhere."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import wraps
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, Final

import typer

import truejoint
from truejoint.cli import complete
from truejoint.errors import CommandRefused

RobotName = Annotated[
    str,
    typer.Option(
        "--robot",
        metavar="ROBOT[:ARM]",
        help="Robot model or robot file (.toml), and which arm of it, as raven2:right "
        "(default: its first arm).",
        autocompletion=complete.robots,
    ),
]
Force = Annotated[bool, typer.Option("--force", help="Overwrite what is there.")]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
Seed = Annotated[int, typer.Option("--seed", min=0, max=2**31 - 1, help="Same seed, same result.")]

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


def share(percent: float | None) -> float | None:
    """Probability of so many percent, where they are given; raises CommandRefused if it is none."""
    if percent is None:
        return None
    if not 0.0 < percent < 100.0:
        raise CommandRefused(f"--level {percent:g}: give a probability between 0 and 100 %, as 90")
    return percent / 100.0


def robot_and_arm(text: str) -> tuple[str, str]:
    """Split ``"raven2:right"`` into robot and arm; the arm is empty where none is named."""
    name, separator, arm = text.rpartition(":")
    return (name, arm) if separator else (text, "")


def get_robot(text: str) -> truejoint.robots.Robot:
    """Look up the robot arm of ``"raven2:right"``; raises RobotError if there is none."""
    return truejoint.get_robot(*robot_and_arm(text))


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


_OVERRIDES: Final = "Metadata overrides"
Columns = Annotated[
    Path | None,
    typer.Option(
        "--columns",
        help="Column map (.toml) of the file; `truejoint columns` writes one.",
        rich_help_panel=_OVERRIDES,
    ),
]
FilesRobot = Annotated[
    str | None,
    typer.Option(
        "--robot",
        metavar="ROBOT[:ARM]",
        help="Robot, if the file does not name it, and which arm, as raven2:right.",
        rich_help_panel=_OVERRIDES,
        autocompletion=complete.robots,
    ),
]
Metadata = Annotated[
    list[str] | None,
    typer.Option(
        "--metadata",
        metavar="KEY=VALUE",
        help="What the file does not say; once for each: homing_id, load_grams, session, format, "
        "rate_hz (of rows without stamps), truth_unit (rad_m, deg_m, deg_mm or ravenstate).",
        rich_help_panel=_OVERRIDES,
        autocompletion=complete.metadata,
    ),
]
FitRateHz = Annotated[
    float | None,
    typer.Option(
        "--fit-rate-hz",
        help="Fit to rows at most at this rate [Hz]; features with a memory still see every row.",
    ),
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
Profile = Annotated[
    str,
    typer.Option(
        "--profile",
        help="How the robot's messages differ from CRTK (default: the robot's own profile).",
        autocompletion=complete.message_profiles,
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


def takes(**groups: type) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a command the options that are the fields of dataclasses; it takes each by its name.

    In the help they stand where the dataclass does among the command's own.
    """

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        own = inspect.signature(command, eval_str=True).parameters
        of = {name: inspect.signature(kind, eval_str=True).parameters
              for name, kind in groups.items()}  # fmt: skip

        @wraps(command)
        def run(**given: Any) -> None:
            made = {
                name: groups[name](**{field: given.pop(field) for field in fields})
                for name, fields in of.items()
            }
            command(**given, **made)

        taken = (of[name].values() if name in of else [p] for name, p in own.items())
        parameters = [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in chain(*taken)]
        run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        run.__annotations__ = {p.name: p.annotation for p in parameters}
        return run

    return decorate
