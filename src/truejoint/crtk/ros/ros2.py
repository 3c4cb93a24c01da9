"""ROS 2 by what it speaks on the wire, through Eclipse Cyclone DDS: no ROS need be installed.

What DDS is told so that ROS 2's nodes and tools take this for one of theirs follows
ros2/rmw_cyclonedds:rmw_cyclonedds_cpp/src/rmw_node.cpp and ros2/rmw_dds_common.
"""

import logging
import os
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final
from xml.sax.saxutils import quoteattr

from cyclonedds import core
from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.core import Policy
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from truejoint.crtk.messages import OPERATING_STATES, message_type
from truejoint.crtk.ros.dds_types import message_class
from truejoint.crtk.ros.transport import QUEUE, Publisher, header_of
from truejoint.errors import RosError

_ALL: Final = core.SampleState.Any | core.ViewState.Any
_NEW: Final = core.SampleState.NotRead | core.ViewState.Any | core.InstanceState.Any
_DISCOVERY: Final = 1.5  # [s] in which others on the network have been found
_BATCH: Final = 64  # messages of one topic before the next topic's turn
_LAST_DOMAIN: Final = 232  # beyond it DDS has no ports
_RANGES: Final = ("SUBNET", "LOCALHOST", "OFF", "SYSTEM_DEFAULT")
_RELIABILITY: Final = 11  # number of DDS's policy
_GRAPH: Final = "rmw_dds_common/msg/ParticipantEntitiesInfo"

_log = logging.getLogger(__name__)
_domains: dict[int, Domain | None] = {}  # of this process; each is configured once
_domains_lock: Final = threading.Lock()
_topics_lock: Final = threading.Lock()
_ATTEMPTS: Final = 3
_PAUSE: Final = 0.05  # [s] between them


