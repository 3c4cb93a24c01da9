"""Whether the filter's stated covariance is true, over independent runs of a bent model."""

import numpy as np
import pytest
import scipy.stats
from numba import njit

from truejoint.filters import UnscentedFilter
from truejoint.filters.state_space import ScaledSigmaPoints, StateSpaceModel

RUNS, ROWS, DT = 50, 400, 0.01
Q = np.diag([1e-6, 4e-4, 1e-6, 4e-4])
R = np.diag([1e-3, 4e-3])
P0 = np.diag([0.01, 0.04, 0.01, 0.04])


@njit
def coupled_pendulums(x, u, dt, parameters, out):
    gravity, spring, damping = parameters
    stretch = x[2] - x[0]
    pull = spring * (stretch + 0.3 * np.sin(4.0 * stretch))
    out[1] = x[1] + dt * (u[0] + pull - gravity * np.sin(x[0]) - damping * x[1])
    out[3] = x[3] + dt * (-pull - gravity * np.sin(x[2]) - damping * x[3])
    # The new speed moves the old place: this keeps the energy where Euler's method adds to it.
    out[0] = x[0] + dt * out[1]
    out[2] = x[2] + dt * out[3]


@njit
def height_and_speed(x, u, parameters, out):
    out[0] = np.sin(x[2])
    out[1] = x[3] * np.cos(x[2])


def model() -> StateSpaceModel:
    return StateSpaceModel(
        coupled_pendulums,
        height_and_speed,
        Q,
        R,
        states=("driver", "driver rate", "jaw", "jaw rate"),
        measurements=("height", "speed"),
        inputs=("torque",),
        parameters=(9.81, 20.0, 0.3),
    )


def simulate(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    mean = np.array([0.4, 0.0, 0.2, 0.0])
    x = rng.multivariate_normal(mean, P0)
    u = 3.0 * np.sin(2 * np.pi * 0.7 * DT * np.arange(ROWS))[:, None]
    truth, z = np.empty((ROWS, 4)), np.empty((ROWS, 2))
    for k in range(ROWS):
        after = np.empty(4)
        coupled_pendulums(x, u[k], DT, np.array([9.81, 20.0, 0.3]), after)
        x = truth[k] = after + rng.normal(size=4) * np.sqrt(np.diag(Q))
        height_and_speed(x, u[k], np.empty(0), z[k])
    return mean, u, truth, z + rng.normal(size=z.shape) * np.sqrt(np.diag(R))


def normalised(error: np.ndarray, P: np.ndarray) -> np.ndarray:
    """Squares (rows,) of errors in what their covariances state."""
    return np.einsum("ki,ki->k", error, np.linalg.solve(P, error[..., None])[..., 0])


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"sigma_points": ScaledSigmaPoints(1.0, 0.0, -1.0)},
        {"sigma_points": ScaledSigmaPoints(0.5), "gate": 0.99999},
    ],
)
def test_nees_and_nis_within_their_chi_square_bounds(options: dict) -> None:
    estimator = UnscentedFilter(model(), **options)
    nees, nis, smoothed_nees = (np.empty((RUNS, ROWS)) for _ in range(3))
    for run in range(RUNS):
        mean, u, truth, z = simulate(1000 + run)
        result = estimator.run(z, u, x0=mean, P0=P0, dt=DT)
        after = estimator.smooth(result)
        nees[run], nis[run] = normalised(truth - result.x, result.P), result.nis
        smoothed_nees[run] = normalised(truth - after.x, after.P)
    for values, degrees in ((nees, 4), (nis, 2), (smoothed_nees, 4)):
        low, high = scipy.stats.chi2.ppf([0.025, 0.975], RUNS * degrees) / RUNS
        average = values.mean(axis=0)
        # 95 % of the instants for a consistent filter, but neighbours in time are alike: with few
        # independent instants in a record the share itself spreads by several percent.
        assert np.mean((low < average) & (average < high)) > 0.8
        # And all instants together.
        assert low < average.mean() < high
