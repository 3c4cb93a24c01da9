"""Topics of a running ROS, 1 or 2, and what an arm says on them."""

from truejoint.crtk.ros.state_stream import StateStream
from truejoint.crtk.ros.transport import Publisher, Transport
from truejoint.errors import RosError

__all__ = ["Publisher", "StateStream", "Transport", "open_transport"]


def open_transport(version: int = 1, node: str = "truejoint") -> Transport:
    """Become a node of the ROS that runs; rospy or rclpy is imported here and nowhere else.

    Parameters
    ----------
    version : {1, 2}
    node : str
        Its name, to which ROS 1 adds what makes it unique.

    Raises
    ------
    RosError
        If there is no such ROS on this computer, or no master answers; says what to do.

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
        from truejoint.crtk.ros.ros2 import Ros2  # noqa: PLC0415  # needs rclpy

        return Ros2(node)
    raise RosError(f"no ROS {version}; give 1 or 2")
