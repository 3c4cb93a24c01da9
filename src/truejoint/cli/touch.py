"""`truejoint touch`: a block with dimples, taking the tip into them, what touches calibrate."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import typer

import truejoint
from truejoint.cli.console import command_line, out, print_table, progress, say
from truejoint.cli.driven_arm import Topics, home
from truejoint.cli.options import Result, get_robot, robot_and_arm
from truejoint.cli.recording_options import Files, NewModel, check_page_target
from truejoint.cli.show import is_model
from truejoint.errors import CalibrationError, CommandRefused
from truejoint.files import check_target, write_all_atomically, write_atomically
from truejoint.units import with_unit

if TYPE_CHECKING:
    from truejoint.recordings import Recorder
    from truejoint.tip import Block, BlockPose, Touches
    from truejoint.tip.fit import TipFit
    from truejoint.tip.plan import Stop, Task

    Seat = Callable[[Stop], float]

_MANY, _FEW = 30, 6  # touches that calibrate or find a block, and that re-zero a model by it
_AFTER: Final = 0.6  # [s] until what the arm did at rest has been recorded


def block(robot: str, output: Path = Path(), force: bool = False) -> Result:
    """Design a block of stairs to print: its shape, and its points with a map of their numbers."""
    from truejoint.tip.block import block_text

    shape = truejoint.tip.design_block(get_robot(robot))
    made = shape.block()
    output.mkdir(parents=True, exist_ok=True)
    contents = {"block.stl": shape.stl(), "block.toml": (shape.map() + block_text(made)).encode()}
    files = {output / name: data for name, data in contents.items()}
    write_all_atomically(files, overwrite=force, error=CalibrationError)
    reached, cells = int(shape.reached.sum()), shape.level.size
    size = " x ".join(f"{1e3 * v:g}" for v in shape.size)
    out.print(f"{output}: {made.name}, {size} mm, {reached} of {cells} dimples in reach")
    stands = []
    for number in (1, reached):
        place = 1e3 * (shape.rotation @ made.points[str(number)] + shape.translation)
        xyz = ", ".join(f"{x:.0f}" for x in place.tolist())
        stands.append(f"dimple {number} is about ({xyz}) mm")
    out.print(
        f"Stand it so that {' and '.join(stands)} from the base's origin, the dimples looking "
        "against the tool's way in."
    )
    say("print it at 100 %, measure along x, and enter measured_mm in block.toml")
    places = {"rotation": shape.rotation.tolist(), "translation": shape.translation.tolist()}
    return Result({"files": [str(path) for path in files], "dimples": reached, **places})


@dataclass(frozen=True)
class Aim:
    """What touches are for, an option each."""

    block: Path | None = None
    bolted: Path | None = None
    prior: Path | None = None

    def task(self, arm: str, model: Path | None) -> Task:
        """Task of the touches; refuse what does not go together."""
        from truejoint.tip.block import read_block, read_pose
        from truejoint.tip.plan import design_pose, learning, of_model

        if model is None:
            if self.block is None or self.bolted is not None:
                raise CommandRefused(
                    f"touch of {arm}, without a model, takes --block, and calibrates; to re-zero "
                    "or to find a block give the model file"
                )
            robot = get_robot(arm)
            pose = design_pose(read_block(self.block), robot)
            older = None if self.prior is None else truejoint.read_calibration(self.prior)
            return learning(robot, pose, older)
        if (self.block is None) == (self.bolted is None):
            raise CommandRefused(
                "touch run takes --block, to find where it stands, or --bolted, to re-zero by it"
            )
        if self.prior is not None:
            raise CommandRefused("--prior is for an arm without a model; leave it out")
        calibration = truejoint.read_calibration(model)
        if self.bolted is not None:
            return of_model(calibration, read_pose(self.bolted), finds_block=False)
        pose = design_pose(read_block(self.block or Path()), calibration.machine)
        return of_model(calibration, pose, finds_block=True)


class SteeredArm(Topics):
    """Which real arm a person steers into the dimples, if any, an option each."""


def run(
    arm: str,
    aim: Aim,
    live: SteeredArm,
    output: Path | None = None,
    count: int | None = None,
    twin: str = "nominal",
    seed: int = 0,
    force: bool = False,
) -> None:
    """Touch a block's dimples: which, in which order, and from which sides.

    A simulated arm is homed and driven; with --ros you steer a real one, and say when its tip is
    seated.
    """
    ending = Path(robot_and_arm(arm)[0]).suffix
    model = None if ending in {"", ".toml"} and not is_model(Path(arm)) else Path(arm)
    task = aim.task(arm, model)
    count = count or (_MANY if aim.bolted is None else _FEW)
    if count < task.fewest:
        raise CommandRefused(f"--count {count}: it takes {task.fewest} at least; give so many")
    stops = task.plan(count, seed)
    if output is None:
        rows = [(str(k), stop.dimple, stop.words) for k, stop in enumerate(stops, 1)]
        print_table(("touch", "dimple", "come with"), rows, title="Touches, in order")
        return
    if output.suffix != ".csv":
        raise CommandRefused(f"{output}: touches are written as .csv; name it so")
    path = output.with_suffix(".parquet")
    for target in (output, path):
        check_target(target, overwrite=force)
    is_real, pose = live.ros is not None, task.pose
    twins = partial(truejoint.crtk.simulated_arm, pose.robot, pose.arm, parameters=twin, seed=seed)
    about: dict[str, Any] = {"session": output.stem, "command": command_line()}
    with live.over_ros(task.robot) if is_real else twins() as device:
        seat = partial(prompted, device) if is_real else _by_hand(device, pose, seed)
        with truejoint.recordings.Recorder(device, path=path, overwrite=force, **about) as recorder:
            made = follow_plan(stops, recorder, seat, output, goes_on=is_real)
    out.print(f"{output}: {len(made)} touches of {task.pose.block.name}")
    following = "rezero" if aim.bolted else "touch bolt" if model else "touch calibrate"
    say(f"next: truejoint {following} (docs/tracker.md)")


def follow_plan(
    stops: Sequence[Stop], recorder: Recorder, seat: Seat, output: Path, *, goes_on: bool = False
) -> Touches:
    """Touch what is planned; each touch is written at once.

    `seat` seats the tip and gives the time at which that is done. Where the arm moved meanwhile
    that is refused or, if the run `goes_on`, said, and the stop comes again: a person may answer
    too early.
    """
    from truejoint.tip.touch import resting

    made: list[tuple[float, str]] = []
    while len(made) < len(stops):
        stop = stops[len(made)]
        t, recording = seat(stop), recorder.recording()
        start = recording.provenance.start
        stamp = t - (0.0 if math.isnan(start) else start)
        try:
            resting(recording, truejoint.tip.Touches((stamp,), (stop.dimple,)))
        except CalibrationError as error:
            if not goes_on:
                raise
            say(f"  {error}")
            continue
        made.append((stamp, stop.dimple))
        times, dimples = zip(*made, strict=True)
        touches = truejoint.tip.Touches(times, dimples)
        text = "t,dimple\n" + "".join(f"{t:.4f},{dimple}\n" for t, dimple in made)
        write_atomically(output, text.encode(), overwrite=True, error=CommandRefused)
    return touches


def _by_hand(device: truejoint.crtk.Arm, pose: BlockPose, seed: int) -> Seat:
    """Home the arm of a twin; a hand seats its tip in a block at `pose`."""
    from truejoint.calibration.compatibility import check_robot
    from truejoint.motion.touching import SimulatedHand

    check_robot((pose.robot, pose.arm), device.robot)
    home(device, None)
    hand = SimulatedHand(device, pose.rotation, pose.translation, seed=seed)

    def seat(stop: Stop) -> float:
        t = hand.touch(pose.scale * stop.point, stop.side)
        device.wait(_AFTER)
        return t

    return seat


def prompted(device: truejoint.crtk.Arm, stop: Stop, **how: Any) -> float:
    """Ask a person to seat the tip; gives the time of the state when that is said."""
    asked = f"dimple {stop.dimple}, come with {stop.words}; seated?"
    typer.prompt(asked, default="", show_default=False, **how)
    t = float(device.measured_js().t)
    threading.Event().wait(_AFTER)
    return t


def bolt(
    model: Path,
    touches: Path,
    block: Path,
    output: Path,
    recording: str | None = None,
    touch_sd_mm: float = 0.2,
    force: bool = False,
) -> Result:
    """Find where a bolted block stands, on the day of the full calibration."""
    check_target(output, overwrite=force)
    shape, calibration = truejoint.tip.read_block(block), truejoint.read_calibration(model)
    made = truejoint.tip.read_touches(touches)
    whole = Files().one(recording or str(touches.with_suffix(".parquet")), model=calibration)
    pose, fit = truejoint.tip.find_block(
        calibration, whole, made, shape, touch_sd=touch_sd_mm / 1e3
    )
    truejoint.tip.write_pose(pose, output, overwrite=force)
    sd = pose.covariance.diagonal() ** 0.5
    turn, shift = with_unit(float(sd[:3].max()), "rad"), with_unit(float(sd[3:].max()), "m")
    out.print(f"{output}: {pose.title}, within {turn} and {shift} (one standard deviation)")
    if abs(pose.scale / shape.scale - 1.0) > 3.0 * pose.scale_sd:
        off = 100.0 * (pose.scale / shape.scale - 1.0)
        say(f"the print is {off:+.2f} % of what its file says: measure it, and enter measured_mm")
    sds = {"turn_sd": sd[:3].tolist(), "shift_sd": sd[3:].tolist()}
    scale = {"scale": pose.scale, "scale_sd": pose.scale_sd}
    return Result({"pose": str(output), **sds, **scale, **report_touches(fit, made)})


def report_touches(fit: TipFit, touches: Touches) -> dict[str, Any]:
    """Print how well touches fit, and which were left out as outliers; gives the same as values."""
    rms = float((fit.residual[~fit.left_out] ** 2).sum(axis=1).mean() ** 0.5)
    out.print(f"{len(touches)} touches, {with_unit(rms, 'm')} off (RMS)")
    outliers = fit.left_out.nonzero()[0]
    for i in outliers:
        off = with_unit(float((fit.residual[i] ** 2).sum() ** 0.5), "m")
        say(
            f"left out: dimple {touches.dimple[i]} at {touches.t[i]:.1f} s, {off} off: badly "
            "seated, or another number?"
        )
    left_out = [touches.dimple[i] for i in outliers]
    return {"touches": len(touches), "left_out": left_out, "residual_rms": rms}


@dataclass(frozen=True)
class Sightings:
    """What was touched or shot, an option each."""

    touches: Path | None = None
    block: Path | None = None
    points: Path | None = None
    touch_sd_mm: float | None = None

    def __post_init__(self) -> None:
        if self.touches is None and self.points is None:
            raise CalibrationError("give --touches with --block, or --points")

    def read(self) -> tuple[Touches, Block, float]:
        """Read the touches and their block, or shots as such; with the deviation of one [m]."""
        from truejoint.tip.block import TOUCH_SD
        from truejoint.tip.touch import SHOT_SD

        tip = truejoint.tip
        if self.touches is not None and self.block is not None:
            touches, block = tip.read_touches(self.touches), tip.read_block(self.block)
        else:
            touches, block = tip.read_shots(self.points or Path())
        default = SHOT_SD if self.touches is None else TOUCH_SD
        return touches, block, default if self.touch_sd_mm is None else self.touch_sd_mm / 1e3


def calibrate(
    recording: str,
    new: NewModel,
    sightings: Sightings,
    files: Files,
    prior: Path | None = None,
    report: Path | None = None,
) -> Result:
    """Calibrate an arm without joint sensors, and say what the touches could not determine."""
    from truejoint.evaluation.report.page import write_touch_report

    check_page_target(report, new.force)
    older = None if prior is None else truejoint.read_calibration(prior)
    touches, block, sd = sightings.read()
    whole = files.one(recording)
    with progress("Fitting joints and frame"):
        fitted, touch_report = truejoint.tip.calibrate_by_touch(
            whole, touches, block, touch_sd=sd, prior=older
        )
    command = command_line()
    fitted = fitted.with_metadata(command=command)
    new.write(fitted)
    if report is not None:
        write_touch_report(fitted, touch_report, report, command=command, overwrite=new.force)
    report_touches(touch_report.fit, touch_report.touches)
    out.print(f"{new.output}, in the block's frame:")
    for text in (*touch_report.statement, *touch_report.not_seen):
        out.print(f"  {text}", soft_wrap=True)
    return Result({"model": str(new.output), "metadata": fitted.metadata})