class Ros2:
    """A node of ROS 2; as `Ros1`, but that nobody needs a master.

    ``ROS_DOMAIN_ID``, ``ROS_AUTOMATIC_DISCOVERY_RANGE``, ``ROS_STATIC_PEERS``,
    ``ROS_LOCALHOST_ONLY`` and ``CYCLONEDDS_URI`` mean what they mean to ROS 2. Clients on Fast DDS
    get no answer from services: Cyclone DDS cannot say whose the answer is as they want it said.
    Raises RosError if one of them has no meaning, or the network cannot be used.
    """

    name = "ROS 2"

    def __init__(self, node: str) -> None:
        self._node, self._over, self._began = node, threading.Event(), time.monotonic()
        try:
            self._participant = DomainParticipant(_domain(os.environ), _qos("enclave=/;"))
        except core.DDSException as error:
            raise RosError(f"ROS 2's network cannot be used: {error.msg}") from None
        self._lock, self._said_who = threading.RLock(), False
        self._topics: dict[tuple[str, type[Any]], Topic[Any]] = {}
        self._writers: list[DataWriter[Any]] = []
        self._subscriptions: list[_Subscription] = []
        self._waits = core.WaitSet(self._participant)
        self._wake = core.GuardCondition(self._participant)
        self._waits.attach(self._wake)
        self._written = BuiltinDataReader(self._participant, BuiltinTopicDcpsPublication)
        graph = message_class(_GRAPH)
        self._graph = self._endpoint(DataWriter, "ros_discovery_info", graph, latched=True)
        self._show()
        self._thread = threading.Thread(target=self._spin, name="ROS 2", daemon=True)
        self._thread.start()

    @property
    def is_over(self) -> bool:
        """Whether it was closed: nobody else can."""
        return self._over.is_set()

    def now(self) -> float:
        """Time of ROS's clock [s]."""
        return time.time()

    def message(self, kind: str) -> Any:
        """Make an empty message; raises RosError where its type is not known."""
        return message_class(_full_name(kind))()

    def stamped(self, kind: str, t: float) -> Any:
        """Make an empty message with a header that says `t` [s]."""
        message = self.message(kind)
        stamp = header_of(message).stamp
        stamp.sec, stamp.nanosec = divmod(round(t * 1e9), 1_000_000_000)
        return message

    def seconds(self, message: Any) -> float:
        """Stamp of a message [s]; 0 where it is not valid."""
        stamp = header_of(message).stamp
        return float(stamp.sec + 1e-9 * stamp.nanosec)

    def publisher(self, topic: str, kind: str, *, latched: bool = False) -> Publisher:
        """Begin to write a topic."""
        made = message_class(_full_name(kind))
        writer = self._endpoint(DataWriter, f"rt{topic}", made, latched=latched)
        end = self._shown(self._writers, writer, partial(_end, writer))
        return Publisher(topic, writer.write, end, lambda: len(writer.get_matched_subscriptions()))

    def subscribe(
        self, topic: str, kind: str, callback: Callable[[Any], None], *, newest: bool = False
    ) -> Callable[[], None]:
        """Call `callback` with every message, or the `newest` one alone; gives what ends that.

        Its errors are logged, as rospy does, and other subscriptions go on. A robot's state is
        asked for twice: latched, which may have come long ago, and as it comes.
        """
        made = message_class(_full_name(kind))
        readers = [
            self._endpoint(DataReader, f"rt{topic}", made, newest=newest, latched=old)
            for old in ((True, False) if kind in OPERATING_STATES else (False,))
        ]
        return self._listen(_Subscription(topic, callback, readers))

    def serve(self, name: str, kind: str, answer: Callable[[Any, Any], None]) -> Callable[[], None]:
        """Offer a service whose response `answer` fills in from the request; gives what ends it."""
        if not self._said_who:
            self._said_who = True
            _log.warning("services answer clients on Cyclone DDS alone; topics reach all")
        request, response = (
            message_class(f"{_full_name(kind, 'srv')}_{half}", is_call=True)
            for half in ("Request", "Response")
        )
        who = f"serviceid={'.'.join(f'{byte:x}' for byte in os.urandom(16))};"
        reader = self._endpoint(DataReader, f"rq{name}Request", request, who=who)
        writer = self._endpoint(DataWriter, f"rr{name}Reply", response, who=who)

        def respond(call: Any) -> None:
            reply = response(call.client_guid, call.sequence_number)
            answer(call, reply)
            writer.write(reply)

        ending = ExitStack()
        ending.callback(self._shown(self._writers, writer, partial(_end, writer)))
        ending.callback(self._listen(_Subscription(name, respond, [reader])))
        return ending.close

    def topics(self) -> dict[str, str]:
        """Type of every topic that somebody writes now, once others had the time to be found."""
        self._over.wait(max(0.0, self._began + _DISCOVERY - time.monotonic()))
        alive = core.ReadCondition(self._written, _ALL | core.InstanceState.Alive)
        written = self._written.read(1 << 16, condition=alive)
        return {
            end.topic_name.removeprefix("rt"): message_type(
                end.type_name.replace("::dds_::", "::").replace("::", "/").removesuffix("_")
            )
            for end in written
            if isinstance(end.topic_name, str) and end.topic_name.startswith("rt/")
        }

    def close(self) -> None:
        """Give up all topics."""
        if self.is_over:
            return
        self._over.set()
        self._wake.set(True)
        if threading.current_thread() is not self._thread:
            self._thread.join(1.0)
        for subscription in self._subscriptions:  # a thread that is late hears no more
            subscription.detach(self._waits)
        _end(self._participant)

    def _endpoint(
        self, make: Callable[..., Any], name: str, kind: type[Any], *, newest: bool = False,
        latched: bool = False, who: str = "",
    ) -> Any:  # fmt: skip
        """Make a reader or a writer of a topic; says its type's hash, and who calls by it."""
        with self._lock:
            if (name, kind) not in self._topics:
                self._topics[name, kind] = _topic(self._participant, name, kind)
        depth = 1 if newest or latched else QUEUE
        qos = _qos(f"{who}typehash={kind.TYPE_HASH};", depth=depth, latched=latched)
        return make(self._participant, self._topics[name, kind], qos)

    def _listen(self, subscription: "_Subscription") -> Callable[[], None]:
        """Begin to hand messages over; gives what ends it."""
        subscription.attach(self._waits)
        release = partial(subscription.detach, self._waits)
        return self._shown(self._subscriptions, subscription, release)

    def _shown(
        self, endpoints: list[Any], endpoint: Any, release: Callable[[], None]
    ) -> Callable[[], None]:
        """Show an endpoint in ROS's graph; gives what takes it out, and releases it, once."""
        with self._lock:
            endpoints.append(endpoint)
            self._show()

        def end() -> None:
            with self._lock:
                if endpoint in endpoints:
                    endpoints.remove(endpoint)
                    self._show()
                    release()

        return end

    def _show(self) -> None:
        """Say which endpoints are this node's, for ``ros2 node list`` and ``ros2 topic info``."""
        named = message_class("rmw_dds_common/msg/NodeEntitiesInfo")
        gid = message_class("rmw_dds_common/msg/Gid")
        size = len(gid().data)

        def gid_of(entity: Any) -> Any:
            return gid(list(entity.guid.bytes.ljust(size, b"\0")))

        readers = [reader for each in self._subscriptions for reader in each.readers]
        node = named("/", self._node, [*map(gid_of, readers)], [*map(gid_of, self._writers)])
        self._graph.write(message_class(_GRAPH)(gid_of(self._participant), [node]))

    def _spin(self) -> None:
        looked = time.monotonic()
        while not self.is_over:
            self._waits.wait(duration(seconds=1))
            with_look = time.monotonic() - looked > 1.0
            for subscription in tuple(self._subscriptions):
                subscription.take()
                if with_look:
                    subscription.tell_mismatch()
            looked = time.monotonic() if with_look else looked


