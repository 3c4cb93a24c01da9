"""The unscented filter's step as kernels for any model and size.

Equation numbers are those of yan2020, section III-B. All arrays live in the filter's memory (see
`fields`); nothing is allocated and nothing raised.
"""

import math
from typing import Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.compiled import borrow, compiled, copy, fill, inlined, matrix, vector
from truejoint.filters import fields as at
from truejoint.filters.factors import combine, semidefinite_cholesky, solve_rows, wrap
from truejoint.filters.fields import FilterStatus, call_measurement, call_model, unpack_filter

LIMIT: Final = 1e100
"""Beyond it a number is out of range: squares within it, and sums of them, stay finite."""

_INFLATION_TRIES: Final = 60
_LOG_2_PI: Final = math.log(2.0 * math.pi)


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
def _believe(
    x: Array, covariance: Array, factor: Array, to_x: Array, to_covariance: Array, to_factor: Array
) -> None:
    """Copy a state with its covariance and the factor of that."""
    n = x.shape[0]
    copy(x, to_x, n)
    for i in range(n):
        copy(covariance[i], to_covariance[i], n)
        copy(factor[i], to_factor[i], n)


@inlined
def _place_points(numbers: Integers, memory: Array, factor: Array, scale: float) -> None:
    """Deviations of 2 n sigma points, (15), (18).

    They stand plus and minus reach times the columns of a factor (n, n), times a scale.
    """
    m, n = unpack_filter(numbers, memory), numbers[at.N]
    reach = scale * m.reach
    for j in range(n):
        # One row at a time: numba takes each computed index for possibly negative.
        below, above = m.deviations[2 * j], m.deviations[2 * j + 1]
        for i in range(n):
            step = reach * factor[i, j]
            below[i] = -step
            above[i] = step


@compiled
def _propagate(numbers: Integers, memory: Array) -> bool:
    """Send the sigma points through the transition, (16); False if the images are unusable."""
    m, n = unpack_filter(numbers, memory), numbers[at.N]
    # NaN first: a function that fails to write an element is found out.
    fill(m.image, n, np.nan)
    image = vector(m.image, 0, n)
    copy(m.x, m.point, n)
    call_model(numbers[at.F], m.point, m.u, m.dt, m.theta, image)
    copy(image, m.centre, n)
    if not within_limit(m.centre, n, LIMIT):
        return False
    for k in range(2 * n):
        for i in range(n):
            m.point[i] = m.x[i] + m.deviations[k, i]
            image[i] = np.nan
        call_model(numbers[at.F], m.point, m.u, m.dt, m.theta, image)
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
    call_model(numbers[at.G], m.x, m.u, m.dt, m.theta, m.noise)
    # Any array of the right size holds the factor until it is known to be good.
    good = within_limit(entries, n * n, LIMIT)
    if not good or not semidefinite_cholesky(m.noise, n, m.factor_mean):
        return False
    for i in range(n):
        copy(m.factor_mean[i], m.noise_factor[i], n)
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
    first = n + m.n_measurements
    if not (0.0 <= m.dt <= LIMIT and possible(numbers, memory, m.u, m.n_inputs, first)):
        status = FilterStatus.INVALID_INPUT.value
    elif moving and numbers[at.G] != 0 and not _update_process_noise(numbers, memory):
        status = FilterStatus.TRANSITION_FAILED.value
    _place_points(numbers, memory, m.factor, 1.0)
    if moving and status == 0 and not _propagate(numbers, memory):
        status = FilterStatus.TRANSITION_FAILED.value
        _place_points(numbers, memory, m.factor, 1.0)
    if status != 0 or not moving:
        copy(m.x, m.centre, n)
    status |= _combine_prediction(numbers, memory, moving)
    covariance = vector(memory, numbers[at.P_MEAN], n * n)
    if not (within_limit(m.x_mean, n, LIMIT) and within_limit(covariance, n * n, LIMIT**2)):
        _believe(m.x, m.covariance, m.factor, m.x_mean, m.covariance_mean, m.factor_mean)
        _place_points(numbers, memory, m.factor, 1.0)
        copy(m.x, m.centre, n)
        fill(m.shift, n, 0.0)
        status |= FilterStatus.OUT_OF_RANGE.value
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
        m.deficit[i] = m.root_correction * m.shift[i]
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
    whole = combine(m.stack, rows, n, m.deficit, m.correction, m.covariance_mean, m.factor_mean)
    return 0 if whole else FilterStatus.COVARIANCE_REPAIRED.value


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
            status |= FilterStatus.INVALID_MEASUREMENT.value
    numbers[at.OBSERVED] = count
    memory[at.NIS] = np.nan
    memory[at.LOGLIK] = 0.0
    memory[at.INFLATION] = 1.0
    if count == 0:
        status |= FilterStatus.MISSING.value
    elif count < m.n_measurements:
        status |= FilterStatus.PARTIAL.value
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
    for k in range(2 * n):
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
        m.deficit[c] = m.root_correction * m.z_shift[c]
    return True


