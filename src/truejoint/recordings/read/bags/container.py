"""Messages out of bag files: ROS 1, MCAP and SQLite, whole or cut short, in the file's order.

Every file is read once from its beginning, chunk by chunk, whether it has an index or not: so one
that was never closed (``.bag.active``) or cut short gives what is in it, and a long one takes no
more memory than a chunk. One that was packed as a whole is first unpacked into a temporary file.
Layouts: wiki.ros.org/Bags/Format/2.0, mcap.dev/spec, and the tables of
ros2/rosbag2:rosbag2_storage_sqlite3.
"""

from __future__ import annotations

import bz2
import io
import sqlite3
import struct
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Final, Literal

from truejoint.errors import RecordingError
from truejoint.extras import require
from truejoint.files import reason
from truejoint.recordings.bounded_file import most_unpacked, require_file

ROS1_MAGIC: Final = b"#ROSBAG V2.0\n"
MCAP_MAGIC: Final = b"\x89MCAP0\r\n"
SQLITE_MAGIC: Final = b"SQLite format 3\x00"
ZSTD_MAGIC: Final = b"\x28\xb5\x2f\xfd"

CUT_SHORT: Final = "bytes behind the last whole record of a file that was cut short"
UNPACKED_IN_PART: Final = "file packed as a whole that was cut short"
DAMAGED: Final = "chunks that do not unpack, or records of a wrong length"

_MOST_CHUNK: Final = 1 << 28  # bytes of a chunk once unpacked; recorders write about 1 MB
_MOST_HEADER: Final = 1 << 20  # bytes of a record's header
_PIECE: Final = 1 << 20  # bytes of a packed file that are unpacked at a time
_ROWS: Final = 4096  # of a table that are fetched at a time

_DEFINITIONS: Final = (
    "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
)

_U32: Final = struct.Struct("<I")
_U64: Final = struct.Struct("<Q")
_ROS1_ENTRY: Final = 12  # bytes of each message in the index of its chunk: time and place
_ROS1_TOPIC: Final = b"\x07"
_ROS1_TIME: Final = struct.Struct("<II")  # s and ns
_MCAP_RECORD: Final = struct.Struct("<BQ")  # what it is, and its length
_MCAP_SCHEMA, _MCAP_MESSAGE = 0x03, 0x05
_MCAP_MESSAGE_HEAD: Final = struct.Struct("<HIQ")  # channel, sequence, log time; then publish time
_LATEST: Final = (1 << 63) - 1  # [ns] that a stamp may be
_MCAP_CHUNK: Final = struct.Struct("<QQQI")  # first and last time, size unpacked, checksum


@dataclass(frozen=True)
class Topic:
    """What a bag says of one topic."""

    name: str
    type: str  # as the bag names it, ``sensor_msgs/JointState`` or ``sensor_msgs/msg/JointState``
    definition: str  # of the message; empty in old bags of ROS 2
    encoding: Literal["ros1", "cdr"]
    language: Literal["msg", "idl"] = "msg"  # of the definition


Batch = tuple[Topic, list[int], list[bytes]]
"""Messages of one topic that lie together: when each was received [ns], and its bytes."""

Wanted = Callable[[Topic], bool]


def is_bag(path: Path, head: bytes) -> bool:
    """Whether a file that begins with `head`, or a folder, is a bag."""
    if path.is_dir():  # not any folder in which bags lie
        named = [part.name.startswith(f"{path.name}_") for part in _parts(path)]
        return bool(named) and (all(named) or (path / "metadata.yaml").exists())
    magics = (ROS1_MAGIC, MCAP_MAGIC, SQLITE_MAGIC)
    return head.startswith(magics) or (head.startswith(ZSTD_MAGIC) and bool(_inner_suffix(path)))


def list_topics(path: Path) -> dict[Topic, int]:
    """Topics of a bag and how many messages each has; an index tells, where there is one."""
    if not path.is_dir():
        with require_file(path).open("rb") as file, suppress(struct.error, KeyError):
            return _ros1_index(file)
    count: Counter[Topic] = Counter()
    for topic, times, _ in read_batches(path, lambda _: True, Counter()):
        count[topic] += len(times)
    return dict(count)


