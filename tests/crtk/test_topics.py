"""Tests of truejoint.crtk.topics: what a recorder keeps is what the arm's getters say."""

import numpy as np
import pytest

from truejoint.crtk import TOPICS, OperatingState, StateBlock, check_topics, simulated_arm
from truejoint.crtk.topics import joint_efforts, state_columns, topic_columns
from truejoint.errors import CommandRefused, RobotError
from truejoint.robots import get_robot


@pytest.fixture(scope="module")
def moved():
    """An arm of which the last state message is of the middle of a motion, and that message."""
    arm, blocks = simulated_arm("raven2", "left", seed=3), []
    arm.enable()
    arm.home()
    arm.subscribe(blocks.append)
    arm.servo_jp_stream(arm.robot.home + np.linspace(0, 1, 300)[:, None] * np.full(7, 0.01))
    return arm, [block for block in blocks if isinstance(block, StateBlock)][-1]


@pytest.mark.parametrize("topic", ["measured_js", "setpoint_js"])
def test_joint_states_are_those_of_the_getter(moved, topic):
    arm, block = moved
    now, columns = getattr(arm, topic)(), topic_columns(arm.robot, topic, block)
    fields = ("position", "velocity", "effort") if topic == "measured_js" else ("position",)
    assert len(columns) == 7 * len(fields)
    for field in fields:
        ours = [columns[f"{field}/{name}"][-1] for name in arm.robot.joint_names]
        assert np.array_equal(ours, getattr(now, field))


@pytest.mark.parametrize("topic", ["measured_cp", "setpoint_cp"])
def test_poses_are_those_of_the_getter(moved, topic):
    arm, block = moved
    pose, columns = getattr(arm, topic)(), topic_columns(arm.robot, topic, block)
    x, y, z, qx, qy, qz, qw = (
        columns[name][-1] for name in ("x", "y", "z", "qx", "qy", "qz", "qw")
    )
    assert [x, y, z] == pytest.approx(pose[:3, 3], abs=1e-12)
    # The matrix of a unit quaternion, written out.
    matrix = [
        [1 - 2 * (qy**2 + qz**2), 2 * (qx * qy - qz * qw), 2 * (qx * qz + qy * qw)],
        [2 * (qx * qy + qz * qw), 1 - 2 * (qx**2 + qz**2), 2 * (qy * qz - qx * qw)],
        [2 * (qx * qz - qy * qw), 2 * (qy * qz + qx * qw), 1 - 2 * (qx**2 + qy**2)],
    ]
    assert np.array(matrix) == pytest.approx(pose[:3, :3], abs=1e-9)


def test_twists_are_those_of_the_getter(moved):
    arm, block = moved
    columns = topic_columns(arm.robot, "measured_cv", block)
    ours = [columns[name][-1] for name in ("vx", "vy", "vz", "wx", "wy", "wz")]
    assert np.abs(ours).max() > 1e-3
    assert ours == pytest.approx(arm.measured_cv(), abs=1e-12)


def test_a_robot_that_states_no_effort_has_none(moved):
    jaw = get_robot("forceps")
    rows = np.zeros((2, 1))
    block = StateBlock(np.arange(2.0), ("jaw",), rows, rows, rows[:, :0], rows, rows, rows)
    assert joint_efforts(jaw, block).shape == (2, 0)
    assert list(topic_columns(jaw, "measured_js", block)) == ["position/jaw", "velocity/jaw"]


def test_a_state_is_numbers():
    columns = state_columns(OperatingState("PAUSED", is_homed=True, is_busy=False, t=3.0))
    assert {name: float(value[0]) for name, value in columns.items()} == {
        "state": 2.0, "is_homed": 1.0, "is_busy": 0.0,
    }  # fmt: skip


def test_what_an_arm_does_not_offer_is_refused():
    check_topics(get_robot("raven2", "left"), dict.fromkeys(TOPICS, 10.0))
    with pytest.raises(CommandRefused, match="no topic called 'measured_x'"):
        check_topics(get_robot("raven2", "left"), {"measured_x": 1.0})
    with pytest.raises(CommandRefused, match="rate nan Hz"):
        check_topics(get_robot("raven2", "left"), {"measured_js": float("nan")})
    with pytest.raises(RobotError, match="kinematics of forceps are not known"):
        check_topics(get_robot("forceps"), {"measured_cv": 1.0})
