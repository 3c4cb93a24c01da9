"""Factors of covariance matrices that survive rank deficiency, as compiled kernels.

Every covariance in the filter is a sum of outer products, written as the rows of `stack`: it is
positive semidefinite because of how it is made and not by luck of rounding. The kernels write into
arrays that the caller owns and allocate nothing.
"""

import math

import numpy as np

from truejoint.array_types import Array
from truejoint.compiled import compiled, copy, inlined

# A pivot below this share of its diagonal entry is rounding error, not information.
_PIVOT = 64.0 * 2.220446049250313e-16
# Rounding in a pivot grows with the conditioning of the rows before it. Only what is negative
# beyond this share of the diagonal entry is held for an indefinite matrix.
_INDEFINITE = 1e-8


@compiled
def wrap(angle: float) -> float:
    """Angle [rad] in (-pi, pi]; an angle that is already there is returned bit for bit."""
    if -math.pi < angle <= math.pi:
        return angle
    turned = angle - 2.0 * math.pi * np.ceil((angle - math.pi) / (2.0 * math.pi))
    # An angle beyond 2^52 turns has no direction left: rounding may put it anywhere.
    return float(min(max(turned, -math.pi), math.pi))


@compiled
def semidefinite_cholesky(covariance: Array, size: int, factor: Array) -> bool:
    """Lower factor L of a positive semidefinite matrix, L L' = covariance.

    Only the lower triangle is read. A direction without variance becomes a zero column, and nothing
    is added to the diagonal. False if the matrix is indefinite beyond rounding, so that it is not L
    L'.
    """
    semidefinite = True
    for j in range(size):
        pivot = covariance[j, j]
        for k in range(j):
            pivot -= factor[j, k] * factor[j, k]
            factor[k, j] = 0.0
        if not (pivot > _PIVOT * covariance[j, j]):
            semidefinite &= _drop_column(covariance, size, factor, j, pivot)
            continue
        # Root and reciprocal are computed at the same time; 1 / root would wait for the root.
        root = math.sqrt(pivot)
        scale = root * (1.0 / pivot)
        factor[j, j] = root
        for i in range(j + 1, size):
            rest = covariance[i, j]
            for k in range(j):
                rest -= factor[i, k] * factor[j, k]
            factor[i, j] = rest * scale
    return semidefinite


@compiled
def _drop_column(covariance: Array, size: int, factor: Array, column: int, pivot: float) -> bool:
    """Zero a column without a pivot; False if more than rounding stood in it."""
    noise = _INDEFINITE * covariance[column, column]
    nothing = pivot >= -noise
    factor[column, column] = 0.0
    for i in range(column + 1, size):
        rest = covariance[i, column]
        for k in range(column):
            rest -= factor[i, k] * factor[column, k]
        # Nothing may go along with a direction that does not vary. `not (a <= b)` instead of
        # `a > b`: it holds for NaN too.
        if not (rest * rest <= noise * covariance[i, i]):
            nothing = False
        factor[i, column] = 0.0
    return bool(nothing)


@compiled
def outer_sum(stack: Array, rows: int, size: int, covariance: Array) -> None:
    """Sum of the outer products of the rows of a stack, exactly symmetric."""
    for i in range(size):
        for j in range(i + 1):
            total = 0.0
            for k in range(rows):
                total += stack[k, i] * stack[k, j]
            covariance[i, j] = total
            covariance[j, i] = total


@inlined
def combine(
    stack: Array,
    rows: int,
    size: int,
    deficit: Array,
    share: float,
    covariance: Array,
    factor: Array,
) -> bool:
    """Covariance and factor of the sum of outer products of a stack's rows and one of `deficit`.

    That one is added or taken away, as `share` is above or below 0, and put behind the rows where
    it is added. False if taking it away would have left no covariance, so that it was not done.
    """
    if share > 0.0:
        copy(deficit, stack[rows], size)
        rows += 1
    outer_sum(stack, rows, size, covariance)
    whole = not share < 0.0
    if not whole:
        for i in range(size):
            for j in range(size):
                covariance[i, j] -= deficit[i] * deficit[j]
        if semidefinite_cholesky(covariance, size, factor):
            for i in range(size):
                if factor[i, i] == 0.0:
                    # Without a pivot the difference may be indefinite by rounding; L L' cannot be.
                    _square(factor, size, covariance)
            return True
        outer_sum(stack, rows, size, covariance)
    semidefinite_cholesky(covariance, size, factor)
    return whole


@compiled
def _square(factor: Array, size: int, covariance: Array) -> None:
    for i in range(size):
        for j in range(i + 1):
            total = 0.0
            for k in range(j + 1):
                total += factor[i, k] * factor[j, k]
            covariance[i, j] = total
            covariance[j, i] = total


@compiled
def solve_rows(factor: Array, size: int, right: Array, rows: int) -> None:
    """Replace each of the first rows r of `right` by the solution of (L L') s = r.

    A zero pivot marks a direction about which nothing is known: its component becomes zero, as in a
    pseudo-inverse, instead of infinite.
    """
    for i in range(size):
        inverse = 1.0 / factor[i, i] if factor[i, i] > 0.0 else 0.0
        for r in range(rows):
            value = right[r, i]
            for k in range(i):
                value -= factor[i, k] * right[r, k]
            right[r, i] = value * inverse
    for i in range(size - 1, -1, -1):
        inverse = 1.0 / factor[i, i] if factor[i, i] > 0.0 else 0.0
        for r in range(rows):
            value = right[r, i]
            for k in range(i + 1, size):
                value -= factor[k, i] * right[r, k]
            right[r, i] = value * inverse
