"""An arm that is reached over ROS: a robot, or `truejoint node simulate`."""

import logging
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from typing import Any, Final

import numpy as np

from truejoint.array_types import Array
from truejoint.crtk.messages import JOINT_STATE, STRING_STAMPED, beside_columns, profile_of
from truejoint.crtk.protocol import ARRIVAL, SILENCE, STRETCH, Listener
from truejoint.crtk.ros.state_stream import StateStream
from truejoint.crtk.ros.transport import Publisher, Transport
from truejoint.crtk.states import LEADS_TO, OperatingState, StateCommand
from truejoint.errors import CommandRefused, MotionStopped, RobotError, RosError, meant
from truejoint.robots import Robot
from truejoint.robots.blocks import GRAIN, QUANTITIES, SETPOINT_DT, StateBlock, TruthBlock
from truejoint.units import shown

CONNECT_TIMEOUT: Final = 5.0  # [s] that a topic may take to say its first word
_HOPELESS: Final = 0.1  # lateness [s] after which set-points are paced anew
_HASTE: Final = 0.75  # of a period: set-points that are late follow each other no faster
_BEGINNING: Final = 1.0  # [s] within which a robot that has something to home says so
TOLERANCE: Final = {"rad": math.radians(0.15), "m": 1.5e-4}  # of a joint that has arrived
MOST_TRIM: Final = {"rad": math.radians(1.0), "m": 1e-3}  # added to a set-point at most
_TRIM_TIME: Final = 0.2  # [s] in which an error that remains is added once
_NEAR: Final = 0.4  # share of the tolerance that may remain
_LAG: Final = 0.06  # [s] by which joints may follow their set-points
_SETTLING: Final = 5.0  # [s] after a motion: until then the robot's own loops have come to rest
_FADE: Final = 0.25  # [s] in which a joint that moves gives most of its trim back
_IN_FLIGHT: Final = 0.1  # [s] for which a set-point that was sent may be the robot's
_STILL: Final = 0.035  # [s] for which the robot's may stand elsewhere until none is sent
_MOST_STILL: Final = 0.24  # [s] for which it may at most: a busy computer may keep them
_LOOKS: Final = 50  # for a topic that nobody seems to write: it may be a moment late
_AGO: Final = 0.5  # [s] of set-points that are kept in mind together, twice
_LEAVES: Final = 6  # times a second that the robot's leaves all of those: another moves it as well
_log = logging.getLogger(__name__)


