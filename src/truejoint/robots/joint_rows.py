"""Joint vectors from outside, checked before anything is computed from them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from truejoint.array_types import Array
from truejoint.errors import CommandRefused
from truejoint.robots.robot import Robot

SETPOINT_DT: Final = 1e-3  # [s] between set-points: RAVEN's servo period (peng2024 IV-A)
GRAIN: Final = 0.01
"""Longest piece of a motion [s]: what is asked meanwhile takes effect after it."""


def in_grains(rows: Array, size: int = round(GRAIN / SETPOINT_DT)) -> Iterator[Array]:
    """Pieces of set-points (n, n_joints), at most `size` long: by default `GRAIN` of a twin's."""
    for start in range(0, len(rows), size):
        yield rows[start : start + size]


def checked_vector(robot: Robot, value: ArrayLike, command: str) -> Array:
    """Joint vector (n_joints,) as floats; raises CommandRefused on wrong shape or NaN."""
    return np.asarray(checked_rows(robot, np.asarray(value, dtype=float)[None], command)[0])


def checked_rows(robot: Robot, value: ArrayLike, command: str) -> Array:
    """Joint vectors (n, n_joints) as floats; raises CommandRefused on wrong shape or NaN."""
    rows = np.ascontiguousarray(value, dtype=float)
    if rows.ndim != 2 or rows.shape[1] != len(robot.joints):
        raise CommandRefused(
            f"{command} refused: got shape {rows.shape[1:]} per sample, want "
            f"{len(robot.joints)} values, one for each of {', '.join(robot.joint_names)}"
        )
    if not np.isfinite(rows).all():
        row, column = np.argwhere(~np.isfinite(rows))[0]
        raise CommandRefused(
            f"{command} refused: {robot.joints[column].name} is {rows[row, column]}"
            f"{at_sample(row, rows)}; send finite values in rad and m"
        )
    return rows


def at_sample(row: int, rows: Array) -> str:
    """Name the sample of a stream; nothing for a single command."""
    return f" at sample {row} of {len(rows)}" if len(rows) > 1 else ""
