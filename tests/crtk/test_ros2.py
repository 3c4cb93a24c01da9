"""Tests of truejoint.crtk.ros.ros2: what is on the wire, what was latched, and who is found."""

import logging
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from typing import Self

import numpy as np
import pytest
from cyclonedds import core
from cyclonedds._clayer import ddspy_write
from cyclonedds.core import Policy
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from truejoint import read_recording
from truejoint.cli.app import main
from truejoint.crtk import Arm
from truejoint.crtk.backends.ros import RosBackend
from truejoint.crtk.messages import (
    DEFINITIONS,
    FORWARD,
    JOINT_STATE,
    OPERATING_STATE,
    SERVICES,
    STRING_STAMPED,
)
from truejoint.crtk.ros import open_transport, ros2
from truejoint.crtk.ros.dds_types import definitions, message_class
from truejoint.crtk.ros.ros2 import Ros2, discovery
from truejoint.errors import RosError
from truejoint.motion import Trajectory, write_trajectory
from truejoint.robots import get_robot

LONG = 60.0  # [s], on a busy machine
ROBOT = get_robot("raven2")


@pytest.fixture(scope="module", autouse=True)
def _domain_of_our_own() -> Iterator[None]:
    """Nobody but this process, and what it starts, on this computer.

    Up to 101 a domain's ports are none that Linux gives to whoever asks for any.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", str(2 + os.getpid() % 100))
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        yield


@pytest.fixture
def nodes() -> Iterator[tuple[Ros2, Ros2]]:
    made = Ros2("first"), Ros2("second")
    yield made
    for node in made:
        node.close()


class Mailbox(list):
    """Messages, and a wait for so many of them."""

    def __init__(self) -> None:
        self._came = threading.Condition()

    def __call__(self, message: object) -> None:
        with self._came:
            self.append(message)
            self._came.notify_all()

    def until(self, has_come: Callable[[], bool]) -> Self:
        with self._came:
            assert self._came.wait_for(has_come, LONG), f"{len(self)} messages"
        return self

    def wait(self, count: int) -> Self:
        return self.until(lambda: len(self) >= count)


def values(kind: str) -> st.SearchStrategy:
    """Messages of a type, with any values that it can hold."""
    fields = {}
    for name, (shape, of) in definitions().fielddefs[kind][1]:
        fields[name] = field_values(shape.name, of)
    return st.builds(message_class(kind), **fields)


BASIC = {
    "string": st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=9),
    "bool": st.booleans(),
    # rosbags takes an octet for signed
    **dict.fromkeys(("byte", "char", "octet"), st.integers(0, 127)),
    **{f"float{n}": st.floats(width=n, allow_nan=False) for n in (32, 64)},
    **{f"int{n}": st.integers(-1 << (n - 1), (1 << (n - 1)) - 1) for n in (8, 16, 32, 64)},
    **{f"uint{n}": st.integers(0, (1 << n) - 1) for n in (8, 16, 32, 64)},
}


def field_values(shape, of):
    if shape in ("NAME", "BASE"):
        return values(of) if shape == "NAME" else BASIC[of[0]]
    (inner, what), count = of
    size = (count, count) if shape == "ARRAY" else (0, 3)
    return st.lists(field_values(inner.name, what), min_size=size[0], max_size=size[1])


def as_rosbags_has_it(message, kind):
    """The same message of rosbags' own class."""
    fields = {}
    for name, (shape, of) in definitions().fielddefs[kind][1]:
        value = getattr(message, name)
        if shape.name == "NAME":
            value = as_rosbags_has_it(value, of)
        elif shape.name != "BASE":
            inner, what = of[0]
            if inner.name == "NAME":
                value = [as_rosbags_has_it(each, what) for each in value]
            elif what[0] != "string":
                value = np.array(value, dtype="u1" if what[0] in ("byte", "char") else what[0])
        fields[name] = value
    return definitions().types[kind](**fields)


