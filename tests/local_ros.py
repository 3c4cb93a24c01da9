"""A ROS within this process, for what does not depend on a real one."""

import threading
import time
from collections.abc import Callable
from typing import Any

from truejoint.crtk.ros.dds_types import message_class
from truejoint.crtk.ros.transport import header_of


class LocalRos:
    """Topics whose messages are handed over in the thread that writes them."""

    def __init__(self) -> None:
        self.is_over = False
        self.kinds: dict[str, str] = {}
        self.services: dict[str, Callable[[Any, Any], None]] = {}
        self.readers: dict[str, list[Callable[[Any], None]]] = {}
        self.last: dict[str, Any] = {}
        self.awaited: set[str] = set()
        self._told = threading.Condition()

    def now(self) -> float:
        return time.monotonic() + 1e9

    def message(self, kind: str) -> Any:
        return self.stamped(kind, 0.0)

    def stamped(self, kind: str, t: float) -> Any:
        made = message_class(kind.replace("/", "/msg/"))()
        for name in {"header", "hdr"} & vars(made).keys():
            getattr(made, name).stamp = t
        return made

    def seconds(self, message: Any) -> float:
        return header_of(message).stamp

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
        self.awaited.add(topic)
        with self._told:
            found = self._told.wait_for(
                lambda: topic in self.last and wanted(self.last[topic]), timeout=60.0
            )
            assert found, f"no such message on {topic}; the last: {self.last.get(topic)}"
            return self.last[topic]


class _Publisher:
    def __init__(self, ros: LocalRos, topic: str) -> None:
        self._ros, self.topic = ros, topic

    @property
    def readers(self) -> int:
        """How many read it, with who has waited for one of its messages."""
        return len(self._ros.readers.get(self.topic, ())) + (self.topic in self._ros.awaited)

    def publish(self, message: Any) -> None:
        self._ros.send(self.topic, message)

    def close(self) -> None:
        self._ros.kinds.pop(self.topic, None)
