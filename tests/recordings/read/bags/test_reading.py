"""Recordings out of bags of every kind: the same numbers, or one line that says what is wrong."""

import re
import sys
import zlib
from collections import Counter
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import lz4.frame
import numpy as np
import pytest
from rosbags import rosbag1
from tests.recordings.hostile import record
from tests.recordings.marker_bag import bag_writer, header_at
from tests.recordings.read.bags.conftest import make_session
from tests.recordings.refusals import refused

from truejoint.crtk.messages import (
    DEFINITIONS,
    JOINT_STATE,
    OPERATING_STATE,
    RAVEN_FIELDS,
    ros2_definition,
)
from truejoint.errors import TruejointError
from truejoint.recordings import (
    Provenance,
    Recording,
    bag_topics,
    detect_format,
    read_bag,
    read_other_arm,
    read_topic,
    write_bag,
)
from truejoint.recordings.bounded_file import Allowance
from truejoint.recordings.read.bags import assembling, container
from truejoint.recordings.read.bags.assembling import find_wiring
from truejoint.recordings.read.bags.container import CUT_SHORT, DAMAGED, MCAP_MAGIC, read_batches
from truejoint.recordings.read.bags.fields import Lot, typesys
from truejoint.recordings.read.raven_csv import AMID
from truejoint.robots import get_robot

zstd = pytest.importorskip("backports.zstd" if sys.version_info < (3, 14) else "compression.zstd")


def same(
    found: Recording, session: Recording, *, quantities: tuple[str, ...] = ("measured", "effort")
) -> None:
    """Assert that two recordings are equal to the last bit of a float32, stamps to the ns."""
    np.testing.assert_allclose(found.t, session.t, rtol=0, atol=1e-9)
    for quantity in quantities:
        _, factor = RAVEN_FIELDS[quantity]
        for joint in session.joints_of(quantity):
            ours, theirs = (r.column(f"{quantity}/{joint}") / factor for r in (found, session))
            np.testing.assert_array_equal(ours.astype(np.float32), theirs.astype(np.float32))


@pytest.mark.parametrize("suffix", [".bag", ".mcap"])
@pytest.mark.parametrize("profile", ["raven2", "raven2_mended"])
def test_a_session_comes_back_to_the_last_bit(session, tmp_path, suffix, profile):
    path = tmp_path / f"run{suffix}"
    write_bag(session, path, profile=profile)
    found = read_bag(path, profile=profile)
    same(found, session, quantities=("measured", "velocity", "effort", "setpoint"))
    assert found.provenance.start == pytest.approx(session.provenance.start, abs=1e-6)
    ours, theirs = (one.columns("truth", session.joints_of("truth")) for one in (found, session))
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-15)


def test_crtk_alone_has_all_bits(session, tmp_path):
    write_bag(session, tmp_path / "a.bag", profile="raven2_mended")
    found = read_bag(
        tmp_path / "a.bag", "raven2", profile="raven2_mended", state="/arm1/measured_js"
    )
    joints = session.robot.joint_names
    for quantity, atol in (("measured", 0.0), ("setpoint", 0.0), ("effort", 1e-12)):
        ours, theirs = (recording.columns(quantity, joints) for recording in (found, session))
        np.testing.assert_allclose(ours, theirs, rtol=1e-7 if atol else 0.0, atol=atol)


def test_the_left_arm_is_where_the_profile_says(bag, session):
    assert "/arm2/measured_js" in bag_topics(bag)
    found = read_bag(bag, session.robot, state="/arm2/measured_js")
    assert found.robot == session.robot
    found = read_bag(bag, "raven2", "left", state="/arm2/measured_js")
    assert not found.joints_of("effort")
    assert not found.joints_of("setpoint")
    notes = found.provenance.notes
    assert notes.startswith("state of /arm2/measured_js, truth of /ext_jpos; profile raven2: ")
    assert re.search(r"; added to the truth \[rad or m\]: .*\+0.1309 to elbow", notes)
    told = read_bag(bag, "raven2", "left", state="/arm2/measured_js", offset=0.5)
    assert not np.array_equal(told.column("truth/elbow"), found.column("truth/elbow"))


def test_rows_in_which_a_topic_told_nothing_are_left_out_and_counted():
    names, robot = {"name": ("jaw",)}, get_robot("davinci_grasper")
    wiring, lots = assembling.Wiring(robot, "/measured_js", ("/setpoint_js",)), []
    for topic, rows in (("/measured_js", np.arange(40)), ("/setpoint_js", np.arange(30))):
        lots.append(Lot(topic, rows, rows * 10**7 + 1, {"position": rows[:, None] / 40}, names))
    origin = Provenance("davinci_grasper")
    recording = assembling.assemble(lots, wiring, ("measured",), origin, {}, "here")
    assert len(recording) == 30
    assert recording.provenance.dropped == {"state: value missing in one of its topics": 10}


