"""Tests of `truejoint node`: what is refused before a ROS is needed."""

import pytest

from truejoint.crtk.ros import ros1


@pytest.fixture
def no_ros(monkeypatch):
    """No rospy, wherever it might be."""
    real = ros1.import_module

    def lacking(name):
        if name == "rospy":
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return real(name)

    ros1._imported.cache_clear()
    monkeypatch.setattr(ros1, "import_module", lacking)
    yield
    ros1._imported.cache_clear()


def test_without_ros_it_says_what_to_install(call, no_ros):
    said = call.refuses("live ROS 1 needs rospy", "node record -o out.parquet")
    assert "install python3-rospy" in said
