"""The unscented filter's prediction, as compiled kernels for any model and size.

Equation numbers are those of yan2020, section III-B. All arrays live in the filter's memory (see
`memory`); nothing is allocated and nothing raised.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled, copy, fill, inlined, matrix, vector
from truejoint.filters import fields as at
from truejoint.filters.factors import combine, semidefinite_cholesky, wrap
from truejoint.filters.fields import call_process_noise, call_transition, unpack_filter
from truejoint.filters.status import FilterStatus

LIMIT: Final = 1e100
"""Beyond it a number is out of range: squares within it, and sums of them, stay finite."""

_INVALID_INPUT: Final = int(FilterStatus.INVALID_INPUT)
_TRANSITION_FAILED: Final = int(FilterStatus.TRANSITION_FAILED)
_REPAIRED: Final = int(FilterStatus.COVARIANCE_REPAIRED)
_OUT_OF_RANGE: Final = int(FilterStatus.OUT_OF_RANGE)


@compiled
def within_limit(values: Array, count: int, limit: float) -> bool:
    """Whether the first `count` numbers are finite and not beyond a limit."""
    for i in range(count):  # noqa: SIM110 - numba compiles no generator expression
        # `not (a <= b)` instead of `a > b`: it holds for NaN too.
        if not (abs(values[i]) <= limit):
            return False
    return True


@inlined
def possible(numbers: Integers, memory: Array, values: Array, count: int, first: int) -> bool:
    """Whether numbers are within `LIMIT` and the bounds that begin at index `first`."""
    for i in range(count):
        lowest = memory[numbers[at.LOWEST] + first + i]
        highest = memory[numbers[at.HIGHEST] + first + i]
        # `not (a <= b)` instead of `a > b`: it holds for NaN too.
        if not (abs(values[i]) <= LIMIT and lowest <= values[i] and values[i] <= highest):
            return False
    return True


@inlined
def place_points(numbers: Integers, memory: Array, factor_block: int, scale: float) -> None:
    """Deviations of 2 n sigma points, plus and minus reach times a factor's columns: (15), (18)."""
    m, n = unpack_filter(numbers, memory), numbers[at.N]
    factor, reach = matrix(memory, numbers[factor_block], n, n), scale * m.reach
    for j in range(n):
        # One row at a time: numba takes each computed index for possibly negative.
        below, above = m.deviations[2 * j], m.deviations[2 * j + 1]
        for i in range(n):
            step = reach * factor[i, j]
            below[i] = -step
            above[i] = step
    numbers[at.POINTS] = 2 * n


@compiled
def _propagate(numbers: Integers, memory: Array) -> bool:
    """Send the sigma points through the transition, (16); False if the images are unusable."""
    m, n = unpack_filter(numbers, memory), numbers[at.N]
    # NaN first: a function that fails to write an element is found out.
    fill(m.image, n, np.nan)
    image = vector(m.image, 0, n)
    copy(m.x, m.point, n)
    call_transition(numbers[at.F], m.point, m.u, m.dt, m.theta, image)
    copy(image, m.centre, n)
    if not within_limit(m.centre, n, LIMIT):
        return False
    for k in range(m.points):
        for i in range(n):
            m.point[i] = m.x[i] + m.deviations[k, i]
            image[i] = np.nan
        call_transition(numbers[at.F], m.point, m.u, m.dt, m.theta, image)
        if not within_limit(image, n, LIMIT):
            return False
        for i in range(n):
            difference = image[i] - m.centre[i]
            m.deviations[k, i] = wrap(difference) if m.angles[i] else difference
    return True


@compiled
def _update_process_noise(numbers: Integers, memory: Array) -> bool:
    """Factor of the process noise at the present state; False, and the last one kept, if bad."""
    m, n = unpack_filter(numbers, memory), numbers[at.N]
    entries = vector(memory, numbers[at.NOISE], n * n)
    fill(entries, n * n, 0.0)
    call_process_noise(numbers[at.G], m.x, m.u, m.dt, m.theta, m.noise)
    # Any array of the right size holds the factor until it is known to be good.
    good = within_limit(entries, n * n, LIMIT)
    if not good or not semidefinite_cholesky(m.noise, n, m.factor_mean):
        return False
    copy(vector(memory, numbers[at.S_MEAN], n * n), vector(memory, numbers[at.Q], n * n), n * n)
    return True


