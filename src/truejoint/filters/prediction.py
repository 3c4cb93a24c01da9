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
from truejoint.filters.fields import call_process_noise, call_transition
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
    n = numbers[at.N]
    factor = matrix(memory, numbers[factor_block], n, n)
    deviations = matrix(memory, numbers[at.DEVIATIONS], 4 * n, n)
    reach = scale * memory[at.REACH]
    for j in range(n):
        # One row at a time: numba takes each computed index for possibly negative.
        below, above = deviations[2 * j], deviations[2 * j + 1]
        for i in range(n):
            step = reach * factor[i, j]
            below[i] = -step
            above[i] = step
    numbers[at.POINTS] = 2 * n


@compiled
def _propagate(numbers: Integers, memory: Array) -> bool:
    """Send the sigma points through the transition, (16); False if the images are unusable."""
    n = numbers[at.N]
    x = vector(memory, numbers[at.X], n)
    u = vector(memory, numbers[at.U], numbers[at.INPUTS])
    theta = vector(memory, numbers[at.THETA], numbers[at.PARAMETERS])
    centre = vector(memory, numbers[at.CENTRE], n)
    point = vector(memory, numbers[at.POINT], n)
    image = vector(memory, numbers[at.IMAGE], n)
    deviations = matrix(memory, numbers[at.DEVIATIONS], 4 * n, n)
    angles = vector(numbers, numbers[at.ANGLES], n)
    dt = memory[at.DT]
    # NaN first: a function that fails to write an element is found out.
    fill(image, n, np.nan)
    copy(x, point, n)
    call_transition(numbers[at.F], point, u, dt, theta, image)
    copy(image, centre, n)
    if not within_limit(centre, n, LIMIT):
        return False
    for k in range(numbers[at.POINTS]):
        for i in range(n):
            point[i] = x[i] + deviations[k, i]
            image[i] = np.nan
        call_transition(numbers[at.F], point, u, dt, theta, image)
        if not within_limit(image, n, LIMIT):
            return False
        for i in range(n):
            difference = image[i] - centre[i]
            deviations[k, i] = wrap(difference) if angles[i] else difference
    return True


@compiled
def _update_process_noise(numbers: Integers, memory: Array) -> bool:
    """Factor of the process noise at the present state; False, and the last one kept, if bad."""
    n = numbers[at.N]
    entries = vector(memory, numbers[at.NOISE], n * n)
    noise = matrix(memory, numbers[at.NOISE], n, n)
    fill(entries, n * n, 0.0)
    call_process_noise(
        numbers[at.G],
        vector(memory, numbers[at.X], n),
        vector(memory, numbers[at.U], numbers[at.INPUTS]),
        memory[at.DT],
        vector(memory, numbers[at.THETA], numbers[at.PARAMETERS]),
        noise,
    )
    # Any array of the right size holds the factor until it is known to be good.
    factor = matrix(memory, numbers[at.S_MEAN], n, n)
    if not within_limit(entries, n * n, LIMIT) or not semidefinite_cholesky(noise, n, factor):
        return False
    copy(vector(memory, numbers[at.S_MEAN], n * n), vector(memory, numbers[at.Q], n * n), n * n)
    return True


@compiled
def _check_inputs(numbers: Integers, memory: Array) -> bool:
    u = vector(memory, numbers[at.U], numbers[at.INPUTS])
    if not (0.0 <= memory[at.DT] <= LIMIT):
        return False
    return possible(numbers, memory, u, numbers[at.INPUTS], numbers[at.N] + numbers[at.M])


