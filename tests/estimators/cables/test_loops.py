"""The reduced model of an instrument's loops against springs, the plant, and its own limits."""

import sys

import numpy as np
import pytest
from numba.core.runtime import _nrt_python, rtsys

from truejoint.estimators.cables import loops as r
from truejoint.estimators.cables import run as cable_filter
from truejoint.estimators.cables.learn import constants
from truejoint.robots import get_robot

MECHANISM = get_robot("wrist", "400006").mechanism
STARTS = {name: rods for name, (*_, rods, _) in cable_filter.SOUGHT.items()}
PARTS = {"guide": r.GUIDE, "wrist": r.WRIST, "motor": r.MOTOR, "pin": r.PIN, "load": r.LOAD}


@pytest.fixture
def p():
    return constants(MECHANISM, STARTS)


def state(**parts):
    x = np.zeros(r.STATES)
    for name, values in parts.items():
        x[PARTS[name] : PARTS[name] + r.N] = values
    return x


def moved(x, p, by=0.0, load=None):
    """State after the motors have moved, and loads have come."""
    u, out = np.zeros(r.INPUTS), np.empty(r.STATES)
    u[r.CHANGE : r.SPEED] = by
    r.move(x, u, x[r.LOAD :].copy() if load is None else np.array(load), p, out)
    return out


def joints(x, p, motor=(0.0, 0.0, 0.0)):
    out = np.empty(3)
    r.joints(x, np.array(motor), p, out)
    return out


def efforts(x, p):
    out = np.empty(3)
    r.measurement(x, np.zeros(r.INPUTS), p, out)
    return out


def test_joints_are_in_balance_as_the_energy_of_six_springs_says(p):
    motor, load = np.array([0.3, -0.2, 0.4]), np.array([0.02, 0.01, -0.008])
    joint = joints(state(load=load), p, motor)
    moments = MECHANISM.moments
    wound = np.array([c.sign * MECHANISM.motors[c.motor].radius for c in MECHANISM.cables])
    wound *= motor[[list(MECHANISM.motors).index(c.motor) for c in MECHANISM.cables]]
    # A grip drives the jaws apart; a yaw torque turns both, half each.
    torque = np.array([0.01, -0.02 - 0.004, 0.02 - 0.004])

    def energy(q):
        return 0.5 * STARTS["jaw1_stiffness"] * np.sum((wound - moments @ q) ** 2) - torque @ q

    steps = 1e-5 * np.eye(3)
    slope = [(energy(joint + s) - energy(joint - s)) / 2e-5 for s in steps]
    np.testing.assert_allclose(slope, 0.0, atol=1e-6)
    # Motors hold what the coupling carries to them.
    effort = efforts(state(load=load), p)
    np.testing.assert_allclose(MECHANISM.coupling.T @ effort, -torque, atol=1e-12)


def test_a_loop_whose_slacker_cable_lets_go_is_half_as_stiff(p):
    def pitch(load):
        return joints(state(load=[0.0, load, 0.0]), p)[0]

    slack = p[r.TENSION] * abs(MECHANISM.moments[0, 0])  # [Nm] from which on one cable pulls alone
    taut = pitch(0.5 * slack)
    assert pitch(slack) == pytest.approx(2.0 * taut, rel=1e-6)
    assert pitch(1.5 * slack) - pitch(slack) == pytest.approx(2.0 * taut, rel=1e-6)


def test_friction_fills_to_its_level_and_stays_where_nothing_moves(p):
    x = state()
    for _ in range(600):
        x = moved(x, p, 2e-3)
    level = p[r.LEVEL : r.LEVEL + 2 * r.N]
    assert (np.abs(x[r.GUIDE : r.MOTOR]) > 0.9 * level).all()
    np.testing.assert_allclose(x[r.MOTOR : r.PIN], 1.0, atol=1e-6)
    # Pitch drags the jaws back, so that theirs turn by less than their motors.
    assert x[r.PIN] == pytest.approx(p[r.PIN_LEVEL], rel=0.03)
    np.testing.assert_allclose(moved(x, p), x, atol=1e-9)


def test_cables_that_slide_lose_tension_by_the_capstan_equation(p):
    """Motor over joint tension of a loop that pulls a load is that of one cable, e^(mu phi)."""
    x = state(load=[0.0, 0.02, 0.0])
    for _ in range(800):
        x = moved(x, p, [-2e-3, 0.0, 0.0])
    pull = np.empty(3)
    r.tensions(x, p, pull)
    guides, wrist = p[r.LEVEL] / p[r.TENSION], p[r.LEVEL + r.N] / p[r.TENSION]
    # Two legs at T0 -+ D / 2, of which one runs on and the other off, each over both frictions.
    legs = 0.5 * p[r.TENSION] + 0.5 * pull[0] * np.array([1.0, -1.0])
    for exponent in (wrist, guides):
        legs = legs * np.exp(np.array([-1.0, 1.0]) * np.arcsinh(exponent))
    held = x[r.GUIDE] + x[r.WRIST]
    assert held == pytest.approx(legs[0] - legs[1] - pull[0], rel=0.15)