def read_batches(path: Path, wanted: Wanted, lost: Counter[str]) -> Iterator[Batch]:
    """Messages of the topics that are `wanted`; what cannot be read is counted in `lost`.

    Raises RecordingError if a file is no bag or a folder holds none.
    """
    if path.is_dir():
        parts = _parts(path)
        if not parts:
            raise RecordingError(f"{path}: no .mcap or .db3 file in that folder; is it a bag?")
        for part in parts:
            yield from read_batches(part, wanted, lost)
        return
    messages = _Messages(wanted, lost)
    with require_file(path).open("rb") as file:
        head = file.read(len(SQLITE_MAGIC))
        file.seek(0)
        if head.startswith(ROS1_MAGIC):
            file.seek(len(ROS1_MAGIC))
            yield from _ros1(file, messages)
        elif head.startswith(MCAP_MAGIC):
            file.seek(len(MCAP_MAGIC))
            yield from _mcap(file, messages, {})
        elif head.startswith(SQLITE_MAGIC):
            yield from _sqlite(path, messages)
        elif head.startswith(ZSTD_MAGIC) and _inner_suffix(path):
            with _unpacked_file(path, lost) as plain:
                yield from read_batches(plain, wanted, lost)
        elif head.startswith(b"#ROSBAG"):
            version = head.split(b"\n")[0].decode(errors="replace")
            raise RecordingError(f"{path}: is {version[1:]}; rosbag migrates it: rosbag fix")
        else:
            raise RecordingError(f"{path}: is no bag: neither ROS 1 (.bag), MCAP nor SQLite (.db3)")


def _inner_suffix(path: Path) -> str:
    """Suffix of what is packed in a whole file."""
    inner = Path(path.stem).suffix
    return inner if path.suffix == ".zstd" and inner in (".mcap", ".db3") else ""


@contextmanager
def _unpacked_file(path: Path, lost: Counter[str]) -> Iterator[Path]:
    """Unpack a file that was packed as a whole, as far as it can be, while the block lasts."""
    most, size = most_unpacked(path.stat().st_size), 0
    with tempfile.TemporaryDirectory(prefix="truejoint-") as folder:
        plain = Path(folder) / path.stem
        try:
            with _zstd().open(path) as packed, plain.open("wb") as file:
                while piece := packed.read1(_PIECE):
                    size += file.write(piece)
                    if size > most:
                        raise RecordingError(f"{path}: unpacks to more than {most} bytes")
        except EOFError:
            lost[UNPACKED_IN_PART] += 1
        except _zstd().ZstdError:
            lost[DAMAGED] += 1
        except OSError as error:
            raise RecordingError(f"{path}: cannot be unpacked: {reason(error)}") from None
        try:
            yield plain
        except RecordingError as error:
            raise RecordingError(str(error).replace(str(plain), str(path))) from None


def _parts(folder: Path) -> list[Path]:
    """Files of a bag of ROS 2 in the order in which they were recorded: name_0, name_1, ..."""
    parts = [p for p in folder.iterdir() if p.suffix in (".mcap", ".db3") or _inner_suffix(p)]

    def number(path: Path) -> tuple[int, str]:
        digits = path.name.partition(".")[0].rpartition("_")[2]
        return int(digits) if digits.isdecimal() else 0, path.name

    return sorted(parts, key=number)


class _Messages:
    """Messages of the `wanted` topics that wait to be given out, a batch a topic; what was lost."""

    def __init__(self, wanted: Wanted, lost: Counter[str]) -> None:
        self._wanted, self.lost = wanted, lost
        self.topics: dict[Any, Topic | None] = {}  # as far as a file was read; None if not wanted
        self._waiting: dict[Topic, tuple[list[int], list[bytes]]] = {}
        self.count = 0

    def announce(self, key: object, topic: Topic, *, readable: bool = True) -> None:
        """Say which topic the messages with a key are of."""
        self.topics[key] = topic if readable and self._wanted(topic) else None

    def add(self, topic: Topic | None, time: int, message: bytes) -> None:
        """Keep a message that came at `time` [ns], unless its topic is not wanted."""
        if topic is not None:
            times, messages = self._waiting.setdefault(topic, ([], []))
            times.append(time)
            messages.append(message)
            self.count += 1

    def take(self) -> Iterator[Batch]:
        """Give out what there is."""
        waiting, self._waiting, self.count = self._waiting, {}, 0
        yield from ((topic, *messages) for topic, messages in waiting.items())


def _unpacked(data: bytes, packing: str, lost: Counter[str]) -> bytes:
    """Unpack a chunk, or as much as there is of it; one of which nothing comes is counted."""
    if packing in ("none", ""):
        return data
    unpackers: dict[str, Callable[[], Any]] = {
        "bz2": bz2.BZ2Decompressor,
        "lz4": lambda: require("lz4.frame", "ros", "a bag packed with LZ4").LZ4FrameDecompressor(),
        "zstd": lambda: _zstd().ZstdDecompressor(),
    }
    content = b""
    if packing in unpackers:
        unpacker = unpackers[packing]()
        with suppress(Exception):  # each packing has errors of its own
            content = unpacker.decompress(data, _MOST_CHUNK)
    lost[DAMAGED] += not content
    return content


