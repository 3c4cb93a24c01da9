"""Interface to a ROS of either version: topics, messages and a clock."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Protocol

QUEUE: Final = 1000  # messages, a second's, that wait for a slow reader; then the oldest is dropped


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
        self, topic: str, kind: str, callback: Callable[[Any], None], *, newest: bool = False
    ) -> Callable[[], None]:
        """Call `callback` with every message, or the `newest` one alone; gives what ends that."""

    def serve(self, name: str, kind: str, answer: Callable[[Any, Any], None]) -> Callable[[], None]:
        """Offer a service that `answer` fills in; gives its end. RosError if not installed."""

    def topics(self) -> dict[str, str]:
        """Type of every topic that somebody writes now."""

    def close(self) -> None:
        """Give up all topics."""


def header_of(message: Any) -> Any:
    """Header of a message; RAVEN's state calls it ``hdr``."""
    return message.header if hasattr(message, "header") else message.hdr
