"""The RAVEN-II twin against physics worked out on their own, and against peng2024."""

import math
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from truejoint.errors import TruejointError
from truejoint.motion import random_motion
from truejoint.robots import get_robot
from truejoint.robots.blocks import QUANTITIES
from truejoint.robots.raven2.hardware import ENCODER_COUNTS_PER_REV, drives, links
from truejoint.simulation.arm.kernel import gravity_load
from truejoint.simulation.raven2 import Raven2Parameters, Raven2Twin
from truejoint.studies.raven2.sessions import JOINTS, record, zigzags
from truejoint.studies.raven2.sessions import homed as homed_arm

DEG = math.pi / 180.0
SHOWN = np.array([1 / DEG, 1 / DEG, 1e3])
ELBOW = 1


def nominal(**changes):
    """Parameters without anything random or slow, and with `changes` by section__key."""
    plain = {
        "homing.registration_sd": (0.0, 0.0, 0.0),
        "motor_friction.wander": 0.0,
        "motor_friction.warm_up": 0.0,
        "creep.final": (0.0, 0.0, 0.0),
    }
    plain |= {name.replace("__", "."): value for name, value in changes.items()}
    return Raven2Parameters.read().with_values(plain)


def smooth():
    """Changes that take the geometry's imperfections away."""
    names = [f"pulleys__{name}" for name in ("scale", "capstan_run_out", "joint_run_out")]
    names += [f"wrap__sideways_{joint}" for joint in ("shoulder", "elbow", "insertion")]
    ripple = {f"motor_friction__{part}_ripple": 0.0 for part in ("capstan", "gear")}
    return dict.fromkeys(names, (0.0, 0.0, 0.0)) | ripple


def homed(parameters=None, **options):
    twin = Raven2Twin(parameters, **options)  # type: ignore[arg-type]
    twin.home()
    return twin


def held(twin, seconds):
    return twin.run(np.tile(twin.robot.home, (round(seconds * 1000), 1)))


def sway(twin, seconds, period=8.0):
    """Smooth motion of the positioning joints about the home pose."""
    t = np.arange(round(seconds * 1000)) * 1e-3
    goal = np.tile(twin.robot.home, (len(t), 1))
    amplitude = np.array([4 * DEG, 5 * DEG, 0.01])
    goal[:, :3] += amplitude * np.sin(2 * np.pi * t[:, None] / (period * np.array([1, 1.3, 1.7])))
    return goal


def strokes(twin, joint, amplitude, speed, cycles):
    """Triangular strokes of one joint about the home pose, at constant speed."""
    quarter = round(amplitude / speed * 1000)
    corners = np.resize([0.0, 1.0, 0.0, -1.0], 4 * cycles + 1)
    wave = np.interp(np.arange(4 * quarter * cycles), quarter * np.arange(len(corners)), corners)
    goal = np.tile(twin.robot.home, (len(wave), 1))
    goal[:, joint] += amplitude * wave
    return goal


def test_sensors_have_the_robots_resolutions_and_rates():
    twin = homed(seed=1)
    out = twin.run(sway(twin, 20.0))
    counts = np.diff(out.motor, axis=0) * ENCODER_COUNTS_PER_REV / (2 * np.pi)
    np.testing.assert_allclose(counts, np.rint(counts), atol=1e-6)
    speed = np.diff(out.motor, axis=0) / 1e-3
    np.testing.assert_allclose(out.motor_velocity[1:], speed, rtol=0, atol=1e-6)
    joints = twin.robot.joint_channels
    nominal_joint = twin.robot.transmission.joint_from_motor(out.motor[:, joints])
    np.testing.assert_allclose(out.measured[:, joints], nominal_joint, atol=1e-12)
    for k, encoder in enumerate(get_robot("raven2").encoders):
        steps = (out.truth.position[:, k] - out.truth.position[0, k]) / encoder.resolution
        np.testing.assert_allclose(steps, np.rint(steps), atol=1e-6)
        true = np.interp(out.truth.t - 2e-3, out.t, out.joint[:, k])
        assert np.abs(out.truth.position[:, k] - true).max() < 0.51 * encoder.resolution
    np.testing.assert_allclose(np.diff(out.t), 1e-3, atol=1e-9)
    interval = np.diff(out.truth.t)
    assert interval.min() > 0
    assert interval.mean() == pytest.approx(0.01, rel=0.01)
    assert interval.std() == pytest.approx(4e-4, rel=0.15)
    assert twin.robot.channels[3] == "unused"
    for name in ("measured", "velocity", "motor", "motor_velocity", "effort", "setpoint"):
        assert not getattr(out, name)[:, 3].any()