KINDS = [
    *(kind.replace("/", "/msg/") for kind in (*DEFINITIONS, JOINT_STATE)),
    *(f"{kind.replace('/', '/srv/')}_{of}" for kind in SERVICES for of in ("Request", "Response")),
    *("std_msgs/msg/Empty", "std_msgs/msg/Float64MultiArray", "geometry_msgs/msg/PoseStamped"),
    *("diagnostic_msgs/msg/DiagnosticArray", "rmw_dds_common/msg/ParticipantEntitiesInfo"),
]  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=10)
@given(data=st.data())
def test_bytes_are_those_of_rosbags_and_come_back(kind, data):
    message = data.draw(values(kind))
    wire = message.serialize()
    assert wire == bytes(definitions().serialize_cdr(as_rosbags_has_it(message, kind), kind))
    assert message_class(kind).deserialize(wire).serialize() == wire


def test_an_unknown_type_is_refused_and_humble_has_its_longer_names(monkeypatch):
    with pytest.raises(RosError, match="no definition of ROS 2's raven_9/msg/state"):
        message_class("raven_9/msg/state")
    gid = "rmw_dds_common/msg/Gid"
    assert len(message_class(gid)().data) == 16
    humble = get_typestore(Stores.ROS2_HUMBLE)
    definitions.cache_clear()
    message_class.cache_clear()
    monkeypatch.setenv("ROS_DISTRO", "humble")
    assert len(message_class(gid)().data) == 24
    assert humble.hash_rihs01(gid) == message_class(gid).TYPE_HASH
    definitions.cache_clear()
    message_class.cache_clear()


def test_messages_come_in_order_and_subscriptions_end(nodes):
    first, second = nodes
    box = Mailbox()
    end = second.subscribe("/a/measured_js", JOINT_STATE, box)
    out = first.publisher("/a/measured_js", JOINT_STATE)
    for k in range(300):
        message = first.stamped(JOINT_STATE, 10.0 + k)
        message.name, message.position = ["elbow"], [0.1 * k]
        out.publish(message)
    box.wait(300)
    assert [second.seconds(message) for message in box] == [10.0 + k for k in range(300)]
    assert second.topics()["/a/measured_js"] == JOINT_STATE
    assert out.readers == 1
    end()
    end()
    assert out.readers == 0
    out.close()
    assert "/a/measured_js" not in second.topics()
    assert not first.is_over
    first.close()
    assert first.is_over


def test_what_was_latched_comes_once_and_what_was_not_too(nodes):
    first, second = nodes
    latched, plain = (
        first.publisher("/a/operating_state", OPERATING_STATE, latched=x) for x in (1, 0)
    )

    def say(out, state):
        message = first.message(OPERATING_STATE)
        message.state = state
        out.publish(message)

    for state in ("HOMING", "ENABLED"):
        say(latched, state)
    box = Mailbox()
    second.subscribe("/a/operating_state", OPERATING_STATE, box)
    box.wait(1)
    for out, state in ((latched, "PAUSED"), (plain, "FAULT"), (latched, "ENABLED")):
        say(out, state)
    box.wait(4)
    assert [message.state for message in box] == ["ENABLED", "PAUSED", "FAULT", "ENABLED"]


@pytest.mark.parametrize(
    ("kind", "reliability", "what"),
    [
        (JOINT_STATE, Policy.Reliability.BestEffort, "best effort"),
        (STRING_STAMPED, Policy.Reliability.Reliable(0), "of another type"),
    ],
)
def test_a_publisher_that_cannot_be_heard_is_named(nodes, caplog, kind, reliability, what):
    first, second = nodes
    second.subscribe("/a", JOINT_STATE, Mailbox())
    qos = Qos(reliability, Policy.Durability.Volatile)
    topic = Topic(first._participant, "rt/a", message_class(kind.replace("/", "/msg/")))
    writer = DataWriter(first._participant, topic, qos)
    with caplog.at_level(logging.WARNING):
        while f"/a: its publisher is {what}, and is not heard" not in caplog.text:
            threading.Event().wait(0.05)
    del writer


