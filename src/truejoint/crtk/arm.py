"""One arm under CRTK's names, whatever is behind it."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from truejoint.array_types import Array
from truejoint.crtk.planning import time_law
from truejoint.crtk.protocol import BLOCK_DURATION, SERVO_RATE, Backend, Listener
from truejoint.crtk.states import JointState, OperatingState, check_ready, next_state
from truejoint.errors import CommandRefused, RobotError
from truejoint.robots import Robot
from truejoint.robots.blocks import StateBlock, TruthBlock
from truejoint.robots.joint_rows import at_sample, checked_rows, checked_vector
from truejoint.units import shown, shown_range

# Default speeds of a move, as uw-biorobotics/raven2_CRTK_Python_controller goes to a pose
# (python_controller/raven_py_controller.py: positioning joints) and turns the tool
# (python_controller/run_r2_keyboard_controller.py: the others) [rad/s, m/s].
_MOVE_POSITIONING: Final = np.deg2rad(3.0)
_MOVE_TOOL: Final = np.deg2rad(10.0)
_MOVE_PRISMATIC: Final = 0.01
# Rounding of a planned set-point that lies on a limit [rad or m]; far below any encoder's step.
_ROUNDING: Final = 1e-9
_BLOCK: Final = int(BLOCK_DURATION * SERVO_RATE)  # rows


class Arm:
    """A robot arm; commands and measurements are named and mean what CRTK says.

    Positions are in rad and m, in the order of ``arm.robot.joints``. Every command is checked
    against state and limits before it reaches the robot, and refused with a reason; a refused
    command changes nothing. Positions relative are relative to the latest set-point.

    Parameters
    ----------
    backend : Backend
        For instance from `truejoint.crtk.simulated_arm`, which makes the arm as well.

    Attributes
    ----------
    robot : Robot
        What the arm is: joints, limits, kinematics.

    References
    ----------
    collaborative-robotics/documentation:docs/pages/api-robot-motion.rst

    Examples
    --------
    >>> arm.move_jp(arm.robot.home)
    >>> arm.operating_state().state
    'ENABLED'
    """

    def __init__(self, backend: Backend) -> None:
        self._backend = backend
        self.robot: Final[Robot] = backend.robot
        self._joint_channels = [self.robot.channels.index(n) for n in self.robot.joint_names]
        self._listeners: list[Listener] = []
        self._latest: StateBlock | None = None
        self._moving = False
        backend.connect(self._on_block)

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
        return replace(now, is_busy=now.is_busy or self._moving)

    def state_command(self, command: str) -> None:
        """Send ``enable``, ``disable``, ``pause``, ``resume``, ``home`` or ``unhome``; blocks.

        Raises CommandRefused if it is not allowed now; the message says what to send first.
        """
        next_state(self.operating_state(), command)
        self._backend.state_command(command)  # type: ignore[arg-type]  # next_state knows it
        if command == "unhome":
            self._latest = None

    def enable(self) -> None:
        """Switch the motors on."""
        self.state_command("enable")

    def disable(self) -> None:
        """Switch the motors off; the way out of a fault."""
        self.state_command("disable")

    def pause(self) -> None:
        """Stop and hold; during a move, from a subscriber, it ends the move."""
        self.state_command("pause")

    def resume(self) -> None:
        """Go on after `pause`."""
        self.state_command("resume")

    def home(self) -> None:
        """Explore the hard stops, register the motor encoders, go to the home pose."""
        self.state_command("home")

    def unhome(self) -> None:
        """Forget the registration of the motor encoders."""
        self.state_command("unhome")

    def measured_js(self) -> JointState:
        """Position, velocity and effort of every joint as measured at the motors.

        Raises CommandRefused before homing: there is nothing valid to report.
        """
        block = self._valid("measured_js")
        return self._joint_state(block, block.measured, block.velocity)

    def setpoint_js(self) -> JointState:
        """Latest set-point, its velocity and the effort command; refused before homing."""
        block = self._valid("setpoint_js")
        velocity = np.diff(block.setpoint, axis=0, prepend=block.setpoint[:1]) * SERVO_RATE
        return self._joint_state(block, block.setpoint, velocity)

    def measured_cp(self) -> Array:
        """Tool pose (4, 4) [m] in the frame of the robot's CRTK topics, of `measured_js`.

        Raises RobotError if the robot's kinematics are not known.
        """
        kinematics = self.robot.kinematics
        if kinematics is None:
            raise RobotError(f"measured_cp: the kinematics of {self.robot.title} are not known")
        return kinematics.crtk_from_base @ kinematics.forward(self.measured_js().position)

    def servo_jp(self, position: ArrayLike) -> None:
        """Go to `position` (n_joints,) [rad or m] within one servo period.

        Raises CommandRefused if not ready, or on NaN, wrong shape, a joint limit or too large a
        step.
        """
        target = checked_vector(self.robot, position, "servo_jp")
        self._stream(target[None], "servo_jp")

    def servo_jr(self, increment: ArrayLike) -> None:
        """Go by `increment` (n_joints,) [rad or m] from the latest set-point; as `servo_jp`."""
        step = checked_vector(self.robot, increment, "servo_jr")
        check_ready(self.operating_state(), "servo_jr")
        self._stream((self.setpoint_js().position + step)[None], "servo_jr")

    def servo_jp_stream(self, positions: ArrayLike) -> None:
        """Stream `positions` (n, n_joints) [rad or m] at 1 kHz; blocks until all are sent.

        The whole stream is checked before its first sample is sent; raises as `servo_jp`.
        """
        rows = checked_rows(self.robot, positions, "servo_jp_stream")
        self._stream(rows, "servo_jp_stream")

    def move_jp(self, goal: ArrayLike, speed: ArrayLike | None = None) -> None:
        """Go to `goal` (n_joints,) [rad or m] along a straight line; blocks until there.

        All joints arrive together (`planning.TimeLaw`), none faster than `speed` (n_joints,) [rad/s
        or m/s]; by default 3 deg/s for the positioning joints, 10 mm/s for a prismatic one and 10
        deg/s for the others. Raises CommandRefused as `servo_jp`, or if a speed is not positive or
        above the joint's top speed.
        """
        target = checked_vector(self.robot, goal, "move_jp")
        caps = self._move_speed(speed)
        check_range(self.robot, target[None], "move_jp")
        check_ready(self.operating_state(), "move_jp")
        law = time_law(np.vstack([self.setpoint_js().position, target]), caps)
        self._moving = True
        try:
            for block in law.blocks():
                self._send(block, "move_jp")
        finally:
            self._moving = False

    def wait(self, duration: float) -> None:
        """Let `duration` [s] pass; enabled and homed, the arm holds its set-point and reports.

        Otherwise it stands on its brakes and reports nothing.
        """
        if not (np.isfinite(duration) and duration >= 0.0):
            raise CommandRefused(f"wait refused: {duration} s; give a duration of 0 s or more")
        if not self.operating_state().is_ready:
            self._backend.wait(float(duration))
            return
        hold = self.setpoint_js().position
        for left in range(round(duration * SERVO_RATE), 0, -_BLOCK):
            self._send(np.tile(hold, (min(left, _BLOCK), 1)), "wait")

    def subscribe(self, callback: Listener) -> None:
        """Call `callback` with every StateBlock and TruthBlock from now on, in time order."""
        self._listeners.append(callback)

    def unsubscribe(self, callback: Listener) -> None:
        """Stop calling `callback`; one that is not subscribed is left alone."""
        if callback in self._listeners:
            self._listeners.remove(callback)

    def _on_block(self, block: StateBlock | TruthBlock) -> None:
        if isinstance(block, StateBlock) and len(block.t):
            # Two rows are enough for every getter.
            self._latest = block.rows(slice(-2, None))
        for listener in tuple(self._listeners):
            listener(block)

    def _valid(self, name: str) -> StateBlock:
        if self._latest is None:
            raise CommandRefused(f"{name} refused: the arm is not homed; send 'home' first")
        return self._latest

    def _joint_state(self, block: StateBlock, position: Array, velocity: Array) -> JointState:
        t, names, columns = float(block.t[-1]), self.robot.joint_names, self._joint_channels
        effort = block.effort[-1, columns] if block.effort.shape[1] else np.empty(0)
        return JointState(t, names, position[-1, columns], velocity[-1, columns], effort)

    def _stream(self, rows: Array, command: str) -> None:
        check_ready(self.operating_state(), command)
        check_range(self.robot, rows, command)
        check_steps(self.robot, self.setpoint_js().position, rows, command)
        for start in range(0, len(rows), _BLOCK):
            self._send(rows[start : start + _BLOCK], command)

    def _send(self, rows: Array, command: str) -> None:
        # A subscriber may have paused the arm since the last block.
        state = self._backend.operating_state()
        if not state.is_ready:
            raise CommandRefused(f"{command} stopped at t = {state.t:.3f} s: {state.state}")
        self._backend.servo_jp(rows)

    def _move_speed(self, speed: ArrayLike | None) -> Array:
        joints = self.robot.joints
        top = np.array([joint.max_speed for joint in joints])
        if speed is None:
            positioning = [joint.name in self.robot.positioning for joint in joints]
            turning = np.where(positioning, _MOVE_POSITIONING, _MOVE_TOOL)
            sliding = [joint.kind == "prismatic" for joint in joints]
            return np.asarray(np.minimum(np.where(sliding, _MOVE_PRISMATIC, turning), top))
        caps = checked_vector(self.robot, speed, "move_jp speed")
        wrong = ~((caps > 0.0) & (caps <= top))
        if wrong.any():
            joint, cap = joints[int(np.argmax(wrong))], float(caps[np.argmax(wrong)])
            unit = joint.unit + "/s"
            raise CommandRefused(
                f"move_jp refused: speed of {joint.name} is {shown(cap, unit)}; want more than 0 "
                f"and at most {shown(joint.max_speed, unit)}"
            )
        return caps


def check_range(robot: Robot, rows: Array, command: str) -> None:
    """Raise CommandRefused if a position in `rows` (n, n_joints) is outside its joint's range."""
    outside = (rows < robot.lower - _ROUNDING) | (rows > robot.upper + _ROUNDING)
    if outside.any():
        row, column = np.argwhere(outside)[0]
        joint = robot.joints[column]
        raise CommandRefused(
            f"{command} refused: {joint.name} at {shown(rows[row, column], joint.unit)}"
            f"{at_sample(row, rows)} is outside its range "
            f"{shown_range(joint.lower, joint.upper, joint.unit)}; stay inside, in rad and m"
        )


def check_steps(robot: Robot, start: Array, rows: Array, command: str) -> None:
    """Raise CommandRefused if a joint would step faster than its top speed.

    `rows` (n, n_joints) follow each other at `SERVO_RATE`, the first `start` (n_joints,).
    """
    limit = np.array([joint.max_speed for joint in robot.joints]) / SERVO_RATE
    step = np.abs(np.diff(rows, axis=0, prepend=start[None]))
    excess = step > limit + _ROUNDING
    if excess.any():
        row, column = np.argwhere(excess)[0]
        joint = robot.joints[column]
        taken, most = shown(step[row, column], joint.unit), shown(limit[column], joint.unit)
        raise CommandRefused(
            f"{command} refused: {joint.name} would step by {taken} in 1 ms{at_sample(row, rows)}, "
            f"more than {most}; send smaller steps or move_jp"
        )