def test_stamps_of_the_state_jitter_and_keep_their_order():
    still, jittering = (homed(nominal(state_stream__jitter=j), seed=1) for j in (0.0, 3e-4))
    goal = sway(still, 5.0)
    exact, out = still.run(goal), jittering.run(goal)
    np.testing.assert_array_equal(out.measured, exact.measured)
    late = out.t - exact.t
    assert late.std() == pytest.approx(2.6e-4, rel=0.1)  # the largest are cut off
    assert np.abs(late).max() < 4.51e-4
    assert np.diff(out.t).min() > 0.0
    again = homed(nominal(state_stream__jitter=3e-4), seed=1)
    pieces = np.concatenate([again.run(goal[a:b]).t for a, b in pairwise((0, 1, 777, 5000))])
    np.testing.assert_array_equal(pieces, out.t)


def height_of_links(q, instrument):
    """m g h [J] of the left arm's links, from the mechanism's drawing: twists 75 and 128 deg."""
    t1, t2 = q[0] + 205 * DEG, q[1] + 180 * DEG
    twist1, twist2 = 75 * DEG, 128 * DEG
    total = 0.0
    for k, (link, centre) in enumerate(zip(*links("left"), strict=True)):
        x, y, z = centre
        mass = link + (instrument if k == 2 else 0.0)
        if k == 2:  # along the shaft, from frame 3 to frame 2
            x, y, z = 0.0, -math.sin(twist2) * q[2], math.cos(twist2) * q[2]
        if k >= 1:  # frame 2 to frame 1
            x, y = math.cos(t2) * x - math.sin(t2) * y, math.sin(t2) * x + math.cos(t2) * y
            y = math.cos(twist1) * y - math.sin(twist1) * z
        total += mass * 9.8 * (math.cos(t1) * x - math.sin(t1) * y)
    return total


def gravity_at(twin, joint):
    """Joint efforts [Nm, Nm, N] that hold the links in a pose."""
    out = np.empty(3)
    trig = [np.array([math.cos(a), math.sin(a)]) for a in joint[:2]]
    gravity_load(twin._plant.gravity, 0.0, trig[0], trig[1], joint[2], out)
    return out


@pytest.mark.parametrize("pose", [(0.5, 1.3, 0.38), (0.9, 0.9, 0.42), (0.0, 2.2, 0.55)])
def test_gravity_of_the_links_is_the_slope_of_their_height(pose):
    twin = Raven2Twin()
    mass = twin.parameters.mass.instrument
    q = np.array(pose)
    above, below = ([height_of_links(q + s * e, mass) for e in np.eye(3)] for s in (1e-6, -1e-6))
    slope = np.subtract(above, below) / 2e-6
    np.testing.assert_allclose(gravity_at(twin, q), slope, atol=1e-7)


@pytest.mark.parametrize("arm", ["left", "right"])
def test_a_load_stretches_the_cables_by_force_over_stiffness(arm):
    no_friction = {"joint_friction__coulomb": (0.0,) * 3, "joint_friction__load_share": (0.0,) * 3}
    still = nominal(**smooth(), **no_friction)
    twin = homed(still, arm=arm, seed=2)
    there = np.array([0.35, 0.96, 0.33, *twin.robot.home[3:]])
    twin.run(np.linspace(twin.robot.home, there, 3000))
    arm_drives, hold = drives(arm)[:3], np.tile(there, (3000, 1))
    before = twin.run(hold)
    motors = twin._state.motor[:3].copy()  # finer than the encoders
    twin.load = 1.0
    after = twin.run(hold)
    given_way = twin._state.motor[:3] - motors

    # By hand: force on the tool through the Jacobian to joint efforts, through the
    # transposed coupling to cable loads, over the stiffness to stretch, and back.
    q = twin.robot.home.copy()
    q[:3] = before.joint[-1]
    weight = 1.0 * 9.8  # against it the arm pushes along +x of frame 0
    efforts = weight * twin.robot.kinematics.jacobian(q)[0, :3]
    # The links weigh differently where the load has taken them.
    efforts += gravity_at(twin, after.joint[-1]) - gravity_at(twin, before.joint[-1])
    pulleys = still.pulleys
    coupling = np.eye(3)
    coupling[1, 0] = 0.14545 + pulleys.coupling_shoulder_elbow
    coupling[2, 0] = 0.0077973826 + pulleys.coupling_shoulder_insertion
    coupling[2, 1] = 0.008077387 + pulleys.coupling_elbow_insertion
    stretch = np.linalg.solve(coupling.T, efforts) / np.array(still.cable.stiffness)
    by_hand = -np.linalg.solve(coupling, stretch)

    # What the motors gave way by reached the joints with their scale error.
    cables = given_way / [drive.transmission_ratio for drive in arm_drives]
    gave = np.linalg.solve(coupling, (1 + np.array(pulleys.scale)) * cables)
    moved = after.joint[-1] - before.joint[-1] - gave
    assert (np.abs(moved - by_hand) < 0.01 * np.abs(by_hand) + [3e-7, 3e-7, 1e-7]).all()


