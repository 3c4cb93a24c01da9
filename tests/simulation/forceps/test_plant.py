import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad, solve_ivp

from truejoint.simulation.forceps.parameters import (
    DT,
    eigenfrequencies,
    plant_constants,
)
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
from truejoint.simulation.friction import N_ELEMENTS, guide_travel, maxwell_slip

from . import reference_plant as reference

NOMINAL = specimen()
OTHER_FRICTION = population(4, seed=5, prior="capstan")
SLIDER_LAW = plant_constants(NOMINAL).slider_law
INSTRUMENTS = [NOMINAL, specimen("A"), specimen("B"), *population(2, seed=5)]
STEADY = {f"{contact}_friction.stribeck_ratio": 1.0 for contact in ("jaw", "slider")}
FREE = NOMINAL.with_values(
    {
        "jaw_friction.constant": 0.0,
        "jaw_friction.tension_share": 0.0,
        "jaw_friction.viscous": 0.0,
        "slider_friction.constant": 0.0,
        "slider_friction.tension_share": 0.0,
        "slider_friction.viscous": 0.0,
        "drive_cable.elastic_share": 1.0,
        "reset_cable.elastic_share": 1.0,
        "drive_cable.stiffening": 0.0,
        "reset_cable.stiffening": 0.0,
        "jaw.eccentricity": 0.0,
        "assembly.wheel_eccentricity": 0.0,
    }
)


def rates_of(parameters, state, wheel, force=0.0, line_angle=0.0, history=None, keep=False):
    rates = np.empty(8)
    history = np.zeros(N_HISTORY) if history is None else history
    tensions = plant_rates(
        np.asarray(state, dtype=float),
        np.asarray(wheel, dtype=float),
        force,
        line_angle,
        plant_constants(parameters),
        1 / DT,
        history,
        keep,
        rates,
    )
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


@given(
    before=st.floats(0.0, 50.0, allow_subnormal=False),
    behind=st.floats(0.0, 50.0, allow_subnormal=False),
    ratio=st.floats(1.0, 1.7),
    stiffness=st.tuples(st.floats(1e3, 1e5), st.floats(1e3, 1e5)),
)
def test_a_cable_slides_over_a_guide_until_the_capstan_equation_holds(
    before, behind, ratio, stiffness
):
    slid = guide_travel(before, behind, ratio, *stiffness)
    after = before - stiffness[0] * slid, behind + stiffness[1] * slid
    high, low = max(before, behind), min(before, behind)
    if high <= ratio * low:
        assert slid == 0.0
    else:
        assert max(after) == pytest.approx(ratio * min(after), rel=1e-9, abs=1e-9)
        assert (slid > 0) == (before > behind)


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


def test_maxwell_slip_begins_as_stiff_as_a_bristle():
    f, stuck = SLIDER_LAW._replace(damping=7.0), np.zeros(N_ELEMENTS)
    small = 1e-3 * f.presliding
    assert maxwell_slip(small, 0.0, 0.2, f, stuck, 0, False) == pytest.approx(0.2e-3)
    assert maxwell_slip(9.0, 1.0, 0.2, f, stuck, 0, False) == pytest.approx(0.2 + f.viscous)


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


def test_a_guide_takes_its_share_of_the_tension_in_both_directions():
    parameters = FREE.with_values({"reset_cable.guide_friction": 0.05})
    t = np.arange(6_001) / 1000
    jaw = np.radians(30.0) * np.sin(2 * np.pi * t / 4)
    log = run(parameters, parameters.mechanism.motor_per_jaw * jaw, log_every=100)
    t, behind = t[::10], 8.0 + 656.6 * log[:, 2]  # what the spring pulls with, nothing else drags
    for middle, ratio in ((2.0, math.exp(-0.05)), (4.0, math.exp(0.05))):
        rows = abs(t - middle) < 0.5
        np.testing.assert_allclose(log[rows, 6] / behind[rows], ratio, rtol=3e-3)


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
    duration = 0.25
    goal = motor_goal(parameters, duration)
    grid = np.arange(goal.size) / 1000
    w, zeta = 2 * np.pi * 15.0, 0.9

    def right_hand_side(t, y):
        wanted = np.interp(t, grid, goal)
        acceleration = w * w * (wanted - y[0]) - 2 * zeta * w * y[1]
        wheel = reference.wheel(parameters, y[0], y[1], acceleration)
        return np.r_[y[1], acceleration, reference.rates(parameters, y[2:], wheel, 0.0)[0]]

    solution = solve_ivp(
        right_hand_side, (0, duration), np.zeros(10), rtol=1e-8, atol=1e-12, max_step=1e-3
    )
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
    source = NOMINAL if stuck else FREE
    parameters = source.with_values(
        {
            "drive_cable.damping": 0.0,
            "reset_cable.damping": 0.0,
            "drive_cable.mass": 0.0,
            "reset_cable.mass": 0.0,
            "drive_cable.elastic_share": 1.0,
            "reset_cable.elastic_share": 1.0,
            "assembly.gear_stiffness": 1e5,
            "jaw.eccentricity": 0.0,
            "jaw_friction.viscous": 0.0,
            "slider_friction.viscous": 0.0,
            "jaw_friction.bristle_damping": 0.0,
            "slider_friction.bristle_damping": 0.0,
        }
    )
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


