"""A corrector as a node: measured joints come in on a ROS topic, corrected ones go out."""

import math
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, Self

import numpy as np

from truejoint.array_types import Array
from truejoint.crtk.messages import CORRECTED, JOINT_STATE, STRING_STAMPED, profile_of
from truejoint.crtk.protocol import SILENCE
from truejoint.crtk.ros import Publisher, StateStream, Transport
from truejoint.crtk.ros.transport import header_of
from truejoint.errors import RosError
from truejoint.robots import Robot
from truejoint.runtime.corrector import Corrector
from truejoint.runtime.status import Status, Unlearnt

DIAGNOSTICS: Final = "diagnostic_msgs/DiagnosticArray"
_OK, _WARN, _ERROR, _STALE = range(4)  # levels of diagnostic_msgs/DiagnosticStatus
QUIET: Final = 0.4
"""Time without a message after which the status is `SILENT` [s], at least; it is three times that
between the last two messages for a robot that says something less often."""
SILENT: Final = "SILENT"
_WATCH: Final = 0.05  # between looks for that [s]
_ADVICE: Final = {
    Status.NOT_HOMED: "home the robot, or start the node that publishes operating_state",
    Status.HOMED_AGAIN: "re-zero the model after this homing (truejoint rezero), or state "
    "--metadata homing_id=if its positions refer to the same one",
    Status.ZERO_SUSPECT: "a measured position has jumped: home the robot again",
}


