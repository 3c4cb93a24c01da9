"""What the filter with friction and load in its state is made of.

Slider, cables and jaw hold friction that depends on which way they last moved. A few elastoplastic
elements, each a bristle that bends with the reset cable's motion until it slides, stand for it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from truejoint.compiled import compiled
from truejoint.errors import CalibrationError
from truejoint.filters import UnscentedFilter
from truejoint.filters.state_space import StateSpaceModel
from truejoint.models.families import is_number

Array = NDArray[np.float64]

DEGREE: Final = 4
"""Highest power of ``x2`` in both polynomials."""

_LARGEST: Final = 1e30


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
def measurement(x: Array, u: Array, parameters: Array, out: Array) -> None:
    """Drive cable's displacement [m] where the reset cable's is ``u[1]`` [m].

    `parameters` goes on with the inverse scale, constant and powers of a polynomial, a weight for
    each element, and the drive cable's stretch per load [m/Nm].
    """
    n = int(parameters[0])
    place = u[1] * parameters[1 + n]
    total = parameters[2 + n]
    power = 1.0
    for i in range(DEGREE):
        power *= place
        total += parameters[3 + n + i] * power
    for i in range(n):
        total += parameters[3 + n + DEGREE + i] * x[i]
    out[0] = total + parameters[3 + 2 * n + DEGREE] * x[n]


@compiled
def process_noise(_x: Array, _u: Array, dt: float, parameters: Array, out: Array) -> None:
    """Random walks: the last two parameters are variances per second of elements and load."""
    n = int(parameters[0])
    for i in range(n):
        out[i, i] = parameters[4 + 2 * n + DEGREE] * dt
    out[n, n] = parameters[5 + 2 * n + DEGREE] * dt


def friction_filter(params: Mapping[str, Any], arrays: Mapping[str, Array]) -> UnscentedFilter:
    """Build the filter of a fitted `FrictionFilter`, of its parameters and arrays.

    Raises
    ------
    CalibrationError, FilterError
        If an array makes no sense.
    """
    for name in ("scale", "misfit", "interval"):
        if not all(is_number(value, 1.0 / _LARGEST, _LARGEST) for value in arrays[name]):
            raise CalibrationError(f"ukf_friction: {name} is not above 0; fit it again")
    widths = params["widths"]
    n = len(widths)
    parameters = np.concatenate(
        [
            [float(n)],
            widths,
            arrays["scale"],
            arrays["drive"],
            [-1.0 / (params["drive_stiffness"] * params["jaw_radius"])],
            [params["friction_drift"] ** 2, params["load_drift"] ** 2],
        ]
    )
    # A misfit that lasts for a time tells in each row what it told in the row before.
    repeated = max(params["error_time"] / float(arrays["interval"][0]), 1.0)
    model = StateSpaceModel(
        transition=transition,
        measurement=measurement,
        process_noise=process_noise,
        measurement_noise=[[arrays["misfit"][0] ** 2 * repeated]],
        states=(*(f"friction_{i}" for i in range(n)), "load"),
        measurements=("drive",),
        inputs=("reset_motion", "reset"),
        parameters=parameters,
    )
    return UnscentedFilter(model)


def friction_prior(elements: int) -> tuple[Array, Array]:
    """Mean (n + 1,) and covariance (n + 1, n + 1) before the first row.

    At rest and unloaded, with friction anywhere within half of what it can hold.
    """
    return np.zeros(elements + 1), np.diag([*([0.25] * elements), 1e-8])
