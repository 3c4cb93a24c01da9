"""What potentiometers read against the encoders, along each joint's range."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.calibration.compatibility import check_units, in_all

if TYPE_CHECKING:
    from truejoint.recordings import Recording

STRETCHES: Final = 24
"""Parts of a joint's range in which readings are averaged: each has an error of its own."""
_RESOLUTION: Final = 1e-6  # [rad or m], finer than any


@dataclass(frozen=True, eq=False)
class PotentiometerReference:
    """Mean of potentiometer less measured position in stretches of each joint's trained range."""

    lower: Array  # (n_joints,), range of each measured position [rad or m]
    upper: Array
    difference: Array  # (n_joints, n_stretches) [rad or m]
    rows: Array  # (n_joints, n_stretches), readings in each; 0 without a potentiometer
    residual: Array  # (n_joints,), standard deviation of a reading in its stretch [rad or m]


def learn_reference(
    recordings: Sequence[Recording], joints: Sequence[str]
) -> PotentiometerReference | None:
    """Learn what potentiometers read against encoders; None where no joint has one everywhere.

    Raises CalibrationError if one is not in the unit of its joint's position.
    """
    lower, upper = np.zeros((2, len(joints)))
    residual = np.full(len(joints), _RESOLUTION)
    difference, rows = np.zeros((2, len(joints), STRETCHES))
    for k, joint in enumerate(joints):
        if not in_all(recordings, [f"pot/{joint}"]):
            continue
        unit = recordings[0].units[f"measured/{joint}"]
        check_units(recordings[0], {f"pot/{joint}": unit}, "not in")
        measured, pot = (
            np.concatenate([recording.column(f"{name}/{joint}") for recording in recordings])
            for name in ("measured", "pot")
        )
        lower[k], upper[k] = measured.min(), measured.max()
        stretch, rows[k], difference[k] = by_stretch(measured, pot - measured, lower[k], upper[k])
        residual[k] = max(np.std(pot - measured - difference[k][stretch]), _RESOLUTION)
    reference = PotentiometerReference(lower, upper, difference, rows, residual)
    return reference if rows.any() else None


def by_stretch(
    position: Array, values: Array, lower: float, upper: float
) -> tuple[Integers, Array, Array]:
    """Stretch of each position (n,) between the two, and rows and mean value of each stretch."""
    share = (position - lower) / max(upper - lower, _RESOLUTION) * STRETCHES  # of a joint at rest 0
    stretch = np.minimum(share.astype(np.int64), STRETCHES - 1)
    rows = np.bincount(stretch, minlength=STRETCHES).astype(np.float64)
    return stretch, rows, np.bincount(stretch, values, STRETCHES) / np.maximum(rows, 1.0)
