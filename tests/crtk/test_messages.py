"""What messages say: units, joints, arms and the quirks of RAVEN-II, each once and both ways."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from truejoint.crtk import messages
from truejoint.crtk.messages import PROFILES
from truejoint.errors import RobotError
from truejoint.robots import get_robot

RAVEN = PROFILES["raven2"]


def test_definition_of_the_state_is_raven2s_own():
    rosbags = pytest.importorskip("rosbags.typesys", reason="rosbags is not installed")
    store = rosbags.get_typestore(rosbags.Stores.ROS1_NOETIC)
    for name, text in messages.DEFINITIONS.items():
        full = name.replace("/", "/msg/")
        store.register(rosbags.get_types_from_msg(text, full))
    sums = {
        name: store.generate_msgdef(name.replace("/", "/msg/"))[1] for name in messages.DEFINITIONS
    }
    assert sums["raven_2/raven_state"] == "ce9e7f4969049d8bb365de3c98461a01"
    assert sums["crtk_msgs/operating_state"] == "b1bd4021639d9d9c5fbfff78d6ff3158"
    assert sums["crtk_msgs/StringStamped"] == "5e3e46086181199270f1ac3a28a5977f"


@given(
    arrays.arrays(np.float32, (3, 16), elements=st.floats(-1e3, 1e3, width=32)),
    st.sampled_from(["left", "right"]),
    st.sampled_from(sorted(messages.RAVEN_FIELDS)),
)
def test_columns_of_a_state_make_the_same_message_again(values, arm, quantity):
    robot = get_robot("raven2", arm)
    name, _ = messages.RAVEN_FIELDS[quantity]
    if quantity in ("encoder", "dac"):
        values = values.astype(np.int32)
    columns = messages.raven_state_columns(robot, {name: values}, [quantity])
    assert len(columns) == len(robot.channels)
    again = messages.raven_state_fields(robot, columns)[name]
    half = slice(0, 8) if arm == "left" else slice(8, 16)
    np.testing.assert_array_equal(again[:, half], values[:, half])
    assert again.dtype == values.dtype
    assert not np.delete(again, np.arange(16)[half], axis=1).any()


def test_insertion_in_degrees_becomes_metres():
    state = {"jpos": np.full((1, 16), 22.918, dtype=np.float32)}
    columns = messages.raven_state_columns(get_robot("raven2"), state, ["measured"])
    assert columns["measured/insertion"] == pytest.approx(0.4, abs=1e-5)


@pytest.mark.parametrize("name", sorted(PROFILES))
def test_a_topic_is_of_the_arm_that_it_was_asked_for(name):
    profile = PROFILES[name]
    for arm in profile.arms.values():
        for what in ("measured_js", "servo_jp", "measured_cp", "operating_state"):
            assert profile.arm_of(profile.topic(arm, what)) == arm


def test_only_measured_topics_of_raven_are_swapped():
    assert RAVEN.topic("left", "measured_js") == "/arm2/measured_js"
    assert RAVEN.topic("left", "servo_jp") == "/arm1/servo_jp"
    assert PROFILES["raven2_mended"].topic("left", "measured_js") == "/arm1/measured_js"
    assert RAVEN.arm_of("/joint_enc") == ""


@pytest.mark.parametrize(
    ("profile", "robot", "topic"),
    [("raven2", "raven2", "/arm2/measured_js"), ("dvrk", "dvrk_psm", "")],
)
def test_joints_are_found_by_the_names_that_they_have_in_messages(profile, robot, topic):
    profile, robot = PROFILES[profile], get_robot(robot)
    names = [profile.joint_in(topic, joint) for joint in robot.joint_names]
    assert messages.joint_order(robot, names, len(names), profile) == list(robot.joint_names)
    assert names != list(robot.joint_names)


def test_messages_without_names_go_by_their_number():
    robot = get_robot("raven2")
    assert messages.joint_order(robot, [], 3, RAVEN) == list(robot.positioning)
    assert messages.joint_order(robot, [], 7, RAVEN) == list(robot.joint_names)
    with pytest.raises(RobotError, match="4 positions without names"):
        messages.joint_order(robot, [], 4, RAVEN)
    with pytest.raises(RobotError, match="did you mean 'elbow'"):
        messages.joint_order(robot, ["gold_elbo"], 1, RAVEN)
    with pytest.raises(RobotError, match="one for each"):
        messages.joint_order(robot, ["gold_elbow", "elbow"], 2, RAVEN)


def test_efforts_on_joints_become_those_at_the_motors():
    robot = get_robot("raven2")
    motor = np.random.default_rng(0).normal(size=(4, 7))
    fields = {"position": np.zeros((4, 7)), "effort": robot.transmission.joint_effort(motor)}
    turned = list(range(7))[::-1]
    names = [robot.joint_names[k] for k in turned]
    columns = messages.joint_state_columns(
        robot, "measured", names, {k: v[:, turned] for k, v in fields.items()}, PROFILES["crtk"]
    )
    found = np.column_stack([columns[f"effort/{joint}"] for joint in robot.joint_names])
    np.testing.assert_allclose(found, motor, atol=1e-12)
    assert not any(
        n.startswith("effort")
        for n in messages.joint_state_columns(robot, "measured", names, fields, RAVEN)
    )


def test_offsets_of_the_encoders_are_added_to_truth_alone():
    robot, fields = get_robot("raven2"), {"position": np.zeros((1, 3))}
    truth = messages.joint_state_columns(robot, "truth", [], fields, RAVEN)
    assert math.degrees(truth["truth/elbow"][0]) == pytest.approx(7.5)
    assert truth["truth/insertion"][0] == pytest.approx(-0.010467)
    assert truth["truth/shoulder"][0] == 0.0
    assert (
        messages.joint_state_columns(robot, "setpoint", [], fields, RAVEN)["setpoint/elbow"][0]
        == 0.0
    )


def test_unequal_lengths_are_refused():
    fields = {"position": np.zeros((1, 3)), "velocity": np.zeros((1, 2))}
    with pytest.raises(RobotError, match="3 positions and 2 values of velocity"):
        messages.joint_state_columns(get_robot("raven2"), "measured", [], fields, RAVEN)
