import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from truejoint.simulation.forceps.parameters import DT, eigenfrequencies, plant_constants
from truejoint.simulation.forceps.plant import (
    N_HISTORY,
    WHEEL,
    advance,
    advance_motor,
    bouc_wen_rate,
    friction_force,
    motor_acceleration,
    plant_rates,
    settled,
    wheel_motion,
)
from truejoint.simulation.forceps.specimens import population, specimen
from truejoint.simulation.friction import N_ELEMENTS, maxwell_slip

from . import reference_plant as reference

NOMINAL = specimen()
OTHER_FRICTION = population(4, seed=5, prior="capstan")
SLIDER_LAW = plant_constants(NOMINAL).slider_law
INSTRUMENTS = [NOMINAL, specimen("A"), specimen("B"), *population(2, seed=5)]
STEADY = {f"{contact}_friction.stribeck_ratio": 1.0 for contact in ("jaw", "slider")}
CONTACTS, CABLES = ("jaw_friction", "slider_friction"), ("drive_cable", "reset_cable")
ELASTIC = {f"{cable}.elastic_share": 1.0 for cable in CABLES} | {"jaw.eccentricity": 0.0}
FREE = NOMINAL.with_values(
    {f"{c}.{key}": 0.0 for c in CONTACTS for key in ("constant", "tension_share", "viscous")}
    | ELASTIC
    | {f"{cable}.stiffening": 0.0 for cable in CABLES}
    | {"assembly.wheel_eccentricity": 0.0}
)


def rates_of(parameters, state, wheel, force=0.0, line_angle=0.0, history=None, keep=False):
    rates = np.empty(8)
    history = np.zeros(N_HISTORY) if history is None else history
    state, wheel = np.asarray(state, dtype=float), np.asarray(wheel, dtype=float)
    how = force, line_angle, plant_constants(parameters), 1 / DT, history, keep
    tensions = plant_rates(state, wheel, *how, rates)
    return rates, np.array(tensions[:2])


def run(parameters, goal, force=None, line_angle=0.0, step=DT, log_every=1, settle=0.0):
    goal = np.asarray(goal, dtype=float)
    force = np.zeros_like(goal) if force is None else np.asarray(force, dtype=float)
    constants = plant_constants(parameters)
    per_sample = round(1e-3 / step)
    state, motor = settled(constants, per_sample, settle)
    return advance(state, motor, goal, force, line_angle, constants, per_sample, log_every)


def motor_goal(parameters, duration):
    t = np.arange(round(duration * 1000) + 1) / 1000
    jaw = np.minimum(t / 0.5, 1.0) * np.radians(30 * np.sin(2.0 * t) + 8 * np.sin(7.0 * t))
    return parameters.mechanism.motor_per_jaw * jaw


@pytest.mark.parametrize("parameters", INSTRUMENTS)
def test_the_right_hand_side_is_that_of_the_equations(parameters):
    rng = np.random.default_rng(1)
    for _ in range(50):
        angle = rng.uniform(-0.9, 0.9)
        state = rng.uniform(-1, 1, 8) * [
            0, 0.6, 0, 4e-3, parameters.jaw_friction.presliding,
            parameters.slider_friction.presliding, 1, 1,
        ]  # fmt: skip
        r = parameters.mechanism.jaw_radius
        state[0], state[2] = angle, r * angle * 0.97 + rng.uniform(-3e-5, 3e-5)
        wheel = np.array([r * angle + rng.uniform(-1e-4, 2e-4), *rng.uniform(-5e-3, 5e-3, 2)])
        force, line = rng.uniform(-2, 2), rng.uniform(-0.5, 0.5)
        torque = force * parameters.jaw.load_arm * math.cos(angle - line)
        wanted, tensions = reference.rates(parameters, state, wheel, torque)
        rates, got = rates_of(parameters, state, wheel, force, line)
        np.testing.assert_allclose(got, tensions, rtol=1e-6)
        np.testing.assert_allclose(rates, wanted, rtol=1e-5, atol=1e-5 * np.abs(wanted).max())
        np.testing.assert_allclose(rates[[0, 2, 4, 5, 7]], wanted[[0, 2, 4, 5, 7]], rtol=1e-9)