class RosBackend:
    """Executes an arm's commands on a robot that speaks CRTK on ROS topics.

    Set-points go to ``servo_jp``, `rate` a second. Time is the robot's, by the stamps of its
    messages.

    Friction and gravity keep a joint off its set-point where the robot's own loop has no integral
    action, or a slow one, as RAVEN-II's. For 5 s after a motion the back end therefore adds a
    *trim* to the set-points, which brings the joints there and keeps them there. It is at most
    `MOST_TRIM`, and a joint that moves gives it back. The set-points that the arm reports are
    without it.

    Parameters
    ----------
    transport : Transport
        Transport that `truejoint.crtk.open_transport` gives.
    robot : Robot
        The arm that the topics are of.
    profile : str
        How its messages differ from CRTK, by name (`truejoint.crtk.messages.PROFILES`); by default
        the robot's own.
    namespace : str
        Namespace of its topics, for instance ``"/PSM1"``; by default the profile's.
    truth : str
        Topic of joint sensors, a JointState; empty where there are none.
    beside : sequence of str
        Topics that are recorded with the state: potentiometers or a force
        (`truejoint.crtk.messages.beside_columns`). One that is silent is an error.
    rate : float
        Set-points that the robot takes a second [Hz]; RAVEN-II's servo loop takes 1000 (peng2024
        IV-A).
    tolerance : mapping of str to float
        Distance from its set-point within which a joint has arrived, by unit [rad, m]. A motion
        whose joints have not arrived 2 s after its end raises NotArrived.

    Raises
    ------
    RobotError
        If there is no such profile.

    Notes
    -----
    Making an `Arm` of it raises RosError within 5 s where the robot does not report, or nobody
    writes the topic of joint sensors. docs/ros.md has the way from a running ROS to a moving arm.

    Examples
    --------
    >>> try:
    ...     backend = RosBackend(open_transport(1), get_robot("raven2"), "raven_3")
    ... except TruejointError as error:  # no such profile, or no ROS here
    ...     print("refused")
    refused
    """

    stretch = STRETCH

    def __init__(
        self,
        transport: Transport,
        robot: Robot,
        profile: str = "",
        *,
        namespace: str = "",
        truth: str = "",
        beside: Sequence[str] = (),
        rate: float = 1.0 / SETPOINT_DT,
        tolerance: Mapping[str, float] = TOLERANCE,
    ) -> None:
        self.robot: Final = robot
        self.rate: Final = float(rate)
        # It asks whether to go on at each set-point, and at each look about.
        self.grain: Final = max(GRAIN, 1.0 / self.rate)
        self._transport = transport
        self._profile = profile_of(robot, profile)
        self._truth, self._beside = truth, tuple(beside)
        self._columns = {q: [f"{q}/{channel}" for channel in robot.channels] for q in QUANTITIES}
        self._stream = StateStream(transport, robot, self._profile, self._on_state, namespace)
        self._listener: Listener | None = None
        self._changed = threading.Condition()  # of what follows
        self._heard = -np.inf  # when, by this computer's clock
        self._ahead = 0.0  # of the robot's clock [s]
        self._delivering = threading.Lock()
        self._topics = ExitStack()
        self._servo: Publisher
        self._command: Publisher
        self._due = self._paced = 0.0  # when the last set-point was due, and was sent [s]
        self._ranges: deque[tuple[float, Array, Array]] = deque(maxlen=2)  # of what was sent, since
        self._left: deque[float] = deque(maxlen=_LEAVES)  # when [s] the robot's left both of these
        self._is_far = False
        self._reported = -math.inf  # stamp [s] of the newest state
        # A joint that has arrived creeps on: a fifth of the tolerance is for that.
        self._near = 0.8 * np.array([tolerance[joint.unit] for joint in robot.joints])
        self._most_trim = np.array([MOST_TRIM[joint.unit] for joint in robot.joints])
        self._largest_step = np.array([joint.max_speed for joint in robot.joints]) / rate
        self._trimmed = -math.inf  # when the trim was last looked at
        self._closed = threading.Event()
        self._forget()

    def _forget(self) -> None:
        """Know nothing of the robot: it may have been homed since an earlier listener."""
        self._state: OperatingState | None = None
        self._setpoint: Array | None = None
        self._measured: Array | None = None
        self._velocity: tuple[float, Array] | None = None
        self.homing_id = ""  # stamp of the homing that was seen, not of one from before
        self._refusal = ""
        self._readings: dict[str, tuple[float, Mapping[str, Array]]] = {}  # and when [s], by topic
        self._has_commanded = False
        self._failure: BaseException | None = None
        self._forget_sent()

    def _forget_sent(self) -> None:
        self._settling = math.inf, -math.inf  # when the trim may change
        self._trim = np.zeros(len(self.robot.joints))
        self._stamp = -math.inf  # of the newest set-point [s]
        self._sent: Array | None = None
        self._stood: Array | None = None  # where the robot's set-point was then
        self._in_flight: deque[tuple[float, Array]] = deque()  # when it was sent, and what
        self._astray: tuple[float, Array] | None = None  # since when [s] the set-point stands off

    @property
    def time(self) -> float:
        """Stamp of the robot's newest message, and what has passed since [s]."""
        return time.monotonic() + self._ahead

    def connect(self, listener: Listener) -> None:
        """Deliver all blocks from now on to `listener`, once the robot reports its state.

        Raises CommandRefused if there is a listener, RosError if the robot does not report.
        """
        if self._listener is not None:
            raise CommandRefused(
                f"{self.robot.title} refused: another Arm controls it; close that one first"
            )
        self._forget()
        self._closed.clear()
        self._listener = listener
        try:
            self._open()
        except BaseException:
            self.disconnect()
            raise

    def _open(self) -> None:
        """Take up the topics; returns once the robot reports its state, and its joints if homed."""
        name, transport = self._stream.name, self._transport
        closing, subscribe = self._topics.callback, transport.subscribe
        self._servo = transport.publisher(name("servo_jp"), JOINT_STATE)
        closing(self._servo.close)
        self._command = transport.publisher(name("state_command"), STRING_STAMPED)
        closing(self._command.close)
        for topic in self._beside:
            closing(subscribe(topic, JOINT_STATE, partial(self._on_beside, topic)))
        if self._truth:
            closing(subscribe(self._truth, JOINT_STATE, self._on_truth))
        kind = self._profile.operating_state
        closing(subscribe(name("operating_state"), kind, self._on_operating))
        with self._changed:
            if not self._changed.wait_for(lambda: self._state is not None, CONNECT_TIMEOUT):
                raise RosError(self._nobody(name("operating_state")))
        if self._truth and not any(
            self._truth in transport.topics() or self._closed.wait(GRAIN) for _ in range(_LOOKS)
        ):
            states = sorted(t for t, kind in transport.topics().items() if kind == JOINT_STATE)
            near = meant(self._truth, states) or f" joint states: {', '.join(states) or 'none'}"
            raise RosError(f"{self._truth}: no truth is published there;{near}")
        with self._changed:
            self._changed.wait_for(
                lambda: self._refusal or self._readings.keys() >= {*self._beside}, CONNECT_TIMEOUT
            )
        if silent := [topic for topic in self._beside if topic not in self._readings]:
            raise RosError(self._refusal or self._nobody(silent[0]))
        self._stream.start()
        if self.operating_state().is_homed:
            self._wait_for_joints()

    def disconnect(self) -> None:
        """Deliver no more blocks, and give the topics up."""
        self._listener = None
        self._closed.set()
        self._stream.close()
        self._topics.close()
        self._state = None

    def operating_state(self) -> OperatingState:
        """State as the robot reported it last; raises CommandRefused where it reports no more."""
        state = self._state
        if state is None:
            raise CommandRefused(f"{self.robot.title} refused: the arm is closed")
        silent = time.monotonic() - self._heard
        if silent > SILENCE:
            raise CommandRefused(
                f"{self._stream.name('operating_state')} has been silent for {silent:.1f} s, "
                "as have the joints: does the robot still run, and the network?"
            )
        for topic, (heard, _) in self._readings.items():
            if time.monotonic() - heard > SILENCE:
                raise CommandRefused(f"{topic} has been silent for more than {SILENCE:g} s")
        return state

    def state_command(self, command: StateCommand, timeout: float) -> None:
        """Send a state command; returns once the robot reports what it leads to.

        Raises CommandRefused if that takes longer than `timeout` [s], MotionStopped if a homing
        is stopped.
        """
        self._reach(self._command)
        before, began = self.operating_state(), self.time
        self._settling = math.inf, -math.inf
        self._send_command(command)
        homes = not before.is_homed  # so that it has homed as soon as it says so

        def is_done() -> bool:
            nonlocal homes
            now = self.operating_state()
            if now.state == "FAULT" and before.state != "FAULT":
                raise CommandRefused(f"{command!r} stopped: the robot reports FAULT; see its log")
            if command in LEADS_TO:
                return now.state == LEADS_TO[command][1]
            if command == "unhome":
                return not now.is_homed
            if now.state != "ENABLED":
                raise MotionStopped(
                    f"'home' stopped at t = {now.t:.3f} s: {now.state}; the arm is not homed"
                )
            # A robot that is homed already may have nothing to do.
            homes |= now.is_busy or not now.is_homed or now.t - began > _BEGINNING
            return homes and now.is_homed and not now.is_busy

        with self._changed:
            while not is_done():
                self._changed.wait(GRAIN)
                if self.time - began > timeout:
                    raise CommandRefused(
                        f"{command!r} stopped: not done after {timeout:g} s; the robot reports "
                        f"{self.operating_state().state}"
                    )
            self._forget_sent()
        if command == "home":
            self._wait_for_joints()

    def _send_command(self, command: StateCommand) -> None:
        message = self._transport.stamped(STRING_STAMPED, self._transport.now())
        message.string = command
        self._has_commanded |= command not in ("pause", "resume")
        self._command.publish(message)

    def servo_jp(self, position: Array, go_on: Callable[[], bool]) -> int:
        """Send set-points (n, n_joints) [rad or m], `rate` a second, while ``go_on()``."""
        if self._failure is not None:
            failure, self._failure = self._failure, None
            raise failure
        self._reach(self._servo)
        with self._changed:  # which the trim changes under
            self._settling = math.inf, -math.inf
        if self._setpoint is not None and not self._in_flight:
            self._in_flight.append((time.monotonic(), self._setpoint))
            self._keep_in_mind(self._setpoint)
        for taken, row in enumerate(position):
            now = time.perf_counter()
            self._due = now if now - self._due > _HOPELESS else self._due + 1.0 / self.rate
            begin = max(self._due, self._paced + _HASTE / self.rate)
            if begin > now:
                time.sleep(begin - now)
            if not go_on():
                return taken
            state = self.operating_state()
            if not state.is_ready:
                raise CommandRefused(f"servo_jp stopped: the arm is {state.state}")
            if not self._is_taken(go_on):
                return taken
            if self._sent is not None:  # a joint that moves gives its trim back
                step = np.abs(row - self._sent)
                room = np.where(step > 0.0, np.maximum(self._largest_step - step, 0.0), 0.0)
                self._trim = self._trim - np.clip(self._trim / (_FADE * self.rate), -room, room)
            self._paced = time.perf_counter()
            late = self._paced - self._due
            self._send(row, late if late < _HOPELESS else 0.0)
        return len(position)

    def _send(self, row: Array, late: float = 0.0) -> None:
        """Send a set-point (n_joints,) [rad or m] due `late` [s] ago, and what is added to it."""
        self._sent, self._stood = row, self._setpoint
        target = np.clip(row + self._trim, self.robot.lower, self.robot.upper)
        self._stamp = max(self._stamp, self._transport.now() - late)
        message = self._transport.stamped(JOINT_STATE, self._stamp)
        message.position = target.tolist()
        self._has_commanded = True
        self._in_flight.append((time.monotonic(), target))
        self._keep_in_mind(target)
        self._servo.publish(message)

    def _keep_in_mind(self, target: Array) -> None:
        """Widen the range of what was sent of late by a set-point (n_joints,) [rad or m]."""
        now, ranges = time.monotonic(), self._ranges
        if ranges and now - ranges[-1][0] < _AGO:
            since, low, high = ranges[-1]
            ranges[-1] = since, np.minimum(low, target), np.maximum(high, target)
        else:
            ranges.append((now, target, target))

    def _is_taken(self, go_on: Callable[[], bool]) -> bool:
        """Wait while the robot's set-point stands elsewhere; False where it is not to go on.

        Raises CommandRefused where its reports say so for too long, or again and again: two move
        it. Of a robot that is not heard nothing is known: it gets no set-point either, and
        `operating_state` says when it is silent.
        """
        with self._changed:
            if len(self._left) == _LEAVES and self._left[-1] - self._left[0] < 2.0 * _AGO:
                self._left.clear()
                raise CommandRefused(
                    "servo_jp stopped: another program moves the arm as well; end one of them"
                )
            while (astray := self._astray) is not None:
                stands, is_heard = self.time - astray[0], self.time - self._reported <= _STILL
                if stands <= _STILL:
                    break
                if stands > _MOST_STILL and is_heard:
                    raise self._not_taken(astray[1])
                self.operating_state()
                if not go_on():
                    return False
                self._changed.wait(GRAIN)
        return True

    def _not_taken(self, setpoint: Array) -> CommandRefused:
        sent, self._astray = self._in_flight[-1][1], None
        self._in_flight.clear()
        k = int(np.argmax(np.abs(setpoint - sent) / self._near))
        joint = self.robot.joints[k]
        return CommandRefused(
            "servo_jp stopped: the robot does not take the set-points that are sent: "
            f"{joint.name} stands at {shown(float(setpoint[k]), joint.unit)}, "
            f"{shown(float(sent[k]), joint.unit)} was sent; see its log, or who else moves it"
        )

    def _compare(self, t: float, setpoint: Array) -> None:
        """Keep in mind since when [s], by its clock, the robot's set-point stands off the last."""
        now, in_flight = time.monotonic(), self._in_flight
        elapsed, self._reported = t - self._reported, t
        while len(in_flight) > 1 and now - in_flight[1][0] > _IN_FLIGHT:
            in_flight.popleft()
        if (
            self._profile.no_setpoint
            or not in_flight
            or now - in_flight[-1][0] > _MOST_STILL + _IN_FLIGHT  # nothing is being sent
            or (np.abs(setpoint - in_flight[-1][1]) <= self._near).all()
        ):
            self._astray, self._is_far = None, False
            return
        ends = [end for _, *range_ in tuple(self._ranges) for end in range_]
        was_far, self._is_far = self._is_far, not self._is_among(ends, setpoint)
        if self._is_far and not was_far:
            self._left.append(t)
        if (
            self._astray is None
            or elapsed > _IN_FLIGHT  # of that time nothing is known
            or not (self._is_far or np.array_equal(setpoint, self._astray[1]))
        ):
            self._astray = t, setpoint

    def _is_among(self, rows: Sequence[Array], setpoint: Array) -> bool:
        """Whether it is one of the `rows`, or between them, within the tolerance."""
        nearest = np.clip(setpoint, np.min(rows, axis=0), np.max(rows, axis=0))
        return bool((np.abs(setpoint - nearest) <= self._near).all())

    def flush(self, timeout: float = ARRIVAL, go_on: Callable[[], bool] = lambda: True) -> str:
        """Return once the robot's set-point and its joints are where they were sent.

        Gives in words what is not there `timeout` [s] after the set-point came nearer for the last
        time; empty where all is, or where it is not to go on.
        """
        nearest, came_nearer = math.inf, time.monotonic()
        while self._sent is not None and go_on():
            with self._changed:
                to_go = float(np.max(self._to_go() / self._near))
                if to_go < nearest - 0.1:  # a robot that is late catches up at its top speed
                    nearest, came_nearer = to_go, time.monotonic()
                    if timeout > _LAG:
                        self._settling = came_nearer + _LAG, came_nearer + _SETTLING
                if self._changed.wait_for(self._has_arrived, self.grain):
                    return ""
            if not (state := self.operating_state()).is_ready:
                return f"the robot was {state.state} before its joints had arrived"
            if time.monotonic() - came_nearer > timeout:
                self._settling = math.inf, -math.inf
                off = np.abs(self._off())
                worst = int(np.argmax(off / self._near))
                joint, distance = self.robot.joints[worst], float(off[worst])
                return (
                    f"{joint.name} is {shown(distance, joint.unit)} away from where it was sent, "
                    f"after {timeout:g} s; is it held? RosBackend takes a tolerance"
                )
        return ""

    def _has_arrived(self) -> bool:
        # A joint goes as far as its set-point still has to.
        return bool((self._to_go() + np.abs(self._off()) <= self._near).all())

    def _to_go(self) -> Array:
        """How far (n_joints,) the robot's set-point is from the last that was sent [rad or m]."""
        if self._setpoint is None or not self._in_flight:
            return np.full_like(self._trim, np.inf)
        return np.abs(self._in_flight[-1][1] - self._setpoint)

    def _off(self) -> Array:
        """How far (n_joints,) the joints are from where they were sent [rad or m]."""
        if self._measured is None or self._sent is None:
            return np.full_like(self._trim, np.inf)
        return self._sent - self._measured

    def _settle(self, setpoint: Array) -> None:
        """Trim the set-point of joints that stand off it, unless others have moved it meanwhile."""
        now, (begin, end), state = time.monotonic(), self._settling, self._state
        if not (begin < now < end and self._in_flight and now - self._trimmed >= self.grain):
            return
        if not self._is_among([row for _, row in tuple(self._in_flight)], setpoint):
            self._settling = math.inf, -math.inf  # others move the arm now
            return
        # Joints of before the last set-point was taken would be trimmed twice on a slow link.
        is_taken = (np.abs(setpoint - self._in_flight[-1][1]) <= 0.1 * self._near).all()
        if state is None or not state.is_ready or self._sent is None:
            return
        if not is_taken:
            stands = self._stood is not None and np.array_equal(setpoint, self._stood)
            if stands and now - self._in_flight[-1][0] > _IN_FLIGHT:
                self._send(self._sent)  # the last one was lost
            return
        elapsed, self._trimmed = min(now - self._trimmed, _LAG), now
        off = self._off()
        added = np.where(np.abs(off) > _NEAR * self._near, off * elapsed / _TRIM_TIME, 0.0)
        if added.any():
            self._trim = np.clip(self._trim + added, -self._most_trim, self._most_trim)
            self._send(self._sent)

    def wait(self, duration: float) -> None:
        """Let `duration` [s] pass."""
        self._closed.wait(duration)

    def _reach(self, publisher: Publisher) -> None:
        """Raise CommandRefused unless somebody reads a topic of commands, within a while."""
        end = time.monotonic() + CONNECT_TIMEOUT
        while not publisher.readers:
            self.operating_state()  # of a robot that has fallen silent nobody will
            if time.monotonic() > end or self._closed.wait(GRAIN):
                raise CommandRefused(
                    f"nobody reads {publisher.topic}: does the robot take commands there?"
                )

    def _wait_for_joints(self) -> None:
        with self._changed:
            heard = self._changed.wait_for(lambda: self._setpoint is not None, CONNECT_TIMEOUT)
        if not heard:
            raise RosError(self._stream.refusal or self._nobody(self._stream.topic))

    def _nobody(self, topic: str) -> str:
        kinds = self._transport.topics()
        advice = self._stream.namespaces(kinds, topic)
        if topic in kinds:
            advice = f"{kinds[topic]} is published there; is it this robot's, and does it run?"
        return f"no message on {topic} within {CONNECT_TIMEOUT:g} s; {advice}"

    def _on_operating(self, message: Any) -> None:
        t = self._transport.seconds(message)
        if not t > 0.0:
            return
        with self._changed:
            was = self._state
            flags = bool(message.is_homed), bool(message.is_busy)
            self._state = OperatingState(message.state, *flags, t)
            self._tell_time(t)
            if was is not None and self._state.is_homed and not was.is_homed:
                self.homing_id = f"homed at {t:.3f}"
            if not self._state.is_homed:
                self._setpoint = self._measured = None
            self._changed.notify_all()

    def _tell_time(self, t: float) -> None:
        self._heard = time.monotonic()
        self._ahead = t - self._heard

    def _on_state(self, _: Any, t: float, columns: Mapping[str, Array]) -> None:
        state, listener = self._state, self._listener
        if state is None or listener is None or not state.is_homed:
            return  # before the registration positions mean nothing
        trim = self._trim
        block = self._block(t, columns, trim)
        self._tell_time(t)
        # The arm hears it first: once a motion is over, it says nothing older than what ended it.
        self._deliver(listener, block)
        with self._changed:
            self._setpoint = block.setpoint[-1, self.robot.joint_channels] + trim
            self._measured = block.measured[-1, self.robot.joint_channels]
            self._compare(t, self._setpoint)
            self._settle(self._setpoint)
            self._changed.notify_all()

    def _deliver(self, listener: Listener, block: StateBlock | TruthBlock) -> None:
        """Give the arm a block; what a subscriber raises pauses a robot that was commanded."""
        try:
            with self._delivering:
                listener(block)
        except BaseException as error:  # noqa: BLE001  # a subscriber's, in a thread of ROS
            if not self._has_commanded:
                _log.error("%s: a subscriber failed: %r", self.robot.title, error)
                return
            self._failure = error
            self._send_command("pause")

    def _block(self, t: float, columns: Mapping[str, Array], trim: Array) -> StateBlock:
        """One row of all that the robot says, the set-point without the `trim` (n_joints,)."""
        arrays: dict[str, Any] = {}
        for quantity, names in self._columns.items():
            row = [columns[name][0] if name in columns else 0.0 for name in names]
            unsaid = columns.keys().isdisjoint(names)
            arrays[quantity] = np.empty((1, 0)) if unsaid else np.array([row])
        measured = arrays["measured"]
        if not arrays["setpoint"].shape[1]:
            arrays["setpoint"] = measured
        else:
            arrays["setpoint"][:, self.robot.joint_channels] -= trim
        if not arrays["velocity"].shape[1]:  # the robot states none: the change since the last row
            (before, last), self._velocity = self._velocity or (t, measured), (t, measured)
            change = measured - last
            arrays["velocity"] = change / (t - before) if t > before else np.zeros_like(change)
        extra = {n: v for _, columns in self._readings.values() for n, v in columns.items()}
        return StateBlock(np.array([t]), self.robot.channels, **arrays, extra=extra)

    def _on_beside(self, topic: str, message: Any) -> None:
        position = np.array([message.position], dtype=float)
        try:
            columns = beside_columns(self.robot, topic, message.name, position, self._profile)
        except RobotError as refusal:
            self._refusal = str(refusal)
            return
        with self._changed:
            self._readings[topic] = time.monotonic(), columns
            self._changed.notify_all()

    def _on_truth(self, message: Any) -> None:
        state, listener = self._state, self._listener
        t = self._transport.seconds(message)
        if state is None or listener is None or not state.is_homed or not t > 0.0:
            return
        try:
            columns = self._stream.columns_of(message, "truth")
        except RobotError as refusal:
            _log.warning("%s: %s", self._truth, refusal)
            return
        names = tuple(name.partition("/")[2] for name in columns)
        position = np.array([[float(values[0]) for values in columns.values()]])
        self._deliver(listener, TruthBlock(np.array([t]), names, position))
