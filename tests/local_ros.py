"""A ROS within this process, for what does not depend on a real one."""

from __future__ import annotations

import copy
import threading
import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from truejoint.crtk.messages import RAVEN_FIELDS, RAVEN_STATE


def _pose(place: str, turn: str) -> dict[str, Any]:
    return {
        place: SimpleNamespace(x=0.0, y=0.0, z=0.0),
        turn: SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0),
    }


_FIELDS: dict[str, dict[str, Any]] = {
    "sensor_msgs/JointState": {"name": [], "position": [], "velocity": [], "effort": []},
    "crtk_msgs/OperatingState": {"state": "", "is_homed": False, "is_busy": False},
    "crtk_msgs/operating_state": {"state": "", "is_homed": False, "is_busy": False},
    "crtk_msgs/StringStamped": {"string": ""},
    "geometry_msgs/TwistStamped": {
        "twist": SimpleNamespace(
            linear=SimpleNamespace(x=0.0, y=0.0, z=0.0),
            angular=SimpleNamespace(x=0.0, y=0.0, z=0.0),
        )
    },
    "geometry_msgs/WrenchStamped": {},
    "std_msgs/Float64": {"data": 0.0},
    "std_msgs/Float64MultiArray": {"layout": SimpleNamespace(dim=[]), "data": []},
    "std_msgs/MultiArrayDimension": {"label": "", "size": 0, "stride": 0},
    "geometry_msgs/PoseStamped": {"pose": SimpleNamespace(**_pose("position", "orientation"))},
    "geometry_msgs/TransformStamped": {
        "transform": SimpleNamespace(**_pose("translation", "rotation"))
    },
    "std_msgs/Empty": {},
    "diagnostic_msgs/DiagnosticArray": {"status": []},
    "diagnostic_msgs/DiagnosticStatus": {"level": 0, "name": "", "message": "", "values": []},
    "diagnostic_msgs/KeyValue": {},
    RAVEN_STATE: {"runlevel": 0} | {name: [0.0] * 16 for name, _ in RAVEN_FIELDS.values()},
}


class LocalRos:
    """Topics whose messages are handed over in the thread that writes them."""

    name = "local"

    def __init__(self) -> None:
        self.is_over = False
        self.kinds: dict[str, str] = {}
        self.services: dict[str, Callable[[Any, Any], None]] = {}
        self.readers: dict[str, list[Callable[[Any], None]]] = {}
        self.last: dict[str, Any] = {}
        self._told = threading.Condition()

    def now(self) -> float:
        return time.monotonic() + 1e9

    def message(self, kind: str) -> Any:
        header = SimpleNamespace(stamp=0.0, frame_id="")
        name = "hdr" if kind == RAVEN_STATE else "header"
        return SimpleNamespace(**{name: header}, **copy.deepcopy(_FIELDS[kind]))

    def stamped(self, kind: str, t: float) -> Any:
        message = self.message(kind)
        (message.hdr if kind == RAVEN_STATE else message.header).stamp = t
        return message

    def seconds(self, message: Any) -> float:
        return (message.hdr if hasattr(message, "hdr") else message.header).stamp

    def publisher(self, topic: str, kind: str, *, latched: bool = False) -> Any:
        self.kinds[topic] = kind
        return _Publisher(self, topic)

    def subscribe(
        self, topic: str, kind: str, callback: Callable[[Any], None], *, newest: bool = False
    ) -> Any:
        assert self.kinds.get(topic, kind) == kind, f"{topic} is {self.kinds[topic]}, not {kind}"
        self.readers.setdefault(topic, []).append(callback)
        return lambda: self.readers[topic].remove(callback)

    def serve(self, name: str, kind: str, answer: Callable[[Any, Any], None]) -> Any:
        self.services[name] = answer
        return lambda: self.services.pop(name)

    def topics(self) -> dict[str, str]:
        return dict(self.kinds)

    def close(self) -> None:
        pass

    def send(self, topic: str, message: Any) -> None:
        with self._told:
            self.last[topic] = message
            self._told.notify_all()
        for reader in tuple(self.readers.get(topic, ())):
            reader(message)

    def wait_for(self, topic: str, wanted: Callable[[Any], bool]) -> Any:
        """The first message from now on, or the last, that is as wanted."""
        with self._told:
            found = self._told.wait_for(
                lambda: topic in self.last and wanted(self.last[topic]), timeout=60.0
            )
            assert found, f"no such message on {topic}; the last: {self.last.get(topic)}"
            return self.last[topic]


class _Publisher:
    def __init__(self, ros: LocalRos, topic: str) -> None:
        self._ros, self.topic = ros, topic
        self.readers = 1

    def publish(self, message: Any) -> None:
        self._ros.send(self.topic, message)

    def close(self) -> None:
        self._ros.kinds.pop(self.topic, None)