@compiled
def predict(numbers: Integers, memory: Array) -> int:
    """Mean and covariance of the predicted state, (15)-(17); status bits.

    With dt = 0 no time passes: the prediction is the state. Where the inputs or the transition
    cannot be used the state is held and the process noise still added.
    """
    m, n = unpack_filter(numbers, memory), numbers[at.N]
    moving = m.dt != 0.0
    status = 0
    inputs = numbers[at.INPUTS]
    if not (0.0 <= m.dt <= LIMIT and possible(numbers, memory, m.u, inputs, n + numbers[at.M])):
        status = _INVALID_INPUT
    elif moving and numbers[at.G] != 0 and not _update_process_noise(numbers, memory):
        status = _TRANSITION_FAILED
    place_points(numbers, memory, at.S, 1.0)
    if moving and status == 0 and not _propagate(numbers, memory):
        status = _TRANSITION_FAILED
        place_points(numbers, memory, at.S, 1.0)
    if status != 0 or not moving:
        copy(m.x, m.centre, n)
    status |= _combine_prediction(numbers, memory, moving)
    covariance = vector(memory, numbers[at.P_MEAN], n * n)
    if not (within_limit(m.x_mean, n, LIMIT) and within_limit(covariance, n * n, LIMIT**2)):
        copy(m.x, m.x_mean, n)
        copy(vector(memory, numbers[at.P], n * n), covariance, n * n)
        factor = vector(memory, numbers[at.S_MEAN], n * n)
        copy(vector(memory, numbers[at.S], n * n), factor, n * n)
        place_points(numbers, memory, at.S, 1.0)
        copy(m.x, m.centre, n)
        fill(m.shift, n, 0.0)
        return status | _OUT_OF_RANGE
    if numbers[at.SECOND] == 0:
        # Points for the process noise too, so that the predicted measurement feels it.
        for j in range(n):
            below, above = m.deviations[2 * n + 2 * j], m.deviations[2 * n + 2 * j + 1]
            for i in range(n):
                step = m.reach * m.noise_factor[i, j] if moving else 0.0
                below[i] = -step
                above[i] = step
        numbers[at.POINTS] = 4 * n
    return status


@compiled
def _combine_prediction(numbers: Integers, memory: Array, moving: bool) -> int:
    """Mean and covariance from the images of the sigma points, (17)."""
    m, n = unpack_filter(numbers, memory), numbers[at.N]
    root = m.root_weight
    for i in range(n):
        total = 0.0
        for k in range(2 * n):
            total += m.deviations[k, i]
            m.stack[k, i] = root * m.deviations[k, i]
        m.shift[i] = root * root * total
        m.x_mean[i] = m.centre[i] + m.shift[i]
        if m.angles[i]:
            m.x_mean[i] = wrap(m.x_mean[i])
    rows = 2 * n
    if moving:
        for j in range(n):
            row = m.stack[rows]
            for i in range(n):
                row[i] = m.noise_factor[i, j]
            rows += 1
    whole = finish(numbers, memory, m.stack, rows, n, at.SHIFT, at.P_MEAN, at.S_MEAN)
    return 0 if whole else _REPAIRED


@inlined
def finish(
    numbers: Integers,
    memory: Array,
    stack: Array,
    rows: int,
    size: int,
    shift_block: int,
    covariance_block: int,
    factor_block: int,
) -> bool:
    """Add the centre's term to a stack and combine it into covariance and factor."""
    m, shift = unpack_filter(numbers, memory), vector(memory, numbers[shift_block], size)
    for i in range(size):
        m.deficit[i] = m.root_correction * shift[i]
    if m.correction > 0.0:
        copy(m.deficit, stack[rows], size)
        rows += 1
    covariance = matrix(memory, numbers[covariance_block], size, size)
    factor, by_root = matrix(memory, numbers[factor_block], size, size), numbers[at.ROOT] == 1
    return combine(stack, rows, size, m.deficit, m.correction < 0.0, by_root, covariance, factor)