@pytest.mark.parametrize("parameters", OTHER_FRICTION)
def test_the_right_hand_side_of_the_other_friction_is_that_of_its_laws(parameters):
    rng, sliding = np.random.default_rng(2), 0
    p, r = parameters, parameters.mechanism.jaw_radius
    for _ in range(50):
        angle, end = rng.uniform(-0.9, 0.9), rng.uniform(-1e-5, 1e-5)
        slider = 0.97 * r * angle + end
        state = [angle, rng.uniform(-0.6, 0.6), slider, rng.uniform(-4e-3, 4e-3), 0, 0]
        state = np.array([*state, *rng.uniform(-1, 1, 2)])
        wheel = np.array([r * angle + rng.uniform(-2e-5, 6e-5), *rng.uniform(-5e-3, 5e-3, 2)])
        history = np.zeros(N_HISTORY)
        history[:2] = 0.5 * (r * angle + wheel[0]), 0.5 * (r * angle + slider)
        for _ in range(3):  # until the guides let go of all that they do not hold
            moved = history.copy()
            rates_of(parameters, state, wheel, history=moved, keep=True)
            history[:2] = moved[:2]
        history[:2] += rng.uniform(-2e-7, 2e-7, 2)
        history[4:8] = angle + 2 * p.jaw_friction.presliding * rng.uniform(-1, 1, 4)
        history[8:12] = slider + 2 * p.slider_friction.presliding * rng.uniform(-1, 1, 4)
        wanted, tensions = reference.rates(parameters, state, wheel, 0.0, history)
        kept = history.copy()
        rates, got = rates_of(parameters, state, wheel, history=history)
        np.testing.assert_array_equal(history, kept)
        np.testing.assert_allclose(got, tensions, rtol=1e-6)
        np.testing.assert_allclose(rates, wanted, rtol=1e-5, atol=1e-5 * np.abs(wanted).max())
        rates_of(parameters, state, wheel, history=history, keep=True)
        sliding += history[0] != kept[0]
    assert 5 < sliding < 45


@settings(max_examples=50)
@given(turns=st.lists(st.floats(-1.0, 1.0), min_size=2, max_size=30))
def test_maxwell_slip_comes_back_to_where_a_smaller_loop_began(turns):
    f = SLIDER_LAW
    stuck, position = np.zeros(N_ELEMENTS), 0.0

    def go(to):
        return maxwell_slip(to, 0.0, 0.2, f, stuck, 0, True)

    for turn in turns:
        position = turn * 5 * f.presliding
        force = go(position)
        assert abs(force) <= 0.2 * f.stribeck_ratio * (1 + 1e-12)
    go(position + 3 * f.presliding)
    at_turn = go(position + 3.3 * f.presliding)
    go(position + 2.9 * f.presliding)  # an inner loop, closed again
    assert go(position + 3.3 * f.presliding) == pytest.approx(at_turn, abs=1e-12)


@given(motion=st.lists(st.floats(-20.0, 20.0), min_size=1, max_size=50))
def test_the_wheel_follows_behind_the_gears_backlash(motion):
    parameters = NOMINAL.with_values(
        {"assembly.gear_backlash": 0.04, "assembly.wheel_eccentricity": 0.0}
    )
    constants, history, wheel, wanted = plant_constants(parameters), np.zeros(13), np.empty(3), 0.0
    for motor in motion:
        wheel_motion(np.array([motor, 0.0]), motor, constants, history, True, wheel)
        wanted = min(max(wanted, motor / 35.0 - 0.02), motor / 35.0 + 0.02)
        assert history[WHEEL] == pytest.approx(wanted, abs=1e-12)
        assert wheel[0] == pytest.approx(9.75e-3 * wanted, abs=1e-12)


def test_a_cable_creeps_by_its_share_in_its_time():
    held = {"reset_cable.creep_share": 0.1, "reset_cable.creep_time": 0.5}
    goal = np.full(1_501, NOMINAL.mechanism.motor_per_jaw * math.radians(40.0))
    plain, crept = (run(FREE.with_values(v), goal, log_every=10) for v in ({}, held))
    stretch = [4e-3 * log[:, 3] - log[:, 2] for log in (plain, crept)]
    elastic = (crept[:, 6] - 8.0) / 14e3
    share = (stretch[1] - elastic) / elastic
    np.testing.assert_allclose(stretch[0][-50:], (plain[-50:, 6] - 8.0) / 14e3, atol=1e-9)
    late = share[[800, 1300]]  # 0.5 s apart, long after the motor
    assert late[1] == pytest.approx(0.1 - (0.1 - late[0]) * math.exp(-1.0), rel=0.02)


