"""What runs of yan2020 for a jaw: the unscented filter, (12)-(25), and least squares, (29)-(30)."""

import math
from collections.abc import Mapping
from math import nan, sqrt
from types import SimpleNamespace
from typing import Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled
from truejoint.estimators.family import Family, Shape, only_joint
from truejoint.estimators.filtered import FILTER, filter_family, filter_layout, pack_filter
from truejoint.estimators.jaw.signals import (
    COEFFICIENTS,
    DRIVE,
    ERROR_SHAPES,
    MECHANISM_RULES,
    MOTOR,
    RESET,
    bounded_error,
)
from truejoint.estimators.rules import POSITIVE, Params, one_of
from truejoint.filters import ScaledSigmaPoints, StateSpaceModel, UnscentedFilter
from truejoint.filters.fields import unpack_filter
from truejoint.layout import Layout, Memory, part_memory, part_numbers
from truejoint.products import weighted

# Parameters of the compiled functions: two angular frequencies, two modes by two coordinates (row
# by row), jaw inertia, slider mass, torque on the jaw per motor angle, and the spectral densities
# of torque [Nm2 s] and force [N2 s].
_FREQUENCY: Final = 0
_SHAPE: Final = 2
_INERTIA, _MASS, _TORQUE, _TORQUE_DENSITY, _FORCE_DENSITY = range(6, 11)


@compiled
def transition(x: Array, u: Array, dt: float, parameters: Array, out: Array) -> None:
    """Exact solution of (12) over `dt` [s], mode by mode.

    State `x` (4,): jaw angle and speed, slider place and speed; `u`: motor angle [rad].
    """
    inertia = parameters[_INERTIA]
    mass = parameters[_MASS]
    for i in range(4):
        out[i] = 0.0
    for i in range(2):
        jaw = parameters[_SHAPE + i]
        slider = parameters[_SHAPE + 2 + i]
        frequency = parameters[_FREQUENCY + i]
        rest = jaw * parameters[_TORQUE] * u[0] / (frequency * frequency)
        place = jaw * inertia * x[0] + slider * mass * x[2] - rest
        speed = jaw * inertia * x[1] + slider * mass * x[3]
        cosine = math.cos(frequency * dt)
        sine = math.sin(frequency * dt)
        new_place = rest + place * cosine + speed * sine / frequency
        new_speed = speed * cosine - place * frequency * sine
        out[0] += jaw * new_place
        out[1] += jaw * new_speed
        out[2] += slider * new_place
        out[3] += slider * new_speed


@compiled
def measurement(x: Array, _u: Array, _parameters: Array, out: Array) -> None:
    """``C`` of (13): displacement and speed of the reset cable."""
    out[0] = x[2]
    out[1] = x[3]


@compiled
def _sine(difference: float, dt: float) -> float:
    """Integral of cos(difference s) over 0 <= s <= dt."""
    turn = difference * dt
    return dt if abs(turn) < 1e-9 else math.sin(turn) / difference


@compiled
def _versine(difference: float, dt: float) -> float:
    """Integral of sin(difference s) over 0 <= s <= dt."""
    half = 0.5 * difference * dt
    return (
        0.5 * difference * dt * dt if abs(half) < 1e-9 else 2.0 * math.sin(half) ** 2 / difference
    )


@compiled
def process_noise(_x: Array, _u: Array, dt: float, parameters: Array, out: Array) -> None:
    """Covariance over `dt` of white torque on the jaw and white force on the slider.

    The same integral as Van Loan's, solved mode by mode, so that the step may vary.
    """
    for i in range(2):
        for j in range(2):
            a = parameters[_FREQUENCY + i]
            b = parameters[_FREQUENCY + j]
            density = (
                parameters[_SHAPE + i] * parameters[_SHAPE + j] * parameters[_TORQUE_DENSITY]
                + parameters[_SHAPE + 2 + i]
                * parameters[_SHAPE + 2 + j]
                * parameters[_FORCE_DENSITY]
            )
            of_difference = _sine(a - b, dt)
            of_sum = _sine(a + b, dt)
            place = 0.5 * density * (of_difference - of_sum) / (a * b)
            mixed = 0.5 * density * (_versine(a + b, dt) + _versine(a - b, dt)) / a
            speed = 0.5 * density * (of_difference + of_sum)
            for row in range(2):
                for column in range(2):
                    shape = parameters[_SHAPE + 2 * row + i] * parameters[_SHAPE + 2 * column + j]
                    out[2 * row, 2 * column] += shape * place
                    out[2 * row, 2 * column + 1] += shape * mixed
                    out[2 * column + 1, 2 * row] += shape * mixed
                    out[2 * row + 1, 2 * column + 1] += shape * speed


