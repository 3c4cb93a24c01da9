"""Tests of `truejoint node`: what is refused before a ROS is needed, and parameters from a file."""

from importlib.util import find_spec

import pytest

from truejoint.crtk.ros import open_transport, ros1, ros2
from truejoint.errors import RosError


@pytest.fixture
def no_ros(monkeypatch):
    """No rospy, wherever it might be; nor rclpy."""
    real = ros1.import_module

    def lacking(name):
        if name in ("rospy", "rclpy"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return real(name)

    ros1._imported.cache_clear()
    monkeypatch.setattr(ros1, "import_module", lacking)
    monkeypatch.setattr(ros2, "import_module", lacking)
    yield
    ros1._imported.cache_clear()


def test_without_ros_it_says_what_to_install(call, no_ros, tmp_path):
    told = call("node", "record", tmp_path / "out.parquet")
    assert told.code == 2
    assert "live ROS 1 needs rospy" in told.err
    assert "install python3-rospy" in told.err
    assert "Traceback" not in told.err
    told = call("node", "record", tmp_path / "out.parquet", "--ros", "2")
    assert "live ROS 2 needs rclpy" in told.err
    assert "setup.bash" in told.err


def test_parameters_come_from_a_file_and_unknown_ones_are_refused(call, no_ros, tmp_path):
    file = tmp_path / "node.toml"
    file.write_text('robot = "raven3"\n')
    told = call("node", "simulate", "--parameters", file)
    assert "raven3" in told.err  # the file was taken
    told = call("node", "simulate", "--parameters", file, "--robot", "raven2")
    assert "rospy" in told.err  # the command line goes before it
    file.write_text("rate = 5\n")
    told = call("node", "simulate", "--parameters", file)
    assert told.code == 2
    assert "no parameter called 'rate'" in told.err


@pytest.mark.skipif(find_spec("rclpy") is None, reason="needs ROS 2, its rclpy")
def test_a_message_goes_through_ros_2():
    transport = open_transport(2)
    got = []
    end = transport.subscribe("/truejoint_test", "std_msgs/Empty", got.append)
    publisher = transport.publisher("/truejoint_test", "std_msgs/Empty")
    publisher.publish(transport.message("std_msgs/Empty"))
    end()
    transport.close()
    with pytest.raises(RosError):
        transport.message("no_msgs/Nothing")
