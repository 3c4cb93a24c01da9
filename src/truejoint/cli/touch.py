"""`truejoint touch run`: take an arm's tip into the dimples of a block that tell most."""

from __future__ import annotations

import shlex
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import typer

import truejoint
from truejoint.cli import options
from truejoint.cli.collect import home
from truejoint.cli.console import command_line, out, print_table, say
from truejoint.cli.options import takes
from truejoint.cli.show import is_model
from truejoint.cli.touch_calibrate import prior_calibrations
from truejoint.errors import CalibrationError, CommandRefused
from truejoint.files import check_target, write_atomically
from truejoint.units import shown

if TYPE_CHECKING:
    from truejoint.recordings import Recorder
    from truejoint.tip import BlockPose, Touches
    from truejoint.tip.guide import Guide, Stop, Task

    Seat = Callable[[Stop], float]

_MANY, _FEW = 30, 6  # touches that calibrate or find a block, and that re-zero a model by it
_AFTER: Final = 0.6  # [s] until what the arm did at rest has been recorded


@dataclass(frozen=True)
class Aim:
    """What touches are for, an option each."""

    block: Path | None = None
    bolted: Path | None = None
    prior: Path | None = None

    def task(self, arm: str, model: Path | None) -> Task:
        """Task of the touches; refuse what does not go together."""
        from truejoint.tip.files import read_block, read_pose
        from truejoint.tip.guide import design_pose, learning, of_model

        if model is None:
            if self.block is None or self.bolted is not None:
                raise CommandRefused(
                    f"touch of {arm}, without a model, takes --block, and calibrates; to re-zero "
                    "or to find a block give the model file"
                )
            robot, block = options.get_robot(arm), read_block(self.block)
            priors = [] if self.prior is None else prior_calibrations(self.prior)
            return learning(robot, design_pose(block, robot), priors)
        if (self.block is None) == (self.bolted is None):
            raise CommandRefused(
                "touch run takes --block, to find where it stands, or --bolted, to re-zero by it"
            )
        if self.prior is not None:
            raise CommandRefused("--prior is for an arm without a model; leave it out")
        calibration = truejoint.read_calibration(model)
        robot = calibration.machine
        if self.bolted is not None:
            return of_model(calibration, read_pose(self.bolted), finds_block=False)
        meant = design_pose(read_block(self.block or Path()), robot)
        return of_model(calibration, meant, finds_block=True)

    def following(self, arm: str, model: Path | None, output: Path) -> str:
        """Command that takes what was touched."""
        if self.bolted is not None:
            words = ["rezero", arm, "--touches", output, "--bolted", self.bolted]
        elif model is not None:
            words = ["touch", "bolt", arm, "--touches", output, "--block", self.block]
        else:
            priors = [] if self.prior is None else ["--prior", self.prior]
            recording = output.with_suffix(".parquet")
            touched = ["--touches", output, "--block", self.block]
            words = ["touch", "calibrate", recording, *touched, *priors]
        return shlex.join(str(word) for word in words)


@takes(aim=Aim)
def run(
    arm: str,
    output: Path | None = None,
    *,
    aim: Aim,
    touches: int | None = None,
    until_mm: float = 0.0,
    by_hand: bool = False,
    namespace: str = "",
    ros: int = 1,
    twin: str = "nominal",
    seed: int = 0,
    force: bool = False,
) -> None:
    """Touch a block's dimples: which, in which order, and from which sides.

    A simulated arm is homed and driven; with --by-hand you steer, and say when the tip is seated.
    From the fourth touch on each is compared with what the others say, and one that does not fit is
    asked for once more.
    """
    name = Path(options.robot_and_arm(arm)[0])
    is_robot = name.suffix in {"", ".toml"} and not is_model(Path(arm))
    model = None if is_robot else Path(arm)
    task = aim.task(arm, model)
    guide = _guide(task, touches or (_MANY if aim.bolted is None else _FEW), seed)
    if output is None:
        _print_plan(guide)
        return
    _check_output(output, overwrite=force)
    opened = _by_hand(task.robot, namespace, ros) if by_hand else _simulated(task.pose, twin, seed)
    with opened as (device, seat), _recorder(device, output, overwrite=force) as recorder:
        made = follow_guide(
            guide, recorder, seat, output, until_mm / 1e3, fewest=task.fewest, goes_on=by_hand
        )
    out.print(f"{output}: {len(made)} touches of {task.pose.block.name}")
    say(f"next: truejoint {aim.following(arm, model, output)} -o ...")