@pytest.mark.parametrize(("count", "end"), [(0, "there are none"), (30, "29)"), (31, "29), ...")])
def test_of_many_topics_a_message_lists_thirty(count, end):
    topics = {f"/{k:02}": ("std_msgs/String", k) for k in range(count)}
    assert assembling.listed(topics).endswith(end)


def _messages(path: Path) -> list[tuple[Any, int, bytes]]:
    with rosbag1.Reader(path) as reader:
        return list(reader.messages())


def _rewritten(
    bag: Path,
    path: Path,
    keep=lambda topic, k: True,
    pack=None,
    change=None,
    rename=lambda topic: topic,
) -> Path:
    """The messages of a bag in another."""
    writer = rosbag1.Writer(path)
    if pack:
        writer.set_compression(getattr(rosbag1.Writer.CompressionFormat, pack))
    writer.chunk_threshold = 1 << 16
    with writer:
        own = {}
        for k, (connection, time, data) in enumerate(_messages(bag)):
            if not keep(connection.topic, k):
                continue
            if connection.topic not in own:
                own[connection.topic] = writer.add_connection(
                    rename(connection.topic),
                    connection.msgtype,
                    msgdef=connection.msgdef.data,
                    md5sum=connection.digest,
                )
            writer.write(own[connection.topic], time, change(data) if change else data)
    return path


@pytest.mark.parametrize("suffix", [".mcap", ".db3"])
def test_a_file_packed_as_a_whole_is_refused_with_what_to_do(tmp_path, suffix):
    path = tmp_path / f"run_0{suffix}.zstd"
    path.write_bytes(zstd.compress(MCAP_MAGIC + bytes(1 << 20)))
    for read, bag in product((bag_topics, read_bag), (path, tmp_path)):
        said = rf"run_0\{suffix}\.zstd: is packed as a whole; unpack it first: zstd -d run_0"
        refused(said, read, bag)
    assert detect_format(path) == "bag"


def test_nothing_comes_of_what_is_packed_and_damaged():
    packed = bytearray(zstd.compress(bytes(1000)))
    packed[4:12] = b"\xff" * 8
    assert not Allowance("a chunk", 1 << 20).unpack(bytes(packed), "zstd")
    assert not Allowance("a chunk", 1 << 20).unpack(zstd.compress(b"a"), "brotli")
    assert Allowance("a chunk", 1 << 20).unpack(lz4.frame.compress(b"a"), "lz4") == b"a"


def test_what_a_correcting_node_says_is_neither_state_nor_truth(bag, session, tmp_path):
    # Its topics look like a jaw's joints, and like joint sensors.
    names = {"/ext_jpos": "/arm2/corrected/half_width"}
    path = _rewritten(bag, tmp_path / "c.bag", rename=lambda topic: names.get(topic, topic))
    found = read_bag(path)
    same(found, session)
    assert not found.joints_of("truth")
    assert read_bag(bag, truth=None).joints_of("truth") == ()
    named = read_bag(path, truth="/arm2/corrected/half_width")
    assert named.joints_of("truth")


def test_split_bags_and_truth_apart_are_joined(bag, session, tmp_path):
    parts = [
        _rewritten(bag, tmp_path / "a.bag", lambda topic, k: topic == "/ravenstate" and k < 450),
        _rewritten(bag, tmp_path / "b.bag", lambda topic, k: topic == "/ravenstate" and k >= 450),
        _rewritten(bag, tmp_path / "c.bag", lambda topic, k: topic == "/ext_jpos"),
    ]
    found = read_bag(parts)
    same(found, session)
    assert np.isfinite(found.column("truth/elbow")).all()
    assert found.provenance.source == "a.bag, b.bag, c.bag"


