"""Limits enforced at the door: shape, NaN, joint range, step per millisecond."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from truejoint.crtk.backend import SERVO_RATE
from truejoint.crtk.messages import Array
from truejoint.errors import CommandRefused
from truejoint.robots import Joint, Robot
from truejoint.units import display_unit

# Rounding of a planned set-point that lies on a limit [rad or m]; far below any encoder's step.
_ROUNDING: Final = 1e-9


def checked_vector(robot: Robot, value: ArrayLike, command: str) -> Array:
    """Joint vector (n_joints,) as floats; raises CommandRefused on wrong shape or NaN."""
    vector: Array = checked_rows(robot, np.asarray(value, dtype=float)[None], command)[0]
    return vector


def checked_rows(robot: Robot, value: ArrayLike, command: str) -> Array:
    """Joint vectors (n, n_joints) as floats; raises CommandRefused on wrong shape or NaN."""
    rows = np.asarray(value, dtype=float)
    if rows.ndim != 2 or rows.shape[1] != len(robot.joints):
        raise CommandRefused(
            f"{command} refused: got shape {rows.shape[1:]} per sample, want "
            f"{len(robot.joints)} values, one for each of {', '.join(robot.joint_names)}"
        )
    if not np.isfinite(rows).all():
        row, column = np.argwhere(~np.isfinite(rows))[0]
        raise CommandRefused(
            f"{command} refused: {robot.joints[column].name} is {rows[row, column]}"
            f"{_at(row, rows)}; send finite values in rad and m"
        )
    return rows


def check_range(robot: Robot, rows: Array, command: str) -> None:
    """Raise CommandRefused if a position in `rows` (n, n_joints) is outside its joint's range."""
    outside = (rows < robot.lower - _ROUNDING) | (rows > robot.upper + _ROUNDING)
    if not outside.any():
        return
    row, column = np.argwhere(outside)[0]
    joint = robot.joints[column]
    raise CommandRefused(
        f"{command} refused: {joint.name} at {shown(joint, rows[row, column])}{_at(row, rows)} "
        f"is outside its range {shown_range(joint)}; stay inside, in rad and m"
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
        f"{_at(row, rows)}, more than {shown(joint, limit[column])}; send smaller steps or move_jp"
    )


def shown(joint: Joint, value: float) -> str:
    """Position of `joint` as a person reads it, for instance ``"92.5 deg"``."""
    unit = display_unit(joint.unit)
    return f"{value * unit.scale:.4g} {unit.name}"


def shown_range(joint: Joint) -> str:
    """Range of `joint` as a person reads it, for instance ``"[0, 90] deg"``."""
    unit = display_unit(joint.unit)
    return f"[{joint.lower * unit.scale:.4g}, {joint.upper * unit.scale:.4g}] {unit.name}"


def _at(row: int, rows: Array) -> str:
    """Where in a stream; nothing for a single command."""
    return f" at sample {row} of {len(rows)}" if len(rows) > 1 else ""