def test_a_callback_that_fails_and_bytes_of_malice_are_logged_and_the_rest_heard(nodes, caplog):
    first, second = nodes
    box = Mailbox()

    def receive(message):
        box(message)
        if not message.position:
            raise ZeroDivisionError

    second.subscribe("/a", JOINT_STATE, receive)
    out = first.publisher("/a", JOINT_STATE)
    with caplog.at_level(logging.ERROR):
        out.publish(first.message(JOINT_STATE))
        writer = first._writers[-1]
        wire = bytes(first.message(JOINT_STATE).serialize())
        rng = np.random.default_rng(0)
        for _ in range(200):  # lengths of what is not there among them
            bad = bytearray(wire)
            for place in rng.integers(4, len(wire), 6):
                bad[place] = rng.integers(256)
            ddspy_write(writer._ref, bytes(bad))
        good = first.message(JOINT_STATE)
        good.position = [1.0]
        out.publish(good)
        box.until(lambda: len(box) > 0 and list(box[-1].position) == [1.0])
    assert "/a: a message could not be dealt with" in caplog.text


def test_a_node_that_is_closed_amid_its_messages_logs_nothing(nodes, caplog, monkeypatch):
    first, second = nodes
    begun, go_on = threading.Event(), threading.Event()

    def receive(_):
        begun.set()
        go_on.wait(LONG)

    second.subscribe("/a", JOINT_STATE, receive)
    out = first.publisher("/a", JOINT_STATE)
    for _ in range(30):
        out.publish(first.message(JOINT_STATE))
    assert begun.wait(LONG)
    monkeypatch.setattr(second._thread, "join", lambda _: None)  # as if a second had passed
    second.close()
    go_on.set()
    threading.Thread.join(second._thread)
    assert caplog.messages == []


def test_a_service_is_answered_as_clients_on_cyclone_ask(nodes):
    first, second = nodes

    def answer(request, response):
        response.result, response.message = True, f"{sum(request.jp)}"

    end = first.serve("/a/fk", FORWARD, answer)
    name = f"{FORWARD.replace('/', '/srv/')}_"
    ask, reply = (message_class(name + half, is_call=True) for half in ("Request", "Response"))
    box = Mailbox()
    reader = second._endpoint(DataReader, "rr/a/fkReply", reply)
    second._listen(ros2._Subscription("/a/fk", box, [reader]))
    second._endpoint(DataWriter, "rq/a/fkRequest", ask).write(ask(7, 3, [1.0, 2.0]))
    (got,) = box.wait(1)
    assert (got.client_guid, got.sequence_number, got.message) == (7, 3, "3.0")
    end()


def test_the_graph_names_the_node_and_its_endpoints(nodes):
    first, second = nodes
    graph = message_class("rmw_dds_common/msg/ParticipantEntitiesInfo")
    box = Mailbox()
    reader = second._endpoint(DataReader, "ros_discovery_info", graph, latched=True)
    second._listen(ros2._Subscription("graph", box, [reader]))
    first.publisher("/a", JOINT_STATE)
    seen = {}
    count = 0
    while not seen.get("first"):
        count += 1
        for info in box.wait(count):
            for node in info.node_entities_info_seq:
                seen[node.node_name] = [bytes(gid.data) for gid in node.writer_gid_seq]
    assert seen["first"] == [first._writers[0].guid.bytes]


@pytest.mark.parametrize(
    ("environment", "has", "lacks"),
    [
        ({}, "<ParticipantIndex>auto<", "AllowMulticast"),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, '<Peer address="localhost"/>', "SUBNET"),
        ({"ROS_LOCALHOST_ONLY": "1", "ROS_STATIC_PEERS": "10.0.0.9"}, "127.0.0.1", "10.0.0.9"),
        ({"ROS_STATIC_PEERS": '10.0.0.9;a"b'}, "<Peer address='a\"b'/>", "127.0.0.1"),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}, "<ParticipantIndex>none<", "Peers"),
        (
            {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT", "CYCLONEDDS_URI": "file://x"},
            "file://x",
            "CycloneDDS>",
        ),
    ],
)
def test_the_environment_says_who_is_found(environment, has, lacks):
    configuration = discovery(environment)
    assert has in configuration
    assert lacks not in configuration


