"""Factors of covariance matrices that survive rank deficiency, as compiled kernels.

Every covariance in the filter is a sum of outer products, written as the rows of `stack`: it is
positive semidefinite because of how it is made and not by luck of rounding. The kernels write into
arrays that the caller owns and allocate nothing.
"""

from __future__ import annotations

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


@compiled
def triangularise(stack: Array, rows: int, size: int, factor: Array) -> None:
    """Lower factor of the sum of outer products of a stack's rows, without forming the sum.

    Householder reflections turn the stack, at least `size` rows, into an upper triangle, which is
    the factor transposed; its diagonal is not negative. The stack is overwritten.
    """
    top = 0  # a column without a pivot uses up no row, so that its variance is not lost
    for j in range(size):
        square = 0.0
        for i in range(size):
            factor[i, j] = 0.0
        for k in range(top, rows):
            square += stack[k, j] * stack[k, j]
        norm = math.sqrt(square)
        for k in range(j):
            square += factor[j, k] * factor[j, k]
        if not (norm > _PIVOT * math.sqrt(square)):
            continue
        head = stack[top, j]
        # The reflection maps the column onto -sign(head) norm, which cancels nothing.
        target = -norm if head > 0.0 else norm
        stack[top, j] = head - target
        beta = 1.0 / (norm * (norm + abs(head)))
        sign = 1.0 if target > 0.0 else -1.0
        factor[j, j] = norm
        for i in range(j + 1, size):
            dot = 0.0
            for k in range(top, rows):
                dot += stack[k, j] * stack[k, i]
            dot *= beta
            for k in range(top, rows):
                stack[k, i] -= dot * stack[k, j]
            factor[i, j] = sign * stack[top, i]
        top += 1


@compiled
def downdate(factor: Array, size: int, vector: Array) -> bool:
    """Take an outer product away from a factored covariance, in place: L L' - v v'.

    False if the difference is not positive semidefinite; the factor is then spoilt.
    """
    for j in range(size):
        pivot = factor[j, j]
        square = pivot * pivot - vector[j] * vector[j]
        noise = _PIVOT * pivot * pivot
        if not (square >= -noise):
            return False
        if not (square > noise):
            if pivot != 0.0:
                return False
            continue
        root = math.sqrt(square)
        cosine, sine = root / pivot, vector[j] / pivot
        factor[j, j] = root
        for i in range(j + 1, size):
            factor[i, j] = (factor[i, j] - sine * vector[i]) / cosine
            vector[i] = cosine * vector[i] - sine * factor[i, j]
    return True


@inlined
def combine(
    stack: Array,
    rows: int,
    size: int,
    deficit: Array,
    has_deficit: bool,
    square_root: bool,
    covariance: Array,
    factor: Array,
) -> bool:
    """Covariance and factor of the sum of outer products of a stack's rows, less one of `deficit`.

    By triangularising where `square_root`, else by summing and factoring; stack and deficit are
    overwritten. False if the subtraction would have left no covariance, so that it was not done.
    """
    if square_root:
        triangularise(stack, rows, size, factor)
        whole = not has_deficit or _downdate_or_keep(factor, size, deficit, covariance)
        _square(factor, size, covariance)
        return whole
    outer_sum(stack, rows, size, covariance)
    if not has_deficit:
        semidefinite_cholesky(covariance, size, factor)
        return True
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
    return False


@compiled
def _downdate_or_keep(factor: Array, size: int, vector: Array, backup: Array) -> bool:
    for i in range(size):
        copy(factor[i], backup[i], size)
    if downdate(factor, size, vector):
        return True
    for i in range(size):
        copy(backup[i], factor[i], size)
    return False


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
