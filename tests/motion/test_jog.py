"""Tests of truejoint.motion.jog: the stream of set-points that velocities become."""

import threading

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.conftest import LaggingBackend, homed

from truejoint.crtk import simulated_arm
from truejoint.errors import CommandRefused, RobotError
from truejoint.motion import Jog
from truejoint.motion.jog import RAMP


def rows_of(changes, seconds):
    """Set-points (n, 7) of a jog that is told what to do at given times [s]."""
    backend = LaggingBackend(0.02)
    arm = homed(backend)
    count, left, over = len(backend.sent), sorted(changes, key=lambda c: c[0]), threading.Event()
    start = arm.time

    def tell(_):
        while left and arm.time >= start + left[0][0]:
            left.pop(0)[1](jog)
        if arm.time >= start + seconds:
            over.set()

    jog = Jog(arm)
    left_at_once = [change for at, change in changes if at == 0.0]
    for change in left_at_once:
        change(jog)
    arm.subscribe(tell)
    with jog:
        assert over.wait(60.0)
        arm.unsubscribe(tell)
    return np.vstack([arm.robot.home, *backend.sent[count:]]), jog


def test_the_speed_is_the_one_asked_for():
    wanted = np.array([0.03, -0.02, 0.005, 0.1, 0.0, 0.05, -0.05])
    rows, jog = rows_of([(0.0, lambda jog: jog.joints(wanted))], 2.0)
    speed = np.diff(rows, axis=0)[300:2000] * 1e3
    assert speed == pytest.approx(np.tile(wanted, (len(speed), 1)), rel=1e-9, abs=1e-12)
    assert not jog.motion.is_busy()
    assert jog.arm.operating_state().is_ready
    assert not np.diff(rows[-2:], axis=0).any()


@settings(max_examples=20)
@given(
    st.lists(
        st.tuples(st.floats(0.0, 0.6), st.lists(st.floats(-2.0, 2.0), min_size=7, max_size=7)),
        min_size=1,
        max_size=6,
    )
)
def test_speed_its_change_and_range_are_kept(told):
    changes = [(at, lambda jog, v=v: jog.joints(v)) for at, v in told]
    rows, jog = rows_of(changes, 0.8)
    robot, speed = jog.arm.robot, np.diff(rows, axis=0) * 1e3
    assert (rows >= robot.lower).all()
    assert (rows <= robot.upper).all()
    assert (np.abs(speed) <= jog.speed * (1 + 1e-9)).all()
    ramped = np.diff(speed[:700], axis=0) * 1e3
    assert (np.abs(ramped) <= jog.speed / RAMP * 1.3 + 1e-9).all()


def test_a_joint_comes_to_rest_at_its_limit(hasty):
    rows, jog = rows_of([(0.0, lambda jog: jog.joints(np.eye(7)[2]))], 6.5)
    upper = jog.arm.robot.upper[2]
    assert rows[-1, 2] == pytest.approx(upper, abs=1e-4)
    assert (rows[:, 2] <= upper).all()
    change = np.abs(np.diff(rows[:, 2], 2)).max() * 1e6
    assert change <= jog.speed[2] / RAMP * (1 + 1e-6)


def test_the_tool_goes_straight():
    twist = np.array([0.004, 0.002, -0.003, 0.0, 0.0, 0.0])
    rows, jog = rows_of([(0.0, lambda jog: jog.tool(twist))], 2.0)
    kinematics = jog.arm.robot.kinematics
    pose = kinematics.crtk_from_base @ kinematics.forward(rows[[300, 1900]])
    way = pose[1, :3, 3] - pose[0, :3, 3]
    assert way == pytest.approx(1.6 * twist[:3], rel=0.02, abs=2e-5)
    assert pose[1, :3, :3] == pytest.approx(pose[0, :3, :3], abs=2e-3)
    rows, jog = rows_of([(0.0, lambda jog: jog.tool(20.0 * twist))], 0.5)
    assert np.abs(np.diff(rows, axis=0) * 1e3 / jog.speed).max() == pytest.approx(1.0)
    tip = (kinematics.crtk_from_base @ kinematics.forward(rows[[0, 500]]))[:, :3, 3]
    assert (tip[1] - tip[0]) @ way > 0.999 * np.linalg.norm(tip[1] - tip[0]) * np.linalg.norm(way)


def test_refusals(lagging_arm):
    with pytest.raises(CommandRefused, match="jog refused: speed of shoulder"):
        Jog(lagging_arm, np.full(7, 9.0))
    jog = Jog(lagging_arm)
    with pytest.raises(CommandRefused, match="want 7 values"):
        jog.joints([0.0])
    with pytest.raises(CommandRefused, match="a twist is 6 finite values"):
        jog.tool([0.0, np.nan, 0, 0, 0, 0])
    lagging_arm.pause()
    with pytest.raises(CommandRefused, match="jog refused: the arm is PAUSED"):
        jog.__enter__()
    forceps = simulated_arm("forceps", seed=1)
    with pytest.raises(RobotError, match="kinematics of forceps are not known"):
        Jog(forceps).tool(np.zeros(6))
