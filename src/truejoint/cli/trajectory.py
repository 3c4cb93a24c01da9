"""`truejoint trajectory`: make a trajectory of one of four kinds."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, cast

import truejoint
from truejoint.cli.console import say
from truejoint.cli.options import Result, get_robot
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


# Options of each kind; what is not stated is as the motion has it.
KINDS: Final = {
    "zigzag": ("direction", "sparsity", "published"),
    "random": ("duration_s", "seed"),
    "designed": ("duration_s", "seed"),
    "nested": ("duration_s",),
}


@dataclass(frozen=True)
class Shape:
    """What a trajectory is like, an option each."""

    direction: str | None = None
    sparsity: str | None = None
    published: bool | None = None
    duration_s: float | None = None
    seed: int | None = None

    def make(self, kind: str, robot: "truejoint.robots.Robot") -> "truejoint.motion.Trajectory":
        """Make a trajectory; raises TrajectoryError for an option that is not of its kind."""
        how = {name: value for name, value in vars(self).items() if value is not None}
        for name in how:
            if name not in KINDS[kind]:
                takes = ", ".join(f"--{option}" for option in KINDS[kind]).replace("_", "-")
                raise TrajectoryError(
                    f"--{name.replace('_', '-')}: a {kind} motion takes {takes}; leave it out"
                )
        if self.sparsity is not None:
            how["sparsity"] = parse_sparsity(self.sparsity)
        if self.duration_s is not None:
            how["duration"] = how.pop("duration_s")
        box = truejoint.motion.DIRECTIONS[-1]
        if self.published and str(self.direction).upper() != box:
            raise TrajectoryError(f"--published: is the box of {box}; give --direction {box}")
        maker: Any = getattr(truejoint.motion, kind if kind == "zigzag" else f"{kind}_motion")
        return cast("truejoint.motion.Trajectory", maker(robot, **how))


def trajectory(
    kind: str,
    output: Path,
    shape: Shape,
    robot: str = "",
    plot: Path | None = None,
    force: bool = False,
) -> Result:
    """Make a trajectory for an arm to follow; `truejoint show` describes one."""
    if kind not in KINDS:
        raise TrajectoryError(unknown("kind of trajectory", kind, KINDS))
    arm = get_robot(robot or ("forceps" if kind == "nested" else DEFAULT))
    made = shape.make(kind, arm)
    for path in filter(None, (output, plot)):
        check_target(path, overwrite=force)
    if plot is not None:
        truejoint.motion.plot_trajectory(made, plot, overwrite=force)
        say(f"wrote {plot}")
    truejoint.motion.write_trajectory(made, output, overwrite=force)
    say(f"wrote {output}")
    return tell_trajectory(made, arm)