def test_a_truth_on_another_clock_is_brought_back_by_the_motion(bag, tmp_path):
    path = np.cumsum(np.random.default_rng(0).normal(size=30)).repeat(50)
    path = np.convolve(path, np.ones(100) / 100, "same")
    robot = make_session(1500)
    joints = ("shoulder", "elbow", "insertion")
    moved = {f"{q}/{j}": 0.05 * path for q in ("measured", "truth") for j in joints}
    robot = replace(robot, table=robot.table.assign(**moved))
    apart = replace(robot, provenance=replace(robot.provenance, start=1.7e9 + 1000.0))
    parts = []
    for name, recording, topic in (("a", robot, "/ravenstate"), ("b", apart, "/ext_jpos")):
        write_bag(recording, tmp_path / f"{name}.bag")
        parts.append(
            _rewritten(
                tmp_path / f"{name}.bag",
                tmp_path / f"{name}2.bag",
                lambda t, k, own=topic: t == own,
            )
        )
    found = read_bag(parts)
    offset = float(found.provenance.notes.rpartition("; ")[2].partition(" s")[0])
    assert offset == pytest.approx(-1000.0, abs=0.02)
    assert np.isfinite(found.column("truth/elbow")).mean() > 0.95
    assert read_bag(parts, near=-1000.0).provenance.notes == found.provenance.notes
    stated = read_bag(parts, offset=-1000.0)
    np.testing.assert_allclose(
        stated.column("truth/elbow")[5:-5], robot.column("truth/elbow")[5:-5], atol=1e-6
    )


def _index_position(data: bytes) -> int:
    at = data.index(b"index_pos=") + len(b"index_pos=")
    return int.from_bytes(data[at : at + 8], "little")


def test_an_index_that_counts_more_than_a_file_so_long_can_hold_is_none(bag, tmp_path):
    """Room is made for what an index counts, so that a lie of it would take all memory."""
    data = bytearray(bag.read_bytes())
    with bag.open("rb") as file:
        file.seek(_index_position(data))
        records = [(fields[b"op"], at) for fields, at, _ in container._ros1_records(file)]
    last = max(at for op, at in records if op == b"\x06")
    data[last + 4 : last + 8] = b"\xff\xff\xff\xff"  # messages of a topic in that chunk
    path = tmp_path / "boast.bag"
    path.write_bytes(data)
    assert bag_topics(path) == bag_topics(bag)


@pytest.mark.parametrize("suffix", [".bag", ".mcap"])
def test_what_is_left_of_a_bag_cut_short_is_read(session, tmp_path, suffix):
    path = tmp_path / f"run{suffix}"
    write_bag(session, path)
    if suffix == ".bag":
        path = _rewritten(path, tmp_path / "small.bag")
    whole = path.read_bytes()
    for share in (0.2, 0.6, 0.95):
        path.write_bytes(whole[: int(share * len(whole))])
        found = read_bag(path)
        assert 0.5 * share * len(session) < len(found) < len(session)
        np.testing.assert_allclose(found.t, session.t[: len(found)], rtol=0, atol=1e-9)
        assert any("cut short" in reason for reason in found.provenance.dropped)


def _chunk(content: bytes, checksum: int = 0) -> bytes:
    head = bytes(24) + checksum.to_bytes(4, "little") + bytes(4)
    return record(6, head + len(content).to_bytes(8, "little") + content + b"more")


ENDLESS = b"\x04" + (1 << 60).to_bytes(8, "little") + b"rest"


@pytest.mark.parametrize(
    ("content", "counts"),
    [
        (record(5, b"abc"), {DAMAGED: 1}),  # a message too short to be one
        (ENDLESS, {CUT_SHORT: len(ENDLESS)}),
        (_chunk(b"\5\1\2"), {CUT_SHORT: 3}),
        (_chunk(b"\5\1\2", zlib.crc32(b"\5\1\2")), {CUT_SHORT: 3}),
        (_chunk(b"\5\1\2", zlib.crc32(b"\5\1\3")), {DAMAGED: 1}),
        (_chunk(b"\5" + (8).to_bytes(8, "little") + b"short"), {CUT_SHORT: 14}),
    ],
)
def test_what_is_damaged_in_an_mcap_is_counted_by_what_the_file_has(tmp_path, content, counts):
    path, lost = tmp_path / "run.mcap", Counter()
    path.write_bytes(MCAP_MAGIC + content)
    assert not list(read_batches(path, lambda _: True, lost))
    assert lost == counts


@pytest.mark.parametrize(("arm", "space"), [("left", "arm1"), ("right", "arm2")])
def test_an_arm_is_homed_as_it_says_itself(arm, space):
    topics = {
        f"/{one}/{name}": (kind, 5)
        for one in ("arm1", "arm2")
        for name, kind in (("measured_js", JOINT_STATE), ("operating_state", OPERATING_STATE))
    }
    found = find_wiring("a bag", topics, get_robot("raven2", arm), "raven2_mended")
    assert (found.state, found.homed) == (f"/{space}/measured_js", f"/{space}/operating_state")
    others = {name.replace("arm", "robot"): told for name, told in topics.items()}
    for one in ("robot1", "robot2"):  # of which the names say no arm
        state = f"/{one}/measured_js"
        found = find_wiring("a bag", others, get_robot("raven2", arm), "crtk", state)
        assert found.homed == f"/{one}/operating_state"