class ForcepsModel(SimpleNamespace):
    """What the filter takes the forceps to be, by the parameters of `JawFilter`."""

    @property
    def drive_tension(self) -> float:
        """Tension of the drive cable per motor angle at rest [N/rad]."""
        return float(self.drive_stiffness * self.wheel_radius / self.gear_ratio)

    @property
    def rest_divisor(self) -> float:
        """Tension of both cables at rest per jaw angle [N/rad]."""
        return float((self.drive_stiffness + self.reset_stiffness) * self.jaw_radius)

    def rest_covariance(self) -> Array:
        """Covariance (4, 4) of the state in balance, (9): friction holds the jaw off it."""
        slider = self.slider_friction / (self.reset_stiffness * self.jaw_radius)
        angle = slider + self.jaw_friction / (self.rest_divisor * self.jaw_radius)
        return np.asarray(np.diag([angle, 1e-2, self.displacement_noise, self.speed_noise]) ** 2)

    def state_space(self) -> StateSpaceModel:
        """Build the filter's model, by its modes: (13), with the noise of neglected friction."""
        k_d, k_r, r = self.drive_stiffness, self.reset_stiffness, self.jaw_radius
        inertia, mass = self.jaw_inertia, self.slider_mass
        restoring = np.array(
            [
                [(k_r + k_d) * r**2 / inertia, -k_r * r / inertia],
                [-k_r * r / mass, (self.spring_stiffness + k_r) / mass],
            ]
        )
        scale = np.sqrt([inertia, mass])
        squares, vectors = np.linalg.eigh(restoring * np.outer(scale, 1.0 / scale))
        frequencies, shapes = np.sqrt(squares), vectors / scale[:, None]  # [rad/s], as columns
        friction = np.array([self.jaw_friction, self.slider_friction]) ** 2 * self.correlation_time
        # No jaw turns further than once round, within a millisecond at that; no cable goes further
        # than twice that.
        turn, cable = 2.0 * math.pi, 4.0 * math.pi * r
        largest = {
            "jaw": turn, "jaw_speed": 1e3 * turn, "reset": cable, "reset_speed": 1e3 * cable,
            "motor": cable * self.gear_ratio / self.wheel_radius,
        }  # fmt: skip
        return StateSpaceModel(
            transition=transition,
            measurement=measurement,
            process_noise=process_noise,
            measurement_noise=np.diag([self.displacement_noise, self.speed_noise]) ** 2,
            states=("jaw", "jaw_speed", "reset", "reset_speed"),
            measurements=("reset", "reset_speed"),
            inputs=("motor",),
            parameters=np.concatenate(
                [frequencies, shapes.ravel(), [inertia, mass, self.drive_tension * r], friction]
            ),
            possible={name: (-bound, bound) for name, bound in largest.items()},
        )


LAYOUT: Final = filter_layout().declare(__package__, "error", "filter", COEFFICIENTS=COEFFICIENTS)
LAST_MOTOR, LAST_RESET = LAYOUT.places("motor reset")
unpack = LAYOUT.unpacker()


@compiled
def take_inputs(
    numbers: Integers, memory: Array, dt: float, x: Array, _out: Array, _half_width: Array
) -> None:
    """Measure the reset cable and its speed; the motor's angle acts from the row before on."""
    m = unpack(numbers, memory)
    f = unpack_filter(part_numbers(numbers, FILTER), part_memory(numbers, memory, FILTER))
    motor, reset = x[0], x[1]
    f.z[0] = reset
    if dt == 0.0:
        f.x[0] = (m.drive_tension * motor + m.reset_stiffness * reset) / m.divisor
        f.x[2] = reset
        f.z[1], f.u[0] = nan, motor
    else:
        f.z[1], f.u[0] = (reset - m.reset) / dt, m.motor
    memory[LAST_MOTOR], memory[LAST_RESET] = motor, reset


@compiled
def tell(
    numbers: Integers, memory: Array, _dt: float, x: Array, out: Array, half_width: Array
) -> None:
    """Tell the jaw's angle, less the error model or with a constant."""
    m = unpack(numbers, memory)
    f = unpack_filter(part_numbers(numbers, FILTER), part_memory(numbers, memory, FILTER))
    if m.deviations > 0.0:
        half_width[0] = m.deviations * sqrt(max(f.covariance[0, 0], 0.0))
    added = m.constant
    if m.compensated == 1:
        added = -bounded_error(x[0], x[1], m.scale, m.error_coef, m.error_range, half_width)
    out[0] = f.x[0] + added


def _shapes(params: Params, _n_features: int, n_outputs: int) -> dict[str, Shape]:
    learnt = ERROR_SHAPES if params["compensated"] else {"constant": (1,)}
    return only_joint("jaw", learnt, n_outputs)