def test_a_pin_hides_a_part_of_a_small_load(p):
    out = moved(state(), p, load=[0.0, 1e-4, 0.0])
    assert 0.0 < out[r.PIN] < 1e-4
    # What the pin holds and what the cables bear add up to the load.
    pull = np.empty(3)
    r.tensions(out, p, pull)
    assert out[r.PIN] - (MECHANISM.moments[::2].T @ pull)[0] == pytest.approx(1e-4, rel=1e-9)
    stiffness = STARTS["pitch_pin"] / STARTS["pin_way"]  # of a pin that has hardly moved
    assert joints(out, p)[0] == pytest.approx(out[r.PIN] / stiffness, rel=0.05)


def test_motors_that_stand_feel_little_of_a_load_until_they_move(p):
    """Friction at the pulleys holds what a load changes of the tension behind them."""
    p[r.PIN_LEVEL : r.PIN_LEVEL + r.N] = 1e-9
    load = [0.0, 4e-3, 0.0]
    x = moved(state(), p, load=load)
    felt = efforts(x, p)[0]
    for step in 100 * [2e-3] + 100 * [-2e-3]:
        x = moved(x, p, [step, 0.0, 0.0])
    there = efforts(x, p)[0]
    for step in 100 * [2e-3]:
        x = moved(x, p, [step, 0.0, 0.0])
    back = efforts(x, p)[0]
    borne = -load[1] / MECHANISM.coupling[0, 0]
    assert abs(felt) < 0.4 * abs(borne)
    assert 0.5 * (there + back) == pytest.approx(borne, rel=0.15)


def test_pins_hold_what_they_hold_along_the_way_that_they_leave(p):
    """The sweeps find the root of the balance, also where joints turn back."""
    rng, level = np.random.default_rng(7), p[r.PIN_LEVEL : r.PIN_LEVEL + r.N]
    inverse = p[r.INVERSE : r.INVERSE + r.N**2].reshape(r.N, r.N)
    shares = np.array([[1.0, 1.0, r.whole(m, p)] for m in range(r.N)])
    yields = inverse @ np.diag(shares[:, 2]) @ inverse.T
    for _ in range(30):
        began, free = level * rng.uniform(-1.0, 1.0, 3), 0.02 * rng.uniform(-1.0, 1.0, 3)
        way, held = np.empty(3), np.empty(3)
        slope = (level - began * np.sign(free)) / p[r.PIN_WAY]
        for _ in range(20):
            apart = r.turn_pins(began, free, level, shares, p, slope, way, held)

        end = level * np.sign(way)
        dahl = end + (began - end) * np.exp(-np.abs(way) / p[r.PIN_WAY])
        assert apart < 1e-4
        np.testing.assert_allclose(held, dahl, rtol=1e-12)
        np.testing.assert_allclose(way + yields @ (held - began), free, rtol=0.0, atol=2e-6)


def test_friction_beyond_what_a_pin_holds_slips_to_it(p):
    """A sigma point may stand there; the others must not feel it."""
    level = p[r.PIN_LEVEL : r.PIN_LEVEL + r.N]
    x = state(pin=[1.5 * level[0], -1.5 * level[1], 0.5 * level[2]])
    out = moved(x, p, 1e-6)
    np.testing.assert_allclose(out[r.PIN : r.LOAD] / level, [1.0, -1.0, 0.5], atol=0.01)


def test_a_step_of_the_filter_asks_nothing_of_the_heap(p):
    p[r.LOAD_RATE : r.LOAD_RATE + r.N] = 1e-3
    arrays = {"parameters": p, "effort_misfit": np.full(3, 3e-3), "dt": np.array([5e-3])}
    unscented, (x0, P0) = cable_filter.cable_filter(arrays), cable_filter.cable_prior(p)
    taken, switching = [], sys.getswitchinterval()
    _nrt_python.memsys_enable_stats()
    sys.setswitchinterval(1e3)  # [s]: other threads of the process allocate too
    try:
        for rows in (20, 20, 120):  # the first compiles
            effort, u = np.full((rows, r.N), 1e-3), np.zeros((rows, r.INPUTS))
            before = rtsys.get_allocation_stats().alloc
            result = unscented.run(effort, u, x0=x0, P0=P0, dt=5e-3)
            taken.append(rtsys.get_allocation_stats().alloc - before)
            assert (result.status == 0).all()
    finally:
        sys.setswitchinterval(switching)
        _nrt_python.memsys_disable_stats()
    assert taken[1] == taken[2]


def test_a_load_that_comes_at_rest_is_one_with_what_holds_it(p):
    """Process noise is along the load, its pin's friction, and less tension held at the pulleys."""
    p[r.LOAD_RATE : r.LOAD_RATE + r.N] = 1e-4
    Q = np.zeros((r.STATES, r.STATES))
    r.process_noise(state(), np.zeros(r.INPUTS), 5e-3, p, Q)
    assert np.linalg.eigvalsh(Q)[0] > -1e-12 * np.abs(Q).max()
    x, small = state(), 1e-9
    after = moved(x, p, load=[0.0, small, 0.0]) / small
    own = Q[:, r.LOAD + 1] / Q[r.LOAD + 1, r.LOAD + 1]
    np.testing.assert_allclose(own, after, rtol=1e-3, atol=1e-3 * np.abs(after).max())
