"""The RAVEN-II twin against physics worked out on their own, and against peng2024."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from truejoint.errors import TruejointError
from truejoint.robots.raven2.hardware import ENCODER_COUNTS_PER_REV, JOINT_ENCODERS, drives, links
from truejoint.simulation import TwinOutput
from truejoint.simulation.raven2 import Raven2Parameters, Raven2Twin
from truejoint.simulation.raven2.kernel import gravity_load
from truejoint.simulation.raven2.plant import gravity_potential

Array = NDArray[np.float64]
DEG = math.pi / 180.0
SHOWN = np.array([1 / DEG, 1 / DEG, 1e3])
ELBOW = 1


def nominal(**changes: object) -> Raven2Parameters:
    """Parameters without anything random or slow, and with `changes` by section__key."""
    plain: dict[str, object] = {
        "homing.registration_sd": (0.0, 0.0, 0.0),
        "motor_friction.wander": 0.0,
        "motor_friction.warm_up": 0.0,
        "creep.final": (0.0, 0.0, 0.0),
    }
    plain |= {name.replace("__", "."): value for name, value in changes.items()}
    return Raven2Parameters.read().with_values(plain)


def smooth() -> dict[str, object]:
    """Changes that take the geometry's imperfections away."""
    return {
        "pulleys__scale": (0.0, 0.0, 0.0),
        "pulleys__capstan_run_out": (0.0, 0.0, 0.0),
        "pulleys__joint_run_out": (0.0, 0.0, 0.0),
        "wrap__sideways_shoulder": (0.0, 0.0, 0.0),
        "wrap__sideways_elbow": (0.0, 0.0, 0.0),
        "wrap__sideways_insertion": (0.0, 0.0, 0.0),
        "motor_friction__capstan_ripple": 0.0,
        "motor_friction__gear_ripple": 0.0,
    }


def homed(parameters: Raven2Parameters | None = None, **options: object) -> Raven2Twin:
    twin = Raven2Twin(parameters, **options)  # type: ignore[arg-type]
    twin.home()
    return twin


def sway(twin: Raven2Twin, seconds: float, period: float = 8.0) -> Array:
    """Smooth motion of the positioning joints about the home pose."""
    t = np.arange(round(seconds * 1000)) * 1e-3
    goal = np.tile(twin.robot.home, (len(t), 1))
    amplitude = np.array([4 * DEG, 5 * DEG, 0.01])
    goal[:, :3] += amplitude * np.sin(2 * np.pi * t[:, None] / (period * np.array([1, 1.3, 1.7])))
    return goal


def strokes(twin: Raven2Twin, joint: int, amplitude: float, speed: float, cycles: int) -> Array:
    """Triangular strokes of one joint about the home pose, at constant speed."""
    quarter = round(amplitude / speed * 1000)
    wave = np.interp(
        np.arange(4 * quarter * cycles),
        quarter * np.arange(0, 4 * cycles + 1),
        np.tile([0.0, 1.0, 0.0, -1.0], cycles + 1)[: 4 * cycles + 1],
    )
    goal = np.tile(twin.robot.home, (len(wave), 1))
    goal[:, joint] += amplitude * wave
    return goal


def arrays(output: TwinOutput) -> dict[str, Array]:
    flat = {**vars(output), "truth_t": output.truth.t, "truth": output.truth.position}
    return {name: values for name, values in flat.items() if isinstance(values, np.ndarray)}


# ------------------------------------------------------------------------------- sensors


def test_sensors_have_the_robots_resolutions_and_rates() -> None:
    twin = homed(seed=1)
    out = twin.run(sway(twin, 20.0))
    counts = np.diff(out.motor, axis=0) * ENCODER_COUNTS_PER_REV / (2 * np.pi)
    np.testing.assert_allclose(counts, np.rint(counts), atol=1e-6)
    np.testing.assert_allclose(
        out.motor_velocity[1:], np.diff(out.motor, axis=0) / 1e-3, rtol=0, atol=1e-6
    )
    for k, encoder in enumerate(JOINT_ENCODERS):
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


