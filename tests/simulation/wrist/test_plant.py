"""The compiled plant of cables and joints, against what statics and other solvers say."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from truejoint.robots import get_robot
from truejoint.robots.cable_mechanism import Forceps
from truejoint.simulation.wrist.parameters import WristParameters, plant_constants
from truejoint.simulation.wrist.plant import (
    advance,
    at_rest,
    dahl,
    empty_log,
    new_work,
    pull_cable,
    solve,
)

MECHANISM = get_robot("wrist", "400006").mechanism
LOOSE = WristParameters.read().with_values(  # but for the cables
    {f"joint_friction.{key}": 0.0 for key in ("tension_share", "constant")}
    | {f"motor.{key}": 0.0 for key in ("coulomb", "viscous")}
    | {"variation.eccentricity": 0.0}
)
SMOOTH = LOOSE.with_values({"cables.guide_friction": 0.0, "cables.wrist_friction": 0.0})
RUBBING = SMOOTH.with_values({"cables.guide_friction": 0.3, "cables.wrist_friction": 0.1})
EXACT = {"rtol": 1e-10, "atol": 1e-14}


def built(parameters, mechanism=MECHANISM, substeps=4):
    unlimited = np.outer([-np.inf, np.inf], np.ones(len(mechanism.pins)))
    return plant_constants(parameters, mechanism, unlimited, substeps)[0]


def run(c, goal, torque=None, held=-9.0, substeps=4):
    """Log of a motion (n, M) from rest, under steady torques (J,)."""
    state, work, log = at_rest(c), new_work(c), empty_log(len(goal), c)
    goal = np.vstack([np.zeros(goal.shape[1]), goal])
    acting = np.tile(np.zeros(len(c.inertia)) if torque is None else torque, (len(goal), 1))
    advance(c, state, work, goal, acting, np.full(len(goal), held), substeps, log)
    return log


def held_at(angles, rows=600):
    return np.tile(np.asarray(angles, dtype=float), (rows, 1))


def by_joint(c, values):
    """Numbers (C, J) of cables by joint, of those that list the joints that are moved first."""
    found = np.zeros(values.shape)
    np.put_along_axis(found, c.moved, values, 1)
    return found


def test_eccentric_pulleys_change_the_arms_with_the_angle():
    c = built(SMOOTH.with_values({"variation.eccentricity": 2e-4}))
    motor, torque = np.array([0.4, -0.3, 0.5]), np.array([0.01, 0.005, -0.01])
    moments, sine, cosine = (by_joint(c, v) for v in (c.moments, c.sine, c.cosine))
    assert np.abs(sine).max() > 1e-4
    whole = 1.0 / (1.0 / c.stiffness).sum(axis=1)

    def energy(q):
        let_go = moments @ q + sine @ np.sin(q) + cosine @ (np.cos(q) - 1.0)
        stretch = 16.0 / whole + c.capstan * motor[c.motor_of] - let_go
        return 1e3 * (0.5 * whole @ stretch**2 - torque @ q)

    log = run(c, held_at(motor), torque)
    # What is at rest has the least energy, which no derivative of ours says.
    steps = 1e-4 * np.eye(3)
    slope = [(energy(log.joint[-1] + s) - energy(log.joint[-1] - s)) / 2e-4 for s in steps]
    np.testing.assert_allclose(slope, 0.0, atol=1e-2)  # of mNm


def test_without_friction_a_load_gives_what_the_cables_compliance_says():
    c, torque = built(SMOOTH), np.array([0.02, -0.01, 0.015])
    motor = np.array([0.2, -0.1, 0.3])
    log = run(c, held_at(motor), torque)
    # A cable in series, and the balance of both legs of every loop, in closed form.
    moments = by_joint(c, c.moments)
    whole = 1.0 / (1.0 / c.stiffness).sum(axis=1)
    wound = c.capstan * motor[c.motor_of]
    stiffness = (moments.T * whole) @ moments
    pretension = 16.0 * moments.sum(axis=0)
    joint = np.linalg.solve(stiffness, (moments.T * whole) @ wound + pretension + torque)
    np.testing.assert_allclose(log.joint[-1], joint, atol=1e-6)
    tension = 16.0 + whole * (wound - moments @ joint)
    np.testing.assert_allclose(log.tension[-1], tension, rtol=1e-4)
    effort = [(c.capstan * tension)[c.motor_of == m].sum() for m in range(3)]
    np.testing.assert_allclose(log.effort[-1], effort, atol=1e-6)


@pytest.mark.parametrize("travel", [5e-5, -5e-5])
def test_a_sliding_cable_has_the_capstans_ratio_of_tensions(travel):
    c = built(RUBBING)
    work, nodes = new_work(c), np.zeros((6, 2))
    q = np.array([0.4, 0.0, 0.0])
    number = 2  # its moment about the pitch is positive: 0.4 rad of it shorten the wrap
    assert c.moments[number, 0] > 0.0
    for share in np.linspace(0.0, 1.0, 200):
        stiffness = pull_cable(number, share * travel, 0.0, c, q, nodes, work)
    ratios = np.exp([0.3 * 1.0, 0.1 * (1.6 - 0.4)])
    found = work.pull[:-1] / work.pull[1:]
    np.testing.assert_allclose(found, ratios ** math.copysign(1.0, travel), rtol=1e-3)
    # The tangent is what a small motion of the joints, the same way on, does to the last tension.
    for _ in range(100):
        pull_cable(number, travel, 0.0, c, q, nodes, work)
    before, small = work.pull[2], math.copysign(1e-7, travel)
    for _ in range(100):
        pull_cable(number, travel, small, c, q, nodes, work)
    assert (before - work.pull[2]) / small == pytest.approx(stiffness, rel=1e-3)
    assert stiffness < 0.95 * c.stiffness[number, 2]


def test_a_cable_that_was_slack_pulls_all_along_once_it_is_wound_up():
    c = built(RUBBING)
    work, nodes, q = new_work(c), np.zeros((6, 2)), np.zeros(3)
    for wound in (-1e-3, 0.0, 3e-4):  # let go by far more than its stretch, then wound up at once
        for _ in range(40):
            pull_cable(3, wound, 0.0, c, q, nodes, work)
        if wound < 0.0:
            assert work.pull.max() < 1e-6
    ratios = np.exp([0.3, 0.16])
    np.testing.assert_allclose(work.pull[:-1] / work.pull[1:], ratios, rtol=1e-3)
    # Whatever way it came, its segments are stretched by what was wound up and by pretension.
    stretch = (work.pull / c.stiffness[3]).sum()
    assert stretch == pytest.approx(3e-4 + c.slack[3].sum(), rel=1e-9)


def test_a_cable_pulls_and_never_pushes():
    c = built(WristParameters.read())
    log = run(c, held_at([0.0, 0.0, 0.0]), np.array([0.0, 0.25, 0.0]))
    assert 0.0 <= log.tension.min() < 1e-9
    assert np.isfinite(log.joint).all()
    assert log.joint[-1, 1] > 0.05


def test_motors_follow_as_their_equation_says():
    c = built(SMOOTH)
    t = np.arange(1, 401) * 1e-3
    goal = np.column_stack([0.3 * np.sin(20.0 * t), 0.1 * t, np.zeros_like(t)])
    log = run(c, goal)
    w, z = 2.0 * math.pi * 15.0, 0.9

    def rates(at, state):
        wanted = np.interp(at, np.r_[0.0, t], np.r_[0.0, goal[:, 0]])
        return [state[1], w * w * (wanted - state[0]) - 2.0 * z * w * state[1]]

    found = solve_ivp(rates, (0.0, t[-1]), [0.0, 0.0], t_eval=t, max_step=5e-4, rtol=1e-9)
    np.testing.assert_allclose(log.motor[:, 0], found.y[0], atol=1e-6)


def test_dahl_is_the_solution_of_its_equation():
    found = solve_ivp(lambda _x, g: 2.0 * (1.0 - g / 0.005), (0.0, 0.004), [-0.003], **EXACT)
    assert dahl(-0.003, 0.005, 2.0, 0.004) == pytest.approx(found.y[0, -1], rel=1e-6)
    back = solve_ivp(lambda _x, g: -2.0 * (1.0 + g / 0.005), (0.0, 0.001), [0.004], **EXACT)
    assert dahl(0.004, 0.005, 2.0, -0.001) == pytest.approx(back.y[0, -1], rel=1e-6)
    assert dahl(0.004, 0.005, 2.0, 0.0) == 0.004
    assert dahl(0.004, 1e-6, 2.0, 0.001) == pytest.approx(1e-6)
    assert dahl(0.004, 0.0, 2.0, 0.001) == 0.0  # as of ever weaker friction
    assert dahl(0.004, 0.0, 2.0, 0.0) == 0.004


def test_small_systems_are_solved():
    rng = np.random.default_rng(1)
    half, right = rng.normal(size=(4, 4)), rng.normal(size=4)
    matrix = half @ half.T + np.eye(4)
    found = right.copy()
    solve(matrix.copy(), found)
    np.testing.assert_allclose(found, np.linalg.solve(matrix, right))


@pytest.mark.parametrize("law", ["dahl", "maxwell_slip"])
def test_a_finer_step_moves_the_joints_little(law):
    p = WristParameters.read().with_values({"joint_friction.law": law})
    t = np.arange(1, 1201) * 1e-3
    blend = np.sin(2.0 * math.pi * t) * np.minimum(t / 0.2, 1.0)
    goal = blend[:, None] * np.array([0.4, -0.3, 0.3])
    coarse, fine = (run(built(p, substeps=n), goal, substeps=n).joint for n in (4, 32))
    off = np.degrees(np.sqrt(np.mean((coarse - fine) ** 2, axis=0)))
    assert (off < 0.015).all()


def test_effort_of_a_sliding_loop_tells_its_capstans_exponent():
    c = built(LOOSE)
    t = np.arange(1, 1001) * 1e-3
    log = run(c, (0.4 * t)[:, None] * np.array([0.0, 1.0, 0.0]))
    # Both legs slide, e^f T before and T behind, T e^-f and T: the difference at the motor is
    # tanh f of the sum.
    legs = log.tension[-1, 2:4]
    assert abs(np.diff(legs)[0]) / legs.sum() == pytest.approx(math.tanh(0.24 + 0.16), rel=0.02)


def test_jaws_press_on_what_they_hold_as_hard_as_it_is_stiff():
    c = built(WristParameters.read())
    opening, closed = 0.4, MECHANISM.coupling @ np.array([0.0, -0.1, 0.1])
    log = run(c, held_at(closed), held=opening)
    pressed = opening - (log.joint[-1, 2] - log.joint[-1, 1])
    assert log.grip[-1] == pytest.approx(1.5 * pressed, rel=1e-3)
    assert log.grip[-1] > 0.05
    open_jaws = run(c, held_at(closed), held=-1.0)
    assert open_jaws.grip.max() == 0.0
    assert abs(log.effort[-1, 1] - open_jaws.effort[-1, 1]) > 0.02


def test_a_joint_ends_at_its_stops_as_stiff_as_they_are():
    """Without friction, its torque is that of the cables behind, which statics tells."""
    motor = held_at([0.5, 0.2, -0.6], 1500)
    free = run(built(SMOOTH), motor).joint[-1]
    assert np.abs(free).min() > 0.1
    end = np.array([0.6, 0.0, 0.6]) * free  # a stop on the way, but for the first jaw
    lower = np.where((end < 0.0), end, -9.0)
    upper = np.where((end > 0.0), end, 9.0)
    log = run(plant_constants(SMOOTH, MECHANISM, (lower, upper))[0], motor)
    depth = log.joint[-1] - end - SMOOTH.stops.beyond * np.sign(end)
    torque = -SMOOTH.stops.stiffness * np.where(end == 0.0, 0.0, depth)
    assert (np.abs(torque)[[0, 2]] > 0.02).all()
    pushed = run(built(SMOOTH), motor, torque)
    np.testing.assert_allclose(pushed.joint[-1], log.joint[-1], atol=1e-5)
    np.testing.assert_allclose(pushed.effort[-1], log.effort[-1], atol=1e-4)


def test_a_cable_that_ends_at_a_spring_is_the_one_jaw_forceps():
    p = SMOOTH.with_values({f"variation.{key}": 0.0 for key in ("stiffness", "moment", "capstan")})
    log = run(built(p, Forceps(gear_ratio=1.0).mechanism()), held_at([0.3]))
    # Statics of yan2020: the drive cable against spring and reset cable in series.
    drive = p.cables.stiffness
    reset = 1.0 / (1.0 / p.cables.stiffness + 1.0 / 656.6)
    joint = drive * 9.75e-3 * 0.3 / ((drive + reset) * 4e-3)
    assert log.joint[-1, 0] == pytest.approx(joint, rel=1e-5)
