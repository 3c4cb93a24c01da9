"""`truejoint trajectory`: make a trajectory of one of four kinds."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple

import typer

import truejoint
from truejoint.cli import complete, options
from truejoint.cli.console import say
from truejoint.cli.show import tell_trajectory
from truejoint.errors import TrajectoryError, unknown
from truejoint.files import check_target
from truejoint.robots.catalogue import DEFAULT


def parse_sparsity(text: str) -> float:
    """Read ``"1/4"`` or ``"0.25"``; raises TrajectoryError when it is neither."""
    above, slash, below = text.partition("/")
    try:
        sparsity = float(above) / (float(below) if slash else 1.0)
    except (ValueError, ZeroDivisionError):
        sparsity = math.nan
    if not math.isfinite(sparsity):
        raise TrajectoryError(f"sparsity {text!r:.60} is not a number; write it as 1/4 or 0.25")
    return sparsity


class _Kind(NamedTuple):
    """How a kind of trajectory is made, and its options with their defaults."""

    make: Callable[[truejoint.robots.Robot, Mapping[str, Any]], truejoint.motion.Trajectory]
    defaults: Mapping[str, Any]


def _zigzag(robot: truejoint.robots.Robot, how: Mapping[str, Any]) -> truejoint.motion.Trajectory:
    sparsity = parse_sparsity(how["sparsity"])
    return truejoint.motion.zigzag(robot, how["direction"], sparsity, published=how["published"])


def _random(robot: truejoint.robots.Robot, how: Mapping[str, Any]) -> truejoint.motion.Trajectory:
    return truejoint.motion.random_motion(
        robot, duration=60.0 * how["minutes"], seed=how["seed"], profile=how["profile"]
    )


def _designed(robot: truejoint.robots.Robot, how: Mapping[str, Any]) -> truejoint.motion.Trajectory:
    return truejoint.motion.designed_motion(robot, 60.0 * how["minutes"], how["seed"])


def _nested(robot: truejoint.robots.Robot, how: Mapping[str, Any]) -> truejoint.motion.Trajectory:
    return truejoint.motion.nested_motion(robot, 60.0 * how["minutes"])


KINDS: Final = {
    "zigzag": _Kind(_zigzag, {"direction": "J2-J3", "sparsity": "1/4", "published": False}),
    "random": _Kind(_random, {"minutes": 20.0, "seed": 0, "profile": "cosine"}),
    "designed": _Kind(_designed, {"minutes": 2.5, "seed": 0}),
    "nested": _Kind(_nested, {"minutes": 65.0 / 60.0}),
}


def trajectory(
    kind: Annotated[
        str,
        typer.Argument(
            metavar="KIND",
            help="zigzag: lines over the calibration workspace. random: a test motion that no "
            "model was trained on. designed: the motion that is expected to tell most about the "
            "joints in its time. nested: loops of three sizes, for a robot of one joint.",
            autocompletion=lambda: list(KINDS),
        ),
    ],
    output: Annotated[Path, typer.Option("--out", "-o", help="CSV file to write.")],
    direction: Annotated[
        str | None,
        typer.Option(
            help="zigzag: joints that move, such as J2, J1-J3 or J1-J2-J3 (default J2-J3).",
            autocompletion=complete.directions,
        ),
    ] = None,
    sparsity: Annotated[
        str | None,
        typer.Option(help="zigzag: line spacing as a share of the range (default 1/4)."),
    ] = None,
    published: Annotated[
        bool | None,
        typer.Option("--published", help="zigzag J1-J2-J3 in the box of peng2024's generator."),
    ] = None,
    minutes: Annotated[
        float | None,
        typer.Option(help="random, designed, nested: duration [min] (default 20, 2.5 and 1.08)."),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(min=0, max=2**31 - 1, help="random, designed: same seed, same motion."),
    ] = None,
    profile: Annotated[
        str | None,
        typer.Option(
            help="random: speed along a swing, cosine (the default) or laboratory as in peng2024.",
            autocompletion=complete.profiles,
        ),
    ] = None,
    robot: options.RobotName = "",
    plot: Annotated[
        Path | None, typer.Option(help="Also draw it in 3-D: a .png picture or an .html page.")
    ] = None,
    force: options.Force = False,
    as_json: options.Json = False,
) -> None:
    """Make a trajectory for an arm to follow; `truejoint show` describes one."""
    if kind not in KINDS:
        raise TrajectoryError(unknown("kind of trajectory", kind, KINDS))
    stated = {
        "direction": direction, "sparsity": sparsity, "published": published, "minutes": minutes,
        "seed": seed, "profile": profile,
    }  # fmt: skip
    given = {name: value for name, value in stated.items() if value is not None}
    for name in given:
        if name not in KINDS[kind].defaults:
            takes = ", ".join(f"--{option}" for option in KINDS[kind].defaults)
            raise TrajectoryError(f"--{name}: a {kind} motion takes {takes}; leave it out")
    arm = options.get_robot(robot or ("forceps" if kind == "nested" else DEFAULT))
    made = KINDS[kind].make(arm, {**KINDS[kind].defaults, **given})
    for path in filter(None, (output, plot)):
        check_target(path, overwrite=force)
    truejoint.motion.write_trajectory(made, output, overwrite=force)
    say(f"wrote {output}")
    if plot is not None:
        truejoint.motion.plot_trajectories([made], plot, overwrite=force)
        say(f"wrote {plot}")
    tell_trajectory(made, arm, as_json=as_json)
