"""Messages out of bag files: ROS 1, MCAP and SQLite, whole or cut short, in the file's order.

Every file is read once from its beginning, chunk by chunk, whether it has an index or not: so one
that was never closed (``.bag.active``) or cut short gives what is in it, and a long one takes no
more memory than a chunk. Which topics there are is read from the index, where there is one. Nothing
that a file holds is run, and what it may unpack to has its bounds (`Allowance`). Layouts:
wiki.ros.org/Bags/Format/2.0, mcap.dev/spec, and the tables of ros2/rosbag2:rosbag2_storage_sqlite3.
"""

import io
import sqlite3
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from os.path import isdir
from pathlib import Path
from typing import Any, BinaryIO, Final, Literal

from truejoint.errors import RecordingError
from truejoint.recordings.bounded_file import MOST_PIECE_BYTES, Allowance, require_file

ROS1_MAGIC: Final = b"#ROSBAG V2.0\n"
MCAP_MAGIC: Final = b"\x89MCAP0\r\n"
SQLITE_MAGIC: Final = b"SQLite format 3\x00"
_ZSTD_MAGIC: Final = b"\x28\xb5\x2f\xfd"
_PACKED: Final = (".mcap.zstd", ".db3.zstd")  # how a bag is called that was packed as a whole

CUT_SHORT: Final = "bytes behind the last whole record of a file that was cut short"
DAMAGED: Final = "chunks that do not unpack or of a wrong checksum, or records of a wrong length"

_HEADERS: Final = range(30, 1 << 20)  # bytes that a record's header may have
_ROWS, _BYTES = 4096, 1 << 24  # of messages that are given out together

# Those of which no column is computed, which may take for ever.
_PLAIN_TABLES: Final = (
    "SELECT name FROM sqlite_master AS here WHERE type = 'table' AND rootpage > 0 "
    "AND NOT EXISTS (SELECT 1 FROM pragma_table_xinfo(here.name) WHERE hidden)"
)
_DEFINITIONS: Final = (
    "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions NOT INDEXED"
)
_TOPICS: Final = "SELECT id, name, type, serialization_format FROM topics NOT INDEXED"
_MESSAGES: Final = "SELECT topic_id, timestamp, data FROM messages NOT INDEXED"
_COUNTED: Final = (
    "SELECT topic_id FROM messages NOT INDEXED "
    "WHERE typeof(timestamp) = 'integer' AND typeof(data) = 'blob'"
)
_STEPS: Final = 10_000  # of SQLite's machine between two looks at Ctrl-C
_STEPS_PER_BYTE: Final = 10  # that reading a table may take: it takes about one

_U32: Final = struct.Struct("<I")
_U64: Final = struct.Struct("<Q")
_ROS1_TOPIC: Final = b"\x07"
_MCAP_RECORD: Final = struct.Struct("<BQ")  # what it is, and its length
_MCAP_SCHEMA, _MCAP_CHANNEL, _MCAP_MESSAGE, _MCAP_CHUNK = 0x03, 0x04, 0x05, 0x06
_MCAP_STATISTICS, _MCAP_DATA_END, _MCAP_FOOTER = 0x0B, 0x0F, 0x02
_MCAP_OF_CHUNKS: Final = (_MCAP_SCHEMA, _MCAP_CHANNEL, _MCAP_MESSAGE)
_MCAP_MESSAGE_HEAD: Final = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_LATEST: Final = (1 << 63) - 1  # [ns] that a stamp may be


@dataclass(frozen=True)
class Topic:
    """What a bag says of one topic."""

    name: str
    type: str  # as the bag names it, ``sensor_msgs/JointState`` or ``sensor_msgs/msg/JointState``
    definition: str  # of the message; empty where the bag has none in ROS's own language
    encoding: Literal["ros1", "cdr"]


Batch = tuple[Topic, list[int], list[bytes]]
"""Messages of one topic that lie together: when each was received [ns], and its bytes."""

Wanted = Callable[[Topic], bool]
_Messages = Iterator[tuple[Topic, int, bytes]]
_Kind = tuple[Callable[[BinaryIO, "_Bag"], _Messages], Callable[[BinaryIO, "_Bag"], Counter[Any]]]


