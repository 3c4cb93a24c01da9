"""Whatever is done to the bytes of a bag, it is read in part or refused in one line."""

import sqlite3
import struct
import sys
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import pytest
from rosbags import rosbag1
from tests.recordings.hostile import MESSAGE, nested_definition, record, tables, text
from tests.recordings.read.bags.conftest import make_session
from tests.recordings.refusals import refused

from truejoint.crtk.messages import RAVEN_FIELDS
from truejoint.recordings import bag_topics, read_bag, read_topic, write_bag
from truejoint.recordings.bounded_file import Allowance
from truejoint.recordings.read.bags import container
from truejoint.recordings.read.bags.container import DAMAGED, MCAP_MAGIC, Topic
from truejoint.recordings.read.bags.fields import Decoder, typesys

zstd = pytest.importorskip("backports.zstd" if sys.version_info < (3, 14) else "compression.zstd")


_JOINTS = "float64[1] position\nfloat64[1] velocity\nfloat64[1] effort\nstring[] name\n"
_JAW = bytes(24) + struct.pack("<II4s", 1, 4, b"jaw\0")
_JOINT_STATE = "sensor_msgs/msg/JointState"
_RAVEN = ["runlevel", *(name for name, _ in RAVEN_FIELDS.values())]
_END = "=" * 80


def _mcap(path: Path, *topics: tuple[str, str, str, bytes], times: Sequence[int] = ()) -> Path:
    """MCAP of 20 equal messages of each topic: name, type, definition, bytes."""
    records = [MCAP_MAGIC]
    for key, (name, kind, definition, message) in enumerate(topics, 1):
        schema = struct.pack("<H", key) + text(kind) + text("ros2msg") + text(definition)
        channel = struct.pack("<HH", key, key) + text(name) + text("cdr") + bytes(4)
        records += [record(3, schema), record(4, channel)]
        for number in range(20):
            time = times[number] if times else number * 10**7
            head = struct.pack("<HIQQ", key, number, time, time)
            records.append(record(5, head + b"\0\1\0\0" + message))
    path.write_bytes(b"".join(records))
    return path


def _state(definition: str, message: bytes = bytes(400)) -> tuple[str, str, str, bytes]:
    return "/measured_js", _JOINT_STATE, definition, message


@pytest.mark.parametrize(
    ("topics", "said"),
    [
        ([_state(_JOINTS.replace("float64[1]", "string"))], "/measured_js: its position is not as"),
        (
            [
                _state(_JOINTS, _JAW),
                ("/operating_state", "crtk_msgs/msg/operating_state", "string is_homed", bytes(9)),
            ],
            "/operating_state: its is_homed is not as",
        ),
    ],
)
def test_fields_of_another_kind_are_refused(tmp_path, topics, said):
    refused(said, read_bag, _mcap(tmp_path / "run.mcap", *topics), "davinci_grasper")


@pytest.mark.parametrize("kind", ["string", "int32[]", "int32[1]", "float64"])
def test_a_state_of_raven_with_other_fields_is_refused(tmp_path, kind):
    definition = "".join(f"{kind} {name}\n" for name in _RAVEN)
    topic = ("/ravenstate", "raven_2/msg/raven_state", definition, bytes(4000))
    refused("is not as", read_bag, _mcap(tmp_path / "run.mcap", topic), "raven2")


@pytest.mark.parametrize("seconds", ["int32[] sec", "float64 sec"])
def test_a_stamp_of_another_kind_is_none(tmp_path, seconds):
    definition = (
        f"{_JOINTS}own/head header\n{_END}\nMSG: own/head\nown/when stamp\n"
        f"{_END}\nMSG: own/when\n{seconds}\nuint32 nanosec"
    )
    path = _mcap(tmp_path / "run.mcap", _state(definition, _JAW + bytes(24)))
    assert len(read_bag(path, "davinci_grasper")) == 20


def test_a_time_beyond_all_stamps_is_the_last_of_them(tmp_path):
    path = _mcap(tmp_path / "run.mcap", _state(_JOINTS, _JAW), times=[2**64 - 1] * 20)
    stamps, _ = read_topic(path, "/measured_js", "position")
    assert set(stamps.tolist()) == {2**63 - 1}


