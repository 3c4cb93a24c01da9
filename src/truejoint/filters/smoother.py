"""The unscented Rauch-Tung-Striebel smoother over a filtered record, as a compiled kernel."""

from __future__ import annotations

import math
from typing import Final

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled, copy, matrix, vector
from truejoint.filters import fields as at
from truejoint.filters.factors import combine, semidefinite_cholesky, solve_rows, wrap
from truejoint.filters.prediction import LIMIT, predict, within_limit
from truejoint.filters.status import BROKEN_PREDICTION

_BROKEN: Final = int(BROKEN_PREDICTION)


@compiled
def _load(numbers: Integers, memory: Array, x: Array, covariance: Array) -> None:
    """Put a filtered state and its factor where the prediction starts from."""
    n = numbers[at.N]
    copy(x, vector(memory, numbers[at.X], n), n)
    for i in range(n):
        copy(covariance[i], matrix(memory, numbers[at.P], n, n)[i], n)
    semidefinite_cholesky(covariance, n, matrix(memory, numbers[at.S], n, n))


@compiled
def _gain(numbers: Integers, memory: Array, inflation: float, gain: Array) -> None:
    """Smoother gain: covariance of state and prediction, divided by that of the prediction."""
    n = numbers[at.N]
    factor = matrix(memory, numbers[at.S], n, n)
    deviations = matrix(memory, numbers[at.DEVIATIONS], 4 * n, n)
    # Points stand in pairs at plus and minus reach times a column of the factor and weigh
    # 1 / (2 reach^2): the sum over a pair is the column times a difference of images.
    weight = 0.5 / (memory[at.REACH] * inflation)
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += factor[i, k] * (deviations[2 * k + 1, j] - deviations[2 * k, j])
            gain[i, j] = weight * total
    solve_rows(matrix(memory, numbers[at.S_MEAN], n, n), n, gain, n)


@compiled
def _fill_stack(
    numbers: Integers, memory: Array, inflation: float, gain: Array, later: Array, stack: Array
) -> int:
    """Outer products whose sum is the smoothed covariance, all of them positive; their number."""
    n = numbers[at.N]
    factor = matrix(memory, numbers[at.S], n, n)
    predicted = matrix(memory, numbers[at.S_MEAN], n, n)
    noise = matrix(memory, numbers[at.Q], n, n)
    deviations = matrix(memory, numbers[at.DEVIATIONS], 4 * n, n)
    reach = memory[at.REACH]
    root = memory[at.ROOT_WEIGHT]
    moving = 1.0 if memory[at.DT] != 0.0 else 0.0
    surplus = math.sqrt(inflation - 1.0)
    for i in range(n):
        for j in range(n):
            for sign in range(2):
                rest = (2 * sign - 1) * reach * factor[i, j]
                for k in range(n):
                    rest -= gain[i, k] * deviations[2 * j + sign, k]
                stack[2 * j + sign, i] = root * rest
            by_noise, by_surplus, by_later = 0.0, 0.0, 0.0
            for k in range(n):
                by_noise += gain[i, k] * noise[k, j]
                by_surplus += gain[i, k] * predicted[k, j]
                by_later += gain[i, k] * later[k, j]
            stack[2 * n + j, i] = moving * by_noise
            stack[3 * n + j, i] = surplus * by_surplus
            stack[4 * n + j, i] = by_later
    return 5 * int(n)


@compiled
def _move(numbers: Integers, memory: Array, gain: Array, x: Array, later_x: Array) -> bool:
    """Smoothed state into POINT and the centre's term into DEFICIT; False if out of range."""
    n = numbers[at.N]
    shift = vector(memory, numbers[at.SHIFT], n)
    mean = vector(memory, numbers[at.X_MEAN], n)
    deficit = vector(memory, numbers[at.DEFICIT], n)
    smoothed = vector(memory, numbers[at.POINT], n)
    for i in range(n):
        smoothed[i] = x[i]
        deficit[i] = 0.0
        for k in range(n):
            difference = later_x[k] - mean[k]
            if numbers[numbers[at.ANGLES] + k]:
                difference = wrap(difference)
            smoothed[i] += gain[i, k] * difference
            deficit[i] += memory[at.ROOT_CORRECTION] * gain[i, k] * shift[k]
        if numbers[numbers[at.ANGLES] + i]:
            smoothed[i] = wrap(smoothed[i])
    return bool(within_limit(smoothed, n, LIMIT))


@compiled
def _smooth_one(
    numbers: Integers,
    memory: Array,
    inflation: float,
    x: Array,
    covariance: Array,
    later_x: Array,
    later_covariance: Array,
) -> None:
    """Smooth the state that `_load` has put in place, given the smoothed state one row later."""
    n = numbers[at.N]
    if predict(numbers, memory) & _BROKEN:
        return
    gain = matrix(memory, numbers[at.NOISE], n, n)
    stack = matrix(memory, numbers[at.STACK], 5 * n + 1, n)
    deficit = vector(memory, numbers[at.DEFICIT], n)
    # P_MEAN has done its duty: it holds the later factor, then the smoothed covariance.
    scratch = matrix(memory, numbers[at.P_MEAN], n, n)
    _gain(numbers, memory, inflation, gain)
    if not _move(numbers, memory, gain, x, later_x):
        return
    semidefinite_cholesky(later_covariance, n, scratch)
    rows = _fill_stack(numbers, memory, inflation, gain, scratch, stack)
    correction = memory[at.CORRECTION]
    if correction > 0.0:
        copy(deficit, stack[rows], n)
        rows += 1
    factor, by_root = matrix(memory, numbers[at.S_MEAN], n, n), numbers[at.ROOT] == 1
    combine(stack, rows, n, deficit, correction < 0.0, by_root, scratch, factor)
    if within_limit(vector(memory, numbers[at.P_MEAN], n * n), n * n, LIMIT**2):
        copy(vector(memory, numbers[at.POINT], n), x, n)
        for i in range(n):
            copy(scratch[i], covariance[i], n)


@compiled
def smooth(
    numbers: Integers,
    memory: Array,
    u: Array,
    dt: Array,
    inflation: Array,
    status: Integers,
    x0: Array,
    P0: Array,
    x: Array,
    P: Array,
) -> None:
    """Smooth a filtered record backwards, in place (Saerkkae, IEEE TAC 53(3), 2008).

    A filter's memory serves as scratch space; `inflation` and `status` (N,) are what it reported
    for `u` (N, inputs) and `dt` (N,). Replaced by their smoothed selves: the prior `x0` (n,), `P0`
    (n, n), and the filtered `x` (N, n), `P` (N, n, n).
    """
    inputs = numbers[at.INPUTS]
    for k in range(x.shape[0] - 1, -1, -1):
        if status[k] & _BROKEN:
            continue
        copy(u[k], vector(memory, numbers[at.U], inputs), inputs)
        memory[at.DT] = dt[k]
        before_x, before_P = (x[k - 1], P[k - 1]) if k > 0 else (x0, P0)
        _load(numbers, memory, before_x, before_P)
        _smooth_one(numbers, memory, inflation[k], before_x, before_P, x[k], P[k])
