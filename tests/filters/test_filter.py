"""The filter and the smoother against other people's, and against a Kalman filter written here."""

from pathlib import Path

import numpy as np
import pytest
import scipy.io
import scipy.stats
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from numba import njit
from tests.filters.linear import linear_model

from truejoint.filters import UnscentedFilter
from truejoint.filters.fields import FilterStatus
from truejoint.filters.state_space import FilterError, ScaledSigmaPoints, StateSpaceModel

POINTS = (
    ScaledSigmaPoints(),
    ScaledSigmaPoints(0.3, 1.5, 1.0),
    ScaledSigmaPoints(1.0, 0.0, -0.5),
    ScaledSigmaPoints(1.0, 0.0, 3.0),
)


@pytest.mark.parametrize("points", POINTS)
def test_robot_reference_of_matlab(reference: Path, points: ScaledSigmaPoints) -> None:
    data = scipy.io.loadmat(reference / "pykalman_robot.mat")
    # The offset b[k] of each step enters as control input; d is taken off the measurements.
    model = linear_model(data["A"], np.eye(5), data["C"], data["Q"], data["R"])
    estimator = UnscentedFilter(model, points)
    z = (data["y"] - data["d"]).T
    result = estimator.run(z, data["b"].T, x0=data["x0"].ravel(), P0=data["V_0"], dt=1.0)
    smoothed = estimator.smooth(result)
    filtered_P, smoothed_P = np.stack(data["Vfilt"][0]), np.stack(data["Vsmooth"][0])
    assert not result.status.any()
    for ours, theirs in (
        (result.x, data["xfilt"].T[1:]),
        (result.P, filtered_P[1:]),
        (smoothed.x, data["xsmooth"].T[1:]),
        (smoothed.P, smoothed_P[1:]),
        (smoothed.x0, data["xsmooth"][:, 0]),
        (smoothed.P0, smoothed_P[0]),
    ):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("points", POINTS[::2])
def test_missing_values_like_kfas(reference: Path, points: ScaledSigmaPoints) -> None:
    table = np.genfromtxt(reference / "statsmodels_macrodata.csv", delimiter=",", names=True)
    theirs = np.genfromtxt(
        reference / "statsmodels_results_smoothing_R.csv", delimiter=",", names=True
    )
    z = np.column_stack([np.diff(table[c]) for c in ("realgdp", "realcons", "realinv")])
    z[:50, 0] = z[19:70, 1] = z[39:90, 2] = z[119:130, ::2] = np.nan
    eye = np.eye(3)
    estimator = UnscentedFilter(linear_model(eye, np.zeros((3, 0)), eye, eye, eye), points)
    time = np.arange(len(z), dtype=float)
    result = estimator.run(z, x0=np.zeros(3), P0=1e6 * eye, t=time)
    smoothed = estimator.smooth(result)

    def columns(stem: str) -> np.ndarray:
        return np.column_stack([theirs[f"{stem}{i}"] for i in (1, 2, 3)])

    missing = np.isnan(z)
    wanted = np.where(missing.all(axis=1), int(FilterStatus.MISSING), int(FilterStatus.PARTIAL))
    np.testing.assert_array_equal(result.status, np.where(missing.any(axis=1), wanted, 0))
    # R wrote 15 digits; the variance of 1e6 leaves about 1e-9 of them in numbers of order 1.
    np.testing.assert_allclose(result.innovation, columns("v"), rtol=1e-9, atol=1e-8)
    np.testing.assert_allclose(result.x, columns("a"), rtol=1e-9, atol=1e-8)
    np.testing.assert_allclose(smoothed.x, columns("alphahat"), rtol=1e-9, atol=1e-8)
    # T = Q = I: the covariance predicted for the next row is this row's plus I.
    np.testing.assert_allclose(np.linalg.det(result.P + eye), theirs["detP"], rtol=1e-9)
    np.testing.assert_allclose(np.linalg.det(smoothed.P), theirs["detV"], rtol=1e-8)


def kalman(A, B, C, Q, R, z, u, x, P):
    """Textbook Kalman filter and Rauch-Tung-Striebel smoother on dense matrices."""
    filtered, predicted, scores = [(x, P)], [], []
    for row, control in zip(z, u, strict=True):
        x, P = A @ x + B @ control, A @ P @ A.T + Q
        predicted.append((x, P))
        there = ~np.isnan(row)
        nis = loglik = 0.0
        if there.any():
            H, S = C[there], C[there] @ P @ C[there].T + R[np.ix_(there, there)]
            innovation = row[there] - H @ x
            gain = np.linalg.solve(S, H @ P).T
            x, P = x + gain @ innovation, P - gain @ S @ gain.T
            P = 0.5 * (P + P.T)
            nis = innovation @ np.linalg.solve(S, innovation)
            loglik = scipy.stats.multivariate_normal.logpdf(innovation, cov=S)
        scores.append((nis, loglik))
        filtered.append((x, P))
    smoothed = [filtered[-1]]
    for (x, P), (ahead_x, ahead_P) in zip(filtered[-2::-1], predicted[::-1], strict=True):
        gain = np.linalg.solve(ahead_P, A @ P).T
        later_x, later_P = smoothed[0]
        smoothed.insert(
            0, (x + gain @ (later_x - ahead_x), P + gain @ (later_P - ahead_P) @ gain.T)
        )
    return filtered, smoothed, scores


