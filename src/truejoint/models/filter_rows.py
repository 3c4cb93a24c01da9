"""The unscented filters in the loop: their states in one flat memory, their covariance as width."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from math import nan, sqrt
from typing import Final

import numpy as np

from truejoint.compiled import compiled
from truejoint.filters import UnscentedFilter
from truejoint.filters import kernels as unscented_kernels
from truejoint.filters import memory as lay
from truejoint.filters.memory import copy, matrix, vector
from truejoint.filters.status import FilterStatus
from truejoint.models.elastic_joint import ElasticJoint, output
from truejoint.models.families import EstimatorData
from truejoint.models.friction_filter import DEGREE, friction_filter, friction_prior
from truejoint.models.jaw_filter import jaw_filter, mechanics, rest_spread
from truejoint.models.jaw_kernels import COEFFICIENTS, rational_row
from truejoint.models.row_model import Array, Integers, RowModel

FAULTS: Final = int(
    FilterStatus.INVALID_INPUT
    | FilterStatus.INVALID_MEASUREMENT
    | FilterStatus.TRANSITION_FAILED
    | FilterStatus.MEASUREMENT_FAILED
    | FilterStatus.OUT_OF_RANGE
    | FilterStatus.SINGULAR
)
"""What makes a filter's estimate none: its row is then NaN, and the sample IMPLAUSIBLE."""

# Every filter's `numbers` begin with the length of its own numbers and of its own memory, and where
# the latter starts; `memory` begins with how many standard deviations a half-width is. The filter's
# own follow, each twice: as they are, and as they were before the first row.
_LENGTH: Final = 0
_SIZE: Final = 1
_PLACE: Final = 2
_EXTRA: Final = 3  # a number of the estimator's own
_OWN: Final = 4
_DEVIATIONS: Final = 0

# Then in `memory`, of the jaw's filter: what it remembers, and what at_rest and (26) need.
_MOTOR: Final = 1
_RESET: Final = 2
_INJECTED: Final = 3
_DRIVE_STIFFNESS: Final = 4
_RESET_STIFFNESS: Final = 5
_WHEEL: Final = 6
_GEAR: Final = 7
_DIVISOR: Final = 8
_CONSTANT: Final = 9
_GAIN: Final = 10
_SCALE: Final = 11
_ERROR: Final = 13
_JAW_FILTER: Final = _ERROR + COEFFICIENTS
_READINGS: Final = ("constant", "output", "scaled", "signed", "literal")

# Of the filter with friction: displacement of the row before, drive per motor angle, inverse scale,
# standard deviation of what the angle's model misses, and its polynomial and weights.
_LAST: Final = 1
_FACTOR: Final = 2
_INVERSE: Final = 3
_MISFIT: Final = 4
_ANGLE: Final = 5

# Of the elastic joint's: driver of the row before, its middle and scale, the torque's scale; then
# two numbers for each state, and for each output its misfit and its coefficients.
_MIDDLE: Final = 2
_HALF_RANGE: Final = 3
_TORQUE: Final = 4
_STATES: Final = 5


@compiled
def start_anew(numbers: Integers, memory: Array) -> None:
    """Put the filter back to where it stood before the first row."""
    length, size, place = numbers[_LENGTH], numbers[_SIZE], numbers[_PLACE]
    own = vector(numbers, _OWN, length)
    first = vector(numbers, _OWN + length, length)
    for i in range(length):
        own[i] = first[i]
    copy(vector(memory, place + size, size), vector(memory, place, size), size)


@compiled
def step_filter(numbers: Integers, memory: Array, interval: float) -> bool:
    """Advance the filter; whether its estimate is one."""
    own = vector(numbers, _OWN, numbers[_LENGTH])
    state = vector(memory, numbers[_PLACE], numbers[_SIZE])
    state[lay.DT] = interval
    return (unscented_kernels.step(own, state) & FAULTS) == 0


@compiled
def block(numbers: Integers, memory: Array, which: int, length: int) -> Array:
    """View of a block of the filter's memory."""
    view: Array = vector(memory, numbers[_PLACE] + numbers[_OWN + which], length)
    return view


