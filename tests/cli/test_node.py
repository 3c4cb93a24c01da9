"""Tests of `truejoint node`: what is refused before a ROS is needed."""

import sys
import threading

from truejoint.crtk.ros import ros1


def test_without_ros_it_says_what_to_install(call, monkeypatch):
    monkeypatch.setitem(sys.modules, "rospy", None)  # which no import then finds
    ros1._imported.cache_clear()
    said = call.refuses("live ROS 1 needs rospy", "node record -o out.parquet")
    assert "install python3-rospy" in said


def test_a_twin_that_finds_no_ros_stops(call, monkeypatch):
    monkeypatch.setitem(sys.modules, "rospy", None)
    ros1._imported.cache_clear()
    call.refuses("live ROS 1 needs rospy", "node simulate --quirks")
    assert "paced arm" not in {thread.name for thread in threading.enumerate()}
