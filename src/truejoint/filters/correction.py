"""The unscented filter's correction by a measurement, as compiled kernels for any model and size.

Equation numbers are those of yan2020, section III-B. All arrays live in the filter's memory (see
`memory`); nothing is allocated and nothing raised.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled, copy, fill, inlined, matrix, vector
from truejoint.filters import fields as at
from truejoint.filters.factors import solve_rows, wrap
from truejoint.filters.fields import call_measurement
from truejoint.filters.prediction import LIMIT, finish, place_points, possible, within_limit
from truejoint.filters.status import FilterStatus

_MISSING: Final = int(FilterStatus.MISSING)
_PARTIAL: Final = int(FilterStatus.PARTIAL)
_GATED: Final = int(FilterStatus.GATED)
_REACQUIRED: Final = int(FilterStatus.REACQUIRED)
_INVALID_MEASUREMENT: Final = int(FilterStatus.INVALID_MEASUREMENT)
_MEASUREMENT_FAILED: Final = int(FilterStatus.MEASUREMENT_FAILED)
_REPAIRED: Final = int(FilterStatus.COVARIANCE_REPAIRED)
_OUT_OF_RANGE: Final = int(FilterStatus.OUT_OF_RANGE)
_SINGULAR: Final = int(FilterStatus.SINGULAR)
_INFLATION_TRIES: Final = 60
_LOG_2_PI: Final = math.log(2.0 * math.pi)


@compiled
def _choose_measurements(numbers: Integers, memory: Array) -> int:
    """List the components of the measurement that are there; status bits."""
    m = numbers[at.M]
    z = vector(memory, numbers[at.Z], m)
    innovation = vector(memory, numbers[at.INNOVATION], m)
    status = 0
    count = 0
    for i in range(m):
        innovation[i] = np.nan
        if possible(numbers, memory, z[i : i + 1], 1, numbers[at.N] + i):
            numbers[numbers[at.CHOSEN] + count] = i
            count += 1
        elif not math.isnan(z[i]):
            status |= _INVALID_MEASUREMENT
    numbers[at.OBSERVED] = count
    memory[at.NIS] = np.nan
    memory[at.LOGLIK] = 0.0
    memory[at.INFLATION] = 1.0
    if count == 0:
        status |= _MISSING
    elif count < m:
        status |= _PARTIAL
    return status


@compiled
def _observe(numbers: Integers, memory: Array) -> bool:
    """Send the sigma points through the measurement function, (19); False if unusable."""
    n, m = numbers[at.N], numbers[at.M]
    count = numbers[at.OBSERVED]
    chosen = vector(numbers, numbers[at.CHOSEN], count)
    angles = vector(numbers, numbers[at.ANGLES] + n, m)
    u = vector(memory, numbers[at.U], numbers[at.INPUTS])
    theta = vector(memory, numbers[at.THETA], numbers[at.PARAMETERS])
    centre = vector(memory, numbers[at.CENTRE], n)
    point = vector(memory, numbers[at.POINT], n)
    image = vector(memory, numbers[at.IMAGE], m)
    z_mean = vector(memory, numbers[at.Z_MEAN], count)
    z_shift = vector(memory, numbers[at.Z_SHIFT], count)
    deviations = matrix(memory, numbers[at.DEVIATIONS], 4 * n, n)
    z_deviations = matrix(memory, numbers[at.Z_DEVIATIONS], 4 * n, count)
    fill(image, m, np.nan)
    copy(centre, point, n)
    call_measurement(numbers[at.H], point, u, theta, image)
    for c in range(count):
        z_mean[c] = image[chosen[c]]
        z_shift[c] = 0.0
    if not within_limit(z_mean, count, LIMIT):
        return False
    for k in range(numbers[at.POINTS]):
        for i in range(n):
            point[i] = centre[i] + deviations[k, i]
        fill(image, m, np.nan)
        call_measurement(numbers[at.H], point, u, theta, image)
        for c in range(count):
            i = chosen[c]
            difference = image[i] - z_mean[c]
            if not (abs(difference) <= LIMIT):
                return False
            if angles[i]:
                difference = wrap(difference)
            z_deviations[k, c] = difference
            z_shift[c] += difference
    weight = memory[at.ROOT_WEIGHT] ** 2
    for c in range(count):
        z_shift[c] *= weight
        z_mean[c] += z_shift[c]
    return True


@compiled
def _innovate(numbers: Integers, memory: Array) -> int:
    """Innovation, its covariance, (20), and its NIS; status bits."""
    n, m = numbers[at.N], numbers[at.M]
    count = numbers[at.OBSERVED]
    chosen = vector(numbers, numbers[at.CHOSEN], count)
    points = numbers[at.POINTS]
    if not _observe(numbers, memory):
        return _MEASUREMENT_FAILED
    z = vector(memory, numbers[at.Z], m)
    z_mean = vector(memory, numbers[at.Z_MEAN], count)
    innovation = vector(memory, numbers[at.INNOVATION], m)
    white = vector(memory, numbers[at.WHITE], count)
    z_deviations = matrix(memory, numbers[at.Z_DEVIATIONS], 4 * n, count)
    noise = matrix(memory, numbers[at.R], m, m)
    stack = matrix(memory, numbers[at.STACK], 4 * n + m + 1, count)
    root = memory[at.ROOT_WEIGHT]
    for k in range(points):
        for c in range(count):
            stack[k, c] = root * z_deviations[k, c]
    for j in range(m):
        row = stack[points + j]
        for c in range(count):
            row[c] = noise[chosen[c], j]
    whole = finish(numbers, memory, stack, points + m, count, at.Z_SHIFT, at.P_ZZ, at.S_ZZ)
    status = 0 if whole else _REPAIRED
    factor = matrix(memory, numbers[at.S_ZZ], count, count)
    angles = vector(numbers, numbers[at.ANGLES] + n, m)
    nis, logarithm, product, rank = 0.0, 0.0, 1.0, 0
    for c in range(count):
        i = chosen[c]
        difference = z[i] - z_mean[c]
        innovation[i] = wrap(difference) if angles[i] else difference
        rest = innovation[i]
        for k in range(c):
            rest -= factor[c, k] * white[k]
        if factor[c, c] > 0.0:
            white[c] = rest / factor[c, c]
            nis += white[c] * white[c]
            product *= factor[c, c]
            if not (1e-100 < product < 1e100):
                logarithm += math.log(product)
                product = 1.0
            rank += 1
        else:
            white[c] = 0.0
            status |= _SINGULAR
    memory[at.NIS] = nis
    memory[at.LOGLIK] = -0.5 * (nis + rank * _LOG_2_PI) - logarithm - math.log(product)
    return status


@inlined
def _second_generation(numbers: Integers, memory: Array, scale: float) -> None:
    """Draw sigma points again from the predicted mean and covariance, (18)."""
    n = numbers[at.N]
    place_points(numbers, memory, at.S_MEAN, scale)
    copy(vector(memory, numbers[at.X_MEAN], n), vector(memory, numbers[at.CENTRE], n), n)
    fill(vector(memory, numbers[at.SHIFT], n), n, 0.0)


@inlined
def _gain(numbers: Integers, memory: Array) -> None:
    """Covariance of state and measurement, (21), divided by that of the measurement, (22)."""
    n, count, points = numbers[at.N], numbers[at.OBSERVED], numbers[at.POINTS]
    shift = vector(memory, numbers[at.SHIFT], n)
    z_shift = vector(memory, numbers[at.Z_SHIFT], count)
    deviations = matrix(memory, numbers[at.DEVIATIONS], 4 * n, n)
    z_deviations = matrix(memory, numbers[at.Z_DEVIATIONS], 4 * n, count)
    gain = matrix(memory, numbers[at.GAIN], n, count)
    weight = memory[at.ROOT_WEIGHT] ** 2
    for i in range(n):
        for c in range(count):
            total = 0.0
            for k in range(points):
                total += deviations[k, i] * z_deviations[k, c]
            gain[i, c] = weight * total + memory[at.CORRECTION] * shift[i] * z_shift[c]
    solve_rows(matrix(memory, numbers[at.S_ZZ], count, count), count, gain, n)


@compiled
def _apply_gain(numbers: Integers, memory: Array) -> int:
    """Corrected state, (23), and its covariance in Joseph's form; status bits.

    Each sigma point is corrected with the gain as if it were the state, and the covariance is that
    of the corrected points plus the gain's share of the measurement noise. For this gain that is
    (23), but it cannot turn indefinite.
    """
    n, m = numbers[at.N], numbers[at.M]
    count = numbers[at.OBSERVED]
    chosen = vector(numbers, numbers[at.CHOSEN], count)
    points = numbers[at.POINTS]
    x = vector(memory, numbers[at.X], n)
    x_mean = vector(memory, numbers[at.X_MEAN], n)
    shift = vector(memory, numbers[at.SHIFT], n)
    innovation = vector(memory, numbers[at.INNOVATION], m)
    z_shift = vector(memory, numbers[at.Z_SHIFT], count)
    deviations = matrix(memory, numbers[at.DEVIATIONS], 4 * n, n)
    z_deviations = matrix(memory, numbers[at.Z_DEVIATIONS], 4 * n, count)
    noise = matrix(memory, numbers[at.R], m, m)
    gain = matrix(memory, numbers[at.GAIN], n, count)
    stack = matrix(memory, numbers[at.STACK], 4 * n + m + 1, n)
    root = memory[at.ROOT_WEIGHT]
    _gain(numbers, memory)
    angles = vector(numbers, numbers[at.ANGLES], n)
    for j in range(m):
        row = stack[points + j]
        for i in range(n):
            total = 0.0
            for c in range(count):
                total += gain[i, c] * noise[chosen[c], j]
            row[i] = total
    for i in range(n):
        for k in range(points):
            rest = deviations[k, i]
            for c in range(count):
                rest -= gain[i, c] * z_deviations[k, c]
            stack[k, i] = root * rest
        x[i] = x_mean[i]
        for c in range(count):
            x[i] += gain[i, c] * innovation[chosen[c]]
            shift[i] -= gain[i, c] * z_shift[c]
        if angles[i]:
            x[i] = wrap(x[i])
    whole = finish(numbers, memory, stack, points + m, n, at.SHIFT, at.P, at.S)
    covariance = vector(memory, numbers[at.P], n * n)
    if within_limit(x, n, LIMIT) and within_limit(covariance, n * n, LIMIT**2):
        return 0 if whole else _REPAIRED
    _keep_prediction(numbers, memory)
    return _OUT_OF_RANGE


@inlined
def _keep_prediction(numbers: Integers, memory: Array) -> None:
    """Take the prediction for the state."""
    n = numbers[at.N]
    size = n * n
    copy(vector(memory, numbers[at.X_MEAN], n), vector(memory, numbers[at.X], n), n)
    copy(vector(memory, numbers[at.P_MEAN], size), vector(memory, numbers[at.P], size), size)
    copy(vector(memory, numbers[at.S_MEAN], size), vector(memory, numbers[at.S], size), size)


@compiled
def _reacquire(numbers: Integers, memory: Array, limit: float) -> int:
    """Enlarge the predicted covariance until the gate lets the measurement in; status bits.

    A filter that trusts its own wrong prediction would gate every measurement for ever. If the
    measurement function cannot bear points that far out, the last covariance it bore is used.
    """
    inflation = 1.0
    status = 0
    for _ in range(_INFLATION_TRIES):
        # Twice at least, so that it ends; a thousandfold at most, so that it does not overshoot.
        larger = inflation * min(max(memory[at.NIS] / limit, 2.0), 1e3)
        _second_generation(numbers, memory, math.sqrt(larger))
        attempt = _innovate(numbers, memory)
        if attempt & _MEASUREMENT_FAILED:
            break
        status = attempt
        inflation = larger
        if memory[at.NIS] <= limit:
            memory[at.INFLATION] = inflation
            return status | _REACQUIRED
    _second_generation(numbers, memory, math.sqrt(inflation))
    status |= _innovate(numbers, memory)
    memory[at.INFLATION] = inflation
    return status | _REACQUIRED


@compiled
def correct(numbers: Integers, memory: Array) -> int:
    """Correct the prediction by what is usable of the measurement in Z, (18)-(23); status bits."""
    status = _choose_measurements(numbers, memory)
    if status & _MISSING:
        _keep_prediction(numbers, memory)
        return status
    if numbers[at.SECOND] == 1:
        _second_generation(numbers, memory, 1.0)
    status |= _innovate(numbers, memory)
    limit = vector(memory, numbers[at.GATE], numbers[at.M] + 1)[numbers[at.OBSERVED]]
    if limit > 0.0 and not (status & _MEASUREMENT_FAILED) and not (memory[at.NIS] <= limit):
        if numbers[at.REJECTED] < numbers[at.PATIENCE]:
            numbers[at.REJECTED] += 1
            memory[at.LOGLIK] = 0.0
            _keep_prediction(numbers, memory)
            return status | _GATED
        status |= _reacquire(numbers, memory, limit)
    if status & _MEASUREMENT_FAILED:
        memory[at.INFLATION] = 1.0
        _keep_prediction(numbers, memory)
        return status
    numbers[at.REJECTED] = 0
    return status | _apply_gain(numbers, memory)
