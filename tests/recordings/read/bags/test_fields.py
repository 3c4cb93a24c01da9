"""Fields of many messages at once are those that rosbags reads one by one, whatever their sizes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.recordings.refusals import refused

from truejoint.errors import TruejointError
from truejoint.recordings.read.bags import fields as decoding
from truejoint.recordings.read.bags.container import Topic
from truejoint.recordings.read.bags.fields import Decoder, Lot, Series, full_name, typesys

SYSTEM = typesys()
KINDS = {
    "own/nested": "uint8 flag\nstring note\nown/part[2] parts\nfloat64[] values\nint16 last\n",
    "own/part": "int8 a\nfloat64 b\nstring[] words\n",
    "own/state": "std_msgs/Header hdr\n",
}
JOINTS = st.lists(
    st.tuples(st.text("ab_/é", max_size=5), st.floats(-9, 9), st.floats(-9, 9, width=32)),
    max_size=3,
)
MESSAGES = st.lists(
    st.tuples(st.text("xyz", max_size=6), st.integers(0, 2**31 - 1), JOINTS, st.booleans()),
    min_size=1,
    max_size=8,
)


def store_of(encoding: str):
    store = SYSTEM.get_typestore(
        SYSTEM.Stores.ROS1_NOETIC if encoding == "ros1" else SYSTEM.Stores.ROS2_HUMBLE
    )
    found = {}
    for kind, text in KINDS.items():
        found |= SYSTEM.get_types_from_msg(text, full_name(kind))
    store.register(found)
    return store


STORES = {encoding: store_of(encoding) for encoding in ("ros1", "cdr")}


def serialise(encoding: str, message: object, kind: str, little: bool = True) -> bytes:
    store = STORES[encoding]
    if encoding == "ros1":
        return bytes(store.serialize_ros1(message, kind))
    return bytes(store.serialize_cdr(message, kind, little_endian=little))


def topic_of(encoding: str, kind: str) -> Topic:
    text, _ = STORES[encoding].generate_msgdef(kind, ros_version=1 if encoding == "ros1" else 2)
    return Topic("/t", kind, text, encoding)


@pytest.mark.parametrize("encoding", ["ros1", "cdr"])
@given(messages=MESSAGES)
def test_joint_states_of_any_length(encoding, messages):
    kind, store = "sensor_msgs/msg/JointState", STORES[encoding]
    types = store.types
    raw, want = [], []
    for number, (frame, seconds, joints, velocities) in enumerate(messages):
        names, position, effort = (
            list(v) for v in (zip(*joints, strict=True) if joints else ([],) * 3)
        )
        stamp = types["builtin_interfaces/msg/Time"](seconds, number)
        more = {"seq": number} if encoding == "ros1" else {}
        header = types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame, **more)
        message = types[kind](
            header=header,
            name=names,
            position=np.array(position),
            velocity=np.array(effort if velocities else []),
            effort=np.array(effort),
        )
        raw.append(serialise(encoding, message, kind, little=bool(number % 3)))
        want.append(message)
    decoder = Decoder(topic_of(encoding, kind), ("position", "velocity", "effort"))
    seen = []
    for lot in decoder.decode([10**18] * len(raw), raw):
        for k, row in enumerate(lot.places):
            seen.append(row)
            message = want[row]
            assert list(lot.texts["name"]) == message.name
            assert lot.stamps[k] == (message.header.stamp.sec * 10**9 + row or 10**18)
            for name in ("position", "velocity", "effort"):
                np.testing.assert_array_equal(lot.fields[name][k], getattr(message, name))
    assert sorted(seen) == list(range(len(messages)))
    assert not decoder.damaged
    assert not [*decoder.decode([10**18] * 2, [raw[0][:-1]] * 2)]
    assert decoder.damaged == 2
    empty, one = np.zeros(0), np.ones(1)
    alike = [  # of as many bytes
        types[kind](header=header, name=[name], position=first, velocity=last, effort=empty)
        for name, first, last in (("a", empty, one), ("a", one, empty), ("b", one, empty))
    ]
    lots = [*decoder.decode([7] * 3, [serialise(encoding, each, kind) for each in alike])]
    found = sorted((*lot.texts["name"], lot.fields["position"].shape[1]) for lot in lots)
    assert found == [("a", 0), ("a", 1), ("b", 1)]
    state = serialise(encoding, types["own/msg/state"](hdr=header), "own/msg/state")
    (lot,) = Decoder(topic_of(encoding, "own/msg/state"), ()).decode([7], [state])
    assert lot.stamps == (stamp.sec * 10**9 + stamp.nanosec or 7)


@pytest.mark.parametrize("encoding", ["ros1", "cdr"])
@given(
    words=st.lists(st.text("abc", max_size=4), max_size=3),
    values=st.lists(st.floats(-1, 1), max_size=4),
)
def test_messages_within_messages(encoding, words, values):
    store, kind = STORES[encoding], "own/msg/nested"
    part = store.types["own/msg/part"]
    message = store.types[kind](
        flag=3,
        note="n" * len(words),
        parts=[part(a=-1, b=0.5, words=words), part(a=2, b=1.5, words=words[:1])],
        values=np.array(values),
        last=-7,
    )
    decoder = Decoder(topic_of(encoding, kind), ("flag", "values", "last"))
    (lot,) = decoder.decode([7] * 3, [serialise(encoding, message, kind)] * 3, first=5)
    assert lot.places.tolist() == [5, 6, 7]
    assert lot.stamps.tolist() == [7] * 3
    assert (lot.fields["last"] == -7).all()
    assert (lot.fields["flag"] == 3).all()
    np.testing.assert_array_equal(lot.fields["values"][2], values)
    assert lot.texts["parts[0].words"] == tuple(words)


def test_layouts_that_never_repeat_are_refused(monkeypatch):
    monkeypatch.setattr(decoding, "_MOST_WALKED", 60_000)
    raw = []
    for number in range(1200):  # one size, and two texts that share it in ever other ways
        words = ["a" * (number % 40), "b" * (number // 40), "c" * (70 - number % 40 - number // 40)]
        raw.append(b"".join(len(w).to_bytes(4, "little") + w.encode() for w in words))
    topic = Topic("/t", "own/words", "string a\nstring b\nstring c\n", "ros1")
    refused(
        "change their lengths all the time", list, Decoder(topic, ()).decode([0] * len(raw), raw)
    )


@pytest.mark.parametrize(
    ("topic", "said"),
    [
        (Topic("/t", "own/unheard", "", "cdr"), "has no definition of own/unheard"),
        (
            Topic("/t", "own/broken", "float64[ x\n??", "ros1"),
            "definition of own/broken in the bag is damaged",
        ),
        (
            Topic("/t", "own/loop", "float64 position\nown/loop again\n", "ros1"),
            "definition of own/loop in the bag is damaged (messages within messages, 20 deep)",
        ),
        (Topic("/t", "own/other", "float64 y\n", "ros1"), "has no field 'position'; it has y"),
    ],
)
def test_what_cannot_be_read_is_said(topic, said):
    with pytest.raises(TruejointError) as caught:
        Decoder(topic, ("position",))
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_stamp_without_nanoseconds_is_none():
    text = "own/head header\n" + "=" * 80 + "\nMSG: own/head\nown/when stamp\n" + "=" * 80
    text += "\nMSG: own/when\nuint32 sec\n"
    (lot,) = Decoder(Topic("/t", "own/told", text, "ros1"), ()).decode([9], [bytes([7] * 4)])
    assert lot.stamps.tolist() == [9]


def test_types_without_a_definition_are_those_of_ros_2():
    assert Decoder(Topic("/t", "sensor_msgs/msg/JointState", "", "cdr"), ("position",)).damaged == 0
    assert (
        Decoder(Topic("/t", "raven_2/msg/raven_state", "", "cdr"), ("jpos", "hdr.stamp")).damaged
        == 0
    )


def test_lots_become_columns_in_the_order_of_the_messages():
    taken, random = Series(), np.random.default_rng(0)
    values = random.random(10)
    for rows in ([0, 1], [3], [2, *range(4, 10)]):  # other layouts come in lots of their own
        place = np.array(rows)
        columns = {"a": values[rows]} | ({"b": -values[rows]} if rows[0] else {})
        taken.add(Lot("/t", place, 5 + place, {}, {}), columns)
    assert taken.count == 10
    assert taken.start == 5
    stamps, columns = taken.joined()
    np.testing.assert_array_equal(stamps, 5 + np.arange(10))
    np.testing.assert_array_equal(columns["a"], values)
    np.testing.assert_array_equal(columns["b"], [np.nan, np.nan, *-values[2:]])
    assert taken.joined()[1] == {}  # nothing is held twice


def test_too_many_values_are_refused(monkeypatch):
    monkeypatch.setattr(decoding, "MAX_VALUES", 5)
    taken = Series()
    taken.add(Lot("/t", np.arange(2), np.arange(2), {}, {}), {"a": np.zeros(2)})
    refused(
        "more than 5 values; extract fewer bags",
        taken.add,
        Lot("/t", np.array([2]), np.array([2]), {}, {}),
        {"a": np.zeros(1)},
    )
