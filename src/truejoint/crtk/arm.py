"""One arm under CRTK's names, whatever is behind it."""

import atexit
import math
import threading
import weakref
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import replace
from numbers import Real
from typing import Final, Self

import numpy as np
from numpy.typing import ArrayLike

from truejoint.array_types import Array
from truejoint.crtk import cartesian, limits
from truejoint.crtk.handle import Motion, Subscription
from truejoint.crtk.planning import time_law
from truejoint.crtk.protocol import SILENCE, Backend, Listener
from truejoint.crtk.states import JointState, OperatingState, check_ready, next_state
from truejoint.errors import CommandRefused, MotionStopped, NotArrived, TruejointError, other_kind
from truejoint.robots import Robot, blocks
from truejoint.robots.blocks import StateBlock, TruthBlock

MAX_AGE: Final = 0.1  # [s]: a state message older than this is no measurement of now
BRAKING: Final = 0.05  # [s] in which the set-point of an arm that is stopped comes to rest
TIMEOUT: Final = 5.0  # [s], time limit of a state command other than homing
HOMING_TIMEOUT: Final = 120.0

_OPEN: "Final[weakref.WeakSet[Arm]]" = weakref.WeakSet()


class Arm:
    """A robot arm; commands and measurements are named and mean what CRTK says.

    Positions are in rad and m, in the order of ``arm.robot.joints``. Every command is checked
    against state and limits before it reaches the robot, and refused with a reason; a refused
    command changes nothing. Positions relative are relative to the latest set-point. Moves run in a
    separate thread and return a `Motion`; meanwhile `pause` stops it from any thread within 20 ms
    and the time that it needs to brake. Left by an exception, or by the end of the program, the
    arm is paused.

    Parameters
    ----------
    backend : Backend
        For instance from `truejoint.crtk.simulated_arm`, which makes the arm as well.
    controls : bool
        Whether this program moves the arm. Otherwise it looks on: all commands but to pause and
        resume are refused, and in the end the arm is left as it is.

    Attributes
    ----------
    robot : Robot
        Joints, limits and kinematics of the arm.
    rate : float
        Set-points that it takes a second [Hz], as what is behind declares it.
    grain : float
        Time [s] within which a motion notices that it is to stop.
    stretch : float
        Longest piece of a motion [s] that is sent at once, where no subscriber wants blocks sooner.

    Raises
    ------
    CommandRefused
        If another Arm controls what is behind.
    RobotError
        If it is no `Backend`, or declares a rate or a grain that no arm can have, or be stopped
        with.

    References
    ----------
    collaborative-robotics/documentation:docs/pages/api-robot-motion.rst

    Examples
    --------
    >>> arm.move_jp(arm.robot.home).wait()
    >>> arm.operating_state().state
    'ENABLED'
    """

    def __init__(self, backend: Backend, *, controls: bool = True) -> None:
        self._backend = backend
        self._controls = controls
        self.rate, self.grain = limits.checked_backend(backend)
        self.stretch: Final = backend.stretch
        self.robot: Final[Robot] = backend.robot
        self._joint_channels = self.robot.joint_channels
        self._subscriptions: list[Subscription] = []
        self._latest: StateBlock | None = None
        self._before: StateBlock | None = None  # the latest
        self._lock = threading.RLock()  # of what follows
        self._motion: Motion | None = None
        self._motion_thread = 0  # thread that drives the motion
        self._stop_command = ""  # to stop it: a state command, or hold
        self._last_setpoints: Array | None = None  # two (2, n_joints) of this controller
        self._stamps = np.empty(0)  # of the latest messages [s]
        self._jump_reported = ""  # of a position that was reported during a motion
        self._unreported_s = 0.0  # [s] of set-points that were sent since the latest message
        backend.connect(self._on_block)
        _OPEN.add(self)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop and pause the arm if it is enabled, and let another control it."""
        with suppress(TruejointError):
            if self._controls and self.operating_state().state == "ENABLED":
                self.pause()
        self._backend.disconnect()
        _OPEN.discard(self)

    @property
    def time(self) -> float:
        """Now, on the robot's clock [s]."""
        return self._backend.time

    @property
    def homing_id(self) -> str:
        """Name of the homing that positions count from, for the provenance of a recording."""
        return self._backend.homing_id

    def operating_state(self) -> OperatingState:
        """State, whether homed, whether busy, with a time stamp."""
        now = self._backend.operating_state()
        return replace(now, is_busy=now.is_busy or self._motion is not None)

    def state_command(self, command: str, timeout: float | None = None) -> None:
        """Send ``enable``, ``disable``, ``pause``, ``resume``, ``home`` or ``unhome``; blocks.

        Raises CommandRefused if it is not allowed now, the message says what to send first, or not
        done within `timeout` [s] of the robot's clock: by default 5 s, and 120 s for homing.
        """
        if command not in ("pause", "resume"):  # which move nothing by themselves
            self._check_control(command)
        limit = timeout if timeout is not None else HOMING_TIMEOUT if command == "home" else TIMEOUT
        if not limit > 0.0:
            raise CommandRefused(f"{command!r} refused: timeout {limit} s; give more than 0 s")
        motion, stops = self._motion, command in ("pause", "disable")
        # A motion is asked to stop before anything that has to wait for the robot.
        if not (stops and self._ask(motion, command)):
            next_state(self.operating_state(), command)
        if stops:
            self._stop(motion, command, limit)
        else:
            self._last_setpoints, self._jump_reported, self._unreported_s = None, "", 0.0
            if command == "home":  # what comes next is no step from here
                self._latest = self._before = None
            self._backend.state_command(command, limit)  # type: ignore[arg-type]  # next_state knows
        if command == "unhome":
            self._latest = self._before = None

    def enable(self, timeout: float | None = None) -> None:
        """Switch the motors on."""
        self.state_command("enable", timeout)

    def disable(self, timeout: float | None = None) -> None:
        """Stop, and switch the motors off; the way out of a fault."""
        self.state_command("disable", timeout)

    def pause(self, timeout: float | None = None) -> None:
        """Brake and stand, from any thread and whatever the arm is doing; a motion ends with it.

        The set-point comes to rest within `BRAKING`. Called by a subscriber, it takes effect when
        the subscriber returns.
        """
        self.state_command("pause", timeout)

    def resume(self, timeout: float | None = None) -> None:
        """Go on after `pause`."""
        self.state_command("resume", timeout)

    def home(self, timeout: float | None = None) -> None:
        """Explore the hard stops, register the motor encoders, go to the home pose; blocks."""
        self.state_command("home", timeout)

    def unhome(self, timeout: float | None = None) -> None:
        """Forget the registration of the motor encoders."""
        self.state_command("unhome", timeout)

    def hold(self) -> None:
        """Brake and hold the set-point, the arm staying enabled; a motion ends with it."""
        self._check_control("hold")
        motion = self._motion
        if not self._ask(motion, "hold"):
            check_ready(replace(self.operating_state(), is_busy=False), "hold")
        self._stop(motion, "hold")

    def measured_js(self, age: float = MAX_AGE) -> JointState:
        """Position, velocity and effort of every joint as measured at the motors.

        Raises CommandRefused before homing, when there is nothing valid to report, and if the
        newest message is older than `age` [s].
        """
        block = self.newest_state("measured_js", age)
        return self._joint_state(block, block.measured, block.velocity)

    def setpoint_js(self, age: float = MAX_AGE) -> JointState:
        """Latest set-point, its velocity and the effort command; refused as `measured_js`."""
        before, block = self._before, self.newest_state("setpoint_js", age)
        first = block.rows(slice(-2, -1)) if len(block.t) > 1 else before or block
        period = block.t[-1] - first.t[-1]
        step = block.setpoint[-1:] - first.setpoint[-1:]
        velocity = step / period if period > 0.0 else np.zeros_like(step)
        return self._joint_state(block, block.setpoint, velocity)

    def measured_cp(self, age: float = MAX_AGE) -> Array:
        """Tool pose (4, 4) [m] in the frame of the robot's CRTK topics, of `measured_js`.

        Raises RobotError if the robot's kinematics are not known.
        """
        kinematics = self.robot.known_kinematics("measured_cp")
        return cartesian.pose(kinematics, self.measured_js(age).position)

    def setpoint_cp(self, age: float = MAX_AGE) -> Array:
        """Tool pose (4, 4) [m] of `setpoint_js`; as `measured_cp`."""
        kinematics = self.robot.known_kinematics("setpoint_cp")
        return cartesian.pose(kinematics, self.setpoint_js(age).position)

    def measured_cv(self, age: float = MAX_AGE) -> Array:
        """Twist (6,) of the tool: velocity [m/s] over angular velocity [rad/s]; as `measured_cp`.

        The velocity is that of the tool's origin; both are in the frame of the CRTK topics.
        """
        kinematics, now = self.robot.known_kinematics("measured_cv"), self.measured_js(age)
        return np.asarray(cartesian.jacobian(kinematics, now.position) @ now.velocity)

    def servo_jp(self, position: ArrayLike) -> None:
        """Go to `position` (n_joints,) [rad or m] within one servo period.

        Raises CommandRefused if not ready, or on NaN, wrong shape, a joint limit or too large a
        step.
        """
        target = blocks.checked_vector(self.robot, position, "servo_jp")
        self._servo(target[None], "servo_jp")

    def servo_jr(self, increment: ArrayLike) -> None:
        """Go by `increment` (n_joints,) [rad or m] from the latest set-point; as `servo_jp`."""
        step = blocks.checked_vector(self.robot, increment, "servo_jr")
        self._servo((self.latest_setpoint("servo_jr") + step)[None], "servo_jr")

    def servo_jv(self, velocity: ArrayLike) -> None:
        """Go on at `velocity` (n_joints,) [rad/s or m/s] for one servo period; as `servo_jp`."""
        step = blocks.checked_vector(self.robot, velocity, "servo_jv") / self.rate
        self._servo((self.latest_setpoint("servo_jv") + step)[None], "servo_jv")

    def servo_cp(self, pose: ArrayLike) -> None:
        """Go to a tool pose (4, 4) [m] within one servo period; as `servo_jp`.

        The pose is in the frame of the CRTK topics. Raises RobotError if it is out of reach or
        the robot's kinematics are not known.
        """
        kinematics = self.robot.known_kinematics("servo_cp")
        start = self.latest_setpoint("servo_cp")
        self._servo(cartesian.joints_at(kinematics, pose, start)[None], "servo_cp")

    def servo_cr(self, increment: ArrayLike) -> None:
        """Move the tool by an `increment` (4, 4) [m] of the latest set-point; as `servo_cp`.

        Shift and turn are about the axes of the CRTK topics' frame, the turn about the tool.
        """
        kinematics = self.robot.known_kinematics("servo_cr")
        start = self.latest_setpoint("servo_cr")
        target = cartesian.moved(cartesian.pose(kinematics, start), increment)
        self._servo(cartesian.joints_at(kinematics, target, start)[None], "servo_cr")

    def servo_jp_stream(self, positions: ArrayLike) -> None:
        """Stream `positions` (n, n_joints) [rad or m] at `rate`; blocks until all are sent.

        The whole stream is checked before its first sample is sent; raises as `servo_jp`.
        """
        rows = blocks.checked_rows(self.robot, positions, "servo_jp_stream")
        self._servo(rows, "servo_jp_stream")

    def move_jp(self, goal: ArrayLike, speed: ArrayLike | None = None) -> Motion:
        """Go to `goal` (n_joints,) [rad or m] along a straight line.

        All joints arrive together (`planning.TimeLaw`), none faster than `speed` (n_joints,) [rad/s
        or m/s]; by default 3 deg/s for positioning joints, 10 mm/s for prismatic and 10 deg/s for
        other ones. Raises CommandRefused as `servo_jp`, or if a speed is not positive or above the
        joint's top speed.
        """
        target = blocks.checked_vector(self.robot, goal, "move_jp")
        return self._move(target[None], speed, "move_jp")

    def move_jr(self, increment: ArrayLike, speed: ArrayLike | None = None) -> Motion:
        """Go by `increment` (n_joints,) [rad or m] from the latest set-point; as `move_jp`."""
        step = blocks.checked_vector(self.robot, increment, "move_jr")
        return self._move((self.latest_setpoint("move_jr") + step)[None], speed, "move_jr")

    def move_cp(self, pose: ArrayLike, speed: ArrayLike | None = None) -> Motion:
        """Take the tool to a pose (4, 4) [m] along a straight line in space; as `move_jp`.

        The pose is in the frame of the CRTK topics, `speed` of the joints. The whole way is checked
        before the arm moves; raises RobotError if some of it is out of reach.
        """
        kinematics, start = self.robot.known_kinematics("move_cp"), self.latest_setpoint("move_cp")
        return self._move(cartesian.straight_line(kinematics, start, pose), speed, "move_cp")

    def stream(self, pieces: Iterable[Array], duration: float, command: str) -> Motion:
        """Stream set-points (n, n_joints) [rad or m] at `rate` as `pieces` of them come.

        Each piece is checked as `servo_jp` checks, when it is its turn; one that fails ends the
        motion. `duration` [s] is what all will take; `command` names it in messages.
        """
        motion = self._begin(command, duration)
        motion.thread = threading.Thread(
            target=self._drive, args=(motion, self._checked(pieces, command)), daemon=True
        )
        motion.thread.start()
        return motion

    def wait(self, duration: float) -> None:
        """Let `duration` [s] of the robot's clock pass; enabled and homed, the arm holds.

        Otherwise it stands on its brakes, or others hold it. A motion under way goes on meanwhile.
        """
        if not (isinstance(duration, Real) and 0.0 <= duration < math.inf):
            raise CommandRefused(
                f"wait refused: {duration!r:.40} s; give a duration of 0 s or more"
            )
        if self._motion_thread == threading.get_ident():
            raise CommandRefused("wait refused: a subscriber must not block; return first")
        end, motion = self.time + duration, self._motion
        while motion is not None and motion.is_busy() and self.time < end:
            with suppress(CommandRefused):
                motion.wait(min(self.grain, end - self.time))
        rest_s = end - self.time
        if rest_s * self.rate < 0.5:
            return
        if not (self._controls and self.operating_state().is_ready):
            self._backend.wait(rest_s)
            return
        hold = self.latest_setpoint("wait")
        rows = np.broadcast_to(hold, (round(rest_s * self.rate), len(hold)))
        self._run(self._begin("wait", rest_s), iter([rows]))

    def subscribe(self, callback: Listener, every: float = 0.0) -> None:
        """Call `callback` with every StateBlock and TruthBlock from now on, in time order.

        Blocks come as the arm reports them, or joined to up to `every` seconds each, which costs a
        recorder less; what is left is delivered by `unsubscribe`. The callback runs in the thread
        that moves the arm: it must not block, and an exception in it stops the arm and ends its
        calls.
        """
        self._subscriptions.append(Subscription(callback, every))

    def deliver(self, callback: Listener) -> None:
        """Call `callback` with the blocks that are kept for it."""
        for subscription in [s for s in self._subscriptions if s.callback == callback]:
            subscription.flush()

    def unsubscribe(self, callback: Listener) -> None:
        """Stop calling `callback`; one that is not subscribed is left alone."""
        for subscription in [s for s in self._subscriptions if s.callback == callback][:1]:
            self._subscriptions.remove(subscription)
            subscription.flush()

    def _on_block(self, block: StateBlock | TruthBlock) -> None:
        if isinstance(block, StateBlock) and len(block.t):
            before = self._latest
            t = block.t if before is None else np.append(self._stamps, block.t)
            if self._motion is not None and before is not None:
                rows = np.vstack([before.measured[-1:], block.measured])
                rows = rows[:, self._joint_channels]
                jump = limits.jump_of(self.robot, self.rate, t, rows)
                self._jump_reported = self._jump_reported or jump
            self._stamps = t[-limits.JITTER :]
            # In this order: who reads the one before first never gets the same one twice.
            self._latest, self._before, self._unreported_s = block, before, 0.0
        broken: BaseException | None = None
        for subscription in tuple(self._subscriptions):
            try:
                subscription(block)
            except BaseException as error:  # noqa: BLE001  # the others must hear of the arm
                self._subscriptions.remove(subscription)
                broken = broken or error
        if broken is not None:
            raise broken

    def newest_state(self, name: str, age: float = MAX_AGE) -> StateBlock:
        """Newest state message, for a command called `name`; refused as `measured_js`."""
        block = self._latest
        if block is None:
            raise CommandRefused(f"{name} refused: the arm is not homed; send 'home' first")
        now = self.time - float(block.t[-1])
        if now > age:
            raise CommandRefused(
                f"{name} refused: the newest state message is {now:.3g} s old, more than {age:g}; "
                f"the arm is {self.operating_state().state}: does it report?"
            )
        return block

    def _joint_state(self, block: StateBlock, position: Array, velocity: Array) -> JointState:
        t, names, columns = float(block.t[-1]), self.robot.joint_names, self._joint_channels
        effort = joint_efforts(self.robot, block.rows(slice(-1, None)))[0]
        return JointState(t, names, position[-1, columns], velocity[-1, columns], effort)

    def _check_control(self, command: str) -> None:
        if not self._controls:
            raise CommandRefused(
                f"{command} refused: this program looks on; make the Arm to control"
            )

    def latest_setpoint(self, command: str, *, pre_empts: bool = False) -> Array:
        """Set-point (n_joints,) [rad or m] that a relative `command` or a move starts at.

        Raises CommandRefused unless the arm is ready; one that `pre_empts` a motion may be busy.
        """
        now = self.operating_state()
        check_ready(replace(now, is_busy=now.is_busy and not pre_empts), command)
        return np.asarray(self._latest_setpoints()[-1])

    def _latest_setpoints(self) -> Array:
        """Last two (2, n_joints) [rad or m], the same twice where none was sent."""
        if self._last_setpoints is None:
            return np.tile(self.setpoint_js(np.inf).position, (2, 1))
        return self._last_setpoints

    def _move(self, knots: Array, speed: ArrayLike | None, command: str) -> Motion:
        caps = limits.move_speed(self.robot, speed, command)
        blocks.check_range(self.robot, knots, command)
        start = self.latest_setpoint(command)
        if self._last_setpoints is None:  # what is planned from is what steps are checked against
            self._last_setpoints = np.tile(start, (2, 1))
        law = time_law(np.vstack([start, knots]), caps)
        return self.stream(law.blocks(self.rate), law.duration, command)

    def _servo(self, rows: Array, command: str) -> None:
        check_ready(self.operating_state(), command)
        for _ in self._checked([rows], command):
            pass
        self._run(self._begin(command, len(rows) / self.rate), iter([rows]), waits=len(rows) > 1)

    def _checked(self, pieces: Iterable[Array], command: str) -> Iterator[Array]:
        for rows in pieces:
            blocks.check_range(self.robot, rows, command)
            limits.check_steps(self.robot, self.rate, self._latest_setpoints()[-1], rows, command)
            yield rows

    def _begin(self, command: str, duration: float) -> Motion:
        """Take the arm for a motion; raises CommandRefused if it is not ready or busy."""
        self._check_control(command)
        with self._lock:
            check_ready(self.operating_state(), command)
            self._stop_command = ""
            self._motion = motion = Motion(command, duration, self._stop)
        return motion

    def _run(self, motion: Motion, pieces: Iterator[Array], *, waits: bool = True) -> None:
        self._drive(motion, pieces, waits=waits)
        motion.wait()

    def _drive(self, motion: Motion, pieces: Iterator[Array], *, waits: bool = True) -> None:
        """Send a motion piece by piece until its end or until it is asked to stop.

        Unless it `waits` for the last set-point, the next may be sent before that is executed: one
        who streams single ones at the robot's own pace has no time to lose.
        """
        self._motion_thread = threading.get_ident()
        error: BaseException | None = None
        try:
            for rows in pieces:
                self._send(motion, rows)
                if self._stop_command:
                    break
            if waits and not self._stop_command:
                missing = self._backend.flush(go_on=lambda: not self._stop_command)
                error = NotArrived(f"{motion.command} is over, but {missing}") if missing else None
        except BaseException as caught:  # noqa: BLE001  # whatever it is, the arm stops
            error = caught
            self._stop_command = self._stop_command or "pause"
        try:
            if self._stop_command:
                stopped = self._stand(motion)
                error = error or stopped
        except BaseException as caught:  # noqa: BLE001  # who waits must hear of it
            error = error or caught
        finally:
            with self._lock:
                self._motion, self._motion_thread = None, 0
            motion.ended(error)

    def _send(self, motion: Motion, rows: Array) -> None:
        """Send set-points, in pieces as long as subscribers want blocks, until asked to stop."""
        path, taken = np.vstack([self._latest_setpoints(), rows]), 0
        while taken < len(rows) and not self._stop_command:
            state = self._backend.operating_state()
            silent = 0.0 if self._latest is None else state.t - float(self._latest.t[-1])
            # The robot itself, or another program, may have stopped it.
            why = self._jump_reported if state.is_ready else state.state
            if not why and silent > SILENCE and self._unreported_s > SILENCE:
                why = f"no state message for {silent:.1f} s; does it report?"
            if why:
                raise motion.stopped(why, state.t)
            every = min((s.every for s in tuple(self._subscriptions)), default=self.stretch)
            size = max(round(min(max(every, self.grain), self.stretch) * self.rate), 1)
            piece = rows[taken : taken + size]
            # Before they are sent: a subscriber may raise meanwhile.
            self._last_setpoints = path[taken + len(piece) :][:2]
            try:
                done = self._backend.servo_jp(piece, lambda: not self._stop_command)
            except CommandRefused:  # there is nothing to brake along: the robot stands, or is gone
                self._last_setpoints = None
                raise
            taken += done
            self._last_setpoints = path[taken : taken + 2]
            motion.elapsed += done / self.rate
            self._unreported_s += done / self.rate

    def _stand(self, motion: Motion) -> MotionStopped:
        """Brake and carry out what stops the motion; gives the error that says so."""
        asked = self._stop_command
        with suppress(Exception):  # whatever keeps it from braking, it can still be paused
            self._brake()
        state = self._backend.operating_state()
        if asked != "hold" and state.state == "ENABLED":
            with suppress(TruejointError):
                self._backend.state_command(asked, TIMEOUT)  # type: ignore[arg-type]
                self._stop_command = ""
        after = self._backend.operating_state()
        return motion.stopped("held" if asked == "hold" else after.state, after.t)

    def _brake(self) -> None:
        """Bring the set-point to rest along the way that it went."""
        if self._last_setpoints is None or not self._backend.operating_state().is_ready:
            return
        step, start = self._last_setpoints[1] - self._last_setpoints[0], self._last_setpoints[1]
        if not step.any():
            return
        n = max(int(BRAKING * self.rate), 1)
        share = 1.0 - np.arange(1, n + 1) / n
        rows = np.clip(start + np.cumsum(share)[:, None] * step, self.robot.lower, self.robot.upper)
        self._backend.servo_jp(rows, lambda: True)
        self._backend.flush(BRAKING)
        self._last_setpoints = rows[-1:].repeat(2, axis=0)

    def _ask(self, motion: Motion | None, command: str) -> bool:
        """Ask a motion to stop, without waiting; whether it is under way."""
        with self._lock:
            running = motion is not None and motion is self._motion
            if running:
                self._stop_command = command
        return running

    def _stop(self, motion: Motion | None, command: str, timeout: float = TIMEOUT) -> None:
        """Stop a motion, or the arm if there is none, by a state command or by holding."""
        running = self._ask(motion, command)
        if running and self._motion_thread == threading.get_ident():
            return  # from a subscriber: the motion ends when it returns
        if motion is not None and running:
            motion.over.wait(timeout)
        elif motion is None:
            self._brake()
        is_done = running and not self._stop_command  # somebody may have resumed it since
        target = {"pause": "PAUSED", "disable": "DISABLED"}.get(command)
        if target and not is_done and self._backend.operating_state().state != target:
            self._backend.state_command(command, timeout)  # type: ignore[arg-type]


def joint_efforts(robot: Robot, block: StateBlock) -> Array:
    """Efforts (n, n_joints) on the joints themselves [Nm or N]; (n, 0) where none are stated."""
    if not block.effort.shape[1]:
        return np.empty((len(block.t), 0))
    efforts = block.effort[:, robot.joint_channels]
    if robot.transmission is not None and robot.effort == "motor":
        efforts = robot.transmission.joint_effort(efforts)
    return efforts


def as_arm(value: Arm) -> Arm:
    """Give back an arm; raises CommandRefused for anything else, saying how to get one."""
    if hasattr(value, "subscribe"):  # as anything may have that stands for one
        return value
    raise CommandRefused(other_kind(value, "Arm", "simulated_arm(robot) gives one"))


@atexit.register
def _leave_paused() -> None:
    for arm in tuple(_OPEN):
        with suppress(Exception):
            arm.close()