def test_the_only_joint_state_that_is_nothing_of_crtks_is_the_truth():
    topics = dict.fromkeys(("/a/measured_js", "/a/servo_jp", "/lab/sensors"), (JOINT_STATE, 5))
    assert find_wiring("a bag", topics, get_robot("davinci_grasper")).truth == "/lab/sensors"
    topics["/lab/others"] = (JOINT_STATE, 5)
    assert not find_wiring("a bag", topics, get_robot("davinci_grasper")).truth


def test_a_field_that_is_no_number_is_refused(bag):
    refused("name is no number", read_topic, bag, "/ext_jpos", ["name"])


def test_the_other_arm_is_read_without_a_truth_that_is_not_its_own(bag, session):
    found = read_other_arm(bag, session)
    assert found.robot.arm == "right"
    assert not found.joints_of("truth")


def test_a_damaged_chunk_costs_no_other(bag, session, tmp_path):
    path = _rewritten(bag, tmp_path / "p.bag", pack="BZ2")
    data = bytearray(path.read_bytes())
    at = data.index(b"BZh", data.index(b"BZh") + 3)
    data[at : at + 3] = b"xyz"
    path.write_bytes(data)
    found = read_bag(path)
    assert 0 < len(found) < len(session)
    assert found.provenance.dropped[DAMAGED] == 1


def test_rows_of_homing_are_left_out(session, tmp_path):
    level = np.where(np.arange(len(session)) < 50, 1.0, 3.0)
    homing = Recording.from_columns({**session.table, "state/run_level": level}, session.provenance)
    write_bag(homing, tmp_path / "h.bag")
    found = read_bag(tmp_path / "h.bag")
    assert len(found) == len(session) - 50
    assert found.provenance.dropped["homing"] == 50
    assert AMID not in found.provenance.dropped


@pytest.mark.parametrize(
    ("kind", "suffix"),  # as RAVEN-II, as CRTK
    [("operating_state", ".bag"), ("operating_state", ".mcap"), ("OperatingState", ".db3")],
)
def test_rows_while_the_arm_says_that_it_is_not_homed_are_left_out(session, tmp_path, kind, suffix):
    start, kind = session.provenance.start, f"crtk_msgs/msg/{kind}"
    text = DEFINITIONS["crtk_msgs/operating_state"]
    if suffix != ".bag":
        text = ros2_definition("crtk_msgs/operating_state")
    said = tmp_path / f"said{suffix}"
    with bag_writer(said) as (writer, store, serialize):
        store.register(typesys().get_types_from_msg(text, kind))
        topic = writer.add_connection("/arm1/operating_state", kind, typestore=store)
        for after, is_homed in ((0.0, True), (1.0, False), (2.0, True)):
            stamp = round((start + after) * 1e9)
            header = header_at(store.types, stamp)
            message = store.types[kind](header, "ENABLED", is_homed, not is_homed)
            writer.write(topic, stamp, serialize(message, kind))
    assert detect_format(said) == "bag"
    whole = tmp_path / ("a.bag" if suffix == ".bag" else "a.mcap")
    write_bag(session, whole, profile="raven2_mended")
    found = read_bag([whole, said], "raven2", profile="raven2_mended", state="/arm1/measured_js")
    amid = (session.t >= 1.0 - 1e-9) & (session.t < 2.0 - 1e-9)
    assert found.provenance.dropped[AMID] == amid.sum() > 10
    np.testing.assert_allclose(found.t, session.t[~amid], atol=1e-6)


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ({"robot": "dvrk_psm"}, "no joint called 'green_shoulder'"),
        ({"state": "/nothing"}, "no topic '/nothing'; there are /arm2/measured_js"),
        ({"profile": "raven3"}, "no profile called 'raven3'; did you mean 'raven2'"),
        ({"quantities": ["torque"]}, "no quantity called 'torque'"),
        ({"truth": "/nowhere"}, "no topic '/nowhere'"),
        ({"truth": "/ravenstate"}, "is the state"),
    ],
)  # fmt: skip
def test_what_is_not_there_is_said_in_one_line(bag, how, said):
    with pytest.raises(TruejointError) as caught:
        read_bag(bag, **how)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"t,measured/jaw\n1,2\n", "is no bag"),
        (b"#ROSBAG V1.2\n" + bytes(40), "is ROSBAG V1.2"),
        (b"#ROSBAG V2.0\n", "no topic in it can be read"),
        (b"SQLite format 3\x00" + bytes(100), "no topic in it can be read"),
        (b"\x89MCAP0\r\n" + b"\xff" * 40, "no topic in it can be read"),
    ],
)
def test_no_bag_is_said_in_one_line(tmp_path, content, said):
    path = tmp_path / "x.bag"
    path.write_bytes(content)
    refused(said, read_bag, path)


