from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad_vec, solve_ivp
from scipy.linalg import expm

from truejoint.errors import CalibrationError
from truejoint.estimators.jaw.dynamics import ForcepsModel, injection_gain, steady_gain
from truejoint.estimators.jaw.run import FilterNoise, measurement, process_noise, state_space

MODEL = ForcepsModel(13e3, 14e3, 656.6, 1e-6, 0.05, 35.0, 9.75e-3, 4e-3)
SENSOR = np.diag([4e-7, 1e-4]) ** 2
NOISE = FilterNoise(1.5e-3, 0.2, 5e-3, 4e-7, 1e-4)
OBSERVED = np.array([[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


def test_state_space_is_equation_12():
    theta, speed, x2, x2_speed, motor = 0.3, 1.0, 1e-3, 0.02, 4.0
    m = MODEL
    jaw = (
        -(m.reset_stiffness + m.drive_stiffness) * m.jaw_radius**2 * theta
        + m.reset_stiffness * m.jaw_radius * x2
        + m.drive_stiffness * m.wheel_radius * m.jaw_radius / m.gear_ratio * motor
    ) / m.jaw_inertia
    slider = (
        m.reset_stiffness * m.jaw_radius * theta - (m.spring_stiffness + m.reset_stiffness) * x2
    ) / m.slider_mass
    rate = m.system @ [theta, speed, x2, x2_speed] + m.input[:, 0] * motor
    assert np.allclose(rate, [speed, jaw, x2_speed, slider], rtol=1e-12)


@pytest.mark.parametrize("dt", [1e-4, 1e-3, 5e-3, 0.02])
def test_compiled_transition_is_exact(dt):
    space = state_space(MODEL, NOISE)
    x, u = np.array([0.3, 1.0, 1e-3, 0.02]), np.array([4.0, 0.01])
    out = np.empty(4)
    space.transition(x, u, dt, space.parameters, out)
    start = x + np.array([0.01, 0.0, 0.0, 0.0])
    both = np.zeros((5, 5))
    both[:4, :4], both[:4, 4:] = MODEL.system * dt, MODEL.input * dt
    expected = (expm(both) @ [*start, 4.0])[:4]
    assert np.allclose(out, expected, rtol=1e-9, atol=1e-12 * np.abs(expected).max())
    seen = np.empty(2)
    measurement(x, u, space.parameters, seen)
    assert seen.tolist() == [1e-3, 0.02]


def test_discretisation_follows_the_differential_equation():
    dt = 5e-3
    transition, gain, _noise = MODEL.discrete(MODEL.noise_density(1.5e-3, 0.2, dt), dt)
    x0, motor = np.array([0.1, 0.0, 3e-4, 0.0]), 2.0
    solution = solve_ivp(
        lambda _t, x: MODEL.system @ x + MODEL.input[:, 0] * motor,
        (0.0, dt), x0, method="DOP853", rtol=1e-11, atol=1e-14,
    )  # fmt: skip
    assert np.allclose(transition @ x0 + gain[:, 0] * motor, solution.y[:, -1], rtol=1e-7)


@pytest.mark.parametrize("dt", [1e-3, 5e-3, 0.013])
def test_process_noise_is_the_integral_of_van_loan(dt):
    density = MODEL.noise_density(1.5e-3, 0.2, 5e-3)
    integral, _ = quad_vec(
        lambda s: expm(MODEL.system * s) @ density @ expm(MODEL.system * s).T, 0.0, dt,
        epsabs=0.0, epsrel=1e-10,
    )  # fmt: skip
    space = state_space(MODEL, NOISE)
    compiled = np.zeros((4, 4))
    process_noise(np.zeros(4), np.zeros(2), dt, space.parameters, compiled)
    size = np.sqrt(np.outer(np.diag(integral), np.diag(integral)))
    assert (np.abs(compiled - integral) / size).max() < 1e-8
    assert (np.abs(MODEL.discrete(density, dt)[2] - integral) / size).max() < 1e-8


def test_rest_is_a_balance():
    x = MODEL.at_rest(2.0, 1e-3)
    torque = (MODEL.system @ x + MODEL.input[:, 0] * 2.0)[1] * MODEL.jaw_inertia
    assert abs(torque) < 1e-12


def test_steady_gain_is_where_the_riccati_recursion_ends():
    transition, _gain, noise = MODEL.discrete(MODEL.noise_density(1.5e-3, 0.2, 5e-3), 5e-3)
    covariance = np.diag([1e-3, 1e-2, 1e-6, 1e-4]) ** 2
    for _ in range(400):
        predicted = transition @ covariance @ transition.T + noise
        innovation = OBSERVED @ predicted @ OBSERVED.T + SENSOR
        gain = predicted @ OBSERVED.T @ np.linalg.inv(innovation)
        rest = np.eye(4) - gain @ OBSERVED
        covariance = rest @ predicted @ rest.T + gain @ SENSOR @ gain.T
    found = steady_gain(transition, noise, OBSERVED, SENSOR)
    assert np.allclose(found, gain, rtol=1e-6, atol=1e-9 * np.abs(gain).max())


@pytest.mark.parametrize("friction", [1.0, 0.1, 0.02])
def test_injection_gain_is_what_a_constant_settles_at(friction):
    density = MODEL.noise_density(1.5e-3 * friction, 0.2 * friction, 5e-3)
    transition, _gain, noise = MODEL.discrete(density, 5e-3)
    kalman = steady_gain(transition, noise, OBSERVED, SENSOR)
    x = np.zeros(4)
    for _ in range(20_000):
        x = transition @ x
        x = x - kalman @ (OBSERVED @ x) + [1.0, 0.0, 0.0, 0.0]
    assert injection_gain(transition, OBSERVED, kalman) == pytest.approx(x[0], rel=1e-6)


def test_impossible_mechanics_are_refused():
    with pytest.raises(CalibrationError, match="jaw_inertia is -1"):
        ForcepsModel(13e3, 14e3, 656.6, -1.0, 0.05, 35.0, 9.75e-3, 4e-3)