@compiled
def jaw_filter_row(
    numbers: Integers,
    memory: Array,
    interval: float,
    features: Array,
    out: Array,
    half_width: Array,
) -> None:
    """Predict one row: the filter of yan2020; arguments as in `row_models.offset_row`."""
    motor, reset = features[0], features[1]
    speed = nan
    if interval == 0.0:
        start_anew(numbers, memory)
        drive = motor * memory[_WHEEL] / memory[_GEAR]
        tension = memory[_DRIVE_STIFFNESS] * drive + memory[_RESET_STIFFNESS] * reset
        state = block(numbers, memory, lay.X, 4)
        state[0] = tension / memory[_DIVISOR]
        state[2] = reset
        memory[_MOTOR] = motor
        memory[_INJECTED] = 0.0
    else:
        speed = (reset - memory[_RESET]) / interval
    z = block(numbers, memory, lay.Z, 2)
    z[0] = reset
    z[1] = speed
    u = block(numbers, memory, lay.U, 2)
    u[0] = memory[_MOTOR]
    u[1] = memory[_INJECTED]
    good = step_filter(numbers, memory, interval)
    injected = 0.0
    added = memory[_CONSTANT]
    reading = numbers[_EXTRA]
    if reading > 0:
        error = rational_row(
            motor, reset, vector(memory, _SCALE, 2), vector(memory, _ERROR, COEFFICIENTS)
        )
        if reading == 1:
            added = -error
        elif reading == 2:
            injected = -error / memory[_GAIN]
        else:
            injected = -error if reading == 3 else error
    memory[_MOTOR] = motor
    memory[_RESET] = reset
    memory[_INJECTED] = injected
    out[0] = block(numbers, memory, lay.X, 4)[0] + injected + added if good else nan
    if memory[_DEVIATIONS] > 0.0:
        half_width[0] = memory[_DEVIATIONS] * sqrt(max(block(numbers, memory, lay.P, 1)[0], 0.0))


@compiled
def friction_filter_row(
    numbers: Integers,
    memory: Array,
    interval: float,
    features: Array,
    out: Array,
    half_width: Array,
) -> None:
    """Predict one row: friction and load in the state; arguments as in `row_models.offset_row`."""
    reset = features[1]
    moved = reset - memory[_LAST]
    if interval == 0.0:
        start_anew(numbers, memory)
        moved = 0.0
    block(numbers, memory, lay.Z, 1)[0] = features[0] * memory[_FACTOR]
    u = block(numbers, memory, lay.U, 2)
    u[0] = moved
    u[1] = reset
    good = step_filter(numbers, memory, interval)
    memory[_LAST] = reset
    elements = numbers[_EXTRA]
    n = elements + 1
    x = block(numbers, memory, lay.X, n)
    weights = vector(memory, _ANGLE, 1 + DEGREE + elements)
    place = reset * memory[_INVERSE]
    angle = weights[0]
    power = 1.0
    for i in range(DEGREE):
        power = power * place
        angle = angle + weights[1 + i] * power
    for i in range(elements):
        angle = angle + weights[1 + DEGREE + i] * x[i]
    out[0] = angle if good else nan
    if memory[_DEVIATIONS] > 0.0:
        spread = matrix(memory, numbers[_PLACE] + numbers[_OWN + lay.P], n, n)
        variance = 0.0
        for i in range(elements):
            for j in range(elements):
                variance += weights[1 + DEGREE + i] * spread[i, j] * weights[1 + DEGREE + j]
        half_width[0] = memory[_DEVIATIONS] * sqrt(max(variance, 0.0) + memory[_MISFIT] ** 2)


@compiled
def elastic_joint_row(
    numbers: Integers,
    memory: Array,
    interval: float,
    features: Array,
    out: Array,
    half_width: Array,
) -> None:
    """Predict one row: the elastic joint; arguments as in `row_models.offset_row`."""
    angle = (features[0] - memory[_MIDDLE]) / memory[_HALF_RANGE]
    moved = angle - memory[_LAST]
    if interval == 0.0:
        start_anew(numbers, memory)
        moved = 0.0
    block(numbers, memory, lay.Z, 1)[0] = features[1] / memory[_TORQUE]
    u = block(numbers, memory, lay.U, 2)
    u[0] = angle
    u[1] = moved
    good = step_filter(numbers, memory, interval)
    memory[_LAST] = angle
    elements = numbers[_EXTRA]
    n = elements + 2
    terms = (numbers[_PLACE] - _STATES - 2 * n) // out.shape[0] - 1
    x = block(numbers, memory, lay.X, n)
    for j in range(out.shape[0]):
        place = _STATES + 2 * n + j * (1 + terms)
        coefficients = vector(memory, place + 1, terms)
        out[j] = output(angle, x, elements, coefficients) if good else nan
        if memory[_DEVIATIONS] > 0.0:
            variance = output_variance(numbers, memory, angle, coefficients) + memory[place] ** 2
            half_width[j] = memory[_DEVIATIONS] * sqrt(variance)