def _zstd() -> Any:
    module = "compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd"
    return require(module, "ros", "a bag packed with Zstandard")


# ---------------------------------------------------------------------------------------- ROS 1


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


def _ros1_topic(fields: dict[bytes, bytes], data: bytes) -> Topic:
    about = _ros1_fields(data)
    name, kind, text = (
        value.decode(errors="replace")
        for value in (fields[b"topic"], about[b"type"], about[b"message_definition"])
    )
    return Topic(name, kind, text, "ros1")


def _ros1_records(file: BinaryIO) -> Iterator[tuple[dict[bytes, bytes], int, int]]:
    """Header of each record of a file, where its data begin and how long they are.

    The file stands there. Ends at the end, or raises struct.error where a record is not whole.
    """
    at = file.tell()
    while start := file.read(4):
        (size,) = _U32.unpack(start)
        if size > _MOST_HEADER:
            raise struct.error("no header")
        header = file.read(size + 4)
        (length,) = _U32.unpack_from(header, size)
        yield _ros1_fields(header[:size]), at + 8 + size, length
        at += 8 + size + length
        file.seek(at)


def _ros1_index(file: BinaryIO) -> dict[Topic, int]:
    """Topics and counts by a bag's index; raises struct.error or KeyError without one.

    Nor is an index one that counts more messages than a file so long has places for.
    """
    end, _ = file.seek(0, 2), file.seek(0)
    is_ros1 = file.read(len(ROS1_MAGIC)) == ROS1_MAGIC
    first: dict[bytes, bytes] = next((fields for fields, _, _ in _ros1_records(file)), {})
    (begin,) = _U64.unpack(first.get(b"index_pos", b""))
    if not (is_ros1 and 0 < begin < end):
        raise struct.error("no index")
    file.seek(begin)
    topics: dict[bytes, Topic] = {}
    counts: Counter[bytes] = Counter()
    for fields, at, length in _ros1_records(file):
        if at + length > end:
            raise struct.error("no index")
        data = file.read(length)
        if fields.get(b"op") == _ROS1_TOPIC:
            topics[fields[b"conn"]] = _ros1_topic(fields, data)
        elif fields.get(b"op") == b"\x06":
            for place in range(0, length, 8):
                counts[data[place : place + 4]] += _U32.unpack_from(data, place + 4)[0]
    if counts.total() * _ROS1_ENTRY > end:
        raise struct.error("no index")
    by_topic: Counter[Topic] = Counter()
    for key, topic in topics.items():
        by_topic[topic] += counts[key]
    return dict(by_topic)


def _ros1(file: BinaryIO, messages: _Messages, *, in_chunk: bool = False) -> Iterator[Batch]:
    """Messages of a file, or of a chunk of one.

    The last chunk of a bag that was never closed states no length: what should be in it lies in the
    file itself.
    """
    whole, end = file.tell(), file.seek(0, 2)
    file.seek(whole)
    topics, lost = messages.topics, messages.lost
    try:
        for fields, begin, length in _ros1_records(file):
            op = fields.get(b"op")
            if op == b"\x05" and not in_chunk:
                if begin + length > end:
                    lost[CUT_SHORT] += end - begin
                packing = fields.get(b"compression", b"").decode(errors="replace")
                chunk = _unpacked(file.read(min(length, _MOST_CHUNK)), packing, lost)
                yield from _ros1(io.BytesIO(chunk), messages, in_chunk=True)
            elif begin + length > end:
                raise struct.error("not whole")
            elif op == b"\x02":
                topic = topics[fields[b"conn"]]
                seconds, rest = _ROS1_TIME.unpack(fields[b"time"])
                if topic is not None:
                    messages.add(topic, seconds * 1_000_000_000 + rest, file.read(length))
                if messages.count >= _ROWS:
                    yield from messages.take()
            elif op == _ROS1_TOPIC and fields[b"conn"] not in topics:
                messages.announce(fields[b"conn"], _ros1_topic(fields, file.read(length)))
            whole = min(begin + length, end)
    except (struct.error, KeyError):
        lost[CUT_SHORT] += end - whole
    yield from messages.take()


# ----------------------------------------------------------------------------------------- MCAP