@compiled
def predict(numbers: Integers, memory: Array) -> int:
    """Mean and covariance of the predicted state, (15)-(17); status bits.

    With dt = 0 no time passes: the prediction is the state. Where the inputs or the transition
    cannot be used the state is held and the process noise still added.
    """
    n = numbers[at.N]
    x = vector(memory, numbers[at.X], n)
    centre = vector(memory, numbers[at.CENTRE], n)
    deviations = matrix(memory, numbers[at.DEVIATIONS], 4 * n, n)
    noise = matrix(memory, numbers[at.Q], n, n)
    moving = memory[at.DT] != 0.0
    status = 0
    if not _check_inputs(numbers, memory):
        status = _INVALID_INPUT
    elif moving and numbers[at.G] != 0 and not _update_process_noise(numbers, memory):
        status = _TRANSITION_FAILED
    place_points(numbers, memory, at.S, 1.0)
    if moving and status == 0 and not _propagate(numbers, memory):
        status = _TRANSITION_FAILED
        place_points(numbers, memory, at.S, 1.0)
    if status != 0 or not moving:
        copy(x, centre, n)
    status |= _combine_prediction(numbers, memory, moving)
    mean = vector(memory, numbers[at.X_MEAN], n)
    covariance = vector(memory, numbers[at.P_MEAN], n * n)
    if not (within_limit(mean, n, LIMIT) and within_limit(covariance, n * n, LIMIT**2)):
        copy(x, mean, n)
        copy(vector(memory, numbers[at.P], n * n), covariance, n * n)
        factor = vector(memory, numbers[at.S_MEAN], n * n)
        copy(vector(memory, numbers[at.S], n * n), factor, n * n)
        place_points(numbers, memory, at.S, 1.0)
        copy(x, centre, n)
        fill(vector(memory, numbers[at.SHIFT], n), n, 0.0)
        return status | _OUT_OF_RANGE
    if numbers[at.SECOND] == 0:
        # Points for the process noise too, so that the predicted measurement feels it.
        for j in range(n):
            below, above = deviations[2 * n + 2 * j], deviations[2 * n + 2 * j + 1]
            for i in range(n):
                step = memory[at.REACH] * noise[i, j] if moving else 0.0
                below[i] = -step
                above[i] = step
        numbers[at.POINTS] = 4 * n
    return status


@compiled
def _combine_prediction(numbers: Integers, memory: Array, moving: bool) -> int:
    """Mean and covariance from the images of the sigma points, (17)."""
    n = numbers[at.N]
    centre = vector(memory, numbers[at.CENTRE], n)
    shift = vector(memory, numbers[at.SHIFT], n)
    mean = vector(memory, numbers[at.X_MEAN], n)
    deviations = matrix(memory, numbers[at.DEVIATIONS], 4 * n, n)
    noise = matrix(memory, numbers[at.Q], n, n)
    stack = matrix(memory, numbers[at.STACK], 3 * n + 1, n)
    angles = vector(numbers, numbers[at.ANGLES], n)
    root = memory[at.ROOT_WEIGHT]
    for i in range(n):
        total = 0.0
        for k in range(2 * n):
            total += deviations[k, i]
            stack[k, i] = root * deviations[k, i]
        shift[i] = root * root * total
        mean[i] = centre[i] + shift[i]
        if angles[i]:
            mean[i] = wrap(mean[i])
    rows = 2 * n
    if moving:
        for j in range(n):
            row = stack[rows]
            for i in range(n):
                row[i] = noise[i, j]
            rows += 1
    whole = finish(numbers, memory, stack, rows, n, at.SHIFT, at.P_MEAN, at.S_MEAN)
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
    shift = vector(memory, numbers[shift_block], size)
    deficit = vector(memory, numbers[at.DEFICIT], size)
    correction = memory[at.CORRECTION]
    scale = memory[at.ROOT_CORRECTION]
    for i in range(size):
        deficit[i] = scale * shift[i]
    if correction > 0.0:
        copy(deficit, stack[rows], size)
        rows += 1
    covariance = matrix(memory, numbers[covariance_block], size, size)
    factor = matrix(memory, numbers[factor_block], size, size)
    by_root = numbers[at.ROOT] == 1
    return combine(stack, rows, size, deficit, correction < 0.0, by_root, covariance, factor)
