"""Least squares on both cables' displacements and their derivatives: (29) and (30) of yan2020."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled
from truejoint.estimators.family import Family, Params, Shape, one_of, only_joint
from truejoint.estimators.jaw.signals import (
    COEFFICIENTS,
    DRIVE,
    ERROR_SHAPES,
    MOTOR,
    RESET,
    bounded_error,
)
from truejoint.estimators.products import weighted
from truejoint.layout import Layout, Memory

OBSERVED: Final = 7
"""Columns of the observation matrix (29)."""

LAYOUT: Final = Layout()
LAYOUT.integer("compensated", "1: less the error model in the motor's angle")
LAYOUT.scalar("constant", "of the sum [rad]")
LAYOUT.array("coef", "of each column", OBSERVED)
LAYOUT.array("scale", "inverse largest motor angle [1/rad] and displacement [1/m]", 2)
LAYOUT.array("error_coef", "coefficients of the error model (25)", COEFFICIENTS)
LAYOUT.array("error_range", "within which that is believed [rad]", 2)
LAYOUT.array("last", "displacements [m] and speeds [m/s] of the row before", 4)
LAYOUT.array("columns", "of a row: x1 and x2 with derivatives, sign of a speed", OBSERVED)
unpack = LAYOUT.unpacker()


@compiled
def cable_least_squares_row(
    numbers: Integers, memory: Array, dt: float, x: Array, out: Array, half_width: Array
) -> None:
    """Predict by (29), or by (30) where there is an error model."""
    m = unpack(numbers, memory)
    drive, reset = x[m.compensated], x[m.compensated + 1]
    observe(dt, drive, reset, m.last, m.columns)
    error = 0.0
    if m.compensated == 1:
        error = bounded_error(x[0], reset, m.scale, m.error_coef, m.error_range, half_width)
    out[0] = weighted(m.columns, m.coef) + m.constant - error


@compiled
def observe(dt: float, drive: float, reset: float, last: Array, out: Array) -> None:
    """One row of (29) into `out` (7,): both displacements [m], their speeds and accelerations.

    Last comes the sign of the drive's speed. `dt` [s] is 0 where a history starts, at rest; `last`
    (4,), displacements and speeds of the row before, is changed in place.
    """
    for i in range(2):
        place = drive if i == 0 else reset
        speed = 0.0
        acceleration = 0.0
        if dt > 0.0:
            speed = (place - last[i]) / dt
            acceleration = (speed - last[2 + i]) / dt
        last[i] = place
        last[2 + i] = speed
        out[3 * i] = place
        out[3 * i + 1] = speed
        out[3 * i + 2] = acceleration
    out[6] = np.sign(out[4])


@compiled
def observe_rows(dt: Array, drive: Array, reset: Array, out: Array) -> None:
    """(29) of every row, into `out` (n, 7)."""
    last = np.zeros(4)
    for i in range(dt.shape[0]):
        observe(dt[i], drive[i], reset[i], last, out[i])


def _shapes(params: Params, _n_features: int, n_outputs: int) -> dict[str, Shape]:
    shapes: dict[str, Shape] = {"coef": (OBSERVED,), "constant": (1,)}
    if params["compensated"]:
        shapes |= ERROR_SHAPES
    return only_joint("jaw.least_squares", shapes, n_outputs)


def _pack(params: Params, arrays: Mapping[str, Array], _k: int, _n: int) -> Memory:
    return LAYOUT.pack(compensated=params["compensated"], **arrays)


FAMILY: Final = Family(
    "jaw.least_squares",
    rules={
        "intercept": one_of(False, True),
        "compensated": one_of(False, True),
    },
    shapes=_shapes,
    pack=_pack,
    row=cable_least_squares_row,
    remembers=True,
    counts_samples=True,  # differences of rows
    inputs=lambda params: (MOTOR, DRIVE, RESET) if params["compensated"] else (DRIVE, RESET),
    targets=("position", "error"),
)