def _text(data: bytes, at: int) -> tuple[str, int]:
    (size,) = _U32.unpack_from(data, at)
    return data[at + 4 : at + 4 + size].decode(errors="replace"), at + 4 + size


_Schemas = dict[int, tuple[str, str, str]]
"""Type, language and text of each definition of a file as far as it was read."""


def _take_mcap(op: int, data: bytes, schemas: _Schemas, messages: _Messages) -> None:
    """Take a schema, a channel or a message; raises struct.error if it is damaged."""
    if op == _MCAP_MESSAGE:
        channel, _, time = _MCAP_MESSAGE_HEAD.unpack_from(data)
        message = data[_MCAP_MESSAGE_HEAD.size + 8 :]
        messages.add(messages.topics.get(channel), min(time, _LATEST), message)
    elif op == _MCAP_SCHEMA:
        name, at = _text(data, 2)
        language, at = _text(data, at)
        schemas[int.from_bytes(data[:2], "little")] = name, language, _text(data, at)[0]
    else:
        key, schema = struct.unpack_from("<HH", data)
        name, at = _text(data, 4)
        encoding = _text(data, at)[0]
        kind, language, definition = schemas.get(schema, ("", "", ""))
        form: Literal["ros1", "cdr"] = "ros1" if encoding == "ros1" else "cdr"
        topic = Topic(name, kind, definition, form, "idl" if "idl" in language else "msg")
        messages.announce(key, topic, readable=encoding in ("ros1", "cdr"))


def _mcap(
    file: BinaryIO, messages: _Messages, schemas: _Schemas, *, in_chunk: bool = False
) -> Iterator[Batch]:
    """Messages of a file, or of the records of a chunk."""
    at, end, lost = file.tell(), file.seek(0, 2), messages.lost
    while at + _MCAP_RECORD.size <= end:
        file.seek(at)
        op, length = _MCAP_RECORD.unpack(file.read(_MCAP_RECORD.size))
        if op in (0x0F, 0x02):  # end of the data
            at = end
            break
        begin = at + _MCAP_RECORD.size
        try:
            if op == 0x06 and not in_chunk:
                chunk = file.read(min(length, _MOST_CHUNK, end - begin))
                packing, place = _text(chunk, _MCAP_CHUNK.size)
                (size,) = _U64.unpack_from(chunk, place)
                records = _unpacked(chunk[place + 8 : place + 8 + size], packing, lost)
                yield from _mcap(io.BytesIO(records), messages, schemas, in_chunk=True)
            elif op in (_MCAP_SCHEMA, 0x04, _MCAP_MESSAGE) and begin + length <= end:
                _take_mcap(op, file.read(length), schemas, messages)
        except struct.error:
            lost[DAMAGED] += 1
        if messages.count >= _ROWS:
            yield from messages.take()
        if begin + length > end:
            break
        at = begin + length
    if at < end:  # the last record is not whole
        lost[CUT_SHORT] += end - at
    yield from messages.take()


# --------------------------------------------------------------------------------------- SQLite


def _sqlite(path: Path, messages: _Messages) -> Iterator[Batch]:
    lost = messages.lost
    with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as base:
        try:
            texts = {}
            with suppress(sqlite3.OperationalError):  # bags from before 2023 have no such table
                texts = {kind: (form, text) for kind, form, text in base.execute(_DEFINITIONS)}
            rows = base.execute("SELECT id, name, type, serialization_format FROM topics")
            for key, name, kind, form in rows:
                if not (isinstance(name, str) and isinstance(kind, str)):
                    continue  # a table of SQLite may hold anything anywhere
                encoding, text = map(str, texts.get(kind, ("", "")))
                announced = Topic(name, kind, text, "cdr", "idl" if "idl" in encoding else "msg")
                messages.announce(key, announced, readable=form == "cdr")
            rows = base.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY rowid")
            while batch := rows.fetchmany(_ROWS):
                for key, time, data in batch:
                    if (topic := messages.topics.get(key)) is None:
                        continue
                    if not (isinstance(time, int) and isinstance(data, bytes)):
                        lost[DAMAGED] += 1
                        continue
                    packing = "zstd" if data[:4] == ZSTD_MAGIC else ""  # each message by itself
                    if message := _unpacked(data, packing, lost):
                        messages.add(topic, time, message)
                yield from messages.take()
        except (sqlite3.DatabaseError, TypeError) as error:
            if isinstance(error, sqlite3.OperationalError) and "no such table" in str(error):
                raise RecordingError(f"{path}: is an SQLite file, but no bag of ROS 2") from None
            lost["tables that cannot be read further: the file is damaged"] += 1
