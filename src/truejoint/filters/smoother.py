"""The unscented Rauch-Tung-Striebel smoother over a filtered record, as a compiled kernel."""

import math
from typing import Final

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled, copy, vector
from truejoint.filters import fields as at
from truejoint.filters.factors import combine, semidefinite_cholesky, solve_rows, wrap
from truejoint.filters.fields import BROKEN_PREDICTION, unpack_filter
from truejoint.filters.kernels import LIMIT, predict, within_limit

_BROKEN: Final = int(BROKEN_PREDICTION)


@compiled
def _gain(numbers: Integers, memory: Array, inflation: float, gain: Array) -> None:
    """Smoother gain: covariance of state and prediction, divided by that of the prediction."""
    m, n = unpack_filter(numbers, memory), numbers[at.N]
    # Points stand in pairs at plus and minus reach times a column of the factor and weigh
    # 1 / (2 reach^2): the sum over a pair is the column times a difference of images.
    weight = 0.5 / (m.reach * inflation)
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += m.factor[i, k] * (m.deviations[2 * k + 1, j] - m.deviations[2 * k, j])
            gain[i, j] = weight * total
    solve_rows(m.factor_mean, n, gain, n)


@compiled
def _fill_stack(
    numbers: Integers, memory: Array, inflation: float, gain: Array, later: Array
) -> int:
    """Outer products whose sum is the smoothed covariance, all of them positive; their number."""
    m, n = unpack_filter(numbers, memory), numbers[at.N]
    moving = 1.0 if m.dt != 0.0 else 0.0
    surplus = math.sqrt(inflation - 1.0)
    for i in range(n):
        for j in range(n):
            for sign in range(2):
                rest = (2 * sign - 1) * m.reach * m.factor[i, j]
                for k in range(n):
                    rest -= gain[i, k] * m.deviations[2 * j + sign, k]
                m.stack[2 * j + sign, i] = m.root_weight * rest
            by_noise, by_surplus, by_later = 0.0, 0.0, 0.0
            for k in range(n):
                by_noise += gain[i, k] * m.noise_factor[k, j]
                by_surplus += gain[i, k] * m.factor_mean[k, j]
                by_later += gain[i, k] * later[k, j]
            m.stack[2 * n + j, i] = moving * by_noise
            m.stack[3 * n + j, i] = surplus * by_surplus
            m.stack[4 * n + j, i] = by_later
    return 5 * int(n)


@compiled
def _move(numbers: Integers, memory: Array, gain: Array, x: Array, later_x: Array) -> bool:
    """Smoothed state into POINT and the centre's term into DEFICIT; False if out of range."""
    m, n = unpack_filter(numbers, memory), numbers[at.N]
    for i in range(n):
        m.point[i] = x[i]
        m.deficit[i] = 0.0
        for k in range(n):
            difference = later_x[k] - m.x_mean[k]
            if m.angles[k]:
                difference = wrap(difference)
            m.point[i] += gain[i, k] * difference
            m.deficit[i] += m.root_correction * gain[i, k] * m.shift[k]
        if m.angles[i]:
            m.point[i] = wrap(m.point[i])
    return bool(within_limit(m.point, n, LIMIT))


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
    m, n = unpack_filter(numbers, memory), numbers[at.N]
    # After a prediction NOISE and P_MEAN have done their duty: they hold the gain, and the later
    # factor, then the smoothed covariance.
    gain, scratch = m.noise, m.covariance_mean
    for k in range(x.shape[0] - 1, -1, -1):
        if status[k] & _BROKEN:
            continue
        earlier_x, earlier_P = (x[k - 1], P[k - 1]) if k > 0 else (x0, P0)
        copy(u[k], m.u, m.n_inputs)
        memory[at.DT] = dt[k]
        copy(earlier_x, m.x, n)
        for i in range(n):
            copy(earlier_P[i], m.covariance[i], n)
        semidefinite_cholesky(earlier_P, n, m.factor)
        if predict(numbers, memory) & _BROKEN:
            continue
        _gain(numbers, memory, inflation[k], gain)
        if not _move(numbers, memory, gain, earlier_x, x[k]):
            continue
        semidefinite_cholesky(P[k], n, scratch)
        rows = _fill_stack(numbers, memory, inflation[k], gain, scratch)
        combine(m.stack, rows, n, m.deficit, m.correction, scratch, m.factor_mean)
        if within_limit(vector(memory, numbers[at.P_MEAN], n * n), n * n, LIMIT**2):
            copy(m.point, earlier_x, n)
            for i in range(n):
                copy(scratch[i], earlier_P[i], n)
