"""Per-row kernels: derivatives, banks of play operators, weighted sums, the error model (25)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from truejoint.compiled import compiled

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

OBSERVED: Final = 7
"""Columns of the observation matrix (29)."""
COEFFICIENTS: Final = 11
"""Coefficients of the rational error model (25)."""
NEAREST: Final = 1e-3
"""To which the error model's denominator is kept from zero when evaluated."""


@compiled
def observation_row(interval: float, drive: float, reset: float, memory: Array, out: Array) -> None:
    """One row of (29): both displacements, their speeds and accelerations, sign of the last speed.

    Parameters
    ----------
    interval : float
        Time since the row before [s]; 0 starts anew, at rest.
    drive, reset : float
        ``x1``, ``x2`` [m].
    memory : ndarray, shape (4,)
        Displacements and speeds of the row before; changed in place.
    out : ndarray, shape (7,)
    """
    for i in range(2):
        place = drive if i == 0 else reset
        speed = 0.0
        acceleration = 0.0
        if interval > 0.0:
            speed = (place - memory[i]) / interval
            acceleration = (speed - memory[2 + i]) / interval
        memory[i] = place
        memory[2 + i] = speed
        out[3 * i] = place
        out[3 * i + 1] = speed
        out[3 * i + 2] = acceleration
    out[6] = np.sign(out[4])


@compiled
def observation_rows(steps: Array, drive: Array, reset: Array, out: Array) -> None:
    """(29) of every row, into `out` (n, 7)."""
    memory = np.zeros(4)
    for i in range(steps.shape[0]):
        observation_row(steps[i], drive[i], reset[i], memory, out[i])


@compiled
def bank_row(
    fresh: bool, value: float, scale: float, degree: int, widths: Array, memory: Array, out: Array
) -> None:
    """Powers of a signal, and how far it stands in the dead band of each play operator.

    Parameters
    ----------
    fresh : bool
        Whether the history starts here; every play then is in the middle of its band.
    value : float
        Signal [m].
    scale : float
        Inverse of its largest magnitude [1/m], for the powers.
    degree : int
        Highest power.
    widths : ndarray, shape (k,)
        Half-widths of the plays [m].
    memory : ndarray, shape (k,)
        Outputs of the plays; changed in place.
    out : ndarray, shape (degree + k,)
        Powers 1 to `degree`, then each play's deflection, -1 to 1.
    """
    power = 1.0
    for i in range(degree):
        power *= value * scale
        out[i] = power
    for i in range(widths.shape[0]):
        if fresh:
            memory[i] = value
        memory[i] = min(max(memory[i], value - widths[i]), value + widths[i])
        out[degree + i] = (value - memory[i]) / widths[i]


@compiled
def bank_rows(
    steps: Array, values: Array, scale: float, degree: int, widths: Array, out: Array
) -> None:
    """`bank_row` of every row, into `out` (n, degree + k)."""
    memory = np.zeros(widths.shape[0])
    for i in range(steps.shape[0]):
        bank_row(steps[i] == 0.0, values[i], scale, degree, widths, memory, out[i])


@compiled
def product_row(row: Array, pairs: Integers, out: Array) -> None:
    """Products of the first column with columns `pairs` (k,) of one row, into `out` (k,)."""
    for i in range(pairs.shape[0]):
        out[i] = row[0] * row[pairs[i]]


@compiled
def product_rows(rows: Array, pairs: Integers, out: Array) -> None:
    """`product_row` of every row, into `out` (n, k)."""
    for i in range(rows.shape[0]):
        product_row(rows[i], pairs, out[i])


@compiled
def weighted(row: Array, weights: Array) -> float:
    """Sum of products, in the order of the columns whatever the number of rows."""
    total = 0.0
    for i in range(weights.shape[0]):
        total += row[i] * weights[i]
    return total


@compiled
def weighted_rows(rows: Array, weights: Array, out: Array) -> None:
    """`weighted` of every row, into `out` (n,)."""
    for i in range(rows.shape[0]):
        out[i] = weighted(rows[i], weights)


@compiled
def rational_row(motor: float, reset: float, scale: Array, p: Array) -> float:
    """Error (25) at one motor angle [rad] and displacement [m]; finite whatever the denominator."""
    u = motor * scale[0]
    v = reset * scale[1]
    above = p[0] + p[2] * u + p[4] * v + p[6] * u * u + p[8] * v * v + p[10] * u * v
    below = 1.0 + p[1] * u + p[3] * v + p[5] * u * u + p[7] * v * v + p[9] * u * u * v
    if abs(below) < NEAREST:
        below = NEAREST if below >= 0.0 else -NEAREST
    return float(above / below)


@compiled
def rational_rows(motor: Array, reset: Array, scale: Array, p: Array, out: Array) -> None:
    """Error (25) of every row, into `out` (n,)."""
    for i in range(out.shape[0]):
        out[i] = rational_row(motor[i], reset[i], scale, p)


@compiled
def redescending(difference: float, gate: float) -> float:
    """Hampel's function: `difference` itself within `gate`, falling to 0 at twice the gate."""
    size = abs(difference)
    if size <= gate:
        return difference
    if size >= 2.0 * gate:
        return 0.0
    return difference * (2.0 * gate - size) / size