class CorrectorNode:
    """Corrects the joint states of an arm as they come, from entering to leaving.

    Beside the arm's own topics, in ``<namespace>/corrected``: ``measured_js``, the input with the
    calibrated joints corrected and the stamp as it came; ``half_width``, a JointState of these
    joints whose position is how far off they may be, infinite where that is not known; ``status``,
    a StringStamped of the stamp from which on it holds, sent when it changes, and ``SILENT`` where
    no message comes. Once a second ``/diagnostics`` says how all that goes.

    The first of the `correctors` whose signals the arm's topics have is used: one that also checks
    redundant signals, then one without. Positions refer to the homing `homing_id` until the robot
    is homed again; `say` is told in a line what is waited for and what has changed. `received` and
    `corrected` count messages of `topic`. Raises RobotError if there is no such profile
    (`truejoint.crtk.messages.PROFILES`), RosError where message types are not installed.
    """

    def __init__(
        self,
        transport: Transport,
        correctors: Sequence[Corrector],
        robot: Robot,
        profile: str = "",
        *,
        namespace: str = "",
        homing_id: str | None = None,
        say: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._transport, self._robot, self._say = transport, robot, say
        self._profile = profile_of(robot, profile)
        self._choices = tuple(correctors)
        self._homing_id = homing_id
        self._stream = StateStream(transport, robot, self._profile, self._on_state, namespace)
        self.topic = self._stream.topic
        self.received = self.corrected = 0
        self._corrector: Corrector | None = None
        self._is_homed: bool | None = None  # as the robot said last
        self._was_lost = False  # its homing, since the last sample
        self._told: bool | None = None  # as the corrector was told
        self._status: Status | None = None
        self._heard, self._interval = math.inf, 0.0  # of the last message [s]
        # Messages since the last report, their status bits, and the warnings.
        self._recent = self._bits = self._unlearnt = 0
        self._said = ""
        self._over = threading.Event()
        self._correcting = threading.Lock()
        self._endings: list[Callable[[], None]] = []

    def __enter__(self) -> Self:
        space = self._stream.name(CORRECTED)
        try:
            self._out = self._made(f"{space}/measured_js", JOINT_STATE)
            self._half_width = self._made(f"{space}/half_width", JOINT_STATE)
            self._status_out = self._made(f"{space}/status", STRING_STAMPED, latched=True)
            self._diagnostics = self._made("/diagnostics", DIAGNOSTICS)
            topic, kind = self._stream.name("operating_state"), self._profile.operating_state
            ending = self._transport.subscribe(topic, kind, self._on_operating_state)
            self._endings.append(ending)
            self._stream.start()
        except BaseException:
            self.__exit__()
            raise
        return self

    def _made(self, topic: str, kind: str, *, latched: bool = False) -> Publisher:
        """Begin to write a topic, until leaving."""
        made = self._transport.publisher(topic, kind, latched=latched)
        self._endings.append(made.close)
        return made

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._stream.close()
        while self._endings:
            self._endings.pop()()

    def run(self, duration: float = math.inf) -> None:
        """Report once a second until `stop`, for `duration` [s] or until the node is shut down."""
        now = next_report = time.monotonic()
        end = now + duration
        while not (self._over.is_set() or self._transport.is_over or now >= end):
            if now >= next_report:
                self._report()
                next_report = now + SILENCE
            self._watch(now)
            self._over.wait(min(_WATCH, end - now))
            now = time.monotonic()

    def stop(self) -> None:
        """End `run`, from any thread."""
        self._over.set()

    def _watch(self, now: float) -> None:
        """Say in the status, once, that no message comes."""
        with self._correcting:  # so that the status of a message is not followed by this one
            is_quiet = now - self._heard > max(QUIET, 3.0 * self._interval)
            if is_quiet and self._status is not None:
                self._status = None  # that of the next message is news
                text = self._transport.stamped(STRING_STAMPED, self._transport.now())
                text.string = SILENT
                self._status_out.publish(text)

    def _on_operating_state(self, message: Any) -> None:
        self._is_homed = bool(message.is_homed)
        self._was_lost |= not message.is_homed

    def _on_state(self, message: Any, t: float, columns: Mapping[str, Array]) -> None:
        """Correct a message in whatever thread it comes: a robot that returns has another one."""
        with self._correcting:
            self._correct(message, t, columns)
            if self._corrector is not None:
                self._corrector.release()

    def _correct(self, message: Any, t: float, columns: Mapping[str, Array]) -> None:
        now = time.monotonic()
        self._interval = max(now - self._heard, 0.0)
        self._heard = now
        self.received += 1
        self._recent += 1
        choices = self._choices if self._corrector is None else (self._corrector,)
        corrector = next((c for c in choices if columns.keys() >= set(c.signals)), None)
        if corrector is None:
            lacking = [signal for signal in choices[-1].signals if signal not in columns]
            advice = "give the profile or topics that have them, or calibrate on others (--feature)"
            self._stream.refusal = (
                f"{self.topic} has no {', '.join(lacking)}, which the model needs: "
                f"{self._stream.stale or advice}"
            )
            return
        self._corrector = corrector
        if self._was_lost or self._is_homed is not self._told:
            self._tell_homing(corrector)
        sample = [columns[signal][0] for signal in corrector.signals]
        status = corrector.step(t, np.array(sample, dtype=np.float64))
        self._bits |= status
        self._unlearnt |= corrector.unlearnt
        if not (status and corrector.on_fault.reaction == "silent"):
            self._publish(message, columns, corrector)
        if status is not self._status:
            self._status = status
            text = self._transport.message(STRING_STAMPED)
            text.header.stamp, text.string = header_of(message).stamp, status.name
            self._status_out.publish(text)
        if status == 0:
            self.corrected += 1

    def _tell_homing(self, corrector: Corrector) -> None:
        if self._was_lost:
            self._was_lost, self._homing_id = False, None  # the next homing is another
            corrector.set_homing(False)
        self._told = self._is_homed
        if self._told:
            corrector.set_homing(True, self._homing_id)

    def _publish(self, message: Any, columns: Mapping[str, Array], corrector: Corrector) -> None:
        out = self._transport.message(JOINT_STATE)
        out.header.stamp = header_of(message).stamp
        if self._stream.reads_raven:
            joints: Sequence[str] = self._robot.joint_names
            out.name = list(joints)
            out.position, out.velocity, out.effort = (
                [float(columns[f"{quantity}/{joint}"][0]) for joint in joints]
                for quantity in ("measured", "velocity", "effort")
            )
        else:
            joints = [name.partition("/")[2] for name in columns if name.startswith("measured/")]
            out.header.frame_id = message.header.frame_id
            out.name, out.position = message.name, list(message.position)
            out.velocity, out.effort = message.velocity, message.effort
        for joint, value in zip(corrector.joints, corrector.position.tolist(), strict=True):
            out.position[joints.index(joint)] = value
        self._out.publish(out)
        if self._half_width.readers:
            width = self._transport.message(JOINT_STATE)
            width.header.stamp = header_of(message).stamp
            width.name, width.position = list(corrector.joints), corrector.half_width.tolist()
            self._half_width.publish(width)

    def _report(self) -> None:
        """Say how it goes: to a person what has changed, to ``/diagnostics`` all."""
        with self._correcting:
            recent, bits, unlearnt = self._recent, Status(self._bits), Unlearnt(self._unlearnt)
            self._recent = self._bits = self._unlearnt = 0
        array = self._transport.stamped(DIAGNOSTICS, self._transport.now())
        status = self._transport.message("diagnostic_msgs/DiagnosticStatus")
        status.level, status.message = self._judge(bits, unlearnt)
        status.name, status.hardware_id = f"truejoint: {self._robot.title}", self._robot.title
        if status.message != self._said:
            self._said = status.message
            self._say(self._said)
        facts = {
            "input": self.topic,
            "messages received": self.received,
            "messages corrected": self.corrected,
            "messages with an invalid stamp": self._stream.invalid,
            "messages in the last second": recent,
            "status": bits.name if recent else "none",
        }
        if self._corrector is not None:
            width = self._corrector.half_width
            names = (f"half-width of {joint}" for joint in self._corrector.joints)
            facts |= dict(zip(names, width, strict=True))
        for key, value in facts.items():
            pair = self._transport.message("diagnostic_msgs/KeyValue")
            pair.key, pair.value = key, str(value)
            status.values.append(pair)
        array.status.append(status)
        self._diagnostics.publish(array)

    def _judge(self, bits: Status, unlearnt: Unlearnt) -> tuple[int, str]:
        """Level of diagnostic_msgs and a line on how the last second went."""
        if self._stream.refusal:
            return _ERROR, self._stream.refusal
        if not self.received:
            return _STALE, f"waiting for {self.topic}{self._why_waiting()}"
        if time.monotonic() - self._heard > SILENCE:
            return _STALE, f"{self.topic} is silent: does the robot still run? Waiting for it"
        if not bits:
            words = f", but {unlearnt.words}" if unlearnt else ""
            return _WARN if unlearnt else _OK, f"correcting {self.topic}{words}"
        if self._is_homed is None:
            name = self._stream.name("operating_state")
            return _WARN, f"waiting for {name}, which says whether the robot is homed"
        advice = "; ".join(text for bit, text in _ADVICE.items() if bits & bit)
        return _WARN, f"in doubt: {bits.name}: {advice or bits.words}"

    def _why_waiting(self) -> str:
        if self._stream.invalid:
            return ": its stamps are invalid; is the robot homed?"
        try:
            topics = self._transport.topics()
        except RosError as error:
            return f": {error}"
        others = [name for name in topics if "/corrected/" not in name]  # which is its own
        where = self._stream.namespaces(others, self.topic)
        return "" if self.topic in topics else f", which nobody writes: {where}"