def test_effort_carries_gravity_friction_and_speed():
    twin = homed(nominal(**smooth()), seed=2)
    speed = 3 * DEG
    out = twin.run(strokes(twin, ELBOW, 6 * DEG, speed, 2))
    p = twin.parameters
    drive = drives("left")[ELBOW]
    found = {}
    for direction in (1.0, -1.0):
        # A window in the middle of a stroke of the second cycle.
        rows = np.abs(out.measured[:, ELBOW] - twin.robot.home[ELBOW]) < 0.5 * DEG
        rows &= np.sign(np.gradient(out.setpoint[:, ELBOW])) == direction
        rows[: len(rows) // 2] = False
        assert rows.sum() > 200
        found[direction] = out.effort[rows, ELBOW].mean()
        gravity = gravity_at(twin, out.joint[rows].mean(axis=0))
        # The elbow carries itself, less what the insertion's cable puts on it.
        slide = gravity[2]  # the insertion rests: its friction may take any part of this
        friction = p.joint_friction.coulomb[ELBOW] + 0.06 * abs(gravity[ELBOW])
        coupling = 0.008077387 + p.pulleys.coupling_elbow_insertion
        load = gravity[ELBOW] + direction * friction - coupling * slide
        per_gear = drive.gear_ratio / drive.transmission_ratio
        motor = p.motor_friction.coulomb[ELBOW] + 0.1 * abs(load) * per_gear
        viscous = p.motor_friction.viscous[ELBOW] * speed * drive.transmission_ratio
        expected = load * per_gear + direction * (motor + viscous)
        assert found[direction] == pytest.approx(expected, abs=0.008)
    assert found[1.0] - found[-1.0] > 0.15  # twice the friction: direction shows in the command


def loop(twin, speed):
    """Error of the elbow on a grid of measured positions: up, down, and up one cycle later."""
    out = twin.run(strokes(twin, ELBOW, 6 * DEG, speed, 3))
    grid = twin.robot.home[ELBOW] + np.linspace(-3, 3, 13) * DEG
    going = np.sign(np.gradient(out.setpoint[:, ELBOW]))
    error = out.joint[:, ELBOW] - out.measured[:, ELBOW]
    cycle = len(error) // 3
    branches = []
    for start, direction in ((cycle, 1.0), (cycle, -1.0), (2 * cycle, 1.0)):
        rows = np.zeros(len(error), dtype=bool)
        rows[start : start + cycle] = True
        rows &= going == direction
        order = np.argsort(out.measured[rows, ELBOW], kind="stable")
        branches.append(np.interp(grid, out.measured[rows, ELBOW][order], error[rows][order]))
    return branches[0], branches[1], branches[2]


def test_hysteresis_closes_whatever_the_speed_and_is_as_wide_as_friction_makes_it():
    widths = []
    for speed in (1.0 * DEG, 3.0 * DEG):
        twin = homed(nominal(), seed=7)
        up, down, again = loop(twin, speed)
        np.testing.assert_allclose(again, up, atol=0.004 * DEG)
        widths.append(down - up)
    np.testing.assert_allclose(widths[0], widths[1], atol=0.006 * DEG)
    p = twin.parameters
    wide = 2 * p.joint_friction.coulomb[ELBOW] / p.cable.stiffness[ELBOW]
    assert widths[0].mean() == pytest.approx(wide, rel=0.15)


def test_a_load_changes_how_wide_the_hysteresis_is():
    sticky = nominal(joint_friction__load_share=(0.06, 0.5, 0.06))
    width = []
    for load in (0.0, 2.0):
        twin = homed(sticky, seed=7, load=load)
        up, down, _ = loop(twin, 2.0 * DEG)
        width.append((down - up).mean())
    assert abs(width[1] - width[0]) > 0.05 * width[0]


def test_homing_ends_at_home_and_offsets_by_the_zero_conventions():
    twin = homed(nominal(homing__registration_bias=(0.0, 0.0, 0.0), **smooth()), seed=1)
    out = held(twin, 0.5)
    error = (out.joint - out.measured[:, :3]).mean(axis=0) * SHOWN
    assert np.abs((out.measured[-1, :3] - twin.robot.home[:3]) * SHOWN).max() < 1.5
    # 130 - 137.5 deg and 572.467 - 562 mm. The coupling error of the elbow adds 0.0432 * 30 deg,
    # and the torque that finds a stop, less friction, leaves cables stretched at registration:
    # (0.568 - 0.04) Nm * 9.92 / 400 Nm/rad is 0.75 deg, less gravity's 0.1 to 0.3 deg.
    assert error[0] == pytest.approx(0.0, abs=0.5)
    assert error[1] == pytest.approx(-7.5 + 1.3 + 0.6, abs=0.5)
    # (0.433 - 0.04) Nm / 5.675 mm / 18500 N/m is 3.7 mm, less 0.3 mm of friction.
    assert error[2] == pytest.approx(10.467 + 3.4, abs=1.0)
    assert twin.homing_count == 1


def test_homing_draws_a_fresh_offset_each_time(monkeypatch):
    sd, offsets, draws = (0.01, 0.01, 1e-3), [], []  # large: friction does little beside them
    twin = Raven2Twin(nominal(homing__registration_sd=sd, **smooth()), seed=11)
    generator = twin._rng

    def draw(count):
        draws.append(generator.standard_normal(count))
        return draws[-1]

    monkeypatch.setattr(twin, "_rng", SimpleNamespace(standard_normal=draw))
    for _ in range(4):
        out = twin.home()
        assert np.abs((out.measured[-1, :3] - twin.robot.home[:3]) * SHOWN).max() < 1.5
        offsets.append((out.joint[-500:] - out.measured[-500:, :3]).mean(axis=0))
    assert np.shape(draws) == (4, 3)
    off = (offsets - np.mean(offsets, axis=0)) / sd
    np.testing.assert_allclose(off, np.mean(draws, axis=0) - draws, rtol=0, atol=0.1)
    assert twin.homing_count == 4


def test_cables_creep_with_work_more_under_load_and_not_at_rest():
    quick = {"creep.travel": (3.0, 4.0, 0.4), "homing.registration_sd": (0.0, 0.0, 0.0)}
    fast = Raven2Parameters.read().with_values(quick)

    def drift(load, work):
        twin = homed(fast, seed=4, load=load)
        goal, errors = sway(twin, 60.0), []
        for number in range(7):
            if number in (0, 6):
                out = twin.run(goal[:28_000])
                errors.append((out.joint - out.measured[:, :3])[8000:].mean(axis=0))
            elif work:
                twin.run(goal)
            else:
                twin.idle(3600.0)
        return errors[1] - errors[0]

    rest, work, loaded = drift(0.0, False), drift(0.0, True), drift(0.5, True)
    final = np.array(fast.creep.final)
    assert (np.abs(work) > 0.2 * np.abs(final)).all()
    assert (np.sign(work) == np.sign(final)).all()
    assert (np.abs(loaded) > 1.2 * np.abs(work)).all()
    # Both drift while they are looked at; five hours of rest add nearly nothing to that.
    assert (np.abs(rest) < 0.6 * np.abs(work)).all()


def test_six_idle_hours_do_not_move_the_arm():
    twin = homed(seed=4)
    before = held(twin, 2.0)
    twin.idle(6 * 3600.0)
    after = held(twin, 2.0)
    assert after.t[0] - before.t[-1] == pytest.approx(6 * 3600.0 + 1e-3)
    assert after.truth.t[0] > 6 * 3600.0
    error = [out.joint[-1] - out.measured[-1, :3] for out in (before, after)]
    assert (np.abs((error[1] - error[0]) * SHOWN) < 0.03).all()


def test_the_tool_holds_while_the_insertion_turns_its_motors():
    twin = homed(seed=6)
    goal = np.tile(twin.robot.home, (20_000, 1))
    goal[:, 2] += 0.02 * np.sin(2 * np.pi * np.arange(20_000) / 20_000)
    out = twin.run(goal)
    off = out.measured[3000:, 4:] - twin.robot.home[3:]
    assert np.abs(off).max() < 4 * DEG
    assert np.ptp(out.measured[3000:, 4:], axis=0).min() > 0.02 * DEG
    assert np.ptp(out.motor[:, 4:], axis=0).min() > 1.0


def test_a_tool_wanders_and_is_left_elsewhere_by_every_homing():
    wander, registered = np.full(4, 0.2 * DEG), np.full(4, 1.0 * DEG)
    how = {"wander": tuple(wander), "registration_sd": tuple(registered), "wander_time": 2.0}
    moving = nominal(**{f"tool__{name}": value for name, value in how.items()})
    twin, still = Raven2Twin(moving, seed=4), Raven2Twin(nominal(), seed=4)
    left_at = []
    for number in range(5):
        twin.home()
        hold = held(twin, 20.0)
        if number < 2:  # what the tool draws changes no random number of the rest of the arm
            still.home()
            np.testing.assert_array_equal(held(still, 20.0).truth.t, hold.truth.t)
        tool = hold.measured[5000:, 4:]
        left_at.append(tool.mean(axis=0) - twin.robot.home[3:])
        # Each joint on its own: not all by the same insertion.
        assert (np.abs(np.corrcoef(tool.T)[np.triu_indices(4, 1)]) < 0.95).all()
    assert np.std(left_at) == pytest.approx(1.0 * DEG, rel=0.35)
    assert tool.std(axis=0).mean() == pytest.approx(0.2 * DEG, rel=0.5)


def test_a_load_of_the_tools_cables_shows_in_its_torque_command():
    loaded = nominal(tool__wander_effort=(0.01,) * 4, tool__wander_time=5.0)
    efforts = [held(homed(p, seed=4), 60.0).effort[:, 4:].std(axis=0) for p in (loaded, nominal())]
    assert efforts[0] == pytest.approx(np.full(4, 0.01), rel=0.6)
    assert (efforts[1] < 0.3 * efforts[0]).all()


@pytest.mark.parametrize(
    ("specimen", "profile"), [("nominal", "cosine"), ("peng2024", "laboratory")]
)
def test_raw_and_fixed_offset_errors_are_those_of_table_1(specimen, profile):
    """peng2024, Table I, direction J2-J3: the two rows that the twin was fitted to."""
    arm, _ = homed_arm(Raven2Parameters.read(specimen).to_dict(), 0)
    runs = zigzags(arm, (4,))
    runs.append(record(arm, random_motion(arm.robot, 600.0, seed=1, profile=profile)))
    errors = [run.with_truth(JOINTS).error(JOINTS) * SHOWN for run in runs]
    offset = errors[0].mean(axis=0)
    raw = np.sqrt((errors[1] ** 2).mean(axis=0))
    fixed = np.sqrt(((errors[1] - offset) ** 2).mean(axis=0))
    np.testing.assert_allclose(raw, [2.103, 7.963, 11.715], rtol=0.15)
    np.testing.assert_allclose(fixed, [0.859, 1.095, 0.492], rtol=0.15)


def test_parameters_that_the_step_cannot_resolve_are_refused():
    light = Raven2Parameters.read().with_values({"motor.inertia": (1e-6, 1e-6, 1e-6)})
    Raven2Twin(light)
    stiff = light.with_values({"cable.stiffness": (1e5, 400.0, 18500.0)})
    with pytest.raises(TruejointError, match="shoulder's motor is too light"):
        Raven2Twin(stiff)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32), jump=st.floats(0.0, 1.0), load=st.floats(0.0, 2.0))
def test_no_command_makes_the_twin_leave_what_is_possible(seed, jump, load):
    twin = Raven2Twin(seed=seed, load=load)
    rng = np.random.default_rng(seed)
    wild = twin.robot.home + jump * rng.standard_normal((20, 7)) * [2, 2, 0.5, 2, 2, 2, 2]
    out = twin.run(np.repeat(wild, 50, axis=0))
    assert all(np.isfinite(getattr(out, name)).all() for name in ("t", "joint", *QUANTITIES))
    assert np.isfinite(out.truth.position).all()
    limits = np.array([drive.max_effort for drive in drives("left")])
    assert (np.abs(out.effort[:, twin.robot.joint_channels]) <= limits * 1.001).all()
    assert (out.joint >= twin._plant.stops[:, 0]).all()
    assert (out.joint <= twin._plant.stops[:, 1]).all()


def test_homing_that_finds_no_stop_says_so():
    # The search winds 0.5 m of cable at most, which pulls 10 N: far below the threshold of 76 N.
    slack = Raven2Parameters.read().with_values({"cable.stiffness": (1500.0, 400.0, 20.0)})
    with pytest.raises(TruejointError, match="no hard stop for insertion within 25 s"):
        Raven2Twin(slack).home()
