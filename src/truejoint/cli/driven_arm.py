"""The arm that a command drives: a digital twin's, or with `--ros` a real one's."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from threading import Timer
from typing import TYPE_CHECKING, Any, Final

import typer

import truejoint
from truejoint.cli import options
from truejoint.cli.console import say
from truejoint.cli.node import joined
from truejoint.errors import CommandRefused, RosError
from truejoint.units import shown

if TYPE_CHECKING:
    from truejoint.cli.recording_options import Files
    from truejoint.crtk import Arm, Backend
    from truejoint.recordings.joint_encoders import JointEncoders
    from truejoint.robots import Robot

_LOOK: Final = 0.3  # [s] in which a set-point that is moved shows it
_MOVED: Final = 0.1  # of the tolerance of what has arrived: one that is held does not move at all
_SOON, _BUTTON = 2.0, 120.0  # [s] until a person is told of the button, and waited for


@dataclass(frozen=True)
class Topics:
    """Which arm on ROS's topics, if any, an option each."""

    ros: int | None = None
    namespace: str = ""
    profile: str = ""

    @contextmanager
    def over_ros(
        self, robot: Robot, truth: str = "", beside: Sequence[str] = (), *, controls: bool = False
    ) -> Iterator[Arm]:
        """Look on while others move the arm or, where it `controls`, be the only one who does."""
        with joined("truejoint", self.ros or 1) as transport:
            connected = partial(
                truejoint.crtk.RosBackend, transport, robot, self.profile,
                namespace=self.namespace, truth=truth, beside=beside,
            )  # fmt: skip
            with truejoint.crtk.Arm(connected(), controls=False) as device:
                if not controls:
                    yield device
                    return
                if _is_moved(device):
                    raise CommandRefused(
                        f"{robot.title} is moving: another program controls it; end that first"
                    )
            with truejoint.crtk.Arm(connected()) as device:
                yield device


@dataclass(frozen=True)
class ArmOnTopics(Topics):
    """Which arm on ROS's topics with its truth, if any, an option each."""

    truth: str = ""


@dataclass(frozen=True)
class RealArm(ArmOnTopics):
    """Whether a real arm is driven, and which, an option each."""

    yes_move_it: bool = False
    beside: list[str] | None = None

    @contextmanager
    def or_twin(self, title: str, backend: Callable[[], Backend]) -> Iterator[Arm]:
        """Switch on the arm of a twin or control, once its name is typed, the one on ROS's topics.

        Raises CommandRefused if another name is, or none can be.
        """
        if self.ros is None:
            with truejoint.crtk.Arm(backend()) as device:
                yield device
            return
        robot = options.get_robot(title)
        fastest = {
            joint.unit: shown(joint.max_speed, f"{joint.unit}/s")
            for joint in sorted(robot.joints, key=lambda joint: joint.max_speed)
        }
        name = f"{robot.name}:{robot.arm}" if robot.arm else robot.name
        what = f"a real arm moves, {name}, at up to {' and '.join(fastest.values())}"
        if not (self.yes_move_it or sys.stdin.isatty()):
            raise CommandRefused(f"{what}: agree in a terminal, or give --yes-move-it")
        prompt = f"{what}. Type its name to go on"
        if not self.yes_move_it and typer.prompt(prompt, default="", err=True) != name:
            raise CommandRefused("nothing was moved: another name was typed")
        with self.over_ros(robot, self.truth, self.beside or (), controls=True) as device:
            yield device


@dataclass(frozen=True)
class BriefTruth(ArmOnTopics):
    """A recording that is made on the spot, in place of a file, an option each."""

    duration_s: float = 10.0

    def read(
        self,
        name: str | None,
        files: Files,
        model: truejoint.Calibration,
        *,
        potentiometers: bool = False,
    ) -> truejoint.Recording:
        """Read a recording or, with `--ros`, record the model's arm while others move it."""
        from truejoint.crtk.messages import POT_TOPIC, profile_of

        if self.ros is None:
            if name is None:
                raise CommandRefused("name a RECORDING, or give --ros and --truth")
            return files.one(name, model=model)
        robot, duration, dt = model.machine, self.duration_s, model.origin.sample_dt
        if not 1.0 <= duration <= 600.0:
            raise CommandRefused(
                f"--duration-s {duration:g}: give 1 to 600 s for what is recorded now"
            )
        topic = profile_of(robot, self.profile).topic(robot.arm, POT_TOPIC, self.namespace)
        beside = [topic] if potentiometers else []
        with self.over_ros(robot, self.truth, beside) as device:
            if not device.operating_state().is_homed:
                raise CommandRefused(f"{robot.title} is not homed: home it first")
            say(f"Recording {robot.title} for {duration:g} s ...")
            how: dict[str, Any] = {"state_rate": 1.0 / dt} if dt else {}
            with truejoint.recordings.Recorder(device, **how) as recorder:
                device.wait(duration)
                device.operating_state()  # of an arm that has fallen silent there is none
            recording = recorder.recording()
            if not potentiometers and not recording.joints_of("truth"):
                raise RosError(f"{self.truth}: no truth came within {duration:g} s; does it run?")
        return recording


def _is_moved(device: Arm) -> bool:
    """Whether others are at it: it says that it is busy, or its set-point does not stand."""
    from truejoint.crtk.backends.ros import TOLERANCE
    from truejoint.crtk.protocol import SILENCE

    state = device.operating_state()
    if not state.is_ready:
        return state.is_busy
    device.wait(_LOOK)  # until its set-point has been heard: motors may stand off it
    before = after = device.setpoint_js(SILENCE)
    while after.t - before.t < _LOOK:
        device.wait(_LOOK)
        after = device.setpoint_js(SILENCE)
    moved = abs(after.position - before.position)
    least = [_MOVED * TOLERANCE[joint.unit] for joint in device.robot.joints]
    return bool((moved > least).any())


def home(device: Arm, truth: JointEncoders | None) -> None:
    """Enable and home an arm, and register its joint encoders at the hard stops meanwhile."""
    # A RAVEN-II's state machine waits for its button, or for its pedal.
    hint = Timer(_SOON, say, [f"{device.robot.title} is not enabled: press its button or pedal"])
    try:
        hint.start()
        (device.resume if device.operating_state().state == "PAUSED" else device.enable)(_BUTTON)
    finally:
        hint.cancel()
    if truth is None and device.operating_state().is_homed:
        return
    say(f"Homing {device.robot.title} ...")
    if truth is not None:
        truth.start_registration()
    device.home()
    if truth is not None:
        truth.register()