@dataclass
class _Bag:
    """One file while it is read: whose messages are wanted, what was seen and lost so far."""

    path: Path
    wanted: Wanted
    lost: Counter[str]
    room: Allowance
    size: int  # bytes of it
    topics: dict[Any, Topic | None] = field(default_factory=dict)  # by key; None if not wanted
    schemas: dict[int, tuple[str, str]] = field(default_factory=dict)
    """Type and text of each definition of an MCAP."""

    def announce(self, key: object, topic: Topic, *, readable: bool = True) -> None:
        """Say which topic the messages with a key are of."""
        self.topics[key] = topic if readable and self.wanted(topic) else None

    def read(self, file: BinaryIO, size: int) -> bytes:
        """Read a message or a chunk; raises RecordingError where it is too large."""
        self.room.check_piece(size)
        return file.read(size)

    def unpack(self, data: bytes, packing: str) -> bytes:
        """Unpack a chunk, or as much as there is of it; one of which nothing comes is counted."""
        if packing in ("none", ""):
            return data
        content = self.room.unpack(data, packing)
        self.lost[DAMAGED] += not content
        return content


def is_bag(path: Path, head: bytes) -> bool:
    """Whether a file that begins with `head`, or a folder, is a bag."""
    if path.is_dir():  # not any folder in which bags lie
        with suppress(RecordingError):
            named = [part.name.startswith(f"{path.name}_") for part in _parts(path)]
            return all(named) or (path / "metadata.yaml").exists()
        return False
    return head.startswith(tuple(_KINDS)) or path.name.endswith(_PACKED)


def list_topics(path: Path) -> dict[Topic, int]:
    """Topics of a bag and how many messages each has; an index tells, where there is one."""
    counts: Counter[Topic] = Counter()
    for (messages, index), file, bag in _opened(path, lambda _: True, Counter()):
        begin = file.tell()
        try:
            by_key = index(file, bag)
            for key, topic in bag.topics.items():
                counts.update({topic: by_key[key]} if topic else {})
        except (struct.error, KeyError):  # no index: read through
            file.seek(begin)
            bag.topics.clear()
            counts.update(topic for topic, _, _ in messages(file, bag))
    return dict(counts)


def read_batches(path: Path, wanted: Wanted, lost: Counter[str]) -> Iterator[Batch]:
    """Messages of the topics that are `wanted`; what cannot be read is counted in `lost`.

    Raises RecordingError if a file is no bag or a folder holds none.
    """
    waiting: dict[Topic, tuple[list[int], list[bytes]]] = {}
    count = size = 0
    for (read, _), file, bag in _opened(path, wanted, lost):
        for topic, time, message in read(file, bag):
            times, messages = waiting.setdefault(topic, ([], []))
            times.append(time)
            messages.append(message)
            count, size = count + 1, size + len(message)
            if count == _ROWS or size >= _BYTES:
                yield from ((topic, *both) for topic, both in waiting.items())
                waiting, count, size = {}, 0, 0
    yield from ((topic, *both) for topic, both in waiting.items())


def _opened(
    path: Path, wanted: Wanted, lost: Counter[str]
) -> Iterator[tuple[_Kind, BinaryIO, _Bag]]:
    """Open each file of a bag behind the first bytes, which tell its kind.

    Raises RecordingError if it is no bag.
    """
    is_folder = isdir(path)  # noqa: PTH112 - a name too long is none, not an error
    for part in _parts(path) if is_folder else [path]:
        with require_file(part).open("rb") as file:
            head = file.read(len(SQLITE_MAGIC))
            magic = next((magic for magic in _KINDS if head.startswith(magic)), b"")
            if not magic:
                raise RecordingError(f"{part}: {_why_no_bag(part, head)}")
            file.seek(len(magic))
            log = part.with_name(f"{part.name}-wal")  # where SQLite writes at first
            size = part.stat().st_size + (log.stat().st_size if log.exists() else 0)
            bag = _Bag(part, wanted, lost, Allowance.of_size(part, size), size)
            yield _KINDS[magic], file, bag


def _why_no_bag(path: Path, head: bytes) -> str:
    if head.startswith(b"#ROSBAG"):
        version = head.split(b"\n")[0].decode(errors="replace")
        return f"is {version[1:]}; rosbag migrates it: rosbag fix"
    if head.startswith(_ZSTD_MAGIC):
        return f"is packed as a whole; unpack it first: zstd -d {path.name}"
    return "is no bag: neither ROS 1 (.bag), MCAP nor SQLite (.db3)"


