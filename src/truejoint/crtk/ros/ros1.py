"""ROS 1 through rospy, as Debian or a ROS of one's own brings it."""

import logging
import sys
import threading
import time
import xmlrpc.client
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, Final, cast

from truejoint.crtk.messages import DEFINITIONS, SERVICES
from truejoint.crtk.ros.transport import QUEUE, Publisher, header_of
from truejoint.errors import RosError

_DEBIAN: Final = "/usr/lib/python3/dist-packages"
_BUFFER: Final = 1 << 18  # bytes that are read at once: hundreds of messages
_WATCH: Final = 1.0  # [s] between two looks at the master
_HEADER: Final = "MSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
_RULE: Final = "=" * 80 + "\n"

_log = logging.getLogger(__name__)


class Ros1:
    """A node of ROS 1; there is one in a process, whose topics each `Ros1` has for itself.

    A master that is started anew is told all topics and services; standing connections outlive it.
    Raises RosError if rospy is not there, or no master answers.
    """

    name = "ROS 1"

    def __init__(self, node: str) -> None:
        self._rospy = _start(node)
        self._open: list[Any] = []

    @property
    def is_over(self) -> bool:
        """Whether somebody has shut the node down, as ``rosnode kill`` does."""
        return bool(self._rospy.is_shutdown())

    def now(self) -> float:
        """Time of ROS's clock [s]."""
        return float(self._rospy.get_time())

    def message(self, kind: str) -> Any:
        """Make an empty message; raises RosError where its type is not installed."""
        return _message_class(kind)()

    def stamped(self, kind: str, t: float) -> Any:
        """Make an empty message with a header that says `t` [s]."""
        message = self.message(kind)
        header_of(message).stamp = self._rospy.Time.from_sec(t)
        return message

    def seconds(self, message: Any) -> float:
        """Stamp of a message [s]; 0 where it is not valid."""
        stamp = header_of(message).stamp
        return float(stamp.secs + 1e-9 * stamp.nsecs)

    def publisher(self, topic: str, kind: str, *, latched: bool = False) -> Publisher:
        """Begin to write a topic."""
        made = self._rospy.Publisher(
            topic, _message_class(kind), queue_size=QUEUE, latch=latched, tcp_nodelay=True
        )
        self._open.append(made)

        def count_readers() -> int:
            made.impl.check()  # else one that has gone counts until two messages were sent to it
            return int(made.get_num_connections())

        return Publisher(topic, made.publish, made.unregister, count_readers)

    def subscribe(
        self, topic: str, kind: str, callback: Callable[[Any], None], *, newest: bool = False
    ) -> Callable[[], None]:
        """Call `callback` with every message, or the `newest` one alone; gives what ends that.

        A type of which there are variants is read by the definition that its writer sends.
        """
        message_class, receive = _message_class(kind), callback
        if kind in DEFINITIONS:
            message_class, receive = self._rospy.AnyMsg, _by_definition(kind, callback)
        made = self._rospy.Subscriber(
            topic, message_class, receive, queue_size=1 if newest else None, buff_size=_BUFFER,
            tcp_nodelay=True,
        )  # fmt: skip
        self._open.append(made)
        return lambda: _close(made)

    def serve(self, name: str, kind: str, answer: Callable[[Any, Any], None]) -> Callable[[], None]:
        """Offer a service whose response `answer` fills in from the request; gives what ends it."""
        service_class = _service_class(kind)

        def respond(request: Any) -> Any:
            response = service_class._response_class()
            answer(request, response)
            return response

        made = self._rospy.Service(name, service_class, respond)
        return lambda: made.shutdown("its arm is served no more")

    def topics(self) -> dict[str, str]:
        """Type of every topic that somebody writes now."""
        try:
            return dict(self._rospy.get_published_topics())
        except OSError:
            raise RosError(_no_master()) from None

    def close(self) -> None:
        """Give up all topics."""
        while self._open:
            _close(self._open.pop())


def _close(made: Any) -> None:
    with suppress(Exception):  # a master that is gone need not be told
        made.unregister()


def _by_definition(kind: str, callback: Callable[[Any], None]) -> Callable[[Any], None]:
    """Take raw messages apart as the definition says that came with the connection."""

    def receive(raw: Any) -> None:
        header = raw._connection_header
        message = _generated(header.get("type", kind), header["message_definition"])()
        message.deserialize(raw._buff)
        callback(message)

    return receive


