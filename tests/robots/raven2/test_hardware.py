"""The RAVEN-II's numbers against each other and against published round figures."""

import numpy as np
import pytest

from truejoint.robots import get_robot
from truejoint.robots.raven2 import hardware


@pytest.fixture(params=["left", "right"])
def side(request):
    return request.param


def test_drives_come_in_the_order_of_the_joints(side):
    assert tuple(d.joint for d in hardware.drives(side)) == get_robot("raven2", side).joint_names


def test_encoder_counts_per_degree_and_millimetre(side):
    counts = hardware.ENCODER_COUNTS_PER_REV / (2 * np.pi)
    ratios = np.array([drive.transmission_ratio for drive in hardware.drives(side)[:3]])
    per_unit = ratios * counts * [np.radians(1), np.radians(1), 1e-3]
    assert per_unit == pytest.approx([1513.29, 1350.25, 1374.20], abs=0.01)


def test_torques_follow_from_the_motor_constants(side):
    drives = hardware.drives(side)
    assert drives[0].torque_per_amp == pytest.approx(0.738675)
    assert drives[4].torque_per_amp == pytest.approx(0.199829, abs=1e-6)
    # Force on the insertion per ampere: torque of the motor times its turns per metre.
    assert drives[2].torque_constant * drives[2].transmission_ratio == pytest.approx(130.2, abs=0.1)
    for drive in drives:
        assert 0 < drive.homing_effort < drive.max_effort


def test_only_the_damping_of_the_insertion_differs_between_the_arms():
    differing = [
        (left.joint, left.kd, right.kd)
        for left, right in zip(hardware.drives("left"), hardware.drives("right"), strict=True)
        if left != right
    ]
    assert differing == [("insertion", 0.012, 0.010)]


def test_homing_runs_into_the_hard_stop_beyond_the_soft_limits(side):
    robot = get_robot("raven2", side)
    for drive, joint in zip(hardware.drives(side), robot.joints, strict=True):
        beyond = joint.upper if drive.homing_speed > 0 else joint.lower
        assert (drive.hard_stop - beyond) * np.sign(drive.homing_speed) >= 0
        assert abs(drive.homing_speed) <= joint.max_speed


def test_joint_encoders_are_registered_off_the_robots_own_zero():
    encoders, drives = get_robot("raven2").encoders, hardware.drives("left")[:3]
    offsets = {e.joint: e.hard_stop - d.hard_stop for e, d in zip(encoders, drives, strict=True)}
    assert np.degrees(offsets["elbow"]) == pytest.approx(-7.5)
    assert offsets["insertion"] == pytest.approx(10.467e-3)
    assert offsets["shoulder"] == 0


def test_gravity_points_down_in_the_crtk_frame(side):
    down = get_robot("raven2", side).kinematics.crtk_from_base[:3, :3] @ hardware.GRAVITY
    np.testing.assert_allclose(down, [0, 0, -9.8])


def test_gravity_loads_both_arms_alike():
    joints = np.random.default_rng(5).uniform([0.0, 0.8, 0.3], [1.5, 2.3, 0.45], (20, 3))
    joints = np.hstack([joints, np.zeros((20, 4))])

    def energy(side):
        frames = get_robot("raven2", side).kinematics.link_frames(joints)
        total = np.zeros(len(joints))
        for k, (mass, centre) in enumerate(zip(*hardware.links(side), strict=True)):
            position = frames[:, k] @ np.array([*centre, 1.0])
            total -= mass * position[:, :3] @ np.array(hardware.GRAVITY)
        return total

    # The published centres of mass are mirrored but for the 2 mm of the second link.
    np.testing.assert_allclose(energy("left"), energy("right"), atol=2 * 0.750 * 9.8 * 0.002)