@dataclass(eq=False)
class _Subscription:
    """What is called with the messages of one topic, from one reader or from two.

    Of two the first was asked for what was latched before: each writer's last message. Writers
    that latch are heard by the second too, those that do not by it alone.
    """

    topic: str
    callback: Callable[[Any], None]
    readers: list[DataReader[Any]]
    _conditions: list[core.ReadCondition] = field(default_factory=list)
    _last: dict[int, int] = field(default_factory=dict)  # stamp [ns] by writer

    def attach(self, waits: core.WaitSet) -> None:
        self._conditions = [core.ReadCondition(reader, _NEW) for reader in self.readers]
        for condition in self._conditions:
            waits.attach(condition)

    def detach(self, waits: core.WaitSet) -> None:
        """Let it wake for them no more, and end the readers."""
        while self._conditions:
            waits.detach(self._conditions.pop())
        while self.readers:
            _end(self.readers.pop())

    def take(self) -> None:
        for place, reader in enumerate(tuple(self.readers)):
            only_first = place == 0 and len(self.readers) > 1
            for _ in range(_BATCH):
                try:
                    taken = reader.take(1) if reader in self.readers else ()
                    if not taken:
                        break
                    if self._is_new(taken[0].sample_info, only_first=only_first):
                        self.callback(taken[0])
                except Exception:  # noqa: BLE001  # whatever it is, others are to be heard
                    if reader in self.readers:  # which nobody ended meanwhile
                        _log.exception("%s: a message could not be dealt with", self.topic)

    def tell_mismatch(self) -> None:
        """Log once that a writer cannot be heard: it promises less, or is of another type."""
        with suppress(core.DDSException, IndexError):  # it was ended meanwhile
            reader: Any = self.readers[-1]
            status = reader.get_requested_incompatible_qos_status()
            if status.total_count_change:
                why = "of another type, and is not heard; is it this robot's?"
                if status.last_policy_id == _RELIABILITY:
                    why = "best effort, and is not heard; make it reliable"
                _log.warning("%s: its publisher is %s", self.topic, why)

    def _is_new(self, sample: Any, *, only_first: bool) -> bool:
        writer, stamp = sample.publication_handle, sample.source_timestamp
        last = self._last.get(writer)
        if not sample.valid_data or last == stamp or (only_first and last is not None):
            return False
        if len(self.readers) > 1:
            self._last[writer] = stamp
        return True


def _full_name(kind: str, of: str = "msg") -> str:
    return kind.replace("/", f"/{of}/")


def _end(entity: core.Entity) -> None:
    entity.__del__()  # the binding has no other way to end what others may still refer to