def stored_energy(p, state):
    """Kinetic and potential energy [J] with elastic cables and the motor at zero."""
    r = p.mechanism.jaw_radius
    e, psi = p.jaw.eccentricity, p.jaw.eccentricity_phase
    bent = e * (math.cos(state[0] + psi) - math.cos(psi))
    pre = p.assembly.pretension
    compliance = p.mechanism.wheel_radius**2 / p.assembly.gear_stiffness
    gap = -r * state[0] - bent
    stretch = gap
    for _ in range(20):
        stretch = gap - compliance * reference.elastic(p.drive_cable, pre, stretch, 0.0)[0]
    drive = reference.elastic(p.drive_cable, pre, stretch, 0.0)[0]

    def potential(cable, d):
        return quad(lambda s: reference.elastic(cable, pre, s, 0.0)[0], 0.0, d, epsabs=1e-16)[0]

    reset_stretch = r * state[0] - bent - state[2]
    bristles = 0.0
    for friction, level, deflection in (
        (p.jaw_friction, p.jaw_friction.constant, state[4]),
        (p.slider_friction, p.slider_friction.constant, state[5]),
    ):
        bristles += 0.5 * level / friction.presliding * deflection**2
    return (
        0.5 * p.jaw.inertia * state[1] ** 2
        + 0.5 * p.slider.mass * state[3] ** 2
        + 0.5 * p.mechanism.spring_stiffness * state[2] ** 2
        + pre * (gap + reset_stretch + state[2])
        + potential(p.drive_cable, stretch)
        + 0.5 * compliance * drive**2
        + potential(p.reset_cable, reset_stretch)
        + bristles
    )


@pytest.mark.parametrize("damped", [True, False])
def test_energy_is_lost_to_friction_and_damping_only(damped):
    values = {
        "drive_cable.elastic_share": 1.0,
        "reset_cable.elastic_share": 1.0,
        "drive_cable.mass": 0.0,
        "reset_cable.mass": 0.0,
        "jaw_friction.tension_share": 0.0,
        "slider_friction.tension_share": 0.0,
        "jaw.eccentricity": 0.2e-3,
    }
    if not damped:
        values |= {f"{c}_cable.damping": 0.0 for c in ("drive", "reset")}
        for contact in ("jaw_friction", "slider_friction"):
            values |= {f"{contact}.constant": 0.0, f"{contact}.viscous": 0.0}
    parameters = NOMINAL.with_values(values)
    constants = plant_constants(parameters)
    state = np.array([0.02, 0.0, 5e-5, 0.0, 0.0, 0.0, 0.0, 0.0])
    energy, motor, still = [stored_energy(parameters, state)], np.zeros(2), np.zeros(2)
    state = np.r_[state, np.zeros(N_HISTORY)]
    for _ in range(60):
        advance(state, motor, still, still, 0.0, constants, 10, 10)
        energy.append(stored_energy(parameters, state))
    change = np.diff(energy) / energy[0]
    if damped:
        assert change.max() < 1e-4
        assert energy[-1] < 0.1 * energy[0]
    else:
        np.testing.assert_allclose(energy, energy[0], rtol=2e-4)


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
        (NOMINAL, 1e-5),
        (specimen("A"), 1e-4),
        (specimen("B"), 1e-4),
        *((p.with_values(STEADY), 3e-3) for p in OTHER_FRICTION[:2]),
    ],
)
def test_halving_the_step_changes_nothing_that_matters(parameters, limit):
    goal = motor_goal(parameters, 5.0)
    coarse = run(parameters, goal, log_every=50, settle=0.2)
    fine = run(parameters, goal, step=DT / 2, log_every=100, settle=0.2)
    assert np.degrees(np.abs(coarse[:, 3] - fine[:, 3])).max() < limit


