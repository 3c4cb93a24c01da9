"""`truejoint trajectory`: make a trajectory of one of four kinds."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Final

import truejoint
from truejoint.cli import options
from truejoint.cli.console import say
from truejoint.cli.options import Result
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


# Options of each kind with their defaults.
KINDS: Final[dict[str, dict[str, Any]]] = {
    "zigzag": {"direction": "J2-J3", "sparsity": "1/4", "published": False},
    "random": {"minutes": 20.0, "seed": 0, "profile": "cosine"},
    "designed": {"minutes": 2.5, "seed": 0},
    "nested": {"minutes": 65.0 / 60.0},
}


def _make(
    kind: str, robot: truejoint.robots.Robot, how: dict[str, Any]
) -> truejoint.motion.Trajectory:
    """Make a trajectory by its options."""
    motion = truejoint.motion
    if kind == "zigzag":
        return motion.zigzag(robot, sparsity=parse_sparsity(how.pop("sparsity")), **how)
    duration = 60.0 * how.pop("minutes")
    if kind == "random":
        return motion.random_motion(robot, duration, **how)
    make = motion.designed_motion if kind == "designed" else motion.nested_motion
    return make(robot, duration, **how)


def trajectory(
    kind: str,
    output: Path,
    direction: str | None = None,
    sparsity: str | None = None,
    published: bool | None = None,
    minutes: float | None = None,
    seed: int | None = None,
    profile: str | None = None,
    robot: str = "",
    plot: Path | None = None,
    force: bool = False,
) -> Result:
    """Make a trajectory for an arm to follow; `truejoint show` describes one."""
    if kind not in KINDS:
        raise TrajectoryError(unknown("kind of trajectory", kind, KINDS))
    stated = {
        "direction": direction, "sparsity": sparsity, "published": published, "minutes": minutes,
        "seed": seed, "profile": profile,
    }  # fmt: skip
    stated_options = {name: value for name, value in stated.items() if value is not None}
    for name in stated_options:
        if name not in KINDS[kind]:
            takes = ", ".join(f"--{option}" for option in KINDS[kind])
            raise TrajectoryError(f"--{name}: a {kind} motion takes {takes}; leave it out")
    arm = options.get_robot(robot or ("forceps" if kind == "nested" else DEFAULT))
    made = _make(kind, arm, KINDS[kind] | stated_options)
    for path in filter(None, (output, plot)):
        check_target(path, overwrite=force)
    truejoint.motion.write_trajectory(made, output, overwrite=force)
    say(f"wrote {output}")
    if plot is not None:
        truejoint.motion.plot_trajectory(made, plot, overwrite=force)
        say(f"wrote {plot}")
    return tell_trajectory(made, arm)
