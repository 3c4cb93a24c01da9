"""Limits enforced at the door: joint range and step per millisecond."""

from __future__ import annotations

from typing import Final

import numpy as np

from truejoint.crtk.backends.protocol import SERVO_RATE
from truejoint.crtk.messages import Array
from truejoint.errors import CommandRefused
from truejoint.robots import Joint, Robot
from truejoint.robots.joint_rows import at_sample
from truejoint.units import display_unit

# Rounding of a planned set-point that lies on a limit [rad or m]; far below any encoder's step.
_ROUNDING: Final = 1e-9


def check_range(robot: Robot, rows: Array, command: str) -> None:
    """Raise CommandRefused if a position in `rows` (n, n_joints) is outside its joint's range."""
    outside = (rows < robot.lower - _ROUNDING) | (rows > robot.upper + _ROUNDING)
    if not outside.any():
        return
    row, column = np.argwhere(outside)[0]
    joint = robot.joints[column]
    raise CommandRefused(
        f"{command} refused: {joint.name} at {shown(joint, rows[row, column])}"
        f"{at_sample(row, rows)} is outside its range {shown_range(joint)}; stay inside, "
        "in rad and m"
    )


def check_steps(robot: Robot, start: Array, rows: Array, command: str) -> None:
    """Raise CommandRefused if a joint would step faster than its top speed.

    Parameters
    ----------
    robot : Robot
        `Joint.max_speed` gives the largest step in one period of the servo loop.
    start : ndarray, shape (n_joints,)
        Set-point before the first row [rad or m].
    rows : ndarray, shape (n, n_joints)
        Set-points at `SERVO_RATE` [rad or m].
    command : str
        Named in the message.
    """
    limit = np.array([joint.max_speed for joint in robot.joints]) / SERVO_RATE
    step = np.abs(np.diff(rows, axis=0, prepend=start[None]))
    excess = step > limit + _ROUNDING
    if not excess.any():
        return
    row, column = np.argwhere(excess)[0]
    joint = robot.joints[column]
    raise CommandRefused(
        f"{command} refused: {joint.name} would step by {shown(joint, step[row, column])} in 1 ms"
        f"{at_sample(row, rows)}, more than {shown(joint, limit[column])}; send smaller steps "
        "or move_jp"
    )


def shown(joint: Joint, value: float) -> str:
    """Position of `joint` as a person reads it, for instance ``"92.5 deg"``."""
    unit = display_unit(joint.unit)
    return f"{value * unit.scale:.4g} {unit.name}"


def shown_range(joint: Joint) -> str:
    """Range of `joint` as a person reads it, for instance ``"[0, 90] deg"``."""
    unit = display_unit(joint.unit)
    return f"[{joint.lower * unit.scale:.4g}, {joint.upper * unit.scale:.4g}] {unit.name}"
