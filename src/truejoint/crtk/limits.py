"""Limits enforced at the door: joint range and step per millisecond."""

from __future__ import annotations

from typing import Final

import numpy as np

from truejoint.array_types import Array
from truejoint.crtk.protocol import SERVO_RATE
from truejoint.errors import CommandRefused
from truejoint.robots import Robot
from truejoint.robots.joint_rows import at_sample
from truejoint.units import display_unit

# Rounding of a planned set-point that lies on a limit [rad or m]; far below any encoder's step.
_ROUNDING: Final = 1e-9


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


def shown(value: float, unit: str) -> str:
    """Quantity in `unit` (SI) as a person reads it, for instance ``"92.5 deg"``."""
    display = display_unit(unit)
    return f"{value * display.scale:.4g} {display.name}"


def shown_range(low: float, high: float, unit: str) -> str:
    """Range in `unit` (SI) as a person reads it, for instance ``"[0, 90] deg"``."""
    display = display_unit(unit)
    return f"[{low * display.scale:.4g}, {high * display.scale:.4g}] {display.name}"