def test_stamps_of_the_state_jitter_and_keep_their_order() -> None:
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


def test_measured_is_the_nominal_transmission_of_the_motors() -> None:
    twin = homed(seed=1)
    out = twin.run(sway(twin, 2.0))
    joints = [0, 1, 2, 4, 5, 6, 7]
    transmission = twin.robot.transmission
    assert transmission is not None
    np.testing.assert_allclose(
        out.measured[:, joints], transmission.joint_from_motor(out.motor[:, joints]), atol=1e-12
    )


# ------------------------------------------------------------------------------- statics


def height_of_links(q: Array, instrument: float) -> float:
    """m g h [J] of the left arm's links, from the mechanism's drawing: twists 75 and 128 deg."""
    t1, t2 = q[0] + 205 * DEG, q[1] + 180 * DEG
    twist1, twist2 = 75 * DEG, 128 * DEG
    total = 0.0
    for k, link in enumerate(links("left")):
        x, y, z = link.centre_of_mass
        mass = link.mass + (instrument if k == 2 else 0.0)
        if k == 2:  # along the shaft, from frame 3 to frame 2
            x, y, z = 0.0, -math.sin(twist2) * q[2], math.cos(twist2) * q[2]
        if k >= 1:  # frame 2 to frame 1
            x, y = math.cos(t2) * x - math.sin(t2) * y, math.sin(t2) * x + math.cos(t2) * y
            y = math.cos(twist1) * y - math.sin(twist1) * z
        total += mass * 9.8 * (math.cos(t1) * x - math.sin(t1) * y)
    return total


def gravity_at(twin: Raven2Twin, joint: Array) -> Array:
    """Joint efforts [Nm, Nm, N] that hold the links in a pose."""
    out = np.empty(3)
    trig = [np.array([math.cos(a), math.sin(a)]) for a in joint[:2]]
    potential = gravity_potential(twin.robot, twin.parameters.mass.instrument)
    gravity_load(potential, 0.0, trig[0], trig[1], joint[2], out)
    return out


@pytest.mark.parametrize("pose", [(0.5, 1.3, 0.38), (0.9, 0.9, 0.42), (0.0, 2.2, 0.55)])
def test_gravity_of_the_links_is_the_slope_of_their_height(pose: tuple[float, ...]) -> None:
    twin = Raven2Twin()
    mass = twin.parameters.mass.instrument
    q = np.array(pose)
    step = 1e-6
    slope = [
        (height_of_links(q + step * e, mass) - height_of_links(q - step * e, mass)) / (2 * step)
        for e in np.eye(3)
    ]
    np.testing.assert_allclose(gravity_at(twin, q), slope, atol=1e-7)


