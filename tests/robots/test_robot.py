"""Joints, transmissions and robots as values."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from truejoint.errors import RobotError
from truejoint.robots import Joint, Robot, Transmission


def test_a_robot_is_its_joints_and_the_channels_of_its_messages():
    joints = Joint("lift", "prismatic"), Joint("turn")
    gantry = Robot("gantry", joints, arm="a", channels=("lift", "spare", "turn"))
    assert [joint.unit for joint in gantry.joints] == ["m", "rad"]
    assert [joint.effort_unit for joint in gantry.joints] == ["N", "Nm"]
    assert gantry.unused_channels == ("spare",)
    assert gantry.title == "gantry (a arm)"
    assert gantry.index(["turn", "lift"]) == [1, 0]
    with pytest.raises(RobotError, match=r"gantry \(a arm\): no joint called 'spare'.* lift, turn"):
        gantry.index(["lift", "spare"])
    alone = Robot("one", (Joint("jaw"),))
    assert alone.channels == alone.positioning == ("jaw",)
    assert alone.title == "one"


@pytest.mark.parametrize(
    "matrix",
    [np.ones(3), np.ones((2, 3)), np.zeros((2, 2)), np.ones((2, 2)), np.diag([1.0, np.nan])],
    ids=["vector", "oblong", "zero", "singular", "nan"],
)
def test_transmission_that_cannot_be_inverted_is_refused(matrix):
    with pytest.raises(RobotError, match="square, finite and invertible"):
        Transmission(matrix)


@given(st.lists(st.floats(-10, 10), min_size=6, max_size=6), st.floats(0.1, 2000), st.floats(-5, 5))
def test_motor_angles_are_the_matrix_times_the_joints(joints, ratio, coupling):
    transmission = Transmission(np.array([[ratio, 0.0], [coupling, 1.0]]))
    rows = np.reshape(joints, (3, 2))
    motor = transmission.motor_from_joint(rows)
    np.testing.assert_allclose(motor[:, 0], ratio * rows[:, 0])
    np.testing.assert_allclose(motor[:, 1], coupling * rows[:, 0] + rows[:, 1])
    np.testing.assert_allclose(transmission.joint_from_motor(motor), rows, atol=1e-10)
