"""Tests of truejoint.crtk.ros.state_stream: set-points that cease."""

import logging

import numpy as np
from tests.local_ros import LocalRos

from truejoint.crtk.messages import JOINT_STATE, PROFILES
from truejoint.crtk.protocol import SILENCE
from truejoint.crtk.ros import StateStream
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
