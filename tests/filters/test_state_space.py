"""Models at the door."""

import numpy as np
import pytest
from numba import njit

from truejoint.filters import FilterError, StateSpaceModel
from truejoint.filters.state_space import check_covariance, covariance_factor


@njit
def one_state(x, u, dt, parameters, out):
    out[0] = x[0]


@njit
def one_measurement(x, u, parameters, out):
    out[0] = x[0]


def arguments(**changes):
    return {
        "transition": one_state,
        "measurement": one_measurement,
        "process_noise": [[1.0]],
        "measurement_noise": [[1.0]],
        "states": ("x",),
        "measurements": ("z",),
    } | changes


@njit
def past_the_end(x, u, dt, parameters, out):
    out[1] = x[0]


@njit
def reads_a_missing_input(x, u, dt, parameters, out):
    out[0] = x[0] + u[0]


@njit
def three_arguments(x, u, dt):
    return x


@njit
def cannot_compile(x, u, dt, parameters, out):
    out[0] = x[0] + "a"


@njit
def forgets(x, u, dt, parameters, out):
    out[0] = x[0]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"transition": 3.0}, "transition: 3.0 is no function"),
        ({"transition": past_the_end}, "transition: index 1 is out of bounds"),
        ({"transition": reads_a_missing_input}, "transition: index 0 is out of bounds"),
        ({"transition": three_arguments}, "transition: numba cannot compile it"),
        ({"transition": cannot_compile}, "transition: numba cannot compile it"),
        (
            {"transition": forgets, "states": ("x", "y"), "process_noise": np.eye(2)},
            "transition: it does not write element 1",
        ),
        ({"measurement": one_state}, "measurement: numba cannot compile it"),
        ({"process_noise": [[-1.0]]}, "process noise: variance -1"),
        ({"process_noise": np.eye(2)}, "process noise: shape"),
        ({"process_noise": one_measurement}, "process noise: numba cannot compile it"),
        ({"measurement_noise": [[np.inf]]}, "measurement noise: holds NaN, infinity"),
        ({"measurement_noise": [["a"]]}, "measurement noise: .*; give numbers"),
        ({"states": "x"}, "states 'x': give a tuple"),
        ({"states": ()}, "at least one state"),
        ({"states": ("x", "x")}, "different names"),
        ({"angles": ("w",)}, r"angles \['w'\]: neither"),
        ({"parameters": [[1.0]]}, r"parameters: shape is \(1, 1\)"),
    ],
)
def test_model_is_refused_at_the_door(changes, message) -> None:
    with pytest.raises(FilterError, match=message) as caught:
        StateSpaceModel(**arguments(**changes))
    assert "\n" not in str(caught.value)


def test_model_that_zero_breaks_is_accepted() -> None:
    @njit(error_model="numpy")
    def reciprocal(x, u, dt, parameters, out):
        out[0] = 1.0 / x[0]

    StateSpaceModel(**arguments(transition=reciprocal))


def test_factor_of_a_covariance() -> None:
    covariance = check_covariance([[4.0, 2.0], [2.0, 5.0]], 2, "P0")
    np.testing.assert_allclose(covariance_factor(covariance), [[2.0, 0.0], [1.0, 2.0]], rtol=1e-15)
    assert check_covariance(np.zeros((0, 0)), 0, "R").shape == (0, 0)


def test_rounding_in_a_covariance_is_forgiven_and_taken_off() -> None:
    given = np.array([[1.0, 1.0 + 1e-12], [1.0, 1.0]])
    checked = check_covariance(given, 2, "P0")
    np.testing.assert_array_equal(checked, checked.T)
    np.testing.assert_allclose(checked, given, atol=1e-11)
    tiny = check_covariance(np.diag([1e-30, 1e30]), 2, "P0")
    np.testing.assert_array_equal(tiny, np.diag([1e-30, 1e30]))
