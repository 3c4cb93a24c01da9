"""Factors of covariances, healthy and rank-deficient."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from truejoint.filters.factors import combine, outer_sum, semidefinite_cholesky, solve_rows, wrap


def random_stack(seed: int, rows: int, size: int, rank: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    scales = 10.0 ** rng.uniform(-4, 4, size)
    return rng.normal(size=(rows, rank)) @ rng.normal(size=(rank, size)) * scales


shapes = st.tuples(st.integers(0, 2**31), st.integers(1, 6), st.integers(1, 6), st.integers(0, 8))


def close(one: np.ndarray, two: np.ndarray, tolerance: float) -> bool:
    """Equal relative to the variances of `two`, so that scales do not matter."""
    scale = np.sqrt(np.outer(np.diag(two), np.diag(two)))
    return bool(np.all(np.abs(one - two) <= tolerance * scale + 1e-300))


@given(shapes)
def test_a_factor_gives_the_covariance_at_any_rank(shape) -> None:
    seed, size, rank, extra = shape
    stack = random_stack(seed, size + extra, size, rank)
    covariance, factor = (np.full((size, size), np.nan) for _ in range(2))
    outer_sum(stack, len(stack), size, covariance)
    assert close(covariance, stack.T @ stack, 1e-13)
    np.testing.assert_array_equal(covariance, covariance.T)
    assert semidefinite_cholesky(covariance, size, factor)
    assert close(factor @ factor.T, covariance, 1e-6)
    assert np.all(np.diag(factor) >= 0.0)
    np.testing.assert_array_equal(np.triu(factor, 1), 0.0)


@pytest.mark.parametrize(
    "matrix",
    [
        [[1.0, 0.0], [0.0, -1e-3]],
        [[1.0, 2.0], [2.0, 1.0]],
        [[0.0, 1.0], [1.0, 1.0]],
        [[np.nan, 0.0], [0.0, 1.0]],
        [[1.0, np.nan], [np.nan, 1.0]],
    ],
)
def test_what_is_no_covariance_is_named(matrix) -> None:
    factor = np.empty((2, 2))
    assert not semidefinite_cholesky(np.array(matrix), 2, factor)


def test_impossible_difference_is_left_out() -> None:
    stack = np.array([[1.0, 0.5], [0.0, 1.0], [0.2, 0.2]])
    wanted = stack.T @ stack
    covariance, factor = np.empty((2, 2)), np.empty((2, 2))
    assert combine(stack.copy(), 3, 2, np.array([0.1, 0.3]), -1.0, covariance, factor)
    np.testing.assert_allclose(covariance, wanted - np.outer([0.1, 0.3], [0.1, 0.3]), rtol=1e-12)
    np.testing.assert_allclose(factor @ factor.T, covariance, rtol=1e-12)
    assert not combine(stack.copy(), 3, 2, np.array([5.0, 0.3]), -1.0, covariance, factor)
    np.testing.assert_allclose(covariance, wanted, rtol=1e-12)
    np.testing.assert_allclose(factor @ factor.T, wanted, rtol=1e-12)


@given(shapes)
def test_solutions_solve(shape) -> None:
    seed, size, _, extra = shape
    rng = np.random.default_rng(seed)
    factor = np.tril(rng.uniform(-1, 1, (size, size)), -1) + np.diag(rng.uniform(0.5, 2.0, size))
    right = rng.normal(size=(extra + 1, size))
    solution = right.copy()
    solve_rows(factor, size, solution, extra + 1)
    np.testing.assert_allclose(solution @ (factor @ factor.T), right, atol=1e-9)


def test_direction_without_information_gets_zero() -> None:
    solution = np.array([[3.0, 2.0]])
    solve_rows(np.array([[0.0, 0.0], [0.0, 2.0]]), 2, solution, 1)
    np.testing.assert_array_equal(solution, [[0.0, 0.5]])


@given(st.floats(-1e6, 1e6))
def test_wrapped_angle_is_the_same_direction(angle: float) -> None:
    wrapped = wrap(angle)
    assert -math.pi <= wrapped <= math.pi
    assert math.cos(wrapped) == pytest.approx(math.cos(angle), abs=1e-9)
    assert math.sin(wrapped) == pytest.approx(math.sin(angle), abs=1e-9)
    if -math.pi < angle <= math.pi:
        assert wrapped == angle


@pytest.mark.parametrize("angle", [math.pi, -math.pi, 3 * math.pi, 1e300, -1e300, 0.0, 5e-324])
def test_wrap_at_its_edges(angle: float) -> None:
    assert -math.pi <= wrap(angle) <= math.pi