@pytest.mark.parametrize("kind", ["own/a1", "own/loop"])
def test_lists_of_nothing_are_counted_as_damage(kind):
    nested = "".join(f"\n{_END}\nMSG: own/a{k}\nown/a{k + 1}[1000] f\n" for k in range(1, 9))
    nested += f"\n{_END}\nMSG: own/a9\n\n{_END}\nMSG: own/loop\nown/loop[1] again\n"
    decoder = Decoder(Topic("/t", "own/empty", f"{kind}[1000] f\n{nested}", "ros1"), ())
    assert not list(decoder.decode([0], [b""]))
    assert decoder.damaged == 1


def test_definitions_that_multiply_are_refused():
    refused(
        "more than 65536 fields", Decoder, Topic("/t", "own/many", nested_definition(), "ros1"), ()
    )


def _tables(path: Path, *, spoilt: object) -> Path:
    """Tables of 20 joint states, of which one and a second topic have a value of another kind."""
    tables(path, rows=[MESSAGE] * 20)
    with closing(sqlite3.connect(path)) as base:
        base.execute("INSERT INTO topics VALUES (2, ?, ?, 'cdr')", [spoilt, _JOINT_STATE])
        rows = [(1, spoilt, MESSAGE), (1, 10**9, spoilt)]
        into = "INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)"
        base.executemany(into, rows)
        base.commit()
    return path


@pytest.mark.parametrize("spoilt", [None, 1e300])
def test_values_of_another_kind_in_a_table_are_counted(tmp_path, spoilt):
    path = _tables(tmp_path / "run.db3", spoilt=spoilt)
    assert bag_topics(path) == {"/measured_js": ("sensor_msgs/JointState", 20)}
    found = read_bag(path, "davinci_grasper")
    assert len(found) == 20
    assert found.provenance.dropped[DAMAGED] == 2


def test_what_is_left_of_tables_cut_short_is_read(tmp_path):
    path = tmp_path / "run.db3"
    tables(path, rows=[MESSAGE] * 3000)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    assert 1000 < len(read_bag(path, "davinci_grasper")) < 2000
    for topics in (bag_topics, read_bag):
        path.write_bytes(whole[:4000])
        refused(r"run.db3.*: no topic in it can be read; is it cut short", topics, path)


def test_a_folder_in_the_folder_of_a_bag_is_no_part_of_it(tmp_path):
    folder = tmp_path / "run"
    (folder / "plots").mkdir(parents=True)
    _mcap(folder / "run_0.mcap", _state(_JOINTS, _JAW))
    assert len(read_bag(folder, "davinci_grasper")) == 20
    for part in ("run_10.mcap", "run_2.mcap"):
        (folder / part).touch()
    assert [part.name[4:-5] for part in container._parts(folder)] == ["0", "2", "10"]
    assert container.is_bag(folder, b"")
    (folder / "other.mcap").touch()
    assert not container.is_bag(folder, b"")


def test_topics_are_listed_without_unpacking_a_message(tmp_path, monkeypatch):
    """By the index, by the summary, by rows of tables, which may be packed."""
    for suffix in (".bag", ".mcap"):
        write_bag(make_session(rows=20), tmp_path / f"run{suffix}")
    _tables(tmp_path / "run.db3", spoilt=None)
    with closing(sqlite3.connect(tmp_path / "run.db3")) as base:
        (message,) = base.execute("SELECT data FROM messages").fetchone()
        base.execute("UPDATE messages SET data = ?", [zstd.compress(message)])
        base.commit()
    assert len(read_bag(tmp_path / "run.db3", "davinci_grasper")) == 21
    monkeypatch.setattr(Allowance, "unpack", None)
    monkeypatch.setattr(container, "read_batches", None)
    for suffix in (".bag", ".mcap"):
        counts = {name: count for name, (_, count) in bag_topics(tmp_path / f"run{suffix}").items()}
        assert counts == dict.fromkeys(("/ravenstate", "/arm2/measured_js", "/ext_jpos"), 20)
    assert bag_topics(tmp_path / "run.db3")["/measured_js"][1] == 21


def test_two_who_publish_one_topic_are_counted_together(tmp_path):
    """Of ROS 1 each has a number of its own, in the index too."""
    store = typesys().get_typestore(typesys().Stores.ROS1_NOETIC)
    with rosbag1.Writer(tmp_path / "two.bag") as writer:
        for caller in ("/a", "/b"):
            topic = writer.add_connection("/t", _JOINT_STATE, typestore=store, callerid=caller)
            writer.write(topic, 1, bytes(28))
    assert bag_topics(tmp_path / "two.bag") == {"/t": ("sensor_msgs/JointState", 2)}
