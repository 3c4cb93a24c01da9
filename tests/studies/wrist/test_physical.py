"""The reduced model of an instrument's loops, and what a filter on it says of itself."""

from __future__ import annotations

import numpy as np
import pytest

from truejoint.errors import StudyError
from truejoint.recordings.wrist import record_wrist
from truejoint.robots import get_robot
from truejoint.simulation.wrist.twin import WristTwin
from truejoint.studies.wrist import physical
from truejoint.studies.wrist import reduced as r

FOUND = physical.STARTS
MECHANISM = get_robot("wrist", "400006").cable_mechanism


def state(**parts):
    x = np.zeros(r.STATES)
    for name, values in parts.items():
        at = {"loop": r.LOOP, "motor": r.MOTOR, "pin": r.PIN, "load": r.LOAD}[name]
        x[at : at + r.N] = values
    return x


def test_joints_are_in_balance_as_the_energy_of_six_springs_says():
    p = physical.constants(MECHANISM, FOUND)
    motor, load = np.array([0.3, -0.2, 0.4]), np.array([0.02, 0.01, -0.008])
    joint = np.empty(3)
    r.joints(state(load=load), motor, p, joint)
    moments = MECHANISM.moments
    wound = np.array([c.sign * MECHANISM.motors[c.motor] for c in MECHANISM.cables])
    wound *= motor[[list(MECHANISM.motors).index(c.motor) for c in MECHANISM.cables]]
    # A grip drives the jaws apart; a yaw torque turns both, half each.
    torque = np.array([0.01, -0.02 - 0.004, 0.02 - 0.004])

    def energy(q):
        return 0.5 * FOUND["jaw_stiffness"] * np.sum((wound - moments @ q) ** 2) - torque @ q

    steps = 1e-5 * np.eye(3)
    slope = [(energy(joint + s) - energy(joint - s)) / 2e-5 for s in steps]
    np.testing.assert_allclose(slope, 0.0, atol=1e-6)
    # Motors hold what the coupling carries to them.
    effort, coupling = np.empty(3), MECHANISM.coupling
    r.efforts(state(load=load), np.zeros(3), p, effort)
    np.testing.assert_allclose(coupling.T @ effort, -torque, atol=1e-12)


def test_friction_fills_to_its_level_and_stays_where_nothing_moves():
    p = physical.constants(MECHANISM, FOUND)
    x, u, out = state(), np.zeros(r.INPUTS), np.empty(r.STATES)
    for _ in range(600):
        u[r.ANGLE : r.CHANGE] += 2e-3
        u[r.CHANGE : r.SPEED] = 2e-3
        r.move(x, u, np.zeros(3), p, out)
        x = out.copy()
    level = p[r.LEVEL : r.LEVEL + 3]
    assert (np.abs(x[r.LOOP : r.MOTOR]) > 0.9 * level).all()
    np.testing.assert_allclose(x[r.MOTOR : r.PIN], 1.0, atol=1e-6)
    # Pitch drags the jaws back, so that theirs turn by less than their motors.
    assert x[r.PIN] == pytest.approx(p[r.PIN_LEVEL], rel=1e-3)
    u[r.CHANGE : r.SPEED] = 0.0
    r.move(x, u, np.zeros(3), p, out)
    np.testing.assert_allclose(out, x, atol=1e-12)


def test_a_pin_hides_a_part_of_a_small_load():
    p = physical.constants(MECHANISM, FOUND)
    x, out, before, after = state(), np.empty(r.STATES), np.empty(3), np.empty(3)
    r.joints(x, np.zeros(3), p, before)
    r.move(x, np.zeros(r.INPUTS), np.array([0.0, 1e-4, 0.0]), p, out)
    r.joints(out, np.zeros(3), p, after)
    assert 0.0 < out[r.PIN] < 1e-4
    # What the pin holds and what the cables bear add up to the load.
    pull = np.empty(3)
    r.tensions(out, p, pull)
    moments = MECHANISM.moments[::2]
    assert out[r.PIN] - (moments.T @ pull)[0] == pytest.approx(1e-4, rel=1e-9)
    stiffness = FOUND["pitch_pin"] / FOUND["pin_way"]  # of a pin that has hardly moved
    assert after[0] - before[0] == pytest.approx(out[r.PIN] / stiffness, rel=0.05)


def test_deviations_of_least_squares_hold_what_rows_have_in_common():
    rng = np.random.default_rng(3)
    blocks = np.repeat(np.arange(400), 10)
    common = rng.normal(size=400)[blocks]  # each draw counts ten times, and tells once
    jacobian = np.ones((4000, 1))
    assert physical._robust(jacobian, common, blocks)[0] == pytest.approx(0.05, rel=0.15)


def test_a_filter_as_good_as_its_reference_has_deviations_all_the_same():
    rng = np.random.default_rng(4)
    true, noise = np.zeros((1000, 3)), 1e-3 * rng.normal(size=(1000, 3))
    signals = physical.Signals(true, true, true, noise, true, 5e-3)
    one, load = np.full((1000, 3), 1e-3), 0.01 * rng.normal(size=(1000, 3))

    class Exact:
        def estimate(self, _signals):
            return physical.Estimate(true, one, load, one, np.zeros((1000, r.STATES)))

    structure = physical._structure(Exact(), [signals])
    assert structure.shape == (2, 2, 3)
    assert (structure.sum(axis=1) > 0.0).all()


def test_a_calibration_without_a_load_is_not_asked_for_loads():
    twin = WristTwin(seed=1)
    free = record_wrist(twin, np.zeros((400, 3)))
    with pytest.raises(StudyError, match="add a minute under loads"):
        physical.identify([free], twin.robot)


def test_a_robot_without_cables_is_refused():
    with pytest.raises(StudyError, match="forceps states no cables"):
        physical.identify([], get_robot("forceps"))