def _qos(user_data: str, *, depth: int = 1, latched: bool = False) -> Qos:
    """Promise what ROS 2 does by default: reliable, the newest `depth` messages."""
    history = Policy.History.KeepLast(depth)
    policies = [
        Policy.Reliability.Reliable(duration(infinite=True)),
        Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile,
        history,
        # ROS 2 speaks XCDR1; of both the wheel would offer XCDR2 first.
        Policy.DataRepresentation(use_cdrv0_representation=True, use_xcdrv2_representation=False),
        Policy.WriterDataLifecycle(autodispose=False),
        Policy.Userdata(user_data.encode()),
    ]
    if latched:
        policies.append(Policy.DurabilityService(0, history, -1, -1, -1))
    return Qos(*policies)


def _topic(participant: DomainParticipant, name: str, kind: type[Any]) -> Topic[Any]:
    """Make a topic; raises RosError if it is refused time and again.

    Cyclone DDS cannot make two at once in a process (cyclonedds-python, issue 214), and once in a
    great while refuses one that it takes the next time.
    """
    refusal = ""
    for _ in range(_ATTEMPTS):
        try:
            with _topics_lock:
                return Topic(participant, name, kind)
        except core.DDSException as error:
            refusal = error.msg
            time.sleep(_PAUSE)
    raise RosError(f"ROS 2's network refuses the topic {name}: {refusal}")


def _domain(environment: Mapping[str, str]) -> int:
    """Configure ROS 2's domain as the environment says; gives its number."""
    text = environment.get("ROS_DOMAIN_ID") or "0"
    if not (text.isdecimal() and int(text) <= _LAST_DOMAIN):
        raise RosError(f"ROS_DOMAIN_ID is {text!r}; give a number from 0 to {_LAST_DOMAIN}")
    number, configuration = int(text), discovery(environment)
    with _domains_lock:
        if number not in _domains:
            _domains[number] = Domain(number, configuration) if configuration else None
    return number


def discovery(environment: Mapping[str, str]) -> str:
    """Cyclone's configuration for what ROS 2's environment says of who is to be found.

    Raises RosError for a range that ROS 2 does not know. Source: ros2/rmw_cyclonedds, and for
    ``ROS_AUTOMATIC_DISCOVERY_RANGE`` and ``ROS_STATIC_PEERS`` docs.ros.org since Iron.
    """
    reach = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE") or _RANGES[0]
    peers = [peer for peer in environment.get("ROS_STATIC_PEERS", "").split(";") if peer]
    if environment.get("ROS_LOCALHOST_ONLY") == "1":  # where it is set it goes before
        reach, peers = "LOCALHOST", []
    if reach not in _RANGES:
        raise RosError(f"ROS_AUTOMATIC_DISCOVERY_RANGE is {reach!r}; give {', '.join(_RANGES)}")
    uri = environment.get("CYCLONEDDS_URI", "")
    if reach == "SYSTEM_DEFAULT":
        return uri
    general = discovered = ""
    if reach == "LOCALHOST" and not peers:
        # Nodes that start later announce themselves on this interface alone.
        general = '<Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces>'
    if reach != "SUBNET":
        general += "<AllowMulticast>false</AllowMulticast>"
    if reach == "OFF":
        tag = f"<Tag>ros_discovery_off_{os.getpid()}</Tag>"
        discovered = f"<ParticipantIndex>none</ParticipantIndex>{tag}"
    else:
        listed = [*(["localhost"] if reach == "LOCALHOST" else []), *peers]
        addresses = "".join(f"<Peer address={quoteattr(peer)}/>" for peer in listed)
        discovered = (
            "<ParticipantIndex>auto</ParticipantIndex>"
            "<MaxAutoParticipantIndex>32</MaxAutoParticipantIndex><SPDPInterval>1s</SPDPInterval>"
            + (f"<Peers>{addresses}</Peers>" if listed else "")
        )
    general = f"<General>{general}</General>" if general else ""
    domain = f"<Domain>{general}<Discovery>{discovered}</Discovery></Domain>"
    return f"<CycloneDDS>{domain}</CycloneDDS>,{uri}"