@pytest.mark.parametrize("arm", ["left", "right"])
def test_a_load_stretches_the_cables_by_force_over_stiffness(arm: str) -> None:
    no_friction = {"joint_friction__coulomb": (0.0,) * 3, "joint_friction__load_share": (0.0,) * 3}
    still = nominal(**smooth(), **no_friction)
    twin = homed(still, arm=arm, seed=2)
    hold = np.tile(twin.robot.home, (3000, 1))
    hold[:, :3] = (
        np.linspace(0.0, 1.0, 3000)[:, None] * ([0.35, 0.96, 0.33] - hold[0, :3]) + hold[0, :3]
    )
    twin.run(hold)
    hold[:] = hold[-1]
    arm_drives = drives("right" if arm == "right" else "left")[:3]
    motors = []
    before = twin.run(hold)
    motors.append(twin._state.motor[:3].copy())  # finer than the encoders
    twin.load = 1.0
    after = twin.run(hold)
    motors.append(twin._state.motor[:3].copy())

    # By hand: force on the tool through the Jacobian to joint efforts, through the
    # transposed coupling to cable loads, over the stiffness to stretch, and back.
    q = twin.robot.home.copy()
    q[:3] = before.joint[-1]
    assert twin.robot.kinematics is not None
    weight = 1.0 * 9.8  # against it the arm pushes along +x of frame 0
    efforts = weight * twin.robot.kinematics.jacobian(q)[0, :3]
    # The links weigh differently where the load has taken them.
    efforts += gravity_at(twin, after.joint[-1]) - gravity_at(twin, before.joint[-1])
    pulleys = still.pulleys
    coupling = np.array(
        [
            [1.0, 0.0, 0.0],
            [0.14545 + pulleys.coupling_shoulder_elbow, 1.0, 0.0],
            [
                0.0077973826 + pulleys.coupling_shoulder_insertion,
                0.008077387 + pulleys.coupling_elbow_insertion,
                1.0,
            ],
        ]
    )
    stretch = np.linalg.solve(coupling.T, efforts) / np.array(still.cable.stiffness)
    by_hand = -np.linalg.solve(coupling, stretch)

    motors_gave_way = (motors[1] - motors[0]) / [drive.transmission_ratio for drive in arm_drives]
    # What the motors gave way by reached the joints with their scale error.
    gave = np.linalg.solve(coupling, (1 + np.array(pulleys.scale)) * motors_gave_way)
    moved = after.joint[-1] - before.joint[-1] - gave
    assert (np.abs(moved - by_hand) < 0.01 * np.abs(by_hand) + [3e-7, 3e-7, 1e-7]).all()


def test_effort_carries_gravity_friction_and_speed() -> None:
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


# ---------------------------------------------------------------------------- hysteresis


def loop(twin: Raven2Twin, speed: float) -> tuple[Array, Array, Array]:
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


def test_hysteresis_closes_whatever_the_speed_and_is_as_wide_as_friction_makes_it() -> None:
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


def test_a_load_changes_how_wide_the_hysteresis_is() -> None:
    sticky = nominal(joint_friction__load_share=(0.06, 0.5, 0.06))
    width = []
    for load in (0.0, 2.0):
        twin = homed(sticky, seed=7, load=load)
        up, down, _ = loop(twin, 2.0 * DEG)
        width.append((down - up).mean())
    assert abs(width[1] - width[0]) > 0.05 * width[0]


# -------------------------------------------------------------------------------- homing


def test_homing_ends_at_home_and_offsets_by_the_zero_conventions() -> None:
    twin = homed(nominal(homing__registration_bias=(0.0, 0.0, 0.0), **smooth()), seed=1)
    out = twin.run(np.tile(twin.robot.home, (500, 1)))
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


def test_homing_draws_a_fresh_offset_each_time() -> None:
    twin = Raven2Twin(seed=11)
    offsets = []
    for _ in range(25):
        out = twin.home()
        assert np.abs((out.measured[-1, :3] - twin.robot.home[:3]) * SHOWN).max() < 1.5
        offsets.append((out.joint[-500:] - out.measured[-500:, :3]).mean(axis=0))
    sd = np.array(offsets).std(axis=0, ddof=1)
    # 95 % of the sample deviations of 25 draws lie within 0.72 and 1.28 of the true one.
    ratio = sd / np.array(twin.parameters.homing.registration_sd)
    assert (ratio > 0.6).all()
    assert (ratio < 1.5).all()
    assert twin.homing_count == 25


# ---------------------------------------------------------------- load, hours, creep, tool


def test_a_load_leaves_a_trace_in_the_torque_command() -> None:
    efforts = []
    for load in (0.0, 0.5):
        twin = homed(nominal(), seed=3, load=load)
        efforts.append(twin.run(sway(twin, 40.0)).effort[:, :3].mean(axis=0))
    change = efforts[1] - efforts[0]
    # 0.5 kg along the shaft, 4.9 N x cos(tilt) at a radius of 5.675 mm.
    assert change[2] == pytest.approx(4.9 * 5.675e-3 * 0.85, rel=0.25)