@cache
def _message_class(kind: str) -> Any:
    message_class = import_module("roslib.message").get_message_class(kind)
    if message_class is None and kind in DEFINITIONS:
        message_class = _generated(kind, f"{DEFINITIONS[kind]}{_RULE}{_HEADER}")
    if message_class is None:
        package = kind.partition("/")[0]
        raise RosError(
            f"ROS's messages {kind} are not installed: install {package}, on Debian "
            f"python3-{package.replace('_', '-')}"
        )
    return message_class


@cache
def _service_class(kind: str) -> Any:
    """Type of a service; rospy wants of it what genpy would write (wiki.ros.org/ROS/TCPROS)."""
    made = import_module("roslib.message").get_service_class(kind)
    if made is not None:
        return made
    md5sum, *parts = SERVICES[kind]
    pose = _message_class("geometry_msgs/Pose")._full_text
    request, response = (
        _generated(kind + name, f"{text}{_RULE}MSG: geometry_msgs/Pose\n{pose}")
        for name, text in zip(("Request", "Response"), parts, strict=True)
    )
    of = {"_type": kind, "_md5sum": md5sum, "_request_class": request, "_response_class": response}
    return type(kind.partition("/")[2], (), of)


@cache
def _generated(kind: str, definition: str) -> Any:
    return import_module("genpy.dynamic").generate_dynamic(kind, definition)[kind]


@cache
def _imported() -> Any:
    """Import rospy; Debian's comes after all else, so that it brings no second NumPy."""
    with suppress(ModuleNotFoundError):
        return import_module("rospy")
    if Path(_DEBIAN).is_dir() and _DEBIAN not in sys.path:
        sys.path.append(_DEBIAN)
    try:
        return import_module("rospy")
    except ImportError as error:
        version = f"{sys.version_info.major}.{sys.version_info.minor}"
        raise RosError(
            f"live ROS 1 needs rospy, which this Python {version} lacks ({error}): on Debian 12 "
            "install python3-rospy, elsewhere source your ROS's setup.bash first"
        ) from None


_starting: Final = threading.Lock()


def _start(node: str) -> Any:
    """Make this process a node, once; gives rospy."""
    rospy = _imported()
    with _starting:
        rosgraph = import_module("rosgraph")
        if not rosgraph.is_master_online():
            raise RosError(_no_master())
        if not rospy.core.is_initialized():
            loggers = [logging.getLogger(name) for name in logging.root.manager.loggerDict]
            heard = [logger for logger in loggers if not logger.disabled]
            rospy.init_node(node, argv=[], anonymous=True, disable_signals=True)
            for logger in heard:
                logger.disabled = False  # rospy silences all that are not its own
            threading.Thread(target=_watch, args=(rosgraph, rospy), daemon=True).start()
        elif rospy.is_shutdown():
            raise RosError("this process's ROS node was shut down; start truejoint again")
    return rospy


def _no_master() -> str:
    uri = import_module("rosgraph").get_master_uri()
    return f"no ROS master answers at {uri}: start roscore there, or set ROS_MASTER_URI"


def _watch(rosgraph: Any, rospy: Any) -> None:
    """Tell a new master this node's topics and services (wiki.ros.org/ROS/Slave_API)."""
    master = rosgraph.Master(rospy.get_name())
    was_gone = False
    while not rospy.core.is_shutdown_requested():
        try:
            try:
                master.lookupNode(rospy.get_name())
            except rosgraph.MasterError:  # it does not know us
                name, uri = rospy.get_name(), rospy.get_node_uri()
                with cast("Any", xmlrpc.client.ServerProxy(uri)) as node:
                    for topic, kind in node.getPublications(name)[2]:
                        master.registerPublisher(topic, kind, uri)
                    for topic, kind in node.getSubscriptions(name)[2]:
                        writers = master.registerSubscriber(topic, kind, uri)
                        node.publisherUpdate("/master", topic, writers)
                for service in rospy.impl.registration.get_service_manager().map.values():
                    master.registerService(service.resolved_name, service.uri, uri)
                _log.warning("the ROS master was started anew: told it what we offer")
            was_gone = False
        except OSError:
            if not was_gone:
                _log.warning("%s; connections that stand go on", _no_master())
            was_gone = True
        except Exception as error:  # noqa: BLE001  # whatever it is, look again
            _log.debug("looking at the ROS master: %s", error)
        time.sleep(_WATCH)