@pytest.mark.parametrize("parameters", INSTRUMENTS[:3])
def test_the_wheel_moves_as_on_paper(parameters):
    constants = plant_constants(parameters)
    motor, goal = np.array([7.0, -20.0]), 6.5
    got = np.empty(3)
    wheel_motion(motor, goal, constants, np.zeros(N_HISTORY), True, got)
    acceleration = motor_acceleration(*motor, goal, constants)
    np.testing.assert_allclose(got, reference.wheel(parameters, *motor, acceleration), rtol=1e-12)


@pytest.mark.parametrize("parameters", [NOMINAL, specimen("A")])
def test_a_short_run_agrees_with_an_adaptive_solver(parameters):
    duration = 0.2
    goal = motor_goal(parameters, duration)
    grid = np.arange(goal.size) / 1000
    w, zeta = 2 * np.pi * 15.0, 0.9

    def right_hand_side(t, y):
        wanted = np.interp(t, grid, goal)
        acceleration = w * w * (wanted - y[0]) - 2 * zeta * w * y[1]
        wheel = reference.wheel(parameters, y[0], y[1], acceleration)
        return np.r_[y[1], acceleration, reference.rates(parameters, y[2:], wheel, 0.0)[0]]

    fine = {"rtol": 1e-8, "atol": 1e-12, "max_step": 1e-3}
    solution = solve_ivp(right_hand_side, (0, duration), np.zeros(10), **fine)
    log = run(parameters, goal)
    assert abs(solution.y[2, -1]) > math.radians(1.0)
    np.testing.assert_allclose(log[-1, 0], solution.y[0, -1], rtol=1e-6)
    np.testing.assert_allclose(log[-1, 3], solution.y[2, -1], atol=math.radians(2e-4))
    np.testing.assert_allclose(log[-1, 2], solution.y[4, -1], atol=2e-8)


@pytest.mark.parametrize("force", [0.0, 0.5, -0.8])
def test_it_rests_where_statics_puts_it(force):
    m = FREE.mechanism
    motor = m.motor_per_jaw * math.radians(20.0)
    wound = motor * m.wheel_radius / m.gear_ratio
    goal = np.r_[np.zeros(10), np.full(2500, motor)]
    log = run(FREE, goal, np.full(goal.size, force), line_angle=0.3, log_every=100)
    angle, x2 = log[-1, 3], log[-1, 2]
    r, reset = m.jaw_radius, FREE.reset_cable.stiffness
    # Gear and drive cable are springs in series; friction is gone, so (6) and (8) are two lines.
    drive = 1 / (1 / FREE.drive_cable.stiffness + m.wheel_radius**2 / FREE.assembly.gear_stiffness)
    torque = force * FREE.jaw.load_arm * math.cos(angle - 0.3)
    matrix = [[(drive + reset) * r * r, -reset * r], [-reset * r, reset + m.spring_stiffness]]
    wanted = np.linalg.solve(matrix, [drive * r * wound + torque, 0.0])
    np.testing.assert_allclose([angle, x2], wanted, rtol=2e-5)
    assert log[-1, 4] == pytest.approx(torque)
    drive_pull = 8.0 + drive * (wound - r * wanted[0])
    np.testing.assert_allclose(log[-1, 5:], [drive_pull, 8.0 + 656.6 * wanted[1]], rtol=2e-5)
    twist = wound - log[-1, 1]
    gear = (drive_pull - 8.0) * m.wheel_radius**2 / FREE.assembly.gear_stiffness
    assert twist == pytest.approx(gear, rel=1e-3)