def test_a_named_state_is_not_taken_for_the_truth(bag, tmp_path):
    only = _rewritten(bag, tmp_path / "a.bag", lambda topic, k: topic == "/ext_jpos")
    refused("no state of the arm", read_bag, only, "raven2")
    found = read_bag(only, "raven2", state="/ext_jpos")
    assert found.joints_of("measured") == ("shoulder", "elbow", "insertion")
    assert not found.joints_of("truth")


def test_two_arms_of_a_dvrk_need_a_word(tmp_path):
    joints = {"measured/outer_yaw": np.arange(3.0), "measured/outer_pitch": np.arange(3.0)}
    one = Recording.from_columns({"t": np.arange(3.0), **joints}, "dvrk_psm")
    for arm in ("psm1", "psm2"):
        write_bag(
            replace(one, provenance=replace(one.provenance, arm=arm)), tmp_path / f"{arm}.bag"
        )
    bags = [tmp_path / "psm1.bag", tmp_path / "psm2.bag"]
    assert set(bag_topics(bags)) == {"/PSM1/measured_js", "/PSM2/measured_js"}
    refused("several arms", read_bag, bags, "dvrk_psm")
    assert read_bag(bags, "dvrk_psm", "psm2").provenance.arm == "psm2"
    assert read_bag(bags[0], "dvrk_psm").provenance.arm == "psm1"


@pytest.mark.parametrize(("name", "arm"), [("dvrk_ecm", "ecm"), ("dvrk_mtmr", "mtmr")])
def test_other_arms_of_a_dvrk_are_found_by_their_namespace(tmp_path, name, arm):
    names = get_robot(name, arm).joint_names
    rows = {f"measured/{joint}": np.arange(3.0) + k for k, joint in enumerate(names)}
    one = Recording.from_columns({"t": np.arange(3.0), **rows}, Provenance(name, arm))
    write_bag(one, tmp_path / "a.bag")
    assert set(bag_topics(tmp_path / "a.bag")) == {f"/{arm.upper()}/measured_js"}
    found = read_bag(tmp_path / "a.bag", name)
    assert found.provenance.arm == arm
    np.testing.assert_array_equal(found["measured"], one["measured"])


def test_potentiometers_of_a_dvrk_come_from_its_io_topics(tmp_path):
    joints = ("outer_yaw", "outer_pitch", "outer_insertion", "outer_roll")
    names = [f"{quantity}/{joint}" for quantity in ("measured", "pot") for joint in joints]
    rows = {name: np.arange(4.0) + k for k, name in enumerate(names)}
    one = Recording.from_columns({"t": np.arange(4.0), **rows}, Provenance("dvrk_psm", "psm1"))
    write_bag(one, tmp_path / "a.bag")
    pots = "/PSM1/io/pot/measured_js"
    assert bag_topics(tmp_path / "a.bag")[pots] == (JOINT_STATE, 4)
    found = read_bag(tmp_path / "a.bag", "dvrk_psm")
    # Of the joints that an actuator turns alone; discs of the instrument turn the others.
    assert found.joints_of("pot") == joints[:3]
    np.testing.assert_array_equal(found["pot"], one["pot"][:, :3])
    assert found.units["pot/outer_insertion"] == "m"
    part = Recording.from_columns(one.table.drop(columns="pot/outer_pitch"), one.provenance)
    write_bag(part, tmp_path / "b.bag")
    assert pots not in bag_topics(tmp_path / "b.bag")
    kinds = dict.fromkeys(
        ("/PSM1/measured_js", "/PSM2/measured_js", "/IO/io_1/PSM1/measured_js",
         "/IO/io_1/PSM1/pot/measured_js", "/IO/io_2/PSM2/pot/measured_js"), (JOINT_STATE, 4)
    )  # fmt: skip
    wiring = find_wiring("a.bag", kinds, get_robot("dvrk_psm", "psm2"))
    assert (wiring.state, wiring.others, wiring.truth) == (
        "/PSM2/measured_js", ("/IO/io_2/PSM2/pot/measured_js",), ""
    )  # fmt: skip


def test_without_rosbags_it_says_how_to_install_it(bag, monkeypatch):
    monkeypatch.setitem(sys.modules, "rosbags.typesys", None)
    with pytest.raises(TruejointError, match=r'pip install "truejoint\[ros\]"'):
        read_bag(bag)
