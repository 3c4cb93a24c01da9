"""Tests of truejoint.crtk.ros: set-points that cease, and callbacks that fail on ROS 2."""

from __future__ import annotations

import logging
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from tests.local_ros import LocalRos

from truejoint.crtk.messages import JOINT_STATE, PROFILES
from truejoint.crtk.protocol import SILENCE
from truejoint.crtk.ros import StateStream, ros2
from truejoint.robots import get_robot

ROBOT = get_robot("raven2")


def say(ros, name, t, position):
    message = ros.stamped(JOINT_STATE, t)
    message.position = list(position)
    ros.send(f"/arm1/{name}", message)


def test_set_points_that_have_ceased_are_left_out_and_that_is_said_once(caplog):
    ros, rows = LocalRos(), []
    stream = StateStream(
        ros, ROBOT, PROFILES["raven2_mended"], lambda _, t, columns: rows.append((t, columns))
    )
    stream.start()
    say(ros, "setpoint_js", 10.0, ROBOT.home)
    say(ros, "setpoint_js", 0.0, ROBOT.home + 1.0)  # which says that it means nothing
    with caplog.at_level(logging.WARNING):
        for t in (10.0, 10.0 + SILENCE, 10.2 + SILENCE, 10.3 + SILENCE):
            say(ros, "measured_js", t, ROBOT.home)
    has = ["setpoint/elbow" in columns for _, columns in rows]
    assert has == [True, True, False, False]
    assert rows[0][1]["setpoint/elbow"] == np.array([ROBOT.home[1]])
    assert "measured/elbow" in rows[3][1]
    assert stream.stale == "/arm1/setpoint_js has been silent since 10.000 s"
    assert [r.getMessage() for r in caplog.records] == [
        f"{stream.stale}, while /arm1/measured_js goes on"
    ]
    say(ros, "setpoint_js", 20.0, ROBOT.home)
    say(ros, "measured_js", 20.0, ROBOT.home)
    assert "setpoint/elbow" in rows[-1][1]
    assert not stream.stale
    stream.close()


class FakeNode:
    """A node of ROS 2 that hands messages over."""

    def __init__(self, name):
        self.subscriptions = {}

    def create_subscription(self, kind, topic, callback, queue):
        self.subscriptions[topic] = callback
        return topic

    def destroy_subscription(self, topic):
        del self.subscriptions[topic]

    def destroy_node(self):
        pass


class FakeExecutor:
    def add_node(self, node):
        pass

    def spin(self):
        pass

    def shutdown(self):
        pass


@pytest.fixture
def rclpy(monkeypatch):
    """As much of rclpy as a subscription needs."""
    made = []

    def create_node(name):
        made.append(FakeNode(name))
        return made[-1]

    executors = SimpleNamespace(
        SingleThreadedExecutor=FakeExecutor, ExternalShutdownException=RuntimeError
    )
    messages = ModuleType("std_msgs.msg")
    messages.Empty = object
    modules = {
        "rclpy": SimpleNamespace(ok=lambda: True, create_node=create_node),
        "rclpy.executors": executors,
        "std_msgs.msg": messages,
    }
    monkeypatch.setattr(ros2, "import_module", modules.__getitem__)
    ros2._message_class.cache_clear()
    yield made
    ros2._message_class.cache_clear()


def test_a_callback_that_fails_on_ros_2_is_told_and_the_next_message_heard(rclpy, caplog):
    transport, got = ros2.Ros2("n"), []

    def receive(message):
        got.append(message)
        if message == "bad":
            raise ZeroDivisionError

    end = transport.subscribe("/x", "std_msgs/Empty", receive)
    with caplog.at_level(logging.ERROR):
        for message in ("bad", "good"):
            rclpy[0].subscriptions["/x"](message)
    assert got == ["bad", "good"]
    assert "/x: a message could not be dealt with" in caplog.text
    end()
    assert not rclpy[0].subscriptions
    transport.close()
