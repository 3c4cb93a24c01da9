"""Bad input, bad models and bad luck: the filter survives each with the status it deserves."""

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit
from tests.filters.linear import linear_model

from truejoint.filters import FilterResult, UnscentedFilter
from truejoint.filters.fields import FilterStatus as Status
from truejoint.filters.state_space import ScaledSigmaPoints, StateSpaceModel

DT = 0.01


@njit
def still(x, u, dt, parameters, out):
    out[0] = x[0]


@njit
def seen(x, u, parameters, out):
    out[0] = x[0]


def one_state(transition, process_noise, measurement_noise, **options) -> StateSpaceModel:
    """A model of one state, which is seen."""
    return StateSpaceModel(
        transition, seen, process_noise, measurement_noise,
        states=("x",), measurements=("z",), **options,
    )  # fmt: skip


def joint(gate: float | None = None, patience: int = 10, angle: bool = False) -> UnscentedFilter:
    """A joint with a constant speed that wanders; position and speed are measured."""
    model = linear_model(
        [[1.0, DT], [0.0, 1.0]], [[0.0], [DT]], np.eye(2),
        np.diag([1e-8, 1e-6]), np.diag([1e-4, 1e-4]), angles=("x0", "z0") if angle else (),
    )  # fmt: skip
    return UnscentedFilter(model, gate=gate, patience=patience)


def record(rows: int = 400, speed: float = 0.5) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    t = DT * np.arange(rows)
    z = np.column_stack([speed * t, np.full(rows, speed)]) + rng.normal(size=(rows, 2)) * 0.01
    return z, speed * t


def run(estimator: UnscentedFilter, z, u=None, dt=DT) -> FilterResult:
    u = np.zeros((len(z), 1)) if u is None else u
    return estimator.run(z, u, x0=[0.0, 0.5], P0=np.diag([1e-2, 1e-2]), dt=dt)


def sound(P: np.ndarray) -> bool:
    """Whether covariances are finite, exactly symmetric and semidefinite up to rounding."""
    if not (np.all(np.isfinite(P)) and np.array_equal(P, np.swapaxes(P, -1, -2))):
        return False
    values = np.linalg.eigvalsh(P)
    return bool(np.all(values[..., 0] >= -1e-12 * values[..., -1]))


def test_encoder_jump_is_gated_and_then_reacquired() -> None:
    z, truth = record()
    z[200:, 0] += 1.0
    result = run(joint(0.9999, 10), z)
    np.testing.assert_array_equal(result.status[:200], 0)
    np.testing.assert_array_equal(result.status[200:210], Status.GATED)
    assert np.isfinite(result.nis[200:210]).all()
    np.testing.assert_array_equal(result.loglik[200:210], 0.0)
    assert result.status[210] == Status.REACQUIRED
    assert result.inflation[210] > 1.0
    np.testing.assert_array_equal(result.status[250:], 0)
    assert np.abs(result.x[205, 0] - truth[205]) < 0.02
    assert np.abs(result.x[250:, 0] - truth[250:] - 1.0).max() < 0.02
    smoothed = joint(0.9999, 10).smooth(result)
    assert sound(smoothed.P)
    # The inflated step counts as a jump: smoothing does not drag it back over the rows before.
    assert np.abs(smoothed.x[:200, 0] - truth[:200]).max() < 0.03


@pytest.mark.parametrize("wrong", [10.0, 1e4, 1e9])
@pytest.mark.parametrize("patience", [0, 5])
def test_gate_cannot_lock_itself_out(wrong: float, patience: int) -> None:
    """A filter that starts far off, sure of itself and without process noise, finds back."""
    model = linear_model([[1.0]], [[]], [[1.0]], [[0.0]], [[1e-4]])
    estimator = UnscentedFilter(model, gate=0.999, patience=patience)
    rng = np.random.default_rng(0)
    z = rng.normal(size=60) * 0.01
    result = estimator.run(z, x0=[wrong], P0=[[1e-12]], dt=DT)
    assert np.abs(result.x[-1, 0]) < 0.05
    assert not result.status[-10:].any()


def test_gate_with_nothing_to_inflate_still_goes_on() -> None:
    model = linear_model([[1.0]], [[]], [[1.0]], [[0.0]], [[1e-4]])
    result = UnscentedFilter(model, gate=0.999, patience=2).run(
        np.ones(9), x0=[0.0], P0=[[0.0]], dt=DT
    )
    # P0 = 0 and Q = 0 say that the state is 0 whatever is measured.
    np.testing.assert_array_equal(result.x, 0.0)
    np.testing.assert_array_equal(result.P, 0.0)
    assert result.status[2] == Status.REACQUIRED