def _parts(folder: Path) -> list[Path]:
    """Files of a bag of ROS 2 in the order in which they were recorded: name_0, name_1, ...

    Raises RecordingError if there are none.
    """
    parts = [part for part in folder.iterdir() if part.name.endswith((".mcap", ".db3", *_PACKED))]
    if not parts:
        raise RecordingError(f"{folder}: no .mcap or .db3 file in that folder; is it a bag?")

    def number(path: Path) -> tuple[int, str]:
        digits = path.name.partition(".")[0].rpartition("_")[2]
        return int(digits) if digits.isdecimal() else 0, path.name

    return sorted(parts, key=number)


def _ros1_fields(header: bytes) -> dict[bytes, bytes]:
    """Fields of a record's header; raises struct.error where it is damaged."""
    fields, at = {}, 0
    while at < len(header):
        (size,) = _U32.unpack_from(header, at)
        name, separator, value = header[at + 4 : at + 4 + size].partition(b"=")
        if not separator:
            raise struct.error("no name")
        fields[name] = value
        at += 4 + size
    return fields


def _announce_ros1(fields: dict[bytes, bytes], data: bytes, bag: _Bag) -> None:
    """Take a connection."""
    about = _ros1_fields(data)
    parts = fields[b"topic"], about[b"type"], about[b"message_definition"]
    name, kind, text = (part.decode(errors="replace") for part in parts)
    bag.announce(fields[b"conn"], Topic(name, kind, text, "ros1"))


def _ros1_records(file: BinaryIO) -> Iterator[tuple[dict[bytes, bytes], int, int]]:
    """Header of each record of a file, where its data begin and how long they are.

    The file stands there. Ends at the end, or raises struct.error where a record is not whole.
    """
    at = file.tell()
    while start := file.read(4):
        (size,) = _U32.unpack(start)
        if size not in _HEADERS:
            raise struct.error("no header")
        header = file.read(size + 4)
        (length,) = _U32.unpack_from(header, size)
        yield _ros1_fields(header[:size]), at + 8 + size, length
        at += 8 + size + length
        file.seek(at)


def _ros1_index(file: BinaryIO, bag: _Bag) -> Counter[bytes]:
    """Count messages by a bag's index."""
    first: dict[bytes, bytes] = next((fields for fields, _, _ in _ros1_records(file)), {})
    (begin,) = _U64.unpack(first.get(b"index_pos", b""))
    end = file.seek(0, 2)
    if not 0 < begin < end:
        raise struct.error("no index")
    file.seek(begin)
    counts: Counter[bytes] = Counter()
    for fields, at, length in _ros1_records(file):
        if at + length > end:
            raise struct.error("no index")
        if fields.get(b"op") == _ROS1_TOPIC:
            _announce_ros1(fields, file.read(length), bag)
        elif fields.get(b"op") == b"\x06":
            for key, count in struct.iter_unpack("<4sI", file.read(length)):
                counts[key] += count
    # Nor is it one that counts more than has place: 12 bytes of each are in the index of its chunk.
    if 12 * counts.total() > end:
        raise struct.error("no index")
    return counts


def _ros1(file: BinaryIO, bag: _Bag, *, in_chunk: bool = False) -> _Messages:
    """Messages of a file, or of a chunk of one.

    The last chunk of a bag that was never closed states no length: what should be in it lies in the
    file itself.
    """
    whole, end = file.tell(), file.seek(0, 2)
    file.seek(whole)
    topics, lost = bag.topics, bag.lost
    try:
        for fields, begin, length in _ros1_records(file):
            op = fields.get(b"op")
            if op == b"\x05" and not in_chunk:
                if begin + length > end:
                    lost[CUT_SHORT] += end - begin
                packing = fields.get(b"compression", b"").decode(errors="replace")
                chunk = bag.unpack(bag.read(file, min(length, end - begin)), packing)
                yield from _ros1(io.BytesIO(chunk), bag, in_chunk=True)
            elif begin + length > end:
                raise struct.error("not whole")
            elif op == b"\x02":
                topic = topics[fields[b"conn"]]
                seconds, rest = struct.unpack("<II", fields[b"time"])
                if topic is not None:
                    yield topic, seconds * 1_000_000_000 + rest, bag.read(file, length)
            elif op == _ROS1_TOPIC and fields[b"conn"] not in topics:
                _announce_ros1(fields, file.read(length), bag)
            whole = min(begin + length, end)
    except (struct.error, KeyError):
        lost[CUT_SHORT] += end - whole


