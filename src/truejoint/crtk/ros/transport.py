"""Interface to a ROS of either version: topics, messages and a clock."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Protocol

from truejoint.errors import RosError

QUEUE: Final = 1000
"""Messages that wait for a slow reader before the oldest is dropped: a second at 1 kHz."""


@dataclass(frozen=True, eq=False)
class Publisher:
    """A topic that is written: `publish` sends a message at once, `close` gives it up."""

    topic: str
    publish: Callable[[Any], None]
    close: Callable[[], None]
    count_readers: Callable[[], int]

    @property
    def readers(self) -> int:
        """How many are connected."""
        return int(self.count_readers())


class Transport(Protocol):
    """A node of a running ROS. Callbacks come in threads of their own.

    Message types are named as ROS 1 does, ``sensor_msgs/JointState``; messages are those of the
    ROS itself, whose fields have the same names in both but for what `seconds` and `stamped` hide.
    """

    name: str
    """``"ROS 1"`` or ``"ROS 2"``."""

    @property
    def is_over(self) -> bool:
        """Whether somebody has shut the node down."""

    def now(self) -> float:
        """Time of ROS's clock [s]."""

    def message(self, kind: str) -> Any:
        """Make an empty message; raises RosError where its type is not installed."""

    def stamped(self, kind: str, t: float) -> Any:
        """Make an empty message with a header that says `t` [s]."""

    def seconds(self, message: Any) -> float:
        """Stamp of a message [s]; 0 where it is not valid, as CRTK says so."""

    def publisher(self, topic: str, kind: str, *, latched: bool = False) -> Publisher:
        """Begin to write a topic; one who comes late gets the last message if it is `latched`."""

    def subscribe(
        self, topic: str, kind: str, callback: Callable[[Any], None]
    ) -> Callable[[], None]:
        """Call `callback` with every message; gives what ends that."""

    def topics(self) -> dict[str, str]:
        """Type of every topic that somebody writes now."""

    def close(self) -> None:
        """Give up all topics."""


def header_of(message: Any) -> Any:
    """Header of a message; RAVEN's state calls it ``hdr``."""
    return message.header if hasattr(message, "header") else message.hdr


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
