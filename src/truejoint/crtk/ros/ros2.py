"""ROS 2 through rclpy, as a sourced ROS brings it."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import cache, partial
from importlib import import_module
from typing import Any

from truejoint.crtk.messages import message_type
from truejoint.crtk.ros.transport import QUEUE, Publisher, header_of
from truejoint.errors import RosError

_log = logging.getLogger(__name__)


class Ros2:
    """A node of ROS 2; as `Ros1`, but that nobody needs a master.

    Raises RosError if rclpy is not there.
    """

    name = "ROS 2"

    def __init__(self, node: str) -> None:
        try:
            self._rclpy = import_module("rclpy")
        except ImportError as error:
            raise RosError(
                f"live ROS 2 needs rclpy, which this Python lacks ({error}): source your ROS's "
                "setup.bash first"
            ) from None
        if not self._rclpy.ok():
            self._rclpy.init(args=[])
        self._node = self._rclpy.create_node(node)
        executors = import_module("rclpy.executors")
        self._executor = executors.SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._spin, name="ROS 2", daemon=True)
        self._thread.start()

    @property
    def is_over(self) -> bool:
        """Whether somebody has shut ROS down."""
        return not self._rclpy.ok()

    def now(self) -> float:
        """Time of ROS's clock [s]."""
        return float(self._node.get_clock().now().nanoseconds * 1e-9)

    def message(self, kind: str) -> Any:
        """Make an empty message; raises RosError where its type is not installed."""
        return _message_class(kind)()

    def stamped(self, kind: str, t: float) -> Any:
        """Make an empty message with a header that says `t` [s]."""
        message = _message_class(kind)()
        seconds, rest = divmod(round(t * 1e9), 1_000_000_000)
        stamp = header_of(message).stamp
        stamp.sec, stamp.nanosec = seconds, rest
        return message

    def seconds(self, message: Any) -> float:
        """Stamp of a message [s]; 0 where it is not valid."""
        stamp = header_of(message).stamp
        return float(stamp.sec + 1e-9 * stamp.nanosec)

    def publisher(self, topic: str, kind: str, *, latched: bool = False) -> Publisher:
        """Begin to write a topic."""
        quality: Any = QUEUE
        if latched:
            qos = import_module("rclpy.qos")
            quality = qos.QoSProfile(depth=1, durability=qos.DurabilityPolicy.TRANSIENT_LOCAL)
        made = self._node.create_publisher(_message_class(kind), topic, quality)
        close = partial(self._node.destroy_publisher, made)
        return Publisher(topic, made.publish, close, made.get_subscription_count)

    def subscribe(
        self, topic: str, kind: str, callback: Callable[[Any], None], *, newest: bool = False
    ) -> Callable[[], None]:
        """Call `callback` with every message, or the `newest` one alone; gives what ends that.

        Its errors are logged, as rospy does: rclpy's thread would end by them, and with it every
        other subscription.
        """

        def receive(message: Any) -> None:
            try:
                callback(message)
            except Exception:  # noqa: BLE001  # whatever it is, others are to be heard
                _log.exception("%s: a message could not be dealt with", topic)

        made = self._node.create_subscription(
            _message_class(kind), topic, receive, 1 if newest else QUEUE
        )
        return lambda: self._node.destroy_subscription(made)

    def serve(self, name: str, kind: str, answer: Callable[[Any, Any], None]) -> Callable[[], None]:
        """Offer a service whose response `answer` fills in from the request; gives what ends it."""

        def respond(request: Any, response: Any) -> Any:
            answer(request, response)
            return response

        made = self._node.create_service(_message_class(kind, "srv"), name, respond)
        return lambda: self._node.destroy_service(made)

    def topics(self) -> dict[str, str]:
        """Type of every topic that somebody writes now."""
        listed = self._node.get_topic_names_and_types()
        return {
            name: message_type(kinds[0])
            for name, kinds in listed
            if self._node.count_publishers(name)
        }

    def close(self) -> None:
        """Give up all topics."""
        self._executor.shutdown()
        self._thread.join(1.0)
        self._node.destroy_node()

    def _spin(self) -> None:
        shut_down = import_module("rclpy.executors").ExternalShutdownException
        with suppress(shut_down):
            self._executor.spin()


@cache
def _message_class(kind: str, of: str = "msg") -> Any:
    package, name = kind.split("/")
    try:
        return getattr(import_module(f"{package}.{of}"), name)
    except (ImportError, AttributeError):
        raise RosError(
            f"ROS's messages {kind} are not installed: build or install {package}, and source it"
        ) from None
