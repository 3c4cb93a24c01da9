"""Tests of truejoint.recordings.joint_encoders, its node: a serial line's encoders on /ext_jpos."""

import logging

import numpy as np
import pytest
from tests.local_ros import LocalRos

from truejoint.crtk.messages import PROFILES, TRUTH_TOPIC, joint_state_columns
from truejoint.recordings.joint_encoders import EncoderNode, JointEncoders
from truejoint.robots import get_robot

JOINT_ENCODERS = get_robot("raven2").encoders

pytest.importorskip("serial", reason="pyserial is not installed")

ROBOT = get_robot("raven2")
TOWARDS = np.array([e.direction * (1 if e.end == "upper" else -1) for e in JOINT_ENCODERS])


@pytest.fixture
def node():
    ros = LocalRos()
    encoders = JointEncoders("loop://", JOINT_ENCODERS, clock=ros.now)
    with EncoderNode(ros, encoders, ROBOT, "raven2") as made:
        yield ros, encoders, made


def say(ros, **state):
    message = ros.stamped("crtk_msgs/operating_state", ros.now())
    vars(message).update(state)
    ros.send("/arm1/operating_state", message)


def send(encoders, *rows):
    for row in rows:
        encoders._take(("_".join(map(str, row)) + "\n").encode())


def test_it_registers_while_the_arm_homes_and_publishes_from_the_drivers_zero(node):
    ros, encoders, made = node
    out = []
    ros.subscribe(TRUTH_TOPIC, "sensor_msgs/JointState", out.append)
    send(encoders, (0, 0, 0))
    assert not out
    say(ros, state="ENABLED", is_homed=False, is_busy=True)
    send(encoders, (0, 0, 0), 1000 * TOWARDS, -500 * TOWARDS)
    say(ros, state="ENABLED", is_homed=True, is_busy=False)
    send(encoders, -500 * TOWARDS)
    assert made.published == len(out) == 1
    fields = {"position": np.array([out[0].position])}
    columns = joint_state_columns(ROBOT, "truth", [], fields, PROFILES["raven2"])
    truth = [columns[f"truth/{joint}"][0] for joint in ROBOT.positioning]
    for encoder, position in zip(JOINT_ENCODERS, truth, strict=True):
        # The joint goes to its stop and 1500 counts away from it; the stop is where it is known.
        away = -1.0 if encoder.end == "upper" else 1.0
        assert position == pytest.approx(encoder.hard_stop + away * 1500 * encoder.resolution)
    assert out[0].header.stamp > 1e9


def test_a_homing_that_was_stopped_is_registered_anew(node):
    ros, encoders, made = node
    say(ros, state="ENABLED", is_homed=False, is_busy=True)
    send(encoders, 9000 * TOWARDS)  # before somebody stopped it
    say(ros, state="PAUSED", is_homed=False, is_busy=False)
    say(ros, state="ENABLED", is_homed=False, is_busy=True)
    send(encoders, (0, 0, 0), 1000 * TOWARDS)
    say(ros, state="ENABLED", is_homed=True, is_busy=False)
    assert encoders._zero == pytest.approx(1000 * TOWARDS)
    assert not made.published


def test_a_registration_that_fails_is_said_and_nothing_is_published(node, caplog):
    ros, encoders, made = node
    say(ros, state="ENABLED", is_homed=False, is_busy=True)
    send(encoders, (0, 0, 0), (0, 0, 0))
    with caplog.at_level(logging.WARNING):
        say(ros, state="ENABLED", is_homed=True, is_busy=False)
    assert "did not move during the homing" in caplog.text
    send(encoders, (5, 5, 5))
    assert not made.published