def random_covariance(rng: np.random.Generator, n: int) -> np.ndarray:
    orthogonal = np.linalg.qr(rng.normal(size=(n, n)))[0]
    return (orthogonal * rng.uniform(0.1, 2.0, n)) @ orthogonal.T


@hypothesis_settings(max_examples=60)
@given(
    n=st.integers(1, 5),
    m=st.integers(1, 4),
    p=st.integers(0, 2),
    missing=st.sampled_from([0.0, 0.3, 0.9]),
    known_start=st.booleans(),
    points=st.sampled_from(POINTS),
    seed=st.integers(0, 2**32 - 1),
)
def test_linear_model_is_the_kalman_filter(n, m, p, missing, known_start, points, seed) -> None:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    A /= max(1.0, np.abs(np.linalg.eigvals(A)).max())
    B, C = rng.normal(size=(n, p)), rng.normal(size=(m, n))
    Q, R = random_covariance(rng, n), random_covariance(rng, m)
    z, u = rng.normal(size=(25, m)), rng.normal(size=(25, p))
    z[rng.random(z.shape) < missing] = np.nan
    x0 = rng.normal(size=n)
    P0 = np.zeros((n, n)) if known_start else random_covariance(rng, n)
    estimator = UnscentedFilter(linear_model(A, B, C, Q, R), points)
    result = estimator.run(z, u, x0=x0, P0=P0, dt=1.0)
    after = estimator.smooth(result)
    filtered, smoothed, scores = kalman(A, B, C, Q, R, z, u, x0, P0)
    close = {"rtol": 1e-10, "atol": 1e-10}
    np.testing.assert_allclose(result.x, [x for x, _ in filtered[1:]], **close)
    np.testing.assert_allclose(result.P, [P for _, P in filtered[1:]], **close)
    np.testing.assert_allclose(np.nan_to_num(result.nis), [s for s, _ in scores], **close)
    np.testing.assert_allclose(result.loglik, [s for _, s in scores], **close)
    np.testing.assert_allclose([after.x0, *after.x], [x for x, _ in smoothed], **close)
    np.testing.assert_allclose([after.P0, *after.P], [P for _, P in smoothed], **close)


@njit
def bent(x, u, dt, parameters, out):
    out[0] = x[0] + dt * x[1]
    out[1] = x[1] + dt * (u[0] - parameters[0] * np.sin(x[0]) - 0.2 * x[1])


@njit
def squared(x, u, parameters, out):
    out[0] = x[0] * x[0]
    out[1] = np.cos(x[0]) + 0.1 * x[1]


def bent_model() -> StateSpaceModel:
    return StateSpaceModel(
        bent, squared, np.diag([1e-4, 1e-3]), np.diag([1e-2, 1e-3]), states=("angle", "speed"),
        measurements=("square", "cosine"), inputs=("torque",), parameters=(5.0,),
    )  # fmt: skip


def bent_record(rows: int = 300) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(5)
    u = rng.normal(size=(rows, 1))
    dt = rng.uniform(0.005, 0.03, rows)
    x, z = np.array([1.0, 0.0]), np.empty((rows, 2))
    for k in range(rows):
        after = np.empty(2)
        bent.py_func(x, u[k], dt[k], (5.0,), after)
        x = after + rng.normal(size=2) * [1e-2, 0.03]
        squared.py_func(x, u[k], (), z[k])
    return z + rng.normal(size=(rows, 2)) * [0.1, 0.03], u, dt


def test_paper_weights_by_hand() -> None:
    """One scalar step with f = sin, h = square, worked through (15)-(23) with explicit weights."""
    x, P, Q, R, z, lambda_ = 0.7, 0.04, 0.01, 0.02, 0.5, 2.0
    weights = np.array([lambda_ / (1 + lambda_), 0.5 / (1 + lambda_), 0.5 / (1 + lambda_)])
    chi = np.sin(x + np.sqrt((1 + lambda_) * P) * np.array([0.0, -1.0, 1.0]))
    mean = weights @ chi
    predicted = weights @ (chi - mean) ** 2 + Q
    chi = mean + np.sqrt((1 + lambda_) * predicted) * np.array([0.0, -1.0, 1.0])
    zeta = chi**2
    z_mean = weights @ zeta
    P_zz = weights @ (zeta - z_mean) ** 2 + R
    P_xz = weights @ ((chi - mean) * (zeta - z_mean))

    @njit
    def f(x, u, dt, parameters, out):
        out[0] = np.sin(x[0])

    @njit
    def h(x, u, parameters, out):
        out[0] = x[0] ** 2

    model = StateSpaceModel(f, h, [[Q]], [[R]], states=("x",), measurements=("z",))
    points = ScaledSigmaPoints(1.0, 0.0, lambda_)
    result = UnscentedFilter(model, points).run([z], x0=[x], P0=[[P]], dt=1.0)
    assert result.x[0, 0] == pytest.approx(mean + P_xz / P_zz * (z - z_mean), rel=1e-13)
    assert result.P[0, 0, 0] == pytest.approx(predicted - P_xz**2 / P_zz, rel=1e-12)
    assert result.nis[0] == pytest.approx((z - z_mean) ** 2 / P_zz, rel=1e-12)


