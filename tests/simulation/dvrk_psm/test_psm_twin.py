"""The twin of a dVRK PSM against physics worked out by hand, and the size of real errors."""

import math

import numpy as np
import pytest

from truejoint.crtk import simulated_arm
from truejoint.motion import follow, random_motion
from truejoint.recordings import Recorder
from truejoint.simulation.dvrk_psm import DvrkPsmParameters, DvrkPsmTwin

SHOWN = np.array([*np.full(2, np.rad2deg(1.0)), 1e3, *np.full(3, np.rad2deg(1.0))])
YAW, PITCH, INSERTION, ROLL, WRIST_PITCH, WRIST_YAW = range(6)


def plain(**changes):
    """Parameters without anything random, slow or eccentric, and `changes` by section__key."""
    none, every = (0.0,) * 6, (0.0,) * 7
    values = {
        "motor_friction.wander": 0.0, "motor_friction.warm_up": 0.0, "creep.final": none,
        "pulleys.run_out": none, "pulleys.scale": none, "pulleys.yaw_per_pitch_error": 0.0,
        "potentiometers.noise": every, "potentiometers.offset": every,
        "potentiometers.scale": every, "potentiometers.linearity": every,
    }  # fmt: skip
    values |= {name.replace("__", "."): value for name, value in changes.items()}
    return DvrkPsmParameters.read().with_values(values)


def at_depth(parameters=None, **how):
    """Homed twin with its instrument 140 mm deep, and that pose."""
    twin = DvrkPsmTwin(parameters, **how)
    twin.home()
    pose = twin.robot.home.copy()
    pose[INSERTION] = 0.14
    twin.run(np.linspace(twin.robot.home, pose, 3000))
    twin.run(np.tile(pose, (1000, 1)))
    return twin, pose


def swing(pose, joint, amplitude, seconds=16.0):
    t = np.arange(round(1000 * seconds)) * 1e-3
    goal = np.tile(pose, (len(t), 1))
    goal[:, joint] += amplitude * np.sin(2 * math.pi * t / 8.0)
    return goal


def test_positions_are_off_by_what_the_potentiometers_are_off_by():
    offset = (0.02, -0.01, 0.003, 0.1, 0.05, -0.04, 0.0)
    twin = DvrkPsmTwin(plain(potentiometers__offset=offset), seed=3)
    out = twin.home()
    off = (out.measured[-1, :6] - out.joint[-1]) * SHOWN
    # What friction and gravity keep of the cables' stretch comes on top.
    stretch = [0.06, 0.06, 0.4, 2.0, 6.5, 6.5]
    assert (np.abs(off - np.array(offset[:6]) * SHOWN) < stretch).all()
    scaled = DvrkPsmTwin(plain(potentiometers__scale=(0.0, 0.0, 0.02, *4 * [0.0])), seed=3)
    left = scaled._state.joint[INSERTION]
    out = scaled.home()
    assert out.measured[-1, 2] - out.joint[-1, 2] == pytest.approx(0.02 * left, abs=4e-4)


def test_potentiometers_sit_at_the_motors():
    """Whatever the cables do, they and the encoders differ by a constant, scale and bend aside."""
    offset, preload = (0.02, -0.01, 0.003, 0.1, 0.05, -0.04, 0.0), []
    for seed in (3, 4):
        twin = DvrkPsmTwin(plain(potentiometers__offset=offset), seed=seed)
        twin.home()
        out = twin.run(swing(twin.robot.home, WRIST_PITCH, 0.7, 4.0))
        read = np.column_stack([out.extra[f"pot/{joint}"] for joint in twin.robot.joint_names])
        preload.append((read - out.measured)[-1])
        np.testing.assert_allclose(read - out.measured, preload[-1] * np.ones((4000, 1)), atol=1e-9)
        # They are preloaded to what the potentiometers read, to a count of the encoders.
        np.testing.assert_allclose(preload[-1], 0.0, atol=3e-4)
    zero = twin._plant.joint_from_motor @ twin.encoder_zero
    bend = np.array([0.0, 0.0, 1e-3, *4 * [0.0]])
    bent = DvrkPsmTwin(plain(potentiometers__linearity=tuple(bend)), seed=4)
    bent.home()
    deep = bent.robot.home + np.eye(7)[INSERTION] * 0.12
    out = bent.run(np.linspace(bent.robot.home, deep, 4000))
    off = out.extra["pot/outer_insertion"] - out.measured[:, INSERTION]
    assert np.ptp(off) == pytest.approx(2e-3, rel=0.05)
    assert np.abs(zero[INSERTION] - bent.encoder_zero[INSERTION] / 336.6) < 5e-3