@pytest.mark.parametrize("stuck", [False, True])
def test_small_motions_have_the_models_eigenfrequencies(stuck):
    none = {f"{cable}.{key}": 0.0 for cable in CABLES for key in ("damping", "mass")}
    none |= {f"{c}.{key}": 0.0 for c in CONTACTS for key in ("viscous", "bristle_damping")}
    rigid = {"assembly.gear_stiffness": 1e5}
    parameters = (NOMINAL if stuck else FREE).with_values(none | ELASTIC | rigid)
    # Displacements are in proportion to angles of 1e-8 rad, so that nothing slides or stiffens.
    scale = np.array([1e-8, 1e-8, 4e-11, 4e-11, 1e-8, 4e-11])
    jacobian = np.empty((6, 6))
    for i in range(6):
        state = np.zeros(8)
        state[i] = scale[i]
        forward = rates_of(parameters, state, np.zeros(3))[0]
        backward = rates_of(parameters, -state, np.zeros(3))[0]
        jacobian[:, i] = (forward - backward)[:6] / (2 * scale[i])
    found = np.abs(np.linalg.eigvals(jacobian).imag) / (2 * np.pi)
    found = np.unique(np.round(found[found > 1.0], 2))
    np.testing.assert_allclose(found, eigenfrequencies(parameters, stuck=stuck), rtol=1e-3)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000), size=st.floats(0.5, 20.0), pretension=st.floats(0.5, 8.0))
def test_no_cable_ever_pushes(seed, size, pretension):
    parameters = NOMINAL.with_values({"assembly.pretension": pretension})
    rng = np.random.default_rng(seed)
    n = 400
    goal = parameters.mechanism.motor_per_jaw * rng.uniform(-1, 1, n // 50).repeat(50)
    force = size * rng.uniform(-1, 1, n // 20).repeat(20)
    log = run(parameters, goal, force)
    assert np.isfinite(log).all()
    assert log[:, 5:].min() >= 0.0


def test_a_load_along_the_motion_slackens_the_drive_cable_and_the_stop_holds_the_jaw():
    parameters = specimen("A")
    goal = np.zeros(1500)
    force = np.clip(np.arange(1500) / 500, 0, 1) * 12.0
    log = run(parameters, goal, force, line_angle=1.0, log_every=10)
    assert log[-1, 5] == 0.0
    pushed = log[-1, 4] / parameters.jaw.stop_stiffness
    assert parameters.jaw.stop_upper < log[-1, 3] < parameters.jaw.stop_upper + pushed


@pytest.mark.parametrize(
    ("parameters", "limit"),
    [
        *zip(INSTRUMENTS[:3], (1e-5, 1e-4, 1e-4), strict=True),
        *((p.with_values(STEADY), 3e-3) for p in OTHER_FRICTION[:2]),
    ],
)
def test_halving_the_step_changes_nothing_that_matters(parameters, limit):
    goal = motor_goal(parameters, 5.0)
    coarse = run(parameters, goal, log_every=50, settle=0.2)
    fine = run(parameters, goal, step=DT / 2, log_every=100, settle=0.2)
    assert np.degrees(np.abs(coarse[:, 3] - fine[:, 3])).max() < limit


@settings(max_examples=50)
@given(speeds=st.lists(st.floats(-50.0, 50.0), min_size=1, max_size=200))
def test_bristles_and_yielding_stay_bounded_under_any_motion(speeds):
    parameters = NOMINAL.with_values({"jaw_friction.stribeck_ratio": 1.05})
    f = plant_constants(parameters).jaw_law._replace(damping=1e-5)
    bristle, yielded = 0.0, 0.0
    for speed in speeds:
        bristle += DT * friction_force(speed, bristle, 2e-3, f, 1 / DT)[1]
        yielded += 1e-5 * bouc_wen_rate(speed * 1e-2, yielded, 60e-6)
        assert abs(bristle) <= f.presliding * 1.05 * (1 + 1e-9)
        assert abs(yielded) <= 1.0 + 1e-9


def test_the_motor_keeps_its_limits():
    constants = plant_constants(NOMINAL)
    motor, speeds = np.zeros(2), [0.0]
    for _ in range(8_000):
        advance_motor(motor, np.full(3, 100.0), DT, constants)
        speeds.append(motor[1])
    assert max(speeds) == pytest.approx(400.0)
    assert np.abs(np.diff(speeds)).max() <= 4000.0 * DT * (1 + 1e-9)
    assert motor[0] == pytest.approx(100.0, abs=0.05)
