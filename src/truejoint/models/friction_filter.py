"""What the filter with friction and load in its state is made of.

Slider, cables and jaw hold friction that depends on which way they last moved. A few elastoplastic
elements, each a bristle that bends with the reset cable's motion until it slides, stand for it.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import isnan, nan, sqrt
from typing import Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled, matrix, vector
from truejoint.errors import CalibrationError
from truejoint.filters import StateSpaceModel, UnscentedFilter
from truejoint.filters import fields as at
from truejoint.filters.kernels import restart
from truejoint.layout import Layout, Memory, part_memory, part_numbers
from truejoint.models.family import POSITIVE, Family, Params, Shape, is_number, numbers, only_joint
from truejoint.models.filtered import advance, quadratic
from truejoint.models.jaw import MOTOR, RESET

DEGREE: Final = 4
"""Highest power of ``x2`` in both polynomials."""

_LARGEST: Final = 1e30
_FARTHEST: Final = 3.0
"""Largest displacements of training beyond which no cable is: further out by its whole range."""


@compiled
def transition(x: Array, u: Array, _dt: float, parameters: Array, out: Array) -> None:
    """Bend each element by the reset cable's motion ``u[0]`` [m]; the load stays.

    `parameters` begins with the number of elements and their widths [m].
    """
    n = int(parameters[0])
    for i in range(n):
        out[i] = min(max(x[i] + u[0] / parameters[1 + i], -1.0), 1.0)
    out[n] = x[n]


@compiled
def response(place: float, x: Array, elements: int, weights: Array) -> float:
    """Sum of a constant, powers of a scaled place, and the elements' deflections in `x`."""
    total = weights[0]
    power = 1.0
    for i in range(DEGREE):
        power = power * place
        total = total + weights[1 + i] * power
    for i in range(elements):
        total = total + weights[1 + DEGREE + i] * x[i]
    return float(total)


@compiled
def measurement(x: Array, u: Array, parameters: Array, out: Array) -> None:
    """Drive cable's displacement [m] where the reset cable's is ``u[1]`` [m].

    `parameters` goes on with the inverse scale, constant and powers of a polynomial, a weight for
    each element, and the drive cable's stretch per load [m/Nm].
    """
    n = int(parameters[0])
    last = 3 + 2 * n + DEGREE
    place = response(u[1] * parameters[1 + n], x, n, parameters[2 + n : last])
    out[0] = place + parameters[last] * x[n]


@compiled
def process_noise(_x: Array, _u: Array, dt: float, parameters: Array, out: Array) -> None:
    """Random walks: the last two parameters are variances per second of elements and load."""
    n = int(parameters[0])
    for i in range(n):
        out[i, i] = parameters[4 + 2 * n + DEGREE] * dt
    out[n, n] = parameters[5 + 2 * n + DEGREE] * dt


def friction_filter(params: Params, arrays: Mapping[str, Array]) -> UnscentedFilter:
    """Build the filter of a fitted `FrictionFilter`; raises CalibrationError or FilterError."""
    for name in ("scale", "misfit", "dt"):
        if not all(is_number(value, 1.0 / _LARGEST, _LARGEST) for value in arrays[name]):
            raise CalibrationError(f"friction_filter: {name} is not above 0; fit it again")
    widths = params["widths"]
    n = len(widths)
    stretch = -1.0 / (params["drive_stiffness"] * params["jaw_radius"])
    last = [stretch, params["friction_drift"] ** 2, params["load_drift"] ** 2]
    parameters = np.concatenate([[float(n)], widths, arrays["scale"], arrays["drive"], last])
    # A misfit that lasts for a time tells in each row what it told in the row before.
    repeated = max(params["error_time"] / float(arrays["dt"][0]), 1.0)
    reset = _FARTHEST / float(arrays["scale"][0])
    powers = np.concatenate([_FARTHEST ** np.arange(DEGREE + 1.0), np.ones(n)])
    drive = float(np.abs(arrays["drive"]) @ powers) + reset
    largest = {
        "reset": reset, "reset_motion": 2.0 * reset, "drive": drive, "load": drive / abs(stretch)
    }  # fmt: skip
    model = StateSpaceModel(
        transition=transition,
        measurement=measurement,
        process_noise=process_noise,
        measurement_noise=[[arrays["misfit"][0] ** 2 * repeated]],
        states=(*(f"friction_{i}" for i in range(n)), "load"),
        measurements=("drive",),
        inputs=("reset_motion", "reset"),
        parameters=parameters,
        possible={name: (-bound, bound) for name, bound in largest.items()},
    )
    return UnscentedFilter(model)