def _pack(params: Params, arrays: Mapping[str, Array], _k: int, _n: int) -> Memory:
    model = ForcepsModel(**params)
    # ``lambda`` of (15), here -1, changes nothing: (12) is linear.
    unscented = UnscentedFilter(model.state_space(), ScaledSigmaPoints(1.0, 0.0, -1.0))
    return pack_filter(
        LAYOUT,
        take_inputs=take_inputs,
        tell=tell,
        compensated=params["compensated"],
        drive_tension=model.drive_tension,
        reset_stiffness=model.reset_stiffness,
        divisor=model.rest_divisor,
        **arrays,
        filter=unscented.memory(np.zeros(4), model.rest_covariance()),
    )


FAMILY: Final = filter_family(
    "jaw",
    rules={
        **dict.fromkeys(("drive_stiffness", "reset_stiffness", "jaw_inertia"), POSITIVE),
        **dict.fromkeys(("jaw_friction", "slider_friction", "correlation_time"), POSITIVE),
        **dict.fromkeys(("displacement_noise", "speed_noise", "slider_mass"), POSITIVE),
        **MECHANISM_RULES,
        "compensated": one_of(False, True),
    },
    shapes=_shapes,
    pack=_pack,
    # The gain depends on the step, and what is left to compensate depends on the gain.
    counts_samples=True,
    inputs=lambda _params: (MOTOR, RESET),
    # What is left by a constant alone is friction that always pulls the same way, which no
    # covariance tells; that of the bare filter is more than enough for what (25) leaves.
    states_deviation=lambda params: bool(params["compensated"]),
)

OBSERVED: Final = 7
"""Columns of the observation matrix (29)."""

LEAST_SQUARES_LAYOUT: Final = Layout().declare(
    __package__, "error", "least_squares", COEFFICIENTS=COEFFICIENTS, OBSERVED=OBSERVED
)
unpack_least_squares = LEAST_SQUARES_LAYOUT.unpacker()


@compiled
def cable_least_squares_row(
    numbers: Integers, memory: Array, dt: float, x: Array, out: Array, half_width: Array
) -> None:
    """Predict by (29), or by (30) where there is an error model."""
    m = unpack_least_squares(numbers, memory)
    drive, reset = x[m.compensated], x[m.compensated + 1]
    observe(dt, drive, reset, m.last, m.columns)
    error = 0.0
    if m.compensated == 1:
        error = bounded_error(x[0], reset, m.scale, m.error_coef, m.error_range, half_width)
    out[0] = weighted(m.columns, m.coef) + m.constant - error


@compiled
def observe(dt: float, drive: float, reset: float, last: Array, out: Array) -> None:
    """One row of (29) into `out` (7,): both displacements [m], their speeds and accelerations.

    Last comes the sign of the drive's speed. `dt` [s] is 0 where a history starts, at rest; `last`
    (4,), displacements and speeds of the row before, is changed in place.
    """
    for i in range(2):
        place = drive if i == 0 else reset
        speed = 0.0
        acceleration = 0.0
        if dt > 0.0:
            speed = (place - last[i]) / dt
            acceleration = (speed - last[2 + i]) / dt
        last[i] = place
        last[2 + i] = speed
        out[3 * i] = place
        out[3 * i + 1] = speed
        out[3 * i + 2] = acceleration
    out[6] = np.sign(out[4])


@compiled
def observe_rows(dt: Array, drive: Array, reset: Array, out: Array) -> None:
    """(29) of every row, into `out` (n, 7)."""
    last = np.zeros(4)
    for i in range(dt.shape[0]):
        observe(dt[i], drive[i], reset[i], last, out[i])


def _least_squares_shapes(params: Params, _n_features: int, n_outputs: int) -> dict[str, Shape]:
    error_model = ERROR_SHAPES if params["compensated"] else {}
    learnt = {"coef": (OBSERVED,), "constant": (1,), **error_model}
    return only_joint("jaw.least_squares", learnt, n_outputs)


LEAST_SQUARES: Final = Family(
    "jaw.least_squares",
    rules=dict.fromkeys(("intercept", "compensated"), one_of(False, True)),
    shapes=_least_squares_shapes,
    pack=lambda params, arrays, _k, _n: LEAST_SQUARES_LAYOUT.pack(
        compensated=params["compensated"], **arrays
    ),
    row=cable_least_squares_row,
    remembers=True,
    counts_samples=True,  # differences of rows
    inputs=lambda params: (MOTOR, DRIVE, RESET) if params["compensated"] else (DRIVE, RESET),
    targets=("position", "error"),
)
