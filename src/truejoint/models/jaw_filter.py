"""Compiled model functions of the filter: (12)-(14) of yan2020 for steps of any length."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from truejoint.compiled import compiled
from truejoint.filters import UnscentedFilter
from truejoint.filters.sigma_points import LambdaSigmaPoints
from truejoint.filters.state_space import StateSpaceModel
from truejoint.models.jaw_dynamics import ForcepsModel

Array = NDArray[np.float64]

# Parameters of the compiled functions: two angular frequencies, two modes by two coordinates (row
# by row), jaw inertia, slider mass, torque on the jaw per motor angle, and the spectral densities
# of torque [Nm2 s] and force [N2 s].
_FREQUENCY: Final = 0
_SHAPE: Final = 2
_INERTIA: Final = 6
_MASS: Final = 7
_TORQUE: Final = 8
_TORQUE_DENSITY: Final = 9
_FORCE_DENSITY: Final = 10


@compiled
def transition(x: Array, u: Array, dt: float, parameters: Array, out: Array) -> None:
    """Exact solution of (12) over `dt` [s], mode by mode.

    Parameters
    ----------
    x, out : ndarray, shape (4,)
        Jaw angle and speed, slider place and speed.
    u : ndarray, shape (2,)
        Motor angle [rad], and what (26) adds to the jaw's angle beforehand [rad].
    dt : float
    parameters : ndarray, shape (11,)
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
        place = jaw * inertia * (x[0] + u[1]) + slider * mass * x[2] - rest
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
            apart = _sine(a - b, dt)
            together = _sine(a + b, dt)
            place = 0.5 * density * (apart - together) / (a * b)
            mixed = 0.5 * density * (_versine(a + b, dt) + _versine(a - b, dt)) / a
            speed = 0.5 * density * (apart + together)
            for row in range(2):
                for column in range(2):
                    shape = parameters[_SHAPE + 2 * row + i] * parameters[_SHAPE + 2 * column + j]
                    out[2 * row, 2 * column] += shape * place
                    out[2 * row, 2 * column + 1] += shape * mixed
                    out[2 * column + 1, 2 * row] += shape * mixed
                    out[2 * row + 1, 2 * column + 1] += shape * speed


def state_space(
    model: ForcepsModel, jaw: float, slider: float, correlation_time: float, sensor: Array
) -> StateSpaceModel:
    """Build the filter's model: (13), with the noise of neglected friction.

    Parameters
    ----------
    model : ForcepsModel
    jaw, slider : float
        Neglected friction of jaw [Nm] and slider [N].
    correlation_time : float
        Time over which friction counts as one draw [s].
    sensor : ndarray, shape (2, 2)
        Covariance of the measured displacement [m] and speed [m/s].
    """
    frequencies, shapes = model.modes()
    torque = model.drive_stiffness * model.wheel_radius * model.jaw_radius / model.gear_ratio
    return StateSpaceModel(
        transition=transition,
        measurement=measurement,
        process_noise=process_noise,
        measurement_noise=sensor,
        states=("jaw", "jaw_speed", "reset", "reset_speed"),
        measurements=("reset", "reset_speed"),
        inputs=("motor", "compensation"),
        parameters=np.concatenate(
            [
                frequencies,
                shapes.ravel(),
                [model.jaw_inertia, model.slider_mass, torque],
                np.array([jaw, slider]) ** 2 * correlation_time,
            ]
        ),
    )


def mechanics(params: Mapping[str, Any]) -> ForcepsModel:
    """Model (12) that a filter with these parameters takes the forceps for."""
    return ForcepsModel(**{name: float(params[name]) for name in ForcepsModel.__annotations__})


def sensor_noise(params: Mapping[str, Any]) -> Array:
    """Covariance (2, 2) of the measured displacement [m] and speed [m/s]."""
    return np.diag([params["displacement_noise"], params["speed_noise"]]) ** 2


def rest_spread(params: Mapping[str, Any]) -> Array:
    """Covariance (4, 4) of the state that `at_rest` gives: friction holds the jaw off it."""
    r, k_r = params["jaw_radius"], params["reset_stiffness"]
    angle = params["slider_friction"] / (k_r * r) + params["jaw_friction"] / (
        (k_r + params["drive_stiffness"]) * r**2
    )
    noise = params["displacement_noise"], params["speed_noise"]
    return np.asarray(np.diag([angle, 1e-2, *noise]) ** 2)


def jaw_filter(params: Mapping[str, Any]) -> UnscentedFilter:
    """Build the filter of a `JawFilter`, of its parameters."""
    space = state_space(
        mechanics(params),
        params["jaw_friction"],
        params["slider_friction"],
        params["correlation_time"],
        sensor_noise(params),
    )
    return UnscentedFilter(space, LambdaSigmaPoints(params["lambda_"]))