def friction_prior(elements: int) -> tuple[Array, Array]:
    """Mean (n + 1,) and covariance at first: unloaded, friction within half of what it can hold."""
    return np.zeros(elements + 1), np.diag([*([0.25] * elements), 1e-8])


LAYOUT: Final = Layout()
ELEMENTS: Final = LAYOUT.integer("elements", "of friction")
DEVIATIONS: Final = LAYOUT.scalar("deviations", "of the filter's own that a half-width is; 0: none")
LAST_RESET: Final = LAYOUT.scalar("reset", "displacement of the row before [m]; NaN: start anew")
DRIVE_FACTOR: Final = LAYOUT.scalar("drive_factor", "drive cable per motor angle [m/rad]")
INVERSE: Final = LAYOUT.scalar("inverse_scale", "inverse largest displacement [1/m]")
MISFIT: Final = LAYOUT.scalar("misfit", "standard deviation of what the angle's model misses [rad]")
ANGLE: Final = LAYOUT.array("angle", "constant, powers and elements of the angle [rad]")
FILTER: Final = LAYOUT.part("filter", "of the elements, -1 to 1, and the load [Nm]")


@compiled
def friction_filter_row(
    numbers: Integers, memory: Array, dt: float, x: Array, out: Array, half_width: Array
) -> None:
    """Predict by the filter with friction and load."""
    own, state = part_numbers(numbers, FILTER), part_memory(numbers, memory, FILTER)
    reset = x[1]
    moved = reset - memory[LAST_RESET]
    if dt == 0.0 or isnan(moved):
        restart(own, state)
        moved = dt = 0.0
    vector(state, own[at.Z], 1)[0] = x[0] * memory[DRIVE_FACTOR]
    u = vector(state, own[at.U], 2)
    u[0] = moved
    u[1] = reset
    good = advance(own, state, dt)
    memory[LAST_RESET] = reset if good else nan
    elements = numbers[ELEMENTS]
    weights = vector(memory, numbers[ANGLE], 1 + DEGREE + elements)
    estimate = vector(state, own[at.X], elements + 1)
    out[0] = response(reset * memory[INVERSE], estimate, elements, weights) if good else nan
    if memory[DEVIATIONS] > 0.0:
        spread = matrix(state, own[at.P], elements + 1, elements + 1)
        variance = quadratic(weights[1 + DEGREE :], spread, elements) + memory[MISFIT] ** 2
        half_width[0] = memory[DEVIATIONS] * sqrt(variance)


@compiled
def jaw_angles(
    places: Array, X: Array, spread: Array, weights: Array, angle: Array, variance: Array
) -> None:
    """Jaw angle and its variance in every row: states (n, m + 1), covariances, into (n,)."""
    elements = X.shape[1] - 1
    for i in range(X.shape[0]):
        angle[i] = response(places[i], X[i], elements, weights)
        variance[i] = quadratic(weights[1 + DEGREE :], spread[i], elements)


def shapes(params: Params, _n_features: int, n_outputs: int) -> dict[str, Shape]:
    """Shapes of the learnt arrays."""
    count = 1 + DEGREE + len(params["widths"])
    known: dict[str, Shape] = {
        "angle": (count,), "drive": (count,), "scale": (1,), "misfit": (2,), "dt": (1,)
    }  # fmt: skip
    return only_joint("friction_filter", known, n_outputs)


def _pack(params: Params, arrays: Mapping[str, Array], _k: int, _n: int) -> Memory:
    elements = len(params["widths"])
    return LAYOUT.pack(
        elements=elements,
        drive_factor=params["wheel_radius"] / params["gear_ratio"],
        inverse_scale=arrays["scale"][0],
        misfit=arrays["misfit"][1],
        angle=arrays["angle"],
        filter=friction_filter(params, arrays).memory(*friction_prior(elements)),
    )


FAMILY: Final = Family(
    "friction_filter",
    rules={
        **dict.fromkeys(("load_drift", "friction_drift", "error_time"), POSITIVE),
        **dict.fromkeys(("drive_stiffness", "gear_ratio", "wheel_radius", "jaw_radius"), POSITIVE),
        "widths": numbers(16, 1e-9, 1.0, "lengths [m]"),
    },
    shapes=shapes,
    pack=_pack,
    row=friction_filter_row,
    remembers=True,
    inputs=lambda _params: (MOTOR, RESET),
    targets=("position",),
    states_deviation=lambda _params: True,
)