def test_cables_creep_with_work_more_under_load_and_not_at_rest() -> None:
    fast = Raven2Parameters.read().with_values(
        {"creep.travel": (3.0, 4.0, 0.4), "homing.registration_sd": (0.0, 0.0, 0.0)}
    )

    def drift(load: float, work: bool) -> Array:
        twin = homed(fast, seed=4, load=load)
        goal = sway(twin, 60.0)

        def error() -> Array:
            out = twin.run(goal[:28_000])
            return np.asarray((out.joint - out.measured[:, :3])[8000:].mean(axis=0))

        before = error()
        for _ in range(5):
            if work:
                twin.run(goal)
            else:
                twin.idle(3600.0)
        return error() - before

    rest, work, loaded = drift(0.0, False), drift(0.0, True), drift(0.5, True)
    final = np.array(fast.creep.final)
    assert (np.abs(work) > 0.2 * np.abs(final)).all()
    assert (np.sign(work) == np.sign(final)).all()
    assert (np.abs(loaded) > 1.2 * np.abs(work)).all()
    # Both drift while they are looked at; five hours of rest add nearly nothing to that.
    assert (np.abs(rest) < 0.6 * np.abs(work)).all()


def test_six_idle_hours_do_not_move_the_arm() -> None:
    twin = homed(seed=4)
    hold = np.tile(twin.robot.home, (2000, 1))
    before = twin.run(hold)
    twin.idle(6 * 3600.0)
    after = twin.run(hold)
    assert after.t[0] - before.t[-1] == pytest.approx(6 * 3600.0 + 1e-3)
    assert after.truth.t[0] > 6 * 3600.0
    drift = (after.joint[-1] - after.measured[-1, :3]) - (
        before.joint[-1] - before.measured[-1, :3]
    )
    assert (np.abs(drift * SHOWN) < [0.03, 0.03, 0.03]).all()


def test_the_tool_holds_while_the_insertion_turns_its_motors() -> None:
    twin = homed(seed=6)
    goal = np.tile(twin.robot.home, (20_000, 1))
    goal[:, 2] += 0.02 * np.sin(2 * np.pi * np.arange(20_000) / 20_000)
    out = twin.run(goal)
    off = out.measured[3000:, 4:] - twin.robot.home[3:]
    assert np.abs(off).max() < 4 * DEG
    assert np.ptp(out.measured[3000:, 4:], axis=0).min() > 0.02 * DEG
    assert np.ptp(out.motor[:, 4:], axis=0).min() > 1.0


# ------------------------------------------------------------------------ peng2024 Table I


def held(twin: Raven2Twin, seconds: float) -> TwinOutput:
    return twin.run(np.tile(twin.robot.home, (round(seconds * 1000), 1)))


def test_a_tool_wanders_and_is_left_elsewhere_by_every_homing() -> None:
    wander, registered = np.full(4, 0.2 * DEG), np.full(4, 1.0 * DEG)
    moving = nominal(
        tool__wander=tuple(wander), tool__registration_sd=tuple(registered), tool__wander_time=2.0
    )
    twin, still = Raven2Twin(moving, seed=4), Raven2Twin(nominal(), seed=4)
    left_at = []
    for number in range(8):
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


def test_a_load_of_the_tools_cables_shows_in_its_torque_command() -> None:
    loaded = nominal(tool__wander_effort=(0.01,) * 4, tool__wander_time=5.0)
    efforts = [held(homed(p, seed=4), 60.0).effort[:, 4:].std(axis=0) for p in (loaded, nominal())]
    assert efforts[0] == pytest.approx(np.full(4, 0.01), rel=0.6)
    assert (efforts[1] < 0.3 * efforts[0]).all()