@pytest.mark.parametrize(
    ("name", "value"), [("ROS_DOMAIN_ID", "233"), ("ROS_DOMAIN_ID", "x"),
                        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "GALAXY")],
)  # fmt: skip
def test_variables_without_a_meaning_are_refused(monkeypatch, name, value):
    monkeypatch.setenv("ROS_DOMAIN_ID", "99")
    monkeypatch.setenv(name, value)
    with pytest.raises(RosError, match=f"{name} is '{value}'; give"):
        Ros2("n")


@pytest.mark.parametrize("refusals", [1, 9])
def test_a_topic_that_is_refused_once_is_asked_for_again(monkeypatch, refusals):
    asked, topic = [], ros2.Topic

    def refuse(*given):
        asked.append(given)
        if len(asked) <= refusals:
            raise core.DDSException(-3, "by a test")
        return topic(*given)

    monkeypatch.setattr(ros2, "Topic", refuse)
    monkeypatch.setattr(ros2, "_PAUSE", 0.0)
    if refusals > 1:
        with pytest.raises(RosError, match="refuses the topic ros_discovery_info"):
            Ros2("n")
        assert len(asked) == 3
    else:
        Ros2("n").close()
        assert len(asked) == 2


def test_an_arm_served_by_another_process_moves_and_is_collected_from(tmp_path, monkeypatch):
    command = [sys.executable, "-m", "truejoint", "node", "simulate", "--homed", "--ros", "2"]
    near = {"rad": np.radians(1.0), "m": 1e-3}
    # A busy computer may let either process wait for long.
    for name in ("backends.ros.SILENCE", "backends.ros.CONNECT_TIMEOUT", "backends.ros._STILL"):
        monkeypatch.setattr(f"truejoint.crtk.{name}", LONG)
    monkeypatch.setattr("truejoint.crtk.arm.SILENCE", LONG)
    go_on = RosBackend.flush.__defaults__[1]
    monkeypatch.setattr(RosBackend.flush, "__defaults__", (LONG, go_on))  # in place of 2 s
    with subprocess.Popen(  # noqa: S603 - a line of our own
        [*command, "--state-rate-hz", "100"], stderr=subprocess.PIPE, text=True
    ) as served:
        try:
            assert any("/arm1/measured_js" in line for line in served.stderr)
            transport = open_transport(2, "lab")
            with Arm(RosBackend(transport, ROBOT, "raven2_mended", tolerance=near)) as arm:
                arm.move_jp(ROBOT.home + np.eye(7)[0] * 0.02).wait()
                assert abs(arm.measured_js(LONG).position[0] - ROBOT.home[0] - 0.02) < near["rad"]
            transport.close()
            rows = ROBOT.home[:3] + 0.02 * np.linspace(0.0, 1.0, 20)[:, None] * [1.0, 1.0, 0.1]
            motion = Trajectory(ROBOT.positioning, ("rad", "rad", "m"), rows)
            write_trajectory(motion, tmp_path / "way.csv")
            line = f"collect {tmp_path}/way.csv -o {tmp_path} --ros 2 --yes-move-it"
            real = "--profile raven2_mended --truth /ext_jpos"
            monkeypatch.setattr(sys, "argv", ["truejoint", *f"{line} {real}".split()])
            with pytest.raises(SystemExit) as stop:
                main()
            assert stop.value.code == 0
        finally:
            served.terminate()
            served.communicate()
    recording = read_recording(tmp_path / "way.parquet")
    for quantity in ("measured", "truth"):
        elbow = recording.column(f"{quantity}/elbow")
        assert np.nanmax(elbow) - np.nanmin(elbow) > 0.01
