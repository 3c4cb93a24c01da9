"""The unscented filter's prediction, as compiled kernels for any model and size.

Equation numbers are those of yan2020, section III-B. All arrays live in the filter's memory (see
`memory`); nothing is allocated and nothing raised.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from truejoint.compiled import compiled
from truejoint.filters import memory as lay
from truejoint.filters.factors import combine, inlined, semidefinite_cholesky, wrap
from truejoint.filters.memory import (
    Array,
    Integers,
    call_process_noise,
    call_transition,
    copy,
    fill,
    integers,
    matrix,
    vector,
)
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
def place_points(numbers: Integers, memory: Array, factor_block: int, scale: float) -> None:
    """Deviations of 2 n sigma points, plus and minus reach times a factor's columns: (15), (18)."""
    n = numbers[lay.N]
    factor = matrix(memory, numbers[factor_block], n, n)
    deviations = matrix(memory, numbers[lay.DEVIATIONS], 4 * n, n)
    reach = scale * memory[lay.REACH]
    for j in range(n):
        # One row at a time: numba takes each computed index for possibly negative.
        below, above = deviations[2 * j], deviations[2 * j + 1]
        for i in range(n):
            step = reach * factor[i, j]
            below[i] = -step
            above[i] = step
    numbers[lay.POINTS] = 2 * n


@compiled
def _propagate(numbers: Integers, memory: Array) -> bool:
    """Send the sigma points through the transition, (16); False if the images are unusable."""
    n = numbers[lay.N]
    x = vector(memory, numbers[lay.X], n)
    u = vector(memory, numbers[lay.U], numbers[lay.INPUTS])
    theta = vector(memory, numbers[lay.THETA], numbers[lay.PARAMETERS])
    centre = vector(memory, numbers[lay.CENTRE], n)
    point = vector(memory, numbers[lay.POINT], n)
    image = vector(memory, numbers[lay.IMAGE], n)
    deviations = matrix(memory, numbers[lay.DEVIATIONS], 4 * n, n)
    angles = integers(numbers, numbers[lay.ANGLES], n)
    dt = memory[lay.DT]
    # NaN first: a function that fails to write an element is found out.
    fill(image, n, np.nan)
    copy(x, point, n)
    call_transition(numbers[lay.F], point, u, dt, theta, image)
    copy(image, centre, n)
    if not within_limit(centre, n, LIMIT):
        return False
    for k in range(numbers[lay.POINTS]):
        for i in range(n):
            point[i] = x[i] + deviations[k, i]
            image[i] = np.nan
        call_transition(numbers[lay.F], point, u, dt, theta, image)
        if not within_limit(image, n, LIMIT):
            return False
        for i in range(n):
            difference = image[i] - centre[i]
            deviations[k, i] = wrap(difference) if angles[i] else difference
    return True


@compiled
def _update_process_noise(numbers: Integers, memory: Array) -> bool:
    """Factor of the process noise at the present state; False, and the last one kept, if bad."""
    n = numbers[lay.N]
    entries = vector(memory, numbers[lay.NOISE], n * n)
    noise = matrix(memory, numbers[lay.NOISE], n, n)
    fill(entries, n * n, 0.0)
    call_process_noise(
        numbers[lay.G],
        vector(memory, numbers[lay.X], n),
        vector(memory, numbers[lay.U], numbers[lay.INPUTS]),
        memory[lay.DT],
        vector(memory, numbers[lay.THETA], numbers[lay.PARAMETERS]),
        noise,
    )
    # Any array of the right size holds the factor until it is known to be good.
    factor = matrix(memory, numbers[lay.S_MEAN], n, n)
    if not within_limit(entries, n * n, LIMIT) or not semidefinite_cholesky(noise, n, factor):
        return False
    copy(vector(memory, numbers[lay.S_MEAN], n * n), vector(memory, numbers[lay.Q], n * n), n * n)
    return True


@compiled
def _check_inputs(numbers: Integers, memory: Array) -> bool:
    u = vector(memory, numbers[lay.U], numbers[lay.INPUTS])
    return 0.0 <= memory[lay.DT] <= LIMIT and within_limit(u, numbers[lay.INPUTS], LIMIT)