def test_friction_opens_the_loops_that_the_paper_compensates():
    parameters = NOMINAL.with_values({"jaw.eccentricity": 0.0, "drive_cable.elastic_share": 1.0,
                                      "reset_cable.elastic_share": 1.0})  # fmt: skip
    t = np.arange(12_001) / 1000
    jaw = np.radians(30.0) * np.sin(2 * np.pi * t / 8)
    log = run(parameters, parameters.mechanism.motor_per_jaw * jaw, log_every=100)
    t = t[::10]
    m, reset = parameters.mechanism, parameters.reset_cable.stiffness
    # (5) and (6) at rest: r theta exceeds (1 + K_sp / K_r) x2 by F_fr / K_r, in both directions.
    stretch = m.jaw_radius * log[:, 3] - log[:, 2]
    drag = log[:, 6] - 8.0 - m.spring_stiffness * log[:, 2]
    up = (t > 7.2) & (t < 8.8)
    down = (t > 3.2) & (t < 4.8)
    friction = 0.1 + 0.0125 * log[:, 6]
    assert drag[up].mean() == pytest.approx(friction[up].mean(), rel=0.1)
    assert drag[down].mean() == pytest.approx(-friction[down].mean(), rel=0.1)
    at_zero = [np.interp(0.0, s * log[sel, 2], stretch[sel]) for sel, s in ((up, 1), (down, -1))]
    assert np.subtract(*at_zero) == pytest.approx(2 * 0.2 / reset, rel=0.1)
    torque = (log[:, 5] - log[:, 6]) * m.jaw_radius
    level = 0.6e-3 + 0.015 * m.jaw_radius * (log[:, 5] + log[:, 6])
    assert torque[up].mean() == pytest.approx(level[up].mean(), rel=0.1)
    assert torque[down].mean() == pytest.approx(-level[down].mean(), rel=0.1)


def test_cable_hysteresis_loses_energy_over_a_cycle():
    turns = []
    for share in (1.0, 0.8):
        values = {"jaw_friction.constant": 0.0, "jaw_friction.tension_share": 0.0,
                  "slider_friction.constant": 0.0, "slider_friction.tension_share": 0.0,
                  "reset_cable.elastic_share": share}  # fmt: skip
        parameters = NOMINAL.with_values(values)
        t = np.arange(10_001) / 1000
        jaw = np.radians(40.0) * np.sin(2 * np.pi * t / 4)
        log = run(parameters, parameters.mechanism.motor_per_jaw * jaw, log_every=100)[200:601]
        stretch = parameters.mechanism.jaw_radius * log[:, 3] - log[:, 2]
        turns.append(abs(np.trapezoid(log[:, 6], stretch)))
    assert turns[1] > 1e-5 > 10 * turns[0]


@settings(max_examples=50)
@given(
    speed=st.floats(1e-3, 1e3), ratio=st.floats(1.0, 2.0), direction=st.sampled_from([-1.0, 1.0])
)
def test_steady_sliding_has_coulomb_stribeck_and_viscous_friction(speed, ratio, direction):
    parameters = NOMINAL.with_values({"jaw_friction.stribeck_ratio": ratio})
    f = plant_constants(parameters).jaw_law._replace(damping=1e-5)
    peak = 1 + (ratio - 1) * math.exp(-((speed / 0.3) ** 2))
    bristle = direction * f.presliding * peak
    force, rate = friction_force(direction * speed, bristle, 2e-3, f, 1e4)
    assert rate == pytest.approx(0.0, abs=1e-9 * speed)
    assert force == pytest.approx(direction * (2e-3 * peak + 1e-5 * speed), rel=1e-9)


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
    for _ in range(30_000):
        advance_motor(motor, np.full(3, 1000.0), DT, constants)
        speeds.append(motor[1])
    assert max(speeds) == pytest.approx(400.0)
    assert np.abs(np.diff(speeds)).max() <= 4000.0 * DT * (1 + 1e-9)
    assert motor[0] == pytest.approx(1000.0, abs=0.5)


def test_a_small_step_of_the_motor_is_that_of_a_second_order_loop():
    constants = plant_constants(NOMINAL)
    motor, step, n = np.zeros(2), 0.1, 200
    for _ in range(n):
        advance_motor(motor, np.full(3, step), DT, constants)
    w, zeta, t = 2 * np.pi * 15, 0.9, n * DT
    wd = w * math.sqrt(1 - zeta**2)
    decay = math.exp(-zeta * w * t)
    wanted = 1 - decay * (math.cos(wd * t) + zeta / math.sqrt(1 - zeta**2) * math.sin(wd * t))
    assert motor[0] == pytest.approx(step * wanted, rel=1e-7)
