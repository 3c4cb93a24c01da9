"""The filter (12)-(25) of yan2020: its model in closed form, and what it makes of a recording."""

import numpy as np
import pytest
from scipy.integrate import quad_vec
from scipy.linalg import expm
from scipy.signal import cont2discrete
from tests.estimators.conftest import columns, fitted, rms_deg, steps

from truejoint.calibration import calibrate
from truejoint.estimators import JawFilter
from truejoint.estimators.jaw.run import ForcepsModel, measurement, process_noise
from truejoint.motion.forceps_trajectories import calibration_trajectory
from truejoint.runtime import Corrector, Status
from truejoint.simulation.forceps.load import LoadTest
from truejoint.simulation.forceps.specimens import specimen
from truejoint.studies.forceps.methods import record_forceps

MODEL = ForcepsModel(**{**JawFilter().model_params(), "drive_stiffness": 13e3})
OBSERVED = np.array([[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


def system(m: ForcepsModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A (4, 4) and B (4, 1) of (13), and the density (4, 4) of what neglected friction does."""
    k_d, k_r, r = m.drive_stiffness, m.reset_stiffness, m.jaw_radius
    jaw = [-(k_r + k_d) * r**2 / m.jaw_inertia, 0.0, k_r * r / m.jaw_inertia, 0.0]
    slider = [k_r * r / m.slider_mass, 0.0, -(m.spring_stiffness + k_r) / m.slider_mass, 0.0]
    A = np.array([[0.0, 1.0, 0.0, 0.0], jaw, [0.0, 0.0, 0.0, 1.0], slider])
    gain = k_d * m.wheel_radius * r / (m.gear_ratio * m.jaw_inertia)
    noise = [0.0, m.jaw_friction / m.jaw_inertia, 0.0, m.slider_friction / m.slider_mass]
    return A, np.array([[0.0], [gain], [0.0], [0.0]]), np.diag(noise) ** 2 * m.correlation_time


@pytest.mark.parametrize("dt", [1e-4, 1e-3, 5e-3, 0.02])
def test_compiled_transition_is_exact(dt):
    A, B, _ = system(MODEL)
    space = MODEL.state_space()
    x, u, out, seen = np.array([0.3, 1.0, 1e-3, 0.02]), np.array([4.0]), np.empty(4), np.empty(2)
    space.transition(x, u, dt, space.parameters, out)
    F, G, *_ = cont2discrete((A, B, OBSERVED, np.zeros((2, 1))), dt)
    expected = F @ x + G @ u
    assert np.allclose(out, expected, rtol=1e-9, atol=1e-12 * np.abs(expected).max())
    measurement(x, u, space.parameters, seen)
    assert seen.tolist() == [1e-3, 0.02]


@pytest.mark.parametrize("dt", [1e-3, 5e-3, 0.013])
def test_process_noise_is_its_integral_over_a_step(dt):
    A, _, density = system(MODEL)
    integral, _ = quad_vec(
        lambda s: expm(A * s) @ density @ expm(A * s).T, 0.0, dt, epsabs=0.0, epsrel=1e-10
    )
    compiled, size = np.zeros((4, 4)), np.sqrt(np.diag(integral))
    process_noise(np.zeros(4), np.zeros(1), dt, MODEL.state_space().parameters, compiled)
    assert (np.abs(compiled - integral) / np.outer(size, size)).max() < 1e-8


def balance(m: ForcepsModel, motor: float, reset: float) -> np.ndarray:
    """State at rest: (9), no friction."""
    tension = m.drive_tension * motor + m.reset_stiffness * reset
    return np.array([tension / m.rest_divisor, 0.0, reset, 0.0])


def test_friction_holds_the_jaw_off_its_balance():
    A, B, _ = system(MODEL)
    at_rest = balance(MODEL, 2.0, 1e-3)
    assert abs((A @ at_rest + B[:, 0] * 2.0)[1] * MODEL.jaw_inertia) < 1e-12
    slider = MODEL.slider_friction / MODEL.reset_stiffness / MODEL.jaw_radius
    jaw = MODEL.jaw_friction / MODEL.jaw_radius / (MODEL.reset_stiffness + MODEL.drive_stiffness)
    spread = slider + jaw / MODEL.jaw_radius
    assert MODEL.rest_covariance()[0, 0] == pytest.approx(spread**2, rel=1e-12)


def test_filter_is_a_kalman_filter(pair):
    """(12) is linear, so (15)-(23) must give what an ordinary Kalman filter gives."""
    model = fitted(pair, JawFilter())
    run = pair.verification
    X, dt = columns(run, model)[:3000], 5e-3
    own = ForcepsModel(**model.model_params())
    A, B, _ = system(own)
    transition, gain, *_ = cont2discrete((A, B, OBSERVED, np.zeros((2, 1))), dt)
    noise = np.zeros((4, 4))
    process_noise(np.zeros(4), np.zeros(1), dt, own.state_space().parameters, noise)
    x, covariance = balance(own, *X[0]), own.rest_covariance()
    expected = np.empty(len(X))
    for k, (_motor, reset) in enumerate(X):
        seen = OBSERVED[:1] if k == 0 else OBSERVED
        z = [reset] if k == 0 else [reset, (reset - X[k - 1, 1]) / dt]
        if k:
            x = transition @ x + gain[:, 0] * X[k - 1, 0]
            covariance = transition @ covariance @ transition.T + noise
        sensor = np.diag([own.displacement_noise, own.speed_noise])[: len(z), : len(z)] ** 2
        spread = seen @ covariance @ seen.T + sensor
        kalman = covariance @ seen.T @ np.linalg.inv(spread)
        x = x + kalman @ (z - seen @ x)
        rest = np.eye(4) - kalman @ seen
        covariance = rest @ covariance @ rest.T + kalman @ sensor @ kalman.T
        expected[k] = x[0]
    regular = np.full(len(X), dt)
    regular[0] = 0.0
    states = model.states(X, regular)
    assert np.abs(states.x[:, 0] - expected).max() < 1e-9
    assert states.P[-1] == pytest.approx(covariance, rel=1e-6)


def test_the_error_model_takes_most_of_the_error_off(pair):
    run, error = pair.verification, {}
    for compensated in (False, True):
        model = fitted(pair, JawFilter(compensated=compensated))
        error[compensated] = rms_deg(model.predict(columns(run, model), steps(run)), run)
    assert error[True] < 0.15
    assert error[True] < 0.3 * error[False]


@pytest.mark.parametrize(("jitter", "bound"), [(1e-4, 0.15), (1e-3, 0.3)])
def test_steps_of_varying_length_are_followed(pair, jitter, bound):
    """The undamped model minds jitter: a fiftieth of a step does no harm, a fifth doubles it."""
    model = fitted(pair, JawFilter(compensated=True))
    run = pair.verification
    t = run.t + np.random.default_rng(0).uniform(-jitter, jitter, len(run.t))
    X = np.column_stack([np.interp(t, run.t, c) for c in columns(run, model).T])
    estimate = model.predict(X, np.diff(t, prepend=t[0]))
    assert rms_deg(estimate, run) < bound


def test_on_another_mechanism_under_a_load_it_stays_bounded_and_says_so():
    """Radii and spring 15 % off: a pole of (25) was once met here, and 1431 deg given as good."""
    plant = specimen("A")
    off = {"jaw_radius": 1.15, "wheel_radius": 1.15, "spring_stiffness": 0.85}
    values = {f"mechanism.{n}": getattr(plant.mechanism, n) * by for n, by in off.items()}
    plant = plant.with_values(values)
    training = record_forceps(plant, calibration_trajectory().positions[:, 0])
    test = LoadTest(0.25, "along")
    run = record_forceps(plant, test, seed=5)
    model = calibrate(training, "ukf_compensated")
    assert model.model.jaw_radius == plant.mechanism.jaw_radius
    assert np.degrees(np.abs(model.correct(run))).max() < 60.0
    corrector = Corrector(model)
    corrector.set_homing(True, run.provenance.homing_id)
    status = corrector.run(run).status[run.t >= test.phases["IV"][0]]
    assert (status == Status.OUT_OF_DOMAIN).mean() > 0.9