@compiled
def predict(numbers: Integers, memory: Array) -> int:
    """Mean and covariance of the predicted state, (15)-(17), into X_MEAN, P_MEAN and S_MEAN.

    With dt = 0 no time passes: the prediction is the state. Where the inputs or the transition
    cannot be used the state is held and the process noise still added.

    Returns
    -------
    int
        Status bits.
    """
    n = numbers[lay.N]
    x = vector(memory, numbers[lay.X], n)
    centre = vector(memory, numbers[lay.CENTRE], n)
    deviations = matrix(memory, numbers[lay.DEVIATIONS], 4 * n, n)
    noise = matrix(memory, numbers[lay.Q], n, n)
    moving = memory[lay.DT] != 0.0
    status = 0
    if not _check_inputs(numbers, memory):
        status = _INVALID_INPUT
    elif moving and numbers[lay.G] != 0 and not _update_process_noise(numbers, memory):
        status = _TRANSITION_FAILED
    place_points(numbers, memory, lay.S, 1.0)
    if moving and status == 0 and not _propagate(numbers, memory):
        status = _TRANSITION_FAILED
        place_points(numbers, memory, lay.S, 1.0)
    if status != 0 or not moving:
        copy(x, centre, n)
    status |= _combine_prediction(numbers, memory, moving)
    mean = vector(memory, numbers[lay.X_MEAN], n)
    covariance = vector(memory, numbers[lay.P_MEAN], n * n)
    if not (within_limit(mean, n, LIMIT) and within_limit(covariance, n * n, LIMIT**2)):
        factor = vector(memory, numbers[lay.S_MEAN], n * n)
        copy(x, mean, n)
        copy(vector(memory, numbers[lay.P], n * n), covariance, n * n)
        copy(vector(memory, numbers[lay.S], n * n), factor, n * n)
        place_points(numbers, memory, lay.S, 1.0)
        copy(x, centre, n)
        fill(vector(memory, numbers[lay.SHIFT], n), n, 0.0)
        return status | _OUT_OF_RANGE
    if numbers[lay.SECOND] == 0:
        # Points for the process noise too, so that the predicted measurement feels it.
        for j in range(n):
            below, above = deviations[2 * n + 2 * j], deviations[2 * n + 2 * j + 1]
            for i in range(n):
                step = memory[lay.REACH] * noise[i, j] if moving else 0.0
                below[i] = -step
                above[i] = step
        numbers[lay.POINTS] = 4 * n
    return status


@compiled
def _combine_prediction(numbers: Integers, memory: Array, moving: bool) -> int:
    """Mean and covariance from the images of the sigma points, (17)."""
    n = numbers[lay.N]
    centre = vector(memory, numbers[lay.CENTRE], n)
    shift = vector(memory, numbers[lay.SHIFT], n)
    mean = vector(memory, numbers[lay.X_MEAN], n)
    deviations = matrix(memory, numbers[lay.DEVIATIONS], 4 * n, n)
    noise = matrix(memory, numbers[lay.Q], n, n)
    stack = matrix(memory, numbers[lay.STACK], 3 * n + 1, n)
    angles = integers(numbers, numbers[lay.ANGLES], n)
    root = memory[lay.ROOT_WEIGHT]
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
    whole = finish(numbers, memory, stack, rows, n, lay.SHIFT, lay.P_MEAN, lay.S_MEAN)
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
    deficit = vector(memory, numbers[lay.DEFICIT], size)
    correction = memory[lay.CORRECTION]
    scale = memory[lay.ROOT_CORRECTION]
    for i in range(size):
        deficit[i] = scale * shift[i]
    if correction > 0.0:
        copy(deficit, stack[rows], size)
        rows += 1
    return combine(
        stack,
        rows,
        size,
        deficit,
        correction < 0.0,
        numbers[lay.ROOT] == 1,
        matrix(memory, numbers[covariance_block], size, size),
        matrix(memory, numbers[factor_block], size, size),
    )
