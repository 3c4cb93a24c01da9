"""Models at the door, and the weights of sigma points."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numba import njit
from tests.filters.test_faults import seen, still

from truejoint.filters import FilterError, ScaledSigmaPoints, StateSpaceModel
from truejoint.filters.state_space import check_covariance


def arguments(**changes):
    return {
        "transition": still,
        "measurement": seen,
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


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"transition": 3.0}, "transition: 3.0 is no function"),
        ({"transition": past_the_end}, "transition: index 1 is out of bounds"),
        ({"transition": reads_a_missing_input}, "transition: index 0 is out of bounds"),
        ({"transition": three_arguments}, "transition: numba cannot compile it"),
        ({"transition": cannot_compile}, "transition: numba cannot compile it"),
        (
            {"transition": still, "states": ("x", "y"), "process_noise": np.eye(2)},
            "transition: it does not write element 1",
        ),
        ({"measurement": still}, "measurement: numba cannot compile it"),
        ({"process_noise": [[-1.0]]}, "process noise: variance -1"),
        ({"process_noise": np.eye(2)}, "process noise: shape"),
        ({"process_noise": seen}, "process noise: numba cannot compile it"),
        ({"measurement_noise": [[np.inf]]}, "measurement noise: holds NaN, infinity"),
        ({"measurement_noise": [["a"]]}, "measurement noise: .*; give numbers"),
        ({"states": "x"}, "states 'x': give a tuple"),
        ({"states": ()}, "at least one state"),
        ({"states": ("x", "x")}, "different names"),
        ({"angles": ("w",)}, r"angles \['w'\]: neither"),
        ({"parameters": [[1.0]]}, r"parameters: shape is \(1, 1\)"),
        ({"possible": {"jaw": (0.0, 1.0)}}, "possible 'jaw': .*; give the lowest and the highest"),
        ({"possible": {"x": (1.0, 1.0)}}, "possible 'x': .*; give the lowest and the highest"),
        ({"possible": {"z": (np.nan, 1.0)}}, "possible 'z': .*; give the lowest and the highest"),
        ({"longest_step": 0.0}, "longest step is 0"),
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


def test_rounding_in_a_covariance_is_forgiven_and_taken_off() -> None:
    given = np.array([[1.0, 1.0 + 1e-12], [1.0, 1.0]])
    checked = check_covariance(given, 2, "P0")
    np.testing.assert_array_equal(checked, checked.T)
    np.testing.assert_allclose(checked, given, atol=1e-11)
    tiny = check_covariance(np.diag([1e-30, 1e30]), 2, "P0")
    np.testing.assert_array_equal(tiny, np.diag([1e-30, 1e30]))


@given(
    alpha=st.floats(0.05, 2.0),
    beta=st.floats(0.0, 3.0),
    kappa=st.floats(-0.9, 5.0),
    size=st.integers(1, 6),
    seed=st.integers(0, 1000),
)
def test_rearranged_sums_are_the_weighted_sums(alpha, beta, kappa, size, seed) -> None:
    """Against mean and covariance with Wan and van der Merwe's weights, centre included."""
    rng = np.random.default_rng(seed)
    images = rng.normal(size=(2 * size + 1, 3))
    lambda_ = alpha**2 * (size + kappa) - size
    weights = np.full(2 * size + 1, 0.5 / (size + lambda_))
    weights[0] = lambda_ / (size + lambda_)
    mean = weights @ images
    weights[0] += 1 - alpha**2 + beta
    covariance = (images - mean).T * weights @ (images - mean)
    points = ScaledSigmaPoints(alpha, beta, kappa)
    w = 0.5 / points.reach(size) ** 2
    differences = images[1:] - images[0]
    mu = w * differences.sum(axis=0)
    scale = w * 10 + 10
    np.testing.assert_allclose(images[0] + mu, mean, atol=1e-11 * scale)
    rearranged = w * differences.T @ differences + points.centre_correction * np.outer(mu, mu)
    np.testing.assert_allclose(rearranged, covariance, atol=1e-11 * scale**2)


@pytest.mark.parametrize(
    "make",
    [
        lambda: ScaledSigmaPoints(0.0),
        lambda: ScaledSigmaPoints(np.nan),
        lambda: ScaledSigmaPoints(beta=np.inf),
        lambda: ScaledSigmaPoints(kappa=-4.0).reach(4),
        lambda: ScaledSigmaPoints(kappa=np.nan),
    ],
)
def test_settings_without_meaning_are_refused(make) -> None:
    with pytest.raises(FilterError):
        make()
