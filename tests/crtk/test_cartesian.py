"""Tests of an arm's Cartesian commands, against joint space and against finite differences."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from truejoint.crtk import cartesian, simulated_arm
from truejoint.errors import CommandRefused, RobotError
from truejoint.robots import get_robot

DVRK, RAVEN = get_robot("dvrk_psm"), get_robot("raven2", "left")
INSIDE = {"raven2": RAVEN.home, "dvrk_psm": np.array([0.2, -0.1, 0.12, 0.3, 0.2, -0.3, 0.0])}
SPREAD = np.array([0.1, 0.1, 0.01, 0.3, 0.2, 0.2, 0.2])


@settings(max_examples=30)
@given(
    robot=st.sampled_from([DVRK, RAVEN]), shift=st.lists(st.floats(-1, 1), min_size=7, max_size=7)
)
def test_the_inverse_of_any_chain_finds_the_joints(robot, shift):
    start, kinematics = INSIDE[robot.name], robot.kinematics
    pose = kinematics.forward(start + SPREAD * np.array(shift))
    assert kinematics.forward(kinematics.inverse(pose, start)) == pytest.approx(pose, abs=1e-9)


def test_twist_and_jacobian_are_the_change_of_the_pose(lagging_arm):
    velocity = np.array([0.05, -0.04, 0.01, 0.2, -0.1, 0.1, 0.2])
    rows = lagging_arm.robot.home + np.arange(1, 501)[:, None] * 1e-3 * velocity
    lagging_arm.servo_jp_stream(rows)
    before, now = lagging_arm.setpoint_cp(), lagging_arm.setpoint_js()
    lagging_arm.servo_jv(velocity)
    after = lagging_arm.setpoint_cp()
    turn = Rotation.from_matrix(after[:3, :3] @ before[:3, :3].T).as_rotvec()
    change = np.concatenate([after[:3, 3] - before[:3, 3], turn]) / 1e-3
    assert now.velocity == pytest.approx(velocity, abs=1e-9)
    measured = lagging_arm.measured_js()
    jacobian = cartesian.jacobian(lagging_arm.robot.kinematics, measured.position)
    # Measured 20 ms behind the set-point: the Jacobian of a place 4 mrad away.
    assert jacobian @ velocity == pytest.approx(change, abs=2e-3)
    assert lagging_arm.measured_cv() == pytest.approx(jacobian @ measured.velocity, abs=1e-12)


@pytest.mark.parametrize("frame", ["body", "spatial"])
def test_the_jacobians_of_both_frames_are_the_change_of_the_pose(frame):
    # Murray, Li and Sastry 1994, 2.4: the inverse of the pose times its derivative, or other way.
    kinematics, joint, step = DVRK.kinematics, INSIDE["dvrk_psm"], 1e-6
    found = cartesian.jacobian(kinematics, joint, frame)
    for k in range(len(joint)):
        low, high = (cartesian.pose(kinematics, joint + s * step * np.eye(7)[k]) for s in (-1, 1))
        change, here = (high - low) / (2.0 * step), np.linalg.inv(cartesian.pose(kinematics, joint))
        twist = here @ change if frame == "body" else change @ here
        moved = [*twist[:3, 3], twist[2, 1], twist[0, 2], twist[1, 0]]
        assert found[:, k] == pytest.approx(moved, abs=1e-8)


def test_servo_in_space_goes_where_it_is_told(lagging_arm):
    start = lagging_arm.setpoint_cp()
    step = np.eye(4)
    step[:3, 3] = [1e-5, 0.0, -1e-5]
    step[:3, :3] = Rotation.from_rotvec([1e-4, 5e-5, 0.0]).as_matrix()
    for _ in range(50):
        lagging_arm.servo_cr(step)
    after = lagging_arm.setpoint_cp()
    assert after[:3, 3] - start[:3, 3] == pytest.approx([5e-4, 0.0, -5e-4], abs=1e-9)
    turn = Rotation.from_matrix(after[:3, :3] @ start[:3, :3].T).as_rotvec()
    assert turn == pytest.approx([5e-3, 2.5e-3, 0.0], abs=1e-9)
    last = np.copy(after)
    last[:3, 3] -= step[:3, 3]
    lagging_arm.servo_cp(last)
    assert lagging_arm.setpoint_cp() == pytest.approx(last, abs=1e-9)


def test_a_move_in_space_is_straight(lagging_arm, lagging_backend):
    start = lagging_arm.setpoint_cp()
    goal = start.copy()
    goal[:3, 3] += [0.02, -0.01, 0.015]
    turn = Rotation.from_rotvec([0.2, 0.1, -0.1])
    goal[:3, :3] = turn.as_matrix() @ start[:3, :3]
    sent, kinematics = len(lagging_backend.sent), lagging_arm.robot.kinematics
    lagging_arm.move_cp(goal).wait(60.0)
    assert lagging_arm.setpoint_cp() == pytest.approx(goal, abs=1e-9)
    rows = np.vstack(lagging_backend.sent[sent:])
    tool = kinematics.crtk_from_base @ kinematics.forward(rows)
    way = goal[:3, 3] - start[:3, 3]
    unit = way / np.linalg.norm(way)
    off = tool[:, :3, 3] - start[:3, 3]
    stray = off - (off @ unit)[:, None] * unit
    assert np.linalg.norm(stray, axis=1).max() < 2e-4
    turned = Rotation.from_matrix(tool[:, :3, :3] @ start[:3, :3].T).magnitude()
    even = turn.magnitude() * (off @ unit) / np.linalg.norm(way)
    assert turned == pytest.approx(even, abs=2e-3)
    sent = len(lagging_backend.sent)
    lagging_arm.move_cp(np.block([[start[:3, :3], goal[:3, 3:]], [start[3:]]])).wait(60.0)
    tool = kinematics.crtk_from_base @ kinematics.forward(np.vstack(lagging_backend.sent[sent:]))
    assert np.abs(tool[:, :3, 3] - goal[:3, 3]).max() < 1e-5  # it turns on the spot
    goal[:3, 3] += [0.0, 3.0, 0.0]
    count = len(lagging_backend.sent)
    with pytest.raises((RobotError, CommandRefused)):
        lagging_arm.move_cp(goal)
    assert len(lagging_backend.sent) == count


def test_what_is_no_pose_or_twist_is_refused(lagging_arm):
    with pytest.raises(RobotError, match="must be 4 x 4"):
        lagging_arm.servo_cp(np.eye(3))
    in_mm = lagging_arm.setpoint_cp()
    in_mm[:3, 3] *= 1000.0
    with pytest.raises(
        RobotError, match=r"^the pose is 77.9 m from where the tool is; give it in m"
    ):
        lagging_arm.move_cp(in_mm)
    forceps = simulated_arm("forceps", seed=1)
    with pytest.raises(RobotError, match="servo_cp: the kinematics of forceps are not known"):
        forceps.servo_cp(np.eye(4))
