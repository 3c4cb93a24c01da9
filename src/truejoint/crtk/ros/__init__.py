"""Topics of a running ROS, 1 or 2, and what an arm says on them."""

from truejoint.crtk.ros.state_stream import StateStream
from truejoint.crtk.ros.transport import Publisher, Transport
from truejoint.errors import RosError
from truejoint.extras import require

__all__ = ["Publisher", "StateStream", "Transport", "open_transport"]


def open_transport(version: int = 1, node: str = "truejoint") -> Transport:
    """Become a node of the ROS that runs: by rospy, or over DDS as ROS 2 does.

    Parameters
    ----------
    version : {1, 2}
    node : str
        Its name, to which ROS 1 adds what makes it unique.

    Raises
    ------
    RosError
        If there is no ROS 1 on this computer, no master answers, or ROS 2's variables mean nothing.
    TruejointError
        If what the extra ``ros2`` brings is not installed. All say what to do.

    Examples
    --------
    >>> open_transport(3)
    Traceback (most recent call last):
    truejoint.errors.RosError: no ROS 3; give 1 or 2
    """
    if version == 1:
        from truejoint.crtk.ros.ros1 import Ros1  # noqa: PLC0415  # needs rospy

        return Ros1(node)
    if version == 2:
        for module in ("cyclonedds.domain", "rosbags.typesys"):
            require(module, "ros2", "live ROS 2")
        from truejoint.crtk.ros.ros2 import Ros2  # noqa: PLC0415  # needs them

        return Ros2(node)
    raise RosError(f"no ROS {version}; give 1 or 2")