@compiled
def _innovate(numbers: Integers, memory: Array) -> int:
    """Innovation, its covariance, (20), and its NIS; status bits."""
    if not _observe(numbers, memory):
        return FilterStatus.MEASUREMENT_FAILED.value
    m = unpack_filter(numbers, memory)
    count, points = m.observed, 2 * m.n_states
    for k in range(points):
        for c in range(count):
            m.stack[k, c] = m.root_weight * m.z_deviations[k, c]
    for j in range(m.n_measurements):
        row = m.stack[points + j]
        for c in range(count):
            row[c] = m.sensor_factor[m.chosen[c], j]
    covariance = matrix(memory, numbers[at.P_ZZ], count, count)
    factor, white = matrix(memory, numbers[at.S_ZZ], count, count), m.white
    rows = points + m.n_measurements
    whole = combine(m.stack, rows, count, m.deficit, m.correction, covariance, factor)
    status = 0 if whole else FilterStatus.COVARIANCE_REPAIRED.value
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
            status |= FilterStatus.SINGULAR.value
    memory[at.NIS] = nis
    memory[at.LOGLIK] = -0.5 * (nis + rank * _LOG_2_PI) - logarithm - math.log(product)
    return status


@inlined
def _second_generation(numbers: Integers, memory: Array, scale: float) -> None:
    """Draw sigma points again from the predicted mean and covariance, (18)."""
    m, n = unpack_filter(numbers, memory), numbers[at.N]
    _place_points(numbers, memory, m.factor_mean, scale)
    copy(m.x_mean, m.centre, n)
    fill(m.shift, n, 0.0)


@inlined
def _gain(numbers: Integers, memory: Array) -> None:
    """Covariance of state and measurement, (21), divided by that of the measurement, (22)."""
    m, n, count = unpack_filter(numbers, memory), numbers[at.N], numbers[at.OBSERVED]
    weight = m.root_weight**2
    for i in range(n):
        for c in range(count):
            total = 0.0
            for k in range(2 * n):
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
    x, gain, points = m.x, m.gain, 2 * n
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
        m.deficit[i] = m.root_correction * m.shift[i]
        if m.angles[i]:
            x[i] = wrap(x[i])
    rows = points + m.n_measurements
    whole = combine(m.stack, rows, n, m.deficit, m.correction, m.covariance, m.factor)
    covariance = vector(memory, numbers[at.P], n * n)
    if within_limit(x, n, LIMIT) and within_limit(covariance, n * n, LIMIT**2):
        return 0 if whole else FilterStatus.COVARIANCE_REPAIRED.value
    _keep_prediction(numbers, memory)
    return FilterStatus.OUT_OF_RANGE.value


@inlined
def _keep_prediction(numbers: Integers, memory: Array) -> None:
    """Take the prediction for the state."""
    m = unpack_filter(numbers, memory)
    _believe(m.x_mean, m.covariance_mean, m.factor_mean, m.x, m.covariance, m.factor)


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
        if attempt & FilterStatus.MEASUREMENT_FAILED.value:
            break
        status = attempt
        inflation = larger
        if memory[at.NIS] <= limit:
            memory[at.INFLATION] = inflation
            return status | FilterStatus.REACQUIRED.value
    _second_generation(numbers, memory, math.sqrt(inflation))
    status |= _innovate(numbers, memory)
    memory[at.INFLATION] = inflation
    return status | FilterStatus.REACQUIRED.value


@compiled
def correct(numbers: Integers, memory: Array) -> int:
    """Correct the prediction by what is usable of the measurement in Z, (18)-(23); status bits."""
    m, status = unpack_filter(numbers, memory), _choose_measurements(numbers, memory)
    if status & FilterStatus.MISSING.value:
        _keep_prediction(numbers, memory)
        return status
    _second_generation(numbers, memory, 1.0)
    status |= _innovate(numbers, memory)
    limit = m.gate[numbers[at.OBSERVED]]
    if (
        limit > 0.0
        and not (status & FilterStatus.MEASUREMENT_FAILED.value)
        and not (memory[at.NIS] <= limit)
    ):
        if numbers[at.REJECTED] < numbers[at.PATIENCE]:
            numbers[at.REJECTED] += 1
            memory[at.LOGLIK] = 0.0
            _keep_prediction(numbers, memory)
            return status | FilterStatus.GATED.value
        status |= _reacquire(numbers, memory, limit)
    if status & FilterStatus.MEASUREMENT_FAILED.value:
        memory[at.INFLATION] = 1.0
        _keep_prediction(numbers, memory)
        return status
    numbers[at.REJECTED] = 0
    return status | _apply_gain(numbers, memory)


@compiled
def restart(numbers: Integers, memory: Array) -> None:
    """Put the filter back to where it stood before its first step."""
    m, n = unpack_filter(numbers, memory), numbers[at.N]
    _believe(m.x_prior, m.covariance_prior, m.factor_prior, m.x, m.covariance, m.factor)
    if numbers[at.G] != 0:
        fill(vector(memory, numbers[at.Q], n * n), n * n, 0.0)
    numbers[at.REJECTED] = 0


@compiled
def step(numbers: Integers, memory: Array) -> int:
    """Advance the state in the memory by DT, correct it by the measurement in Z; status bits."""
    lent_numbers, lent_memory = borrow(numbers), borrow(memory)
    m, status = unpack_filter(lent_numbers, lent_memory), 0
    if memory[at.DT] > memory[at.LONGEST]:
        restart(lent_numbers, lent_memory)
        memory[at.DT] = 0.0
        status = FilterStatus.RESTARTED.value
    status |= predict(lent_numbers, lent_memory)
    status |= correct(lent_numbers, lent_memory)
    if not possible(lent_numbers, lent_memory, m.x, m.n_states, 0):
        restart(lent_numbers, lent_memory)
        status |= FilterStatus.RESTARTED.value
    numbers[at.STATUS] = status
    return status
