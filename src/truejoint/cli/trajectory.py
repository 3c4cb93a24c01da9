"""`truejoint trajectory`: make, look at and plot trajectories."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

import truejoint
from truejoint.cli import complete
from truejoint.cli.console import out, print_table, result_json, say
from truejoint.cli.inputs import read_trajectory
from truejoint.cli.options import Arm, Force, Json, RobotName, Seed
from truejoint.errors import TrajectoryError
from truejoint.files import check_target
from truejoint.robots.catalogue import DEFAULT
from truejoint.units import display_unit

app = typer.Typer(no_args_is_help=True, help="Make, look at and plot trajectories.")

Output = Annotated[Path, typer.Option("--out", "-o", help="CSV file to write.")]
Plot = Annotated[
    Path | None, typer.Option(help="Also draw it in 3-D: a .png picture or an .html page.")
]


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


@app.command(
    "zigzag",
    epilog="Example: `truejoint trajectory zigzag --direction J2-J3 --sparsity 1/4 -o zigzag.csv`",
)
def make_zigzag(
    output: Output,
    direction: Annotated[
        str,
        typer.Option(
            help="Joints that move, such as J2, J1-J3 or J1-J2-J3.",
            autocompletion=complete.directions,
        ),
    ] = "J2-J3",
    sparsity: Annotated[str, typer.Option(help="Line spacing as a share of the range.")] = "1/4",
    published: Annotated[
        bool, typer.Option("--published", help="J1-J2-J3 in the box of peng2024's own generator.")
    ] = False,
    robot: RobotName = DEFAULT,
    arm: Arm = "",
    plot: Plot = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Make a zig-zag path that covers the calibration workspace."""
    target = truejoint.get_robot(robot, arm)
    spacing = parse_sparsity(sparsity)
    trajectory = truejoint.motion.zigzag(target, direction, spacing, published=published)
    _tell(trajectory, target, plot, as_json, output=output, force=force)


@app.command(
    "random", epilog="Example: `truejoint trajectory random --minutes 20 --seed 7 -o random.csv`"
)
def make_random(
    output: Output,
    minutes: Annotated[float, typer.Option(help="How long it lasts [min].")] = 20.0,
    seed: Seed = 0,
    profile: Annotated[
        str,
        typer.Option(
            help="Speed along a swing: cosine, or laboratory as in peng2024.",
            autocompletion=complete.profiles,
        ),
    ] = "cosine",
    robot: RobotName = DEFAULT,
    arm: Arm = "",
    plot: Plot = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Make a random motion, to test a calibration on what it was not trained on."""
    target = truejoint.get_robot(robot, arm)
    trajectory = truejoint.motion.random_motion(
        target, duration=60.0 * minutes, seed=seed, profile=profile
    )
    _tell(trajectory, target, plot, as_json, output=output, force=force)


@app.command(
    "designed",
    epilog="Example: `truejoint trajectory designed --minutes 2.5 -o designed.csv`",
)
def make_designed(
    output: Output,
    minutes: Annotated[float, typer.Option(help="How long it lasts [min].")] = 2.5,
    seed: Seed = 0,
    robot: RobotName = DEFAULT,
    arm: Arm = "",
    plot: Plot = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Make the motion that is expected to tell most about the joints in so many minutes."""
    target = truejoint.get_robot(robot, arm)
    trajectory = truejoint.motion.designed_motion(target, 60.0 * minutes, seed)
    _tell(trajectory, target, plot, as_json, output=output, force=force)


@app.command(
    "nested", epilog="Example: `truejoint trajectory nested --robot forceps -o nested.csv`"
)
def make_nested(
    output: Output,
    seconds: Annotated[float, typer.Option(help="How long it lasts [s].")] = 65.0,
    robot: RobotName = "forceps",
    plot: Plot = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Make loops of three sizes, one inside the other, to calibrate a robot of one joint."""
    target = truejoint.get_robot(robot)
    trajectory = truejoint.motion.nested_motion(target, seconds)
    _tell(trajectory, target, plot, as_json, output=output, force=force)


@app.command("show", epilog="Example: `truejoint trajectory show zigzag.csv --plot zigzag.html`")
def show(
    path: Annotated[Path, typer.Argument(metavar="TRAJECTORY", help="Trajectory file.")],
    robot: RobotName = DEFAULT,
    arm: Arm = "",
    plot: Plot = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Show the range, the length and the duration of a trajectory."""
    target = truejoint.get_robot(robot, arm)
    _tell(read_trajectory(path), target, plot, as_json, force=force)


def _tell(
    trajectory: truejoint.motion.Trajectory,
    robot: truejoint.robots.Robot,
    plot: Path | None,
    as_json: bool,
    *,
    output: Path | None = None,
    force: bool = False,
) -> None:
    """Write and draw it where that is asked for, and say how far and how long it goes."""
    for path in filter(None, (output, plot)):
        check_target(path, overwrite=force)
    if output is not None:
        truejoint.motion.write_trajectory(trajectory, output, overwrite=force)
        say(f"wrote {output}")
    if plot is not None:
        truejoint.motion.plot_trajectories([trajectory], plot, overwrite=force)
        say(f"wrote {plot}")
    q = trajectory.positions
    ranges = {
        "lower": q.min(axis=0),
        "upper": q.max(axis=0),
        "path_length": abs(q[1:] - q[:-1]).sum(axis=0),
    }
    duration = truejoint.motion.nominal_duration(trajectory, robot)
    if as_json:
        result = {"name": trajectory.name, "joints": list(trajectory.joints)}
        plain = {name: values.tolist() for name, values in ranges.items()}
        result_json({**result, **plain, "duration": duration})
        return
    header = ("joint", "from", "to", "path", "unit")
    rows = []
    for name, *values in zip(trajectory.joints, *ranges.values(), strict=True):
        shown = display_unit(robot.joint(name).unit)
        rows.append((name, *(f"{value * shown.scale:.2f}" for value in values), shown.name))
    print_table(header, rows, title=trajectory.name)
    out.print(f"{duration / 60:.1f} min at the speed caps of {robot.title}")
