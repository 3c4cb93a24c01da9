"""Kernels that a simulated mechanism shares with a filter's model of one."""

import math

from truejoint.array_types import Array
from truejoint.compiled import inlined


@inlined
def dahl(friction: float, level: float, stiffness: float, way: float) -> float:
    """Friction [Nm, N] after `way` [rad, m] of Dahl's model, exact for one direction.

    It builds up with `stiffness` [Nm/rad, N/m] to `level` [Nm, N] (P. R. Dahl, A solid friction
    model, 1968, exponent 1); where that is 0, any way takes all of it.
    """
    if way == 0.0:
        return friction
    if level <= 0.0:
        return 0.0
    end = math.copysign(level, way)
    return end + (friction - end) * math.exp(-stiffness * abs(way) / level)


@inlined
def solve(matrix: Array, right: Array) -> None:
    """Solve a small positive definite system: `right` (n,) becomes the solution.

    `matrix` (n, n) is used up.
    """
    n = right.shape[0]
    for i in range(n):
        for row in range(i + 1, n):
            share = matrix[row, i] / matrix[i, i]
            for k in range(i + 1, n):
                matrix[row, k] -= share * matrix[i, k]
            right[row] -= share * right[i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            right[i] -= matrix[i, k] * right[k]
        right[i] /= matrix[i, i]