def test_angles_take_the_short_way_round() -> None:
    z, truth = record(2000, speed=3.0)
    wrapped = z.copy()
    wrapped[:, 0] = np.angle(np.exp(1j * z[:, 0]))
    estimator = joint(0.9999, angle=True)
    result = estimator.run(wrapped, np.zeros((2000, 1)), x0=[0.0, 3.0], P0=1e-2 * np.eye(2), dt=DT)
    smoothed = estimator.smooth(result)
    plain = joint().run(z, np.zeros((2000, 1)), x0=[0.0, 3.0], P0=1e-2 * np.eye(2), dt=DT)
    assert truth[-1] > 9 * 2 * np.pi
    for ours, whole in ((result.x, plain.x), (smoothed.x, joint().smooth(plain).x)):
        assert np.all(np.abs(ours[:, 0]) <= np.pi)
        np.testing.assert_allclose(np.exp(1j * ours[:, 0]), np.exp(1j * whole[:, 0]), atol=1e-9)
        np.testing.assert_allclose(ours[:, 1], whole[:, 1], atol=1e-9)
    np.testing.assert_allclose(result.P, plain.P, atol=1e-14)


def test_exact_measurement_of_a_known_state_is_not_used() -> None:
    model = linear_model([[1.0]], [[]], [[1.0]], [[0.0]], [[0.0]])
    result = UnscentedFilter(model).run(np.ones(3), x0=[0.0], P0=[[0.0]], dt=DT)
    np.testing.assert_array_equal(result.status, Status.SINGULAR)
    np.testing.assert_array_equal(result.x, 0.0)


@pytest.mark.parametrize(
    ("fault", "status"),
    [
        ({"dt": np.nan}, Status.INVALID_INPUT),
        ({"dt": -DT}, Status.INVALID_INPUT),
        ({"dt": np.inf}, Status.INVALID_INPUT),
        ({"u": np.nan}, Status.INVALID_INPUT),
        ({"z": [np.nan, np.nan]}, Status.MISSING),
        ({"z": [np.nan, 0.5]}, Status.PARTIAL),
        ({"z": [np.inf, np.nan]}, Status.MISSING | Status.INVALID_MEASUREMENT),
        ({"z": [-np.inf, 0.5]}, Status.PARTIAL | Status.INVALID_MEASUREMENT),
        ({"z": [1e300, 0.5]}, Status.PARTIAL | Status.INVALID_MEASUREMENT),
    ],
)
def test_one_bad_row_is_survived_and_named(fault: dict, status: Status) -> None:
    z, truth = record()
    u, dt = np.zeros((400, 1)), np.full(400, DT)
    z[200] = fault.get("z", z[200])
    u[200] = fault.get("u", 0.0)
    dt[200] = fault.get("dt", DT)
    estimator = joint()
    result = run(estimator, z, u, dt)
    assert result.status[200] == status
    assert not np.delete(result.status, 200).any()
    assert np.abs(result.x[:, 0] - truth).max() < 0.05
    assert sound(result.P)
    smoothed = estimator.smooth(result)
    assert sound(smoothed.P)
    assert np.abs(smoothed.x[:, 0] - truth).max() < 0.05


@njit(error_model="numpy")
def fragile(x, u, dt, parameters, out):
    out[0] = x[0] + dt * x[1] + (np.nan if u[0] > 1.0 else 0.0)
    if u[0] > -1.0:  # below, the second element is never written
        out[1] = x[1]


@njit(error_model="numpy")
def fragile_measurement(x, u, parameters, out):
    out[0] = np.sqrt(x[0]) if u[0] != 0.5 else np.inf


def test_model_functions_that_fail() -> None:
    model = StateSpaceModel(
        fragile, fragile_measurement, 1e-6 * np.eye(2), [[1e-4]],
        states=("x", "v"), measurements=("root",), inputs=("fault",),
    )  # fmt: skip
    estimator = UnscentedFilter(model)
    u = np.zeros((6, 1))
    u[[1, 3, 5], 0] = 2.0, -2.0, 0.5
    result = estimator.run(np.full(6, 2.0), u, x0=[4.0, 0.0], P0=1e-2 * np.eye(2), dt=DT)
    failed = int(Status.TRANSITION_FAILED)
    assert list(result.status) == [0, failed, 0, failed, 0, int(Status.MEASUREMENT_FAILED)]
    assert sound(result.P)
    assert sound(estimator.smooth(result).P)
    # Held state, still corrected by the measurement; its variance grew by the process noise first.
    assert np.abs(result.x[:, 0] - 4.0).max() < 1e-3
    # A square root of a negative point fails; the prediction stands.
    low = estimator.run([0.0], [[0.0]], x0=[0.01, 0.0], P0=np.eye(2), dt=DT)
    assert low.status[0] == Status.MEASUREMENT_FAILED
    assert low.x[0, 0] == pytest.approx(0.01, abs=1e-12)


