"""Linear models, and their exact discretisation."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given
from hypothesis import strategies as st

from truejoint.filters.linear import (
    discretise,
    linear_measurement,
    linear_model,
    linear_transition,
    van_loan,
)
from truejoint.filters.sigma_points import FilterError


def test_linear_functions_are_the_matrix_products() -> None:
    rng = np.random.default_rng(0)
    A, B, C, D = (rng.normal(size=shape) for shape in ((3, 3), (3, 2), (4, 3), (4, 2)))
    model = linear_model(
        A, B, C, D, np.eye(3), np.eye(4),
        states=("a", "b", "c"), measurements=("w", "x", "y", "z"), inputs=("u", "v"),
    )  # fmt: skip
    x, u, after, z = rng.normal(size=3), rng.normal(size=2), np.empty(3), np.empty(4)
    linear_transition(x, u, 1.0, model.parameters, after)
    model.measurement(x, u, model.parameters, z)
    np.testing.assert_allclose(after, A @ x + B @ u, rtol=1e-13)
    np.testing.assert_allclose(z, C @ x + D @ u, rtol=1e-13)
    linear_measurement(x, u, model.parameters, z)
    np.testing.assert_allclose(z, C @ x, rtol=1e-13)
    with pytest.raises(FilterError, match=r"C: shape is \(3, 3\), must be \(1, 3\)"):
        linear_model(A, B, A, D, np.eye(3), [[1.0]], states=("a", "b", "c"),
                     measurements=("z",), inputs=("u", "v"))  # fmt: skip


@given(seed=st.integers(0, 10_000), n=st.integers(1, 4), dt=st.sampled_from([0.0, 1e-3, 0.2, 2.0]))
def test_discretisation_against_quadrature(seed: int, n: int, dt: float) -> None:
    rng = np.random.default_rng(seed)
    A, B = rng.normal(size=(n, n)), rng.normal(size=(n, 2))
    root = rng.normal(size=(n, n))
    nodes, weights = np.polynomial.legendre.leggauss(24)
    at = 0.5 * dt * (nodes + 1.0)
    flows = [scipy.linalg.expm(A * s) for s in at]
    by_input = sum(0.5 * dt * w * F @ B for w, F in zip(weights, flows, strict=True))
    noise = sum(0.5 * dt * w * F @ root @ root.T @ F.T for w, F in zip(weights, flows, strict=True))
    F, G = discretise(A, B, dt)
    again, Q = van_loan(A, root @ root.T, dt)
    scale = max(1.0, np.abs(noise).max())
    np.testing.assert_allclose(F, scipy.linalg.expm(A * dt), rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(again, F, rtol=1e-10, atol=1e-10 * scale)
    np.testing.assert_allclose(G, by_input, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(Q, noise, rtol=1e-10, atol=1e-11 * scale)


def test_stiff_damped_system_keeps_its_digits() -> None:
    """exp(-A dt) of the textbook form overflows here; the stationary variance is density / 2 a."""
    F, Q = van_loan([[-1e6, 0.0], [1.0, -0.5]], np.diag([2.0, 0.0]), 1.0)
    assert F[0, 0] == pytest.approx(0.0, abs=1e-12)
    assert Q[0, 0] == pytest.approx(1e-6, rel=1e-9)


def test_constant_velocity_noise_in_closed_form() -> None:
    F, Q = van_loan([[0.0, 1.0], [0.0, 0.0]], np.diag([0.0, 3.0]), 0.1)
    np.testing.assert_allclose(F, [[1.0, 0.1], [0.0, 1.0]], rtol=1e-14)
    np.testing.assert_allclose(Q, 3.0 * np.array([[1e-3 / 3, 5e-3], [5e-3, 0.1]]), rtol=1e-12)


@pytest.mark.parametrize(
    "call",
    [
        lambda: discretise([[1.0, 2.0]], [[1.0]], 1.0),
        lambda: discretise([[np.nan]], [[1.0]], 1.0),
        lambda: discretise([[1.0]], [[1.0], [2.0]], 1.0),
        lambda: discretise([[1.0]], [1.0], 1.0),
        lambda: van_loan([[1.0]], [[1.0]], -1.0),
        lambda: van_loan([[1.0]], [[1.0]], np.nan),
        lambda: van_loan([[1.0]], [[-1.0]], 1.0),
    ],
)
def test_systems_without_meaning_are_refused(call) -> None:
    with pytest.raises(FilterError):
        call()
