"""Motor, cable and link of a joint, against computations of their own."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from truejoint.errors import CalibrationError
from truejoint.estimators.motor_side import two_mass_rows as two_mass
from truejoint.estimators.motor_side.two_mass_rows import FAMILY, PARAMETERS, TwoMassJoint

JOINT = {
    "motor_inertia": 0.02, "link_inertia": 0.05, "stiffness": 40.0, "damping": 0.3,
    "motor_coulomb": 0.2, "motor_viscous": 0.3, "link_coulomb": 0.1, "link_viscous": 0.2,
    "effort_density": 1e-4, "load_density": 0.5, "slow": 0.05,
}  # fmt: skip
NUMBERS = np.array([JOINT[name] for name in PARAMETERS])


def moved(x, effort, dt):
    out = np.full(5, np.nan)
    two_mass.transition(x, np.array([effort]), dt, NUMBERS, out)
    return out


def test_many_small_steps_are_the_motion_of_two_masses_and_a_spring():
    p = JOINT

    def motion(t, x):
        q_m, v_m, q_l, v_l, load = x
        tension = p["stiffness"] * (q_m - q_l) + p["damping"] * (v_m - v_l)
        braked_m = p["motor_coulomb"] * v_m / (abs(v_m) + p["slow"]) + p["motor_viscous"] * v_m
        braked_l = p["link_coulomb"] * v_l / (abs(v_l) + p["slow"]) + p["link_viscous"] * v_l
        return [
            v_m, (np.sin(6.0 * t) - braked_m - tension) / p["motor_inertia"],
            v_l, (tension - braked_l - load) / p["link_inertia"], 0.0,
        ]  # fmt: skip

    x = np.array([0.1, 0.3, 0.05, -0.2, 0.15])
    expected = solve_ivp(motion, (0.0, 0.4), x, rtol=1e-9, atol=1e-11).y[:, -1]
    dt = 1e-4
    for k in range(4000):
        x = moved(x, np.sin(6.0 * (k + 1) * dt), dt)
    assert x == pytest.approx(expected, abs=1e-3)


def test_a_long_step_of_a_stiff_joint_ends_in_balance():
    """What the cable carries is what the load takes, wherever the motor is."""
    x = np.array([0.4, 0.0, 0.1, 0.0, 0.8])
    for _ in range(60):
        x = moved(x, 0.8, 2.0)
    assert JOINT["stiffness"] * (x[0] - x[2]) == pytest.approx(0.8, abs=1e-3)
    assert np.abs(x[[1, 3]]).max() < 1e-3


def test_process_noise_is_what_noise_of_the_effort_moves():
    x, dt, h = np.array([0.1, 0.3, 0.05, -0.2, 0.15]), 0.01, 1e-4
    slope = (moved(x, 0.2 + h, dt) - moved(x, 0.2 - h, dt)) / (2.0 * h)
    expected = JOINT["effort_density"] / dt * np.outer(slope, slope)
    expected[np.diag_indices(5)] *= 1.0 + two_mass._OWN
    expected[4, 4] += JOINT["load_density"] * dt
    found = np.zeros((5, 5))
    two_mass.process_noise(x, np.zeros(1), dt, NUMBERS, found)
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-14)


def test_the_prior_is_a_motor_that_its_link_follows():
    joint = TwoMassJoint(NUMBERS, 0.5, 0.2)
    mean, covariance = joint.prior()
    assert np.linalg.eigvalsh(covariance).min() > 0.0
    stretch = np.array([1.0, 0.0, -1.0, 0.0, 0.0])
    assert stretch @ mean == pytest.approx(0.5 / 40.0)
    assert stretch @ covariance @ stretch == pytest.approx(2.0 * (1.0 / 40.0) ** 2)


@pytest.mark.parametrize("place", [0, 2, 10, 12])
def test_a_file_whose_dynamics_make_no_joint_is_refused(place):
    row = TwoMassJoint(NUMBERS, 0.5, 0.2).row()
    row[place] = 0.0
    with pytest.raises(CalibrationError, match="fit it again"):
        TwoMassJoint.of_row(row)


def test_its_features_are_positions_then_efforts():
    named = FAMILY.inputs({"joints": ("a", "b")})
    assert named == ("measured/a", "measured/b", "effort/a", "effort/b")