@compiled
def output_variance(numbers: Integers, memory: Array, angle: float, coefficients: Array) -> float:
    """Variance of what the elastic joint's state says of one output."""
    elements = numbers[_EXTRA]
    n = elements + 2
    x = block(numbers, memory, lay.X, n)
    spread = matrix(memory, numbers[_PLACE] + numbers[_OWN + lay.P], n, n)
    near = vector(memory, _STATES, n)
    slope = vector(memory, _STATES + n, n)
    copy(x, near, n)
    for i in range(n):
        # Over a deviation each way, since the responses bend where an element slides.
        width = sqrt(max(spread[i, i], 1e-12))
        near[i] = x[i] + width
        ahead = output(angle, near, elements, coefficients)
        near[i] = x[i] - width
        slope[i] = (ahead - output(angle, near, elements, coefficients)) / (2.0 * width)
        near[i] = x[i]
    variance = 0.0
    for i in range(n):
        for j in range(n):
            variance += slope[i] * spread[i, j] * slope[j]
    return max(variance, 0.0)


def _jaw_filter(data: EstimatorData, _n_features: int, _n_outputs: int) -> RowModel:
    arrays, model = data.arrays, mechanics(data.params)
    compensated = data.family == "ukf_compensated"
    own = np.zeros(_JAW_FILTER)
    own[_DRIVE_STIFFNESS : _DIVISOR + 1] = (
        model.drive_stiffness, model.reset_stiffness, model.wheel_radius, model.gear_ratio,
        (model.drive_stiffness + model.reset_stiffness) * model.jaw_radius,
    )  # fmt: skip
    if compensated:
        own[_GAIN] = arrays["loop_gain"][0]
        own[_SCALE:_ERROR], own[_ERROR:] = arrays["scale"], arrays["coefficients"]
    else:
        own[_CONSTANT] = arrays["constant"][0]
    reading = _READINGS.index(data.params["reading"]) if compensated else 0
    first = np.zeros(4), rest_spread(data.params)
    row = _row_model(jaw_filter_row, jaw_filter(data.params), first, reading, own)
    # What is left by the constant alone is friction that always pulls the same way, which no
    # covariance tells; that of the bare filter is more than enough for what (25) leaves.
    return row if compensated else replace(row, deviations=None)


def _friction_filter(data: EstimatorData, _n_features: int, _n_outputs: int) -> RowModel:
    params, arrays = data.params, data.arrays
    elements = len(params["widths"])
    factor = params["wheel_radius"] / params["gear_ratio"]
    own = np.concatenate(
        [[0.0, 0.0, factor, arrays["scale"][0], arrays["misfit"][1]], arrays["angle"]]
    )
    unscented = friction_filter(params, arrays)
    return _row_model(friction_filter_row, unscented, friction_prior(elements), elements, own)


def _elastic_joint(data: EstimatorData, _n_features: int, _n_outputs: int) -> RowModel:
    arrays = data.arrays
    joint = ElasticJoint.from_arrays(arrays)
    middle, half_range, torque, interval = arrays["scales"].tolist()
    elements = len(joint.widths)
    outputs = np.column_stack([arrays["misfit"], arrays["outputs"]])
    own = np.concatenate(
        [[0.0, 0.0, middle, half_range, torque], np.zeros(2 * (elements + 2)), outputs.ravel()]
    )
    unscented = UnscentedFilter(joint.state_space(interval))
    return _row_model(elastic_joint_row, unscented, joint.prior(), elements, own)


def _row_model(
    function: Callable[..., None],
    unscented: UnscentedFilter,
    first: tuple[Array, Array],
    extra: int,
    own: Array,
) -> RowModel:
    state = unscented.initial_state(*first)
    numbers, memory = state.numbers, state.memory
    header = [len(numbers), len(memory), len(own), extra]
    return RowModel(
        function,
        np.concatenate([header, numbers, numbers]).astype(np.int64),
        np.concatenate([own, memory, memory]),
        _DEVIATIONS,
    )


FILTERS: Final[Mapping[str, Callable[[EstimatorData, int, int], RowModel]]] = {
    "ukf": _jaw_filter,
    "ukf_compensated": _jaw_filter,
    "ukf_friction": _friction_filter,
    "ukf_elastic": _elastic_joint,
}
"""Builders for `row_models.BUILDERS`."""