def _guide(task: Task, count: int, seed: int) -> Guide:
    """Plan so many touches; refuses fewer than the task takes."""
    from truejoint.tip.guide import Guide

    if count < task.fewest:
        raise CommandRefused(f"--touches {count}: it takes {task.fewest} at least; give so many")
    return Guide(task, count, seed=seed)


def _check_output(output: Path, *, overwrite: bool) -> None:
    if output.suffix != ".csv":
        raise CommandRefused(f"{output}: touches are written as .csv; name it so")
    for path in (output, output.with_suffix(".parquet")):
        check_target(path, overwrite=overwrite)


def _recorder(device: truejoint.crtk.Arm, output: Path, *, overwrite: bool) -> Recorder:
    """Record what the arm does while it touches, beside the file of the touches."""
    path, command = output.with_suffix(".parquet"), command_line()
    return truejoint.recordings.Recorder(
        device, path=path, overwrite=overwrite, session=output.stem, command=command
    )


def follow_guide(
    guide: Guide, recorder: Recorder, seat: Seat, output: Path, until: float, *,
    fewest: int = 0, goes_on: bool = False,
) -> Touches:  # fmt: skip
    """Touch what a guide says until all is touched, or the tip is stated to be within `until` [m].

    Not before `fewest` are made.

    `seat` seats the tip and gives the time at which that is done. Each touch is written at once.
    Where a touch is refused that is said and, if the run `goes_on`, the stop comes again: a person
    may answer too early. Touches that do not fit each other are said, and kept: of more it may be
    told which are wrong.
    """
    while (stop := guide.next_stop()) is not None:
        t = seat(stop)
        try:
            verdict = guide.take(stop, t, recorder.recording())
        except CalibrationError as error:
            is_made = guide.next_stop() is not stop
            if not (is_made or goes_on):
                raise
            say(f"  {error}")
            if is_made:
                _write(guide.touches(), output)
            continue
        _write(guide.touches(), output)
        if verdict.off is not None:
            off = shown(verdict.off, "m")
            say(f"  dimple {stop.dimple}: {off} off what the others say; touch it once more")
        if verdict.tip_sd is not None:
            near = shown(verdict.tip_sd, "m")
            say(f"  {verdict.count} touches: tip within {near} (one deviation)")
            if verdict.tip_sd <= until and verdict.count >= fewest:
                break
    return guide.touches()


def _write(touches: Touches, output: Path) -> None:
    rows = zip(touches.t, touches.dimple, strict=True)
    text = "t,dimple\n" + "".join(f"{t:.4f},{dimple}\n" for t, dimple in rows)
    write = partial(Path.write_text, data=text, encoding="utf-8")
    write_atomically(output, write, overwrite=True, error=CommandRefused)


def _print_plan(guide: Guide) -> None:
    rows = []
    count = 1
    while (stop := guide.next_stop()) is not None:
        rows.append((str(count), stop.dimple, stop.words))
        guide.skip(stop)
        count += 1
    print_table(("touch", "dimple", "come with"), rows, title="Touches, in order")


@contextmanager
def _simulated(pose: BlockPose, twin: str, seed: int) -> Iterator[tuple[truejoint.crtk.Arm, Seat]]:
    """Arm of a twin, homed, and a hand that steers it to a block at `pose`."""
    from truejoint.calibration.compatibility import check_robot
    from truejoint.motion.touching import SimulatedHand

    with truejoint.crtk.simulated_arm(pose.robot, pose.arm, parameters=twin, seed=seed) as device:
        check_robot((pose.robot, pose.arm), device.robot)
        home(device, None)
        hand = SimulatedHand(device, pose.rotation, pose.translation, seed=seed)

        def seat(stop: Stop) -> float:
            t = hand.touch(pose.scale * stop.point, stop.side)
            device.wait(_AFTER)
            return t

        yield device, seat
        hand.close()


@contextmanager
def _by_hand(
    robot: truejoint.robots.Robot, namespace: str, ros: int
) -> Iterator[tuple[truejoint.crtk.Arm, Seat]]:
    """Arm that others steer over ROS, and a person who says when its tip is seated."""
    from truejoint.cli.node import as_node
    from truejoint.crtk.backends.ros import RosBackend

    with as_node("truejoint_touch", ros) as transport:
        backend = RosBackend(transport, robot, namespace=namespace)
        with truejoint.crtk.Arm(backend, controls=False) as device:
            yield device, partial(prompted, device)


def prompted(device: truejoint.crtk.Arm, stop: Stop, **how: Any) -> float:
    """Ask a person to seat the tip; gives the time of the state when that is said."""
    typer.prompt(f"dimple {stop.dimple}, come with {stop.words}; seated?", default="", **how)
    t = float(device.measured_js().t)
    threading.Event().wait(_AFTER)
    return t
