"""RAVEN-II transmission against a recorded robot and against the coupling written out."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from truejoint.recordings.datasets import read_dataset
from truejoint.robots import get_robot


def test_joints_follow_from_recorded_motor_positions(dataset_folder):
    dataset_folder("raven2_motor_side")  # or skip
    (recording,) = read_dataset("raven2_motor_side", "test_joint123")
    names = recording.robot.positioning
    motor = np.zeros((len(recording), 7))
    motor[:, :3] = recording.columns("motor", names)
    joint = recording.robot.transmission.joint_from_motor(motor)[:, :3]
    assert np.abs(joint - recording.columns("measured", names)).max() < 1e-6


@given(
    side=st.sampled_from(["left", "right"]),
    motor=st.lists(st.floats(-500, 500), min_size=7, max_size=7),
)
def test_coupling_is_the_published_one(side, motor):
    """Joint by joint, as the robot's own controller resolves the coupling."""
    tr = [136.196256, 121.522075, 2158.590308, 5.395176, 8.991960, 8.991960, 8.991960]
    shoulder = motor[0] / tr[0]
    elbow = motor[1] / tr[1] - 0.14545 * shoulder
    insertion = motor[2] / tr[2] - 0.0077973826 * shoulder - 0.008077387 * elbow
    s = motor[2] / 2.908700441 * (1 if side == "left" else -1)
    tool = [(motor[k] - (s if k != 5 else -s)) / tr[k] for k in range(3, 7)]
    joint = get_robot("raven2", side).transmission.joint_from_motor(motor)
    np.testing.assert_allclose(joint, [shoulder, elbow, insertion, *tool], rtol=1e-6, atol=1e-6)