def test_single_steps_give_the_bits_of_the_whole_record_and_stamps_stand_for_steps() -> None:
    z, u, dt = bent_record(200)
    dt[0] = 0.0
    z[50:60] = np.nan
    z[70:90, 1] = np.nan
    estimator = UnscentedFilter(bent_model(), gate=0.99, patience=3)
    prior = {"x0": [1.2, 0.0], "P0": np.diag([0.1, 0.1])}
    result = estimator.run(z, u, dt=dt, **prior)
    state = estimator.initial_state(**prior)
    for k in range(len(z)):
        assert estimator.step(state, z[k], u[k], dt[k]) == result.status[k]
        np.testing.assert_array_equal(state.x, result.x[k])
        np.testing.assert_array_equal(state.P, result.P[k])
        np.testing.assert_array_equal(state.innovation, result.innovation[k])
        np.testing.assert_array_equal(state.nis, result.nis[k])
        np.testing.assert_array_equal(state.loglik, result.loglik[k])
    by_stamp = estimator.run(z, u, t=100.0 + np.cumsum(dt), **prior)
    np.testing.assert_allclose(by_stamp.x, result.x, atol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"P0": [[1.0, 0.5], [0.0, 1.0]]}, "P0: not symmetric"),
        ({"P0": [[1.0, 2.0], [2.0, 1.0]]}, "P0: not positive semidefinite"),
        ({"P0": [[0.0, 1.0], [1.0, 1.0]]}, "P0: not"),
        ({"P0": np.diag([1.0, -1.0])}, "P0: variance -1 on the diagonal is negative"),
        ({"P0": np.eye(3)}, r"P0: shape is \(3, 3\), must be \(2, 2\)"),
        ({"P0": [[np.nan, 0], [0, 1]]}, "P0: holds NaN"),
        ({"x0": [1.0]}, r"x0: give 2 finite numbers \(angle, speed\)"),
        ({"x0": [1.0, np.inf]}, "x0: give 2 finite numbers"),
        ({"z": np.zeros((5, 3))}, r"z: shape is \(5, 3\), must be \(rows, 2\)"),
        ({"z": np.zeros((0, 2))}, "z: shape"),
        ({"z": "abc"}, "z: .*; give numbers"),
        ({"u": np.zeros((4, 1))}, r"u: shape is \(4, 1\), must be \(5, 1\)"),
        ({"u": None}, r"u: shape is \(5, 0\), must be \(5, 1\)"),
        ({"dt": 0.0}, "dt is 0.0: give a positive"),
        ({"dt": np.nan}, "dt is nan: give a positive"),
        ({"dt": np.ones(4)}, r"dt: shape is \(4,\)"),
        ({"dt": None}, "give either dt or t"),
        ({"t": np.arange(5.0)}, "give either dt or t"),
        ({"dt": None, "t": np.arange(4.0)}, r"t: shape is \(4,\)"),
    ],
)
def test_record_is_refused_at_the_door(arguments, message) -> None:
    given = {
        "z": np.zeros((5, 2)),
        "u": np.zeros((5, 1)),
        "x0": [0.0, 0.0],
        "P0": np.eye(2),
        "dt": 0.1,
    } | arguments
    with pytest.raises(FilterError, match=message) as caught:
        UnscentedFilter(bent_model()).run(given.pop("z"), given.pop("u"), **given)
    assert "\n" not in str(caught.value)


def test_step_refuses_wrong_lengths_and_strange_states() -> None:
    estimator = UnscentedFilter(bent_model())
    state = estimator.initial_state([0, 0], np.eye(2))
    for z, u in (([1.0], [0.0]), ([1.0, 2.0], [0.0, 0.0]), ([1.0, 2.0], None)):
        with pytest.raises(FilterError):
            estimator.step(state, z, u, 0.01)
    with pytest.raises(FilterError, match="another filter"):
        UnscentedFilter(bent_model()).step(state, [1.0, 2.0], [0.0], 0.01)


def test_settings_are_refused_at_the_door() -> None:
    with pytest.raises(FilterError, match="give a probability between 0 and 1"):
        UnscentedFilter(bent_model(), gate=1.5)
    with pytest.raises(FilterError, match="patience"):
        UnscentedFilter(bent_model(), gate=0.9, patience=-1)
    with pytest.raises(FilterError, match="kappa"):
        UnscentedFilter(bent_model(), ScaledSigmaPoints(1.0, 0.0, -2.0))
    with pytest.raises(FilterError, match="StateSpaceModel"):
        UnscentedFilter(bent)
