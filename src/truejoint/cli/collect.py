"""`truejoint collect`: drive an arm along trajectories and record it."""

from __future__ import annotations

import math
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import truejoint
from truejoint.cli.console import command_line, out, progress, say
from truejoint.cli.driven_arm import RealArm, home
from truejoint.cli.options import Result, make_twin
from truejoint.cli.recording_options import read_trajectory, say_dropped
from truejoint.errors import CommandRefused, RecordingError
from truejoint.files import check_target
from truejoint.robots.catalogue import DEFAULT

if TYPE_CHECKING:
    from truejoint.recordings.joint_encoders import JointEncoders
    from truejoint.recordings.recorder import TruthSource

_REZERO: Final = 10.0  # of random motion [s]


def record(
    arm: truejoint.crtk.Arm,
    trajectory: truejoint.motion.Trajectory,
    target: Path,
    *,
    label: str = "",
    steering: truejoint.runtime.Compensator | None = None,
    **how: Any,
) -> tuple[truejoint.Recording, truejoint.motion.TrackingReport]:
    """Follow a trajectory with a homed arm and write what it does, `how` as `Recorder` takes it.

    Shows progress; gives the recording, and how the trajectory was kept. Whatever stops the motion,
    what was recorded until then is kept, under a name of its own.
    """
    how |= {"session": trajectory.name, "command": command_line()}
    recorder = truejoint.recordings.Recorder(arm, path=target, **how)
    try:
        with progress(label or f"Following {trajectory.name}") as done, recorder:
            report = truejoint.motion.follow(arm, trajectory, progress=done, steering=steering)
    except BaseException:
        if recorder.written is not None:
            say(f"stopped; what was recorded until then is in {recorder.written}")
        raise
    return recorder.recording(str(target)), report


@dataclass(frozen=True)
class Loop:
    """What closes a loop around the arm, if anything does, an option each."""

    compensate: Path | None = None
    rezero_s: float | None = None
    closed_loop: bool = False
    lag_s: float | None = None

    def __post_init__(self) -> None:
        for option, value in {"--rezero-s": self.rezero_s, "--lag-s": self.lag_s}.items():
            if value is not None and not math.isfinite(value):
                raise CommandRefused(f"{option} {value:g}: give seconds")

    def read(self, robot: truejoint.robots.Robot) -> truejoint.Calibration | None:
        """Read the model that the loop is around; raises CalibrationError if of another robot."""
        if self.compensate is None:
            return None
        model = truejoint.read_calibration(self.compensate)
        model.check_robot(robot)
        return model

    def around(
        self,
        device: truejoint.crtk.Arm,
        model: truejoint.Calibration | None,
        truth: TruthSource | None,
    ) -> truejoint.runtime.Compensator | None:
        """Close the loop around a homed arm, a model re-zeroed by a random motion's truth."""
        from truejoint.runtime.compensator import LAG

        lag = LAG if self.lag_s is None else self.lag_s
        if model is None:
            return truejoint.runtime.motor_loop(device.robot, lag=lag) if self.closed_loop else None
        duration = _REZERO if self.rezero_s is None else self.rezero_s
        if duration > 0.0:
            motion = truejoint.motion.random_motion(device.robot, duration, profile="laboratory")
            with truejoint.recordings.Recorder(device, truth=truth) as brief:
                truejoint.motion.follow(device, motion)
            model = model.at(truejoint.calibration.find_zero(model, brief.recording()))
        corrector = truejoint.runtime.Corrector(model.without_redundant())
        corrector.set_homing(True, device.homing_id or None)
        return truejoint.runtime.Compensator(corrector, device.robot, lag=lag)


@dataclass(frozen=True)
class Simulated:
    """The simulated arm, an option each."""

    robot: str = DEFAULT
    seed: int = 0
    load_grams: float = 0.0
    twin: str = "nominal"
    real_time: bool = False

    @property
    def load(self) -> float:
        """Mass hung on the tool [kg]."""
        return self.load_grams / 1e3

    def backend(self) -> truejoint.crtk.Backend:
        """Switch it on, not homed."""
        made = make_twin(self.robot, parameters=self.twin, seed=self.seed, load=self.load)
        crtk = truejoint.crtk
        return (crtk.PacedBackend if self.real_time else crtk.SimulatedBackend)(made)


def collect(
    trajectories: list[Path],
    output: Path,
    simulated: Simulated,
    real: RealArm,
    loop: Loop,
    encoders: str | None = None,
    state_rate_hz: float = 30.0,
    resume: bool = False,
    force: bool = False,
) -> Result:
    """Home an arm, simulated or with --ros real, drive it along trajectories and record each.

    All trajectories of one call share one homing, as in one session with a robot. A command that
    is stopped leaves what it recorded; with --resume it continues. Trajectories are set-points of
    the motors; with --compensate positions of the joints, with --closed-loop reported positions.
    """
    from truejoint.recordings.joint_encoders import JointEncoders

    pairs = _to_record(trajectories, output, resume=resume, force=force)
    if not pairs:
        say("nothing is left to record")
        return Result({"recordings": []})
    with ExitStack() as stack:
        device = stack.enter_context(real.or_twin(simulated.robot, simulated.backend))
        for trajectory, _ in pairs:
            trajectory.check_within(device.robot)
            truejoint.motion.nominal_duration(trajectory, device.robot)  # refuses what is too fast
        model = loop.read(device.robot)
        output.mkdir(parents=True, exist_ok=True)
        truth: JointEncoders | None = None
        if encoders is not None:
            port = JointEncoders(encoders, device.robot.encoders, clock=lambda: device.time)
            truth = stack.enter_context(port)
        home(device, truth)
        steering = loop.around(device, model, truth)
        how: dict[str, Any] = {
            "load": simulated.load, "state_rate": state_rate_hz, "truth": truth,
            "steering": steering, "overwrite": force,
        }  # fmt: skip
        rows = []
        for trajectory, target in pairs:
            recording, report = record(device, trajectory, target, **how)
            size = f"{target.stat().st_size / 1e6:.1f} MB"
            out.print(f"{target}: {len(recording)} rows, {size}; {report}")
            say_dropped(recording)
            facts = {"tracking": report.to_dict(), "dropped": recording.provenance.dropped}
            rows.append({"file": str(target), "rows": len(recording), **facts})
    if steering is not None:
        steps, counts = max(steering.statuses.total(), 1), steering.statuses.most_common()
        shares = ", ".join(f"{status.name} {100 * n / steps:.1f} %" for status, n in counts)
        say(f"steps of the loop by status: {shares}")
    return Result({"recordings": rows})


def _to_record(
    trajectories: list[Path], output: Path, *, resume: bool, force: bool
) -> list[tuple[truejoint.motion.Trajectory, Path]]:
    """Trajectories that are still to be recorded, and where to; refused before the robot moves."""
    targets = [output / f"{path.stem}.parquet" for path in trajectories]
    pairs = []
    for path, target in zip(trajectories, targets, strict=True):
        if targets.count(target) > 1:
            raise RecordingError(
                f"{target}: two trajectories have the same file name; rename one of them"
            )
        if resume and target.exists() and len(truejoint.recordings.read_parquet(target)):
            say(f"{target}: recorded already")
            continue
        pairs.append((read_trajectory(path), target))
        check_target(target, overwrite=force, makes_folder=True)
    return pairs