def test_noise_follows_the_step_and_where_it_fails_the_last_one_is_kept() -> None:
    @njit
    def noise(x, u, dt, parameters, out):
        out[0, 0] = u[0] * dt

    model = one_state(still, noise, [[1.0]], inputs=("density",))
    u, dt = np.array([[2.0], [-1.0], [1e200], [1.0], [1.0]]), np.array([0.5, 1.0, 1.0, 2.0, 0.0])
    result = UnscentedFilter(model).run(np.full(5, np.nan), u, x0=[0.0], P0=[[0.0]], dt=dt)
    np.testing.assert_allclose(result.P[:, 0, 0], [1.0, 2.0, 3.0, 5.0, 5.0])
    bits = result.status & ~int(Status.MISSING)
    assert list(bits) == [0, int(Status.TRANSITION_FAILED), int(Status.INVALID_INPUT), 0, 0]


def test_negative_weights_that_give_no_covariance_are_left_out() -> None:
    @njit
    def bowl(x, u, dt, parameters, out):
        out[0] = x[0] ** 2 + x[1] ** 2
        out[1] = out[0]

    model = StateSpaceModel(
        bowl, seen, np.zeros((2, 2)), [[1.0]], states=("a", "b"), measurements=("z",)
    )
    estimator = UnscentedFilter(model, ScaledSigmaPoints(1.0, 0.0, -1.5))
    result = estimator.run([np.nan], x0=[0.0, 0.0], P0=np.eye(2), dt=DT)
    assert result.status[0] == Status.MISSING | Status.COVARIANCE_REPAIRED
    assert sound(result.P)
    assert result.P[0, 0, 0] > 0.0


@njit(error_model="numpy")
def hostile(x, u, dt, parameters, out):
    """Grows, folds, divides by zero and takes logarithms of whatever it gets."""
    kind = int(abs(u[0]) * 7.0) % 8 if abs(u[0]) < 1e9 else 7
    out[0] = x[0] + dt * x[1]
    out[1] = x[1] + u[1]
    out[2] = x[2]
    if kind == 1:
        out[0] = x[1] / x[2]
    elif kind == 2:
        out[1] = np.exp(x[0])
    elif kind == 3:
        out[2] = np.log(x[2])
    elif kind == 4:
        out[0], out[1], out[2] = x[0] * 1e30, x[1] * -1e25, x[0] * x[1]
    elif kind == 5:
        out[2] = np.sqrt(x[0])
    elif kind == 6:
        out[0], out[1], out[2] = 0.0, 0.0, 0.0
    elif kind == 7:
        out[0], out[1], out[2] = np.sin(x[0]), np.cos(x[1]), 1e-300 * x[2]


@njit(error_model="numpy")
def hostile_measurement(x, u, parameters, out):
    out[0] = x[0] * x[1] if abs(u[1]) < 5.0 else np.exp(x[0])
    out[1] = x[2] / (x[0] if u[0] > 0.0 else 1.0)


@njit(error_model="numpy")
def hostile_noise(x, u, dt, parameters, out):
    out[0, 0] = abs(u[0]) * dt
    out[1, 1] = u[1]
    out[2, 2] = x[2]
    out[0, 1] = out[1, 0] = 0.1 * u[0]


def garbage(rng: np.random.Generator, shape: tuple[int, ...], usual: float) -> np.ndarray:
    """Mostly plausible numbers, and every kind of number that breaks things."""
    values = rng.normal(size=shape) * usual
    odd = np.array(
        [np.nan, np.inf, -np.inf, 0.0, 1e308, -1e308, 1e155, 1e99, 5e-324, -1e-200, 1e-9]
    )
    which = rng.random(shape)
    values = np.where(which < 0.1, rng.choice(odd, size=shape), values)
    with np.errstate(over="ignore", invalid="ignore"):
        return np.where(which > 0.95, values * 10.0 ** rng.uniform(-30, 30, shape), values)


