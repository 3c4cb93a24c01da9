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
from truejoint.filters.fields import call_measurement, unpack_filter
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
    m = unpack_filter(numbers, memory)
    status = 0
    count = 0
    for i in range(m.n_measurements):
        m.innovation[i] = np.nan
        if possible(numbers, memory, m.z[i : i + 1], 1, m.n_states + i):
            m.chosen[count] = i
            count += 1
        elif not math.isnan(m.z[i]):
            status |= _INVALID_MEASUREMENT
    numbers[at.OBSERVED] = count
    memory[at.NIS] = np.nan
    memory[at.LOGLIK] = 0.0
    memory[at.INFLATION] = 1.0
    if count == 0:
        status |= _MISSING
    elif count < m.n_measurements:
        status |= _PARTIAL
    return status


@compiled
def _observe(numbers: Integers, memory: Array) -> bool:
    """Send the sigma points through the measurement function, (19); False if unusable."""
    m = unpack_filter(numbers, memory)
    n, count, image = m.n_states, m.observed, vector(m.image, 0, m.n_measurements)
    fill(image, m.n_measurements, np.nan)
    copy(m.centre, m.point, n)
    call_measurement(numbers[at.H], m.point, m.u, m.theta, image)
    for c in range(count):
        m.z_mean[c] = image[m.chosen[c]]
        m.z_shift[c] = 0.0
    if not within_limit(m.z_mean, count, LIMIT):
        return False
    for k in range(m.points):
        for i in range(n):
            m.point[i] = m.centre[i] + m.deviations[k, i]
        fill(image, m.n_measurements, np.nan)
        call_measurement(numbers[at.H], m.point, m.u, m.theta, image)
        for c in range(count):
            i = m.chosen[c]
            difference = image[i] - m.z_mean[c]
            if not (abs(difference) <= LIMIT):
                return False
            if m.angles[n + i]:
                difference = wrap(difference)
            m.z_deviations[k, c] = difference
            m.z_shift[c] += difference
    weight = m.root_weight**2
    for c in range(count):
        m.z_shift[c] *= weight
        m.z_mean[c] += m.z_shift[c]
    return True


@compiled
def _innovate(numbers: Integers, memory: Array) -> int:
    """Innovation, its covariance, (20), and its NIS; status bits."""
    if not _observe(numbers, memory):
        return _MEASUREMENT_FAILED
    m = unpack_filter(numbers, memory)
    count, points = m.observed, m.points
    for k in range(points):
        for c in range(count):
            m.stack[k, c] = m.root_weight * m.z_deviations[k, c]
    for j in range(m.n_measurements):
        row = m.stack[points + j]
        for c in range(count):
            row[c] = m.sensor_factor[m.chosen[c], j]
    rows = points + m.n_measurements
    whole = finish(numbers, memory, m.stack, rows, count, at.Z_SHIFT, at.P_ZZ, at.S_ZZ)
    status = 0 if whole else _REPAIRED
    factor, white = matrix(memory, numbers[at.S_ZZ], count, count), m.white
    nis, logarithm, product, rank = 0.0, 0.0, 1.0, 0
    for c in range(count):
        i = m.chosen[c]
        difference = m.z[i] - m.z_mean[c]
        m.innovation[i] = wrap(difference) if m.angles[m.n_states + i] else difference
        rest = m.innovation[i]
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
    m, n, count = unpack_filter(numbers, memory), numbers[at.N], numbers[at.OBSERVED]
    weight = m.root_weight**2
    for i in range(n):
        for c in range(count):
            total = 0.0
            for k in range(m.points):
                total += m.deviations[k, i] * m.z_deviations[k, c]
            m.gain[i, c] = weight * total + m.correction * m.shift[i] * m.z_shift[c]
    solve_rows(matrix(memory, numbers[at.S_ZZ], count, count), count, m.gain, n)


@compiled
def _apply_gain(numbers: Integers, memory: Array) -> int:
    """Corrected state, (23), and its covariance in Joseph's form; status bits.

    Each sigma point is corrected with the gain as if it were the state, and the covariance is that
    of the corrected points plus the gain's share of the measurement noise. For this gain that is
    (23), but it cannot turn indefinite.
    """
    m, n, count = unpack_filter(numbers, memory), numbers[at.N], numbers[at.OBSERVED]
    x, gain, points = m.x, m.gain, m.points
    _gain(numbers, memory)
    for j in range(m.n_measurements):
        row = m.stack[points + j]
        for i in range(n):
            total = 0.0
            for c in range(count):
                total += gain[i, c] * m.sensor_factor[m.chosen[c], j]
            row[i] = total
    for i in range(n):
        for k in range(points):
            rest = m.deviations[k, i]
            for c in range(count):
                rest -= gain[i, c] * m.z_deviations[k, c]
            m.stack[k, i] = m.root_weight * rest
        x[i] = m.x_mean[i]
        for c in range(count):
            x[i] += gain[i, c] * m.innovation[m.chosen[c]]
            m.shift[i] -= gain[i, c] * m.z_shift[c]
        if m.angles[i]:
            x[i] = wrap(x[i])
    rows = points + m.n_measurements
    whole = finish(numbers, memory, m.stack, rows, n, at.SHIFT, at.P, at.S)
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
