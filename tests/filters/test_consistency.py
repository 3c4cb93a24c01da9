"""Whether the filter's stated covariance is true, over independent runs of a bent model."""

from dataclasses import replace
from pathlib import Path

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


def test_overconfident_filter_is_found_out() -> None:
    """The check above can fail: a filter told half the noise lies outside the bounds."""
    right = model()
    wrong = replace(right, process_noise=Q / 4, measurement_noise=R / 4)
    estimator = UnscentedFilter(wrong)
    values = []
    for run in range(20):
        mean, u, truth, z = simulate(2000 + run)
        result = estimator.run(z, u, x0=mean, P0=P0, dt=DT)
        values.append(normalised((truth - result.x)[-100:], result.P[-100:]))
    assert np.mean(values) > scipy.stats.chi2.ppf(0.999, 20 * 4) / 20


def test_smoothing_helps() -> None:
    mean, u, truth, z = simulate(7)
    estimator = UnscentedFilter(model())
    result = estimator.run(z, u, x0=mean, P0=P0, dt=DT)
    after = estimator.smooth(result)
    assert np.all(np.linalg.eigvalsh(result.P - after.P)[:-1].min(axis=1) > -1e-9)
    assert np.all(np.std(truth - after.x, axis=0) < 0.9 * np.std(truth - result.x, axis=0))
    np.testing.assert_array_equal(after.x[-1], result.x[-1])


@njit
def unicycle(x, u, dt, parameters, out):
    turn = 0.5 * dt * u[0]
    out[0] = x[0] + dt * (u[1] * np.cos(x[2] + turn) - u[2] * np.sin(x[2] + turn))
    out[1] = x[1] + dt * (u[1] * np.sin(x[2] + turn) + u[2] * np.cos(x[2] + turn))
    out[2] = x[2] + dt * u[0]


@njit
def position(x, u, parameters, out):
    out[0] = x[0]
    out[1] = x[1]


def test_wheeled_robot_with_rare_positions(reference: Path) -> None:
    """Real odometry and gyro, with a position to 10 cm every second: heading is never measured."""
    t, gyro, vx, vy, theta, px, py = np.loadtxt(
        reference / "ukfm_wifibot2.txt", skiprows=1, unpack=True
    )
    robot = StateSpaceModel(
        unicycle,
        position,
        np.diag([2e-6, 2e-6, 1e-6]),
        0.1**2 * np.eye(2),
        states=("x", "y", "heading"),
        measurements=("x", "y"),
        inputs=("turn rate", "forward", "sideways"),
        angles=("heading",),
    )
    z = np.full((len(t), 2), np.nan)
    rng = np.random.default_rng(0)
    z[::50] = np.column_stack([px, py])[::50] + rng.normal(size=(len(z[::50]), 2)) * 0.1
    estimator = UnscentedFilter(robot)
    u = np.column_stack([gyro, vx, vy])
    prior = {"x0": [px[0], py[0], theta[0]], "P0": np.diag([1e-4, 1e-4, 1e-4]), "t": t}
    blind = estimator.run(np.full_like(z, np.nan), u, **prior)
    result = estimator.run(z, u, **prior)
    after = estimator.smooth(result)

    def rms(x: np.ndarray) -> float:
        return float(np.sqrt(np.mean((x[:, 0] - px) ** 2 + (x[:, 1] - py) ** 2)))

    heading_error = np.angle(np.exp(1j * (result.x[:, 2] - theta)))
    assert rms(result.x) < 0.7 * rms(blind.x)
    assert rms(after.x) < rms(result.x) < 0.1
    assert np.sqrt(np.mean(heading_error**2)) < np.radians(5.0)
    assert np.all(np.abs(result.x[:, 2]) <= np.pi)