def _text(data: bytes, at: int) -> tuple[str, int]:
    (size,) = _U32.unpack_from(data, at)
    return data[at + 4 : at + 4 + size].decode(errors="replace"), at + 4 + size


def _announce_mcap(op: int, data: bytes, bag: _Bag) -> None:
    """Take a schema or a channel."""
    if op == _MCAP_SCHEMA:
        name, at = _text(data, 2)
        language, at = _text(data, at)
        text = "" if "idl" in language else _text(data, at)[0]
        bag.schemas[int.from_bytes(data[:2], "little")] = name, text
        return
    key, schema = struct.unpack_from("<HH", data)
    name, at = _text(data, 4)
    encoding = _text(data, at)[0]
    form: Literal["ros1", "cdr"] = "ros1" if encoding == "ros1" else "cdr"
    topic = Topic(name, *bag.schemas.get(schema, ("", "")), form)
    bag.announce(key, topic, readable=encoding in ("ros1", "cdr"))


def _mcap_records(file: BinaryIO, end: int) -> Iterator[tuple[int, int, int]]:
    """Give what each record up to `end` is, where its data begin, and how long they are."""
    at = file.tell()
    while at + _MCAP_RECORD.size <= end:
        op, length = _MCAP_RECORD.unpack(file.read(_MCAP_RECORD.size))
        yield op, at + _MCAP_RECORD.size, length
        at = min(at + _MCAP_RECORD.size + length, end)
        file.seek(at)


