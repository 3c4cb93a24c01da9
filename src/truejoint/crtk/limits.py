"""Limits of a robot: steps and speeds that commands are checked against."""

import math
from numbers import Real
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from truejoint.array_types import Array
from truejoint.crtk.protocol import Backend
from truejoint.errors import CommandRefused, RobotError, other_kind
from truejoint.robots import Robot
from truejoint.robots.blocks import ROUNDING, at_sample, checked_vector
from truejoint.units import shown

# Default speeds of a move, as uw-biorobotics/raven2_CRTK_Python_controller goes to a pose
# (python_controller/raven_py_controller.py: positioning joints) and turns the tool
# (python_controller/run_r2_keyboard_controller.py: the others) [rad/s, m/s].
_MOVE_POSITIONING: Final = np.deg2rad(3.0)
_MOVE_TOOL: Final = np.deg2rad(10.0)
_MOVE_PRISMATIC: Final = 0.01
_OF_A_BACKEND: Final = tuple(name for name in vars(Backend) if not name.startswith("_"))
JITTER: Final = 20  # messages over which the jitter of their stamps evens out
_MOST_GRAIN: Final = 0.02  # [s] within which an arm that is stopped begins to brake


def checked_backend(backend: Backend) -> tuple[float, float]:
    """Rate [Hz] and grain [s] that a back end declares; raises RobotError if it is or has none."""
    # On its type first: the clock of a robot may not run yet.
    if missing := [
        name
        for name in _OF_A_BACKEND
        if not (hasattr(type(backend), name) or hasattr(backend, name))
    ]:
        advice = f"it lacks {', '.join(missing)}: see truejoint.crtk.Backend"
        raise RobotError(other_kind(backend, "Backend", advice))
    rate, grain = backend.rate, backend.grain
    if not (
        isinstance(rate, Real) and isinstance(grain, Real)
        and 0.0 < rate < math.inf and (1.0 - 1e-9) / rate <= grain <= _MOST_GRAIN
    ):  # fmt: skip
        raise RobotError(
            f"{backend.robot.title}: its back end declares {rate!s:.40} set-points a second and a "
            f"grain of {grain!s:.40} s; want a finite rate above 0 Hz, and a grain of a period or "
            f"more and at most {_MOST_GRAIN:g} s, within which an arm is to be stopped"
        )
    return float(rate), float(grain)


def check_steps(robot: Robot, rate: float, start: Array, rows: Array, command: str) -> None:
    """Raise CommandRefused if `rows` (n, n_joints) after `start`, at `rate` [Hz], step too fast."""
    limit = np.array([joint.max_speed for joint in robot.joints]) / rate
    step = np.abs(np.diff(rows, axis=0, prepend=start[None]))
    excess = step > limit + ROUNDING
    if excess.any():
        row, column = np.argwhere(excess)[0]
        joint = robot.joints[column]
        taken, most = shown(step[row, column], joint.unit), shown(limit[column], joint.unit)
        raise CommandRefused(
            f"{command} refused: {joint.name} would step by {taken} in {1e3 / rate:.3g} ms"
            f"{at_sample(row, rows)}, more than {most}; send smaller steps or move_jp"
        )


def jump_of(robot: Robot, rate: float, t: Array, measured: Array) -> str:
    """Say which joint's reports jump by twice what it can move; empty where none does.

    `measured` (n, n_joints) [rad or m] are consecutive positions, at most `rate` of them a second
    [Hz], with the last of the stamps `t` (n or more,) [s]. Stamps jitter, so that two say little of
    the time between two messages: it counts as the mean of up to `JITTER` where that is longer.
    """
    top = np.array([joint.max_speed for joint in robot.joints])
    step = np.abs(np.diff(measured, axis=0))
    end = np.arange(len(t) - len(step), len(t))
    begin = np.maximum(end - JITTER, 0)
    mean = (t[end] - t[begin]) / (end - begin)
    time = np.maximum(np.maximum(t[end] - t[end - 1], mean), 1.0 / rate)
    excess = step > 2.0 * top * time[:, None]
    if not excess.any():
        return ""
    row, column = np.argwhere(excess)[0]
    joint = robot.joints[column]
    size, when = shown(step[row, column], joint.unit), t[end[row]]
    return (
        f"{joint.name} jumped by {size} at t = {when:.3f} s, further than it can move: did its "
        "encoder slip? Home the arm"
    )


def move_speed(robot: Robot, speed: ArrayLike | None, command: str) -> Array:
    """Speed caps (n_joints,) [rad/s or m/s] of a move; refuses 0 or less, or above the top."""
    joints = robot.joints
    top = np.array([joint.max_speed for joint in joints])
    if speed is None:
        positioning = [joint.name in robot.positioning for joint in joints]
        turning = np.where(positioning, _MOVE_POSITIONING, _MOVE_TOOL)
        sliding = [joint.kind == "prismatic" for joint in joints]
        return np.asarray(np.minimum(np.where(sliding, _MOVE_PRISMATIC, turning), top))
    caps = checked_vector(robot, speed, f"{command} speed")
    wrong = ~((caps > 0.0) & (caps <= top))
    if wrong.any():
        joint, cap = joints[int(np.argmax(wrong))], float(caps[np.argmax(wrong)])
        unit = joint.unit + "/s"
        raise CommandRefused(
            f"{command} refused: speed of {joint.name} is {shown(cap, unit)}; want more than 0 "
            f"and at most {shown(joint.max_speed, unit)}"
        )
    return caps