def test_a_potentiometer_is_noisy():
    twin = DvrkPsmTwin(seed=1)
    read = twin.run(np.tile(twin.robot.home, (60, 1))).extra["pot/outer_yaw"]
    assert read.std() == pytest.approx(1.7e-3, rel=0.3)


def test_a_homing_registers_anew():
    twin, _ = at_depth(seed=5)
    before = twin.encoder_zero
    twin.home()
    moved = (twin.encoder_zero - before) / np.array(twin.parameters.drive.ratio)
    assert (np.abs(moved[:6]) > 1e-6).all()
    assert (np.abs(moved[:6] * SHOWN) < [1.0, 1.0, 5.0, 10.0, 15.0, 15.0]).all()
    assert twin.homing_count == 2


@pytest.mark.parametrize(
    ("joint", "amplitude"), [(YAW, 0.4), (INSERTION, 0.04), (WRIST_PITCH, 0.7)]
)
def test_the_hysteresis_is_twice_friction_over_stiffness_wide(joint, amplitude):
    twin, pose = at_depth(plain(mass__carriage=0.0), seed=2)
    out = twin.run(swing(pose, joint, amplitude))
    error, way = out.joint[:, joint] - out.measured[:, joint], np.gradient(out.setpoint[:, joint])
    middle = np.abs(out.measured[:, joint] - pose[joint]) < 0.3 * amplitude
    middle[:8000] = False
    width = error[middle & (way < 0)].mean() - error[middle & (way > 0)].mean()
    p = twin.parameters
    by_hand = 2.0 * p.joint_friction.coulomb[joint] / p.cable.stiffness[joint]
    assert width == pytest.approx(by_hand, rel=0.05)


def test_a_load_hangs_from_the_insertions_cable():
    still = plain(joint_friction__coulomb=(0.0,) * 6, joint_friction__load_share=(0.0,) * 6)
    twin, pose = at_depth(still, seed=1)
    before = twin.run(np.tile(pose, (2000, 1)))
    twin.load = 0.3
    after = twin.run(np.tile(pose, (2000, 1)))
    sag, gave = (np.array([o[-1, INSERTION] for o in (a, b)]) for a, b in (
        (before.joint, after.joint), (before.measured, after.measured)
    ))  # fmt: skip
    # The tool hangs straight down: what its motor does not give way, the cable does.
    assert np.diff(sag - gave) == pytest.approx(0.3 * 9.80665 / 15000.0, rel=0.02)


def test_the_wrists_yaw_follows_its_pitch_by_the_error_of_the_coupling():
    slack = {"joint_friction__coulomb": (*3 * [0.0], *3 * [1e-6])}
    twin, pose = at_depth(plain(pulleys__yaw_per_pitch_error=0.1, **slack), seed=1)
    out = twin.run(swing(pose, WRIST_PITCH, 0.5))
    drag = out.joint[:, WRIST_YAW] - out.measured[:, WRIST_YAW]
    slope = np.polyfit(out.joint[8000:, WRIST_PITCH], drag[8000:], 1)[0]
    assert slope == pytest.approx(-0.1, rel=0.02)


def test_efforts_act_on_the_joints():
    twin, pose = at_depth(seed=1)
    out = twin.run(swing(pose, WRIST_YAW, 0.5))
    effort, p = out.effort[9000:], twin.parameters
    # The pitch is held: it carries what the yaw's cables pull at it, by power.
    pull = p.pulleys.yaw_per_pitch * effort[:, WRIST_YAW]
    assert np.corrcoef(pull, effort[:, WRIST_PITCH])[0, 1] > 0.8
    limits = np.array(p.drive.max_torque) * p.drive.ratio
    assert (np.abs(out.effort[:, :4]) <= limits[:4]).all()


def test_its_errors_have_the_size_of_a_real_arms():
    """docs/results.md: what the recordings of a PSM leave after a fixed offset, within a half."""
    with simulated_arm("dvrk_psm", seed=4) as arm:
        arm.enable()
        arm.home()
        with Recorder(arm) as recorder:
            follow(arm, random_motion(arm.robot, 60.0, seed=2))
        run = recorder.recording()
    left = run.with_truth(arm.robot.positioning).error(arm.robot.positioning).std(axis=0) * SHOWN
    recorded = np.array([0.084, 0.078, 0.32, 2.3, 10.4, 9.6])
    assert (left / recorded > 0.5).all()
    assert (left / recorded < 1.5).all()