@settings(max_examples=20)
@given(
    seed=st.integers(0, 2**32 - 1),
    gate=st.sampled_from([(None, 10), (0.99, 3), (0.5, 0)]),
    points=st.sampled_from([(), (1.0, 0.0, -2.0), (1e-3,)]),
    angles=st.sampled_from([(), ("a", "y"), ("a", "b", "c", "y", "z")]),
    constant_noise=st.booleans(),
)
def test_many_steps_of_garbage(seed, gate, points, angles, constant_noise) -> None:
    """Twenty draws of 10 000 steps: the state stays finite and its covariance a covariance."""
    rng = np.random.default_rng(seed)
    model = StateSpaceModel(
        hostile,
        hostile_measurement,
        np.diag([1e-6, 1e-3, 1e-9]) if constant_noise else hostile_noise,
        np.diag([1e-4, 1e-2]),
        states=("a", "b", "c"),
        measurements=("y", "z"),
        inputs=("kind", "kick"),
        angles=angles,
    )
    estimator = UnscentedFilter(model, ScaledSigmaPoints(*points), *gate)
    rows = 10_000
    result = estimator.run(
        garbage(rng, (rows, 2), 1.0),
        garbage(rng, (rows, 2), 1.0),
        x0=rng.normal(size=3),
        P0=np.diag([1.0, 0.0, 1e-6]),
        dt=garbage(rng, (rows,), 0.01),
    )
    assert np.all(np.isfinite(result.x))
    assert sound(result.P)
    smoothed = estimator.smooth(result)
    assert np.all(np.isfinite(smoothed.x))
    assert sound(smoothed.P)


def bounded() -> UnscentedFilter:
    """The joint, with what is possible of it."""
    free = joint().model
    possible = {"x0": (-10.0, 10.0), "z0": (-10.0, 10.0), "u0": (-5.0, 5.0)}
    return UnscentedFilter(replace(free, possible=possible, longest_step=0.5))


def test_what_is_not_possible_is_left_out_and_does_not_last() -> None:
    z, truth = record()
    dt, u = np.full(400, DT), np.zeros((400, 1))
    z[100, 0], u[150], dt[200] = 1e20, 1e20, 1e9
    result = bounded().run(z, u, x0=[0.0, 0.5], P0=np.diag([100.0, 10.0]), dt=dt)
    expected = np.zeros(400, dtype=int)
    expected[100] = Status.PARTIAL | Status.INVALID_MEASUREMENT
    expected[150] = Status.INVALID_INPUT
    expected[200] = Status.RESTARTED
    np.testing.assert_array_equal(result.status, expected)
    assert np.abs(result.x[:, 0] - truth)[10:].max() < 0.04
    # It says how little it knows once it starts anew, and knows it again after forty rows.
    deviation = np.sqrt(result.P[:, 0, 0])
    assert deviation[200] > 3.0 * deviation[199]
    assert deviation[240] < 2.0 * deviation[199]
    assert np.abs(result.x[200:, 0] - truth[200:])[10:].max() < 0.04
    assert sound(bounded().smooth(result).P)


def test_a_state_that_is_not_possible_starts_anew() -> None:
    z, truth = record()
    u = np.zeros((400, 1))
    z[100:110] = np.nan, 1e4  # nobody has said what speed is possible
    result = bounded().run(z, u, x0=[0.0, 0.5], P0=np.diag([100.0, 10.0]), dt=DT)
    assert (result.status[100:120] & int(Status.RESTARTED)).any()
    assert not result.status[120:].any()
    assert np.abs(result.x[120:, 0] - truth[120:]).max() < 0.04


@njit
def picky(x, u, dt, parameters, out):
    if u[0] > 1.0:
        raise ValueError("too much")
    out[0] = x[0] / (1.0 - u[0])


def test_model_functions_that_raise_print_nothing(capfd) -> None:
    model = one_state(picky, [[1e-6]], [[1e-4]], inputs=("u",))
    u = np.array([[0.0], [2.0], [1.0], [0.0]])
    result = UnscentedFilter(model).run(np.ones(4), u, x0=[1.0], P0=[[1.0]], dt=DT)
    failed = int(Status.TRANSITION_FAILED)
    np.testing.assert_array_equal(result.status, [0, failed, failed, 0])
    assert capfd.readouterr() == ("", "")


def test_a_model_is_copied_with_addresses_of_its_own_and_a_state_is_not() -> None:
    estimator = bounded()
    again = pickle.loads(pickle.dumps(estimator))  # noqa: S301  # our own
    z, _ = record(50)
    np.testing.assert_array_equal(run(again, z).x, run(estimator, z).x)
    state = estimator.initial_state([0.0, 0.5], np.eye(2))
    with pytest.raises(TypeError, match="make another from the same model"):
        copy.deepcopy(state)