def _mcap_index(file: BinaryIO, bag: _Bag) -> Counter[int]:
    """Count messages by the summary at the end of a file, which repeats what topics there are."""
    end = file.seek(0, 2) - 37  # where the footer begins
    file.seek(max(end, 0))
    op, _, begin = struct.unpack("<BQQ", file.read(17))  # a record's, where the summary begins
    if op != _MCAP_FOOTER or not 0 < begin < end:
        raise struct.error("no summary")
    file.seek(begin)
    total, counts = -1, Counter[int]()
    for op, _, length in _mcap_records(file, end):
        if op in (_MCAP_SCHEMA, _MCAP_CHANNEL):
            _announce_mcap(op, file.read(min(length, end)), bag)
        elif op == _MCAP_STATISTICS:
            total, _, size = struct.unpack("<Q34sI", file.read(46))  # messages, bytes of counts
            pairs = file.read(min(size, length) // 10 * 10)
            counts.update(dict(struct.iter_unpack("<HQ", pairs)))  # channel, messages
    if counts.total() != total or not counts.keys() <= bag.topics.keys():
        raise struct.error("no statistics")
    return counts


def _unpack_mcap(chunk: bytes, bag: _Bag, *, is_whole: bool) -> bytes:
    """Unpack records of a chunk; raises struct.error where they are not those that were written."""
    packing, place = _text(chunk, 28)  # behind its times, size unpacked and checksum
    (checksum,), (size,) = _U32.unpack_from(chunk, 24), _U64.unpack_from(chunk, place)
    records = bag.unpack(chunk[place + 8 : place + 8 + size], packing)
    if is_whole and checksum and zlib.crc32(records) != checksum:
        raise struct.error("a wrong checksum")
    return records


def _mcap(file: BinaryIO, bag: _Bag, *, in_chunk: bool = False) -> _Messages:
    """Messages of a file, or of the records of a chunk."""
    whole, end = file.tell(), file.seek(0, 2)
    file.seek(whole)
    for op, begin, length in _mcap_records(file, end):
        if op in (_MCAP_DATA_END, _MCAP_FOOTER):
            return
        is_known = op in _MCAP_OF_CHUNKS or not (in_chunk or op == 0)
        if not is_known or (begin + length > end and op != _MCAP_CHUNK):
            break
        try:
            if op == _MCAP_CHUNK:
                chunk = bag.read(file, min(length, end - begin))
                records = _unpack_mcap(chunk, bag, is_whole=begin + length <= end)
                yield from _mcap(io.BytesIO(records), bag, in_chunk=True)
            elif op == _MCAP_MESSAGE:
                size = _MCAP_MESSAGE_HEAD.size
                channel, _, time, _ = _MCAP_MESSAGE_HEAD.unpack(file.read(min(length, size)))
                if (topic := bag.topics.get(channel)) is not None:
                    yield topic, min(time, _LATEST), bag.read(file, length - size)
            elif op in _MCAP_OF_CHUNKS:
                _announce_mcap(op, file.read(length), bag)
        except struct.error:
            bag.lost[DAMAGED] += 1
        whole = begin + length if begin + length <= end else whole
    if whole < end:  # the last record is not whole
        bag.lost[CUT_SHORT] += end - whole


@contextmanager
def _tables(bag: _Bag) -> Iterator[sqlite3.Connection]:
    """Open a file of tables so that every query ends: by itself, or by Ctrl-C.

    A query may take as many steps as tables of the size do. One that is damaged ends the block.
    """
    looks = iter(range(1000 + _STEPS_PER_BYTE * bag.size // _STEPS))
    with closing(sqlite3.connect(f"{bag.path.resolve().as_uri()}?mode=ro", uri=True)) as base:
        base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MOST_PIECE_BYTES)
        base.set_progress_handler(lambda: next(looks, None) is None, _STEPS)
        try:
            yield base
        except (sqlite3.DatabaseError, TypeError) as error:
            if getattr(error, "sqlite_errorcode", 0) != sqlite3.SQLITE_INTERRUPT:
                bag.lost["tables that cannot be read further: the file is damaged"] += 1
            elif next(looks, None) is not None:
                raise KeyboardInterrupt from None  # which Python told to SQLite alone
            else:
                raise RecordingError(
                    f"{bag.path}: its tables take more steps to read than any of "
                    f"{bag.size} bytes do; is it a bag?"
                ) from None


def _sqlite_topics(base: sqlite3.Connection, bag: _Bag) -> None:
    """Take the topics of a bag, all of it of plain tables: nothing that a file defines is run."""
    base.execute("PRAGMA trusted_schema = OFF")
    base.execute("PRAGMA writable_schema = ON")  # opened to read; else what is cut short is refused
    tables = {name for (name,) in base.execute(_PLAIN_TABLES)}
    if not {"topics", "messages"} <= tables:
        raise RecordingError(
            f"{bag.path}: is no bag of ROS 2: it has no plain tables of topics and messages"
        )
    # Bags from before 2023 have no definitions.
    rows = base.execute(_DEFINITIONS) if "message_definitions" in tables else ()
    texts = {kind: "" if "idl" in str(form) else str(text) for kind, form, text in rows}
    for key, name, kind, form in base.execute(_TOPICS):
        if isinstance(name, str) and isinstance(kind, str):  # SQLite holds anything anywhere
            bag.announce(key, Topic(name, kind, texts.get(kind, ""), "cdr"), readable=form == "cdr")


def _sqlite_index(_: BinaryIO, bag: _Bag) -> Counter[Any]:
    counts: Counter[Any] = Counter()
    with _tables(bag) as base:
        _sqlite_topics(base, bag)
        counts.update(key for (key,) in base.execute(_COUNTED))
    return counts


def _sqlite(_: BinaryIO, bag: _Bag) -> _Messages:
    """Messages of a file of tables."""
    with _tables(bag) as base:
        _sqlite_topics(base, bag)
        for key, time, data in base.execute(_MESSAGES):
            if (topic := bag.topics.get(key)) is None:
                continue
            if not (isinstance(time, int) and isinstance(data, bytes)):
                bag.lost[DAMAGED] += 1
                continue
            bag.room.take(len(data))  # a page of a damaged file may stand for many rows
            packing = "zstd" if data[:4] == _ZSTD_MAGIC else ""  # each message by itself
            if message := bag.unpack(data, packing):
                yield topic, time, message


# How a kind of file is read, and how messages are counted by key of their topic; where it is
# damaged both raise struct.error or KeyError.
_KINDS: Final[dict[bytes, _Kind]] = {
    ROS1_MAGIC: (_ros1, _ros1_index),
    MCAP_MAGIC: (_mcap, _mcap_index),
    SQLITE_MAGIC: (_sqlite, _sqlite_index),
}
