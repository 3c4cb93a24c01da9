"""Weights of the sigma points."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from truejoint.filters.state_space import FilterError, ScaledSigmaPoints


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


def test_the_form_of_the_paper_is_the_scaled_form_with_one_alpha() -> None:
    assert ScaledSigmaPoints(1.0, 0.0, -1.0).reach(4) == pytest.approx(np.sqrt(3.0))
    assert ScaledSigmaPoints(1.0, 0.0, -1.0).centre_correction == -1.0


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