@pytest.mark.parametrize(
    ("specimen", "profile"), [("nominal", "cosine"), ("peng2024", "laboratory")]
)
def test_raw_and_fixed_offset_errors_are_those_of_table_1(specimen: str, profile: str) -> None:
    """peng2024, Table I, direction J2-J3: the two rows that the twin was fitted to."""
    from truejoint.crtk import simulated_arm  # noqa: PLC0415 - heavy, one test
    from truejoint.motion import follow, random_motion, zigzag  # noqa: PLC0415

    arm = simulated_arm(parameters=specimen, seed=0)
    arm.enable()
    arm.home()
    errors: list[Array] = []

    def keep(block: object) -> None:
        if hasattr(block, "measured"):
            kept.append(block.measured[::20, :3])
            t.append(block.t[::20])
        else:
            truth.append((block.t, block.position))  # type: ignore[attr-defined]

    paths = [zigzag(arm.robot, "J2-J3", s) for s in (1 / 4, 1 / 5, 1 / 6)]
    for trajectory in (*paths, random_motion(arm.robot, 600.0, seed=1, profile=profile)):
        kept: list[Array] = []
        t: list[Array] = []
        truth: list[tuple[Array, Array]] = []
        arm.subscribe(keep, every=0.5)
        follow(arm, trajectory)
        arm.unsubscribe(keep)
        stamps = np.concatenate([a for a, _ in truth])
        values = np.concatenate([b for _, b in truth])
        at = np.concatenate(t)
        true = np.column_stack([np.interp(at, stamps, values[:, k]) for k in range(3)])
        errors.append((true - np.concatenate(kept)) * SHOWN)
    offset = np.concatenate(errors[:3]).mean(axis=0)
    raw = np.sqrt((errors[3] ** 2).mean(axis=0))
    fixed = np.sqrt(((errors[3] - offset) ** 2).mean(axis=0))
    np.testing.assert_allclose(raw, [2.103, 7.963, 11.715], rtol=0.15)
    np.testing.assert_allclose(fixed, [0.859, 1.095, 0.492], rtol=0.15)


# ----------------------------------------------------------------------------- bad input


def test_parameters_that_the_step_cannot_resolve_are_refused() -> None:
    light = Raven2Parameters.read().with_values({"motor.inertia": (1e-6, 1e-6, 1e-6)})
    Raven2Twin(light)
    stiff = light.with_values({"cable.stiffness": (1e5, 400.0, 18500.0)})
    with pytest.raises(TruejointError, match="shoulder's motor is too light"):
        Raven2Twin(stiff)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32), jump=st.floats(0.0, 1.0), load=st.floats(0.0, 2.0))
def test_no_command_makes_the_twin_leave_what_is_possible(
    seed: int, jump: float, load: float
) -> None:
    twin = Raven2Twin(seed=seed, load=load)
    rng = np.random.default_rng(seed)
    wild = twin.robot.home + jump * rng.standard_normal((20, 7)) * [2, 2, 0.5, 2, 2, 2, 2]
    out = twin.run(np.repeat(wild, 50, axis=0))
    assert all(np.isfinite(values).all() for values in arrays(out).values())
    limits = [d.max_effort for d in drives("left")]
    assert (np.abs(out.effort[:, [0, 1, 2, 4, 5, 6, 7]]) <= np.array(limits) * 1.001).all()
    assert (out.joint >= twin._plant.stops[:, 0]).all()
    assert (out.joint <= twin._plant.stops[:, 1]).all()


def test_homing_that_finds_no_stop_says_so() -> None:
    # The search winds 0.5 m of cable at most, which pulls 10 N: far below the threshold of 76 N.
    slack = Raven2Parameters.read().with_values({"cable.stiffness": (1500.0, 400.0, 20.0)})
    with pytest.raises(TruejointError, match="no hard stop for insertion within 25 s"):
        Raven2Twin(slack).home()
