"""Files made to exhaust whoever reads them: time, memory, or patience with Ctrl-C.

`KINDS` writes or gives each, small as it is. As a program it gives every one to the commands
that read recordings, a process each, with bounded memory, and prints what they took:

    python -m tests.recordings.hostile [--some] [KIND ...]
"""

# ruff: noqa: PLC0415, S608, T201  # SQL of its own constants; truejoint once a command runs

import bz2
import contextlib
import io
import json
import os
import resource
import signal
import sqlite3
import struct
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial, reduce
from itertools import cycle, pairwise, product
from pathlib import Path
from typing import Any

import lz4.frame
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from rosbags import rosbag1
from rosbags.typesys import Stores, get_typestore

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

MEMORY = 1 << 30  # bytes, beyond what is loaded
LONGEST = 10.0  # s of the processor
SOON = 1.0  # s after Ctrl-C

ENDLESS = "WITH RECURSIVE r(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM r)"
JOINTS = "string[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n"
STATE = "sensor_msgs/msg/JointState"
MESSAGE = b"\0\1\0\0" + struct.pack("<II4sIdII", 1, 4, b"jaw\0", 1, 0.5, 0, 0)
RULE = "=" * 80

# ---------------------------------------------------------------------------------------- SQLite

TOPICS = "CREATE TABLE topics (id INTEGER PRIMARY KEY, name, type, serialization_format)"
COLUMNS = "id INTEGER PRIMARY KEY, topic_id, timestamp"
MESSAGES = f"CREATE TABLE messages ({COLUMNS}, data)"
INSERT = "INSERT INTO messages (topic_id, timestamp, data) VALUES (1, ?, ?)"
DEFINITIONS = (
    "CREATE TABLE message_definitions (topic_type, encoding, encoded_message_definition);"
    f"INSERT INTO message_definitions VALUES ('{STATE}', 'ros2msg', '{JOINTS}')"
)
ONE = "INSERT INTO messages VALUES (1, 1, 1)"
TWENTY = [MESSAGE] * 20
SLOW = f"'{'a' * 400}' LIKE '{'%a' * 40}b'"
MANY = ", ".join(f"(VALUES (1), (2), (3), (4)) v{n}" for n in range(40))
ROW = "1 timestamp, x'00' data"
TOPIC_ROW = f"x id, '/t' || x name, '{STATE}' type, 'cdr' serialization_format FROM r"
DEFINITION_ROW = "x topic_type, 'ros2msg' encoding, 'int8 x' encoded_message_definition FROM r"
CALLED_TABLE = (
    "PRAGMA writable_schema = ON",
    "UPDATE sqlite_master SET type = 'table', rootpage = 2 WHERE type = 'view'",
)
TRIGGER = f"CREATE TRIGGER t AFTER INSERT ON messages BEGIN {ENDLESS} SELECT count(*) FROM r; END"


def view(name: str, columns: str, source: str = f"{ENDLESS} SELECT") -> str:
    """SQL of a view in place of a table."""
    return f"CREATE VIEW {name} AS {source} {columns}"


VIEW = view("messages", f"1 topic_id, {ROW} FROM r")


def tables(
    path: Path,
    messages: str = MESSAGES,
    rows: Sequence[bytes] = (),
    topics: str = TOPICS,
    definitions: str = DEFINITIONS,
    then: Sequence[str] = (),
) -> None:
    """Write a bag of tables, or of what is called so, and run some SQL on it."""
    with contextlib.closing(sqlite3.connect(path)) as base:
        base.executescript(f"{definitions};{topics};{messages}")
        if topics == TOPICS:
            base.execute("INSERT INTO topics VALUES (1, '/measured_js', ?, 'cdr')", [STATE])
        for number, row in enumerate(rows):
            base.execute(INSERT, [number * 10**7, row])
        base.commit()
        for line in then:
            base.execute(line)
        base.commit()


def multiply_pages(path: Path) -> None:
    """Have each inner page of the tree of messages point to the next a hundred times."""
    tables(path, rows=[MESSAGE] * 3000)
    data = bytearray(path.read_bytes())
    inner = [at for at in range(0, len(data), 4096) if data[at + 100 * (at == 0)] == 5]
    pages = [*inner, *range(len(data), len(data) + 12 * 4096, 4096)]
    data += bytes(12 * 4096)
    leaf = next(at for at in range(4096, len(data), 4096) if data[at] == 13)
    for at, below in pairwise([*pages, leaf]):
        page = bytearray(4096)
        page[0], page[3:5], page[5:7] = 5, (100).to_bytes(2, "big"), (2000).to_bytes(2, "big")
        number = (below // 4096 + 1).to_bytes(4, "big")
        page[8:12] = number
        for cell in range(100):
            page[12 + 2 * cell : 14 + 2 * cell] = (2000 + 6 * cell).to_bytes(2, "big")
            page[2000 + 6 * cell : 2006 + 6 * cell] = number + bytes([cell + 1, 0])
        data[at : at + 4096] = page
    data[28:32] = (len(data) // 4096).to_bytes(4, "big")
    path.write_bytes(data)


KINDS: dict[str, Callable[[Path], bytes | None]] = {
    "view.db3": partial(tables, messages=VIEW),
    "view_joined.db3": partial(
        tables, messages=view("messages", f"{ROW} FROM {MANY}", "SELECT 1 x, 1 topic_id,")
    ),
    "view_of_topics.db3": partial(tables, topics=view("topics", TOPIC_ROW)),
    "view_of_definitions.db3": partial(
        tables, rows=TWENTY, definitions=view("message_definitions", DEFINITION_ROW)
    ),
    "view_called_table.db3": partial(tables, messages=VIEW, then=CALLED_TABLE),
    "virtual.db3": partial(
        tables, messages="CREATE VIRTUAL TABLE messages USING fts5(topic_id, timestamp, data)"
    ),
    "computed.db3": partial(
        tables, messages=MESSAGES.replace("data", "data AS (zeroblob(1000000000))"), then=[ONE]
    ),
    "computed_slowly.db3": partial(
        tables,
        messages=MESSAGES.replace("data", f"wait AS ({SLOW}), data AS (wait || x'00')"),
        then=[ONE],
    ),
    "index_computed.db3": partial(
        tables, rows=TWENTY, then=["CREATE INDEX slow ON messages (data, 'a' LIKE 'a%a')"]
    ),
    "trigger.db3": partial(tables, rows=TWENTY, then=[TRIGGER]),
    "pages_that_multiply.db3": multiply_pages,
    "messages_zstd.db3": lambda path: tables(
        path, rows=[zstd.compress(MESSAGE + bytes(64_000_000))] * 60
    ),
    "definition_long.db3": lambda path: tables(
        path, rows=TWENTY, definitions=DEFINITIONS.replace(JOINTS, JOINTS + "int32 a\n" * 200_000)
    ),
}

# ------------------------------------------------------------------------------------------ MCAP


def record(op: int, data: bytes) -> bytes:
    """Record of an MCAP."""
    return struct.pack("<BQ", op, len(data)) + data


def text(words: str) -> bytes:
    """Text of an MCAP."""
    return struct.pack("<I", len(words)) + words.encode()


PACK = {"zstd": zstd.compress, "lz4": lz4.frame.compress}
FOOTER = record(2, bytes(20)) + b"\x89MCAP0\r\n"


def state_records(messages: Sequence[bytes], definition: str = JOINTS) -> bytes:
    """Schema, channel and messages of a joint state."""
    schema = struct.pack("<H", 1) + text(STATE) + text("ros2msg") + text(definition)
    channel = struct.pack("<HH", 1, 1) + text("/measured_js") + text("cdr") + bytes(4)
    rows = [
        record(5, struct.pack("<HIQQ", 1, number, number * 10**7, 0) + message)
        for number, message in enumerate(messages)
    ]
    return b"".join([record(3, schema), record(4, channel), *rows])


def blank() -> bytes:
    """Record of a long message."""
    return record(5, bytes(1 << 26))


def chunk(content: bytes, packing: str) -> bytes:
    """Chunk of an MCAP."""
    packed, size = PACK[packing](content), len(content)
    return record(6, struct.pack("<QQQI", 0, 0, size, 0) + text(packing)
                  + struct.pack("<Q", len(packed)) + packed)  # fmt: skip


def mcap(*records: bytes) -> bytes:
    """MCAP without a summary."""
    return b"".join([b"\x89MCAP0\r\n", record(1, text("ros2") + text("")), *records, FOOTER])


def summary_that_lies(_: Path) -> bytes:
    """Count what is not there in a summary that begins at itself."""
    body = mcap(STATES).removesuffix(FOOTER)
    counts = struct.pack("<QHIIIIQQI", 1 << 62, 1, 1, 0, 0, 0, 0, 0, 0xFFFFFFFF)
    summary = record(0x0B, counts + struct.pack("<HQ", 1, 1 << 62))
    return body + summary + record(2, struct.pack("<QQI", len(body), 0, 0)) + b"\x89MCAP0\r\n"


def nested_definition(count: int = 9, last: str = "float64 x\n") -> str:
    """Types within types, each `count` times."""
    return "own/a1 f\n" + "".join(
        f"\n{RULE}\nMSG: own/a{k}\n" + "".join(f"own/a{k + 1} f{j}\n" for j in range(count))
        for k in range(1, 19)
    ) + f"\n{RULE}\nMSG: own/a19\n{last}"  # fmt: skip


def messages_that_lie(name: bytes) -> list[bytes]:
    """Messages of a joint state whose counts and lengths overflow 32 bits once multiplied."""
    huge = 1 << 29, 1 << 31, (1 << 32) - 1
    lengths = product((1, *huge), (name.index(b"w") + 1, len(name), *huge), (1, 8, *huge))
    return [struct.pack("<II4sI", n, size, name, k) + bytes(64) for n, size, k in lengths]


STATES = state_records([MESSAGE] * 20)
EMPTY_LISTS = f"{JOINTS}own/a[] f\n{RULE}\nMSG: own/a\nown/b b\n{RULE}\nMSG: own/b\n"
FEW = record(5, struct.pack("<HIQQ", 1, 0, 0, 0))

KINDS |= {
    "chunks_zstd.mcap": lambda _: mcap(*[chunk(STATES + blank(), "zstd")] * 400),
    "chunks_lz4.mcap": lambda _: mcap(*[chunk(STATES + blank(), "lz4")] * 8),
    "chunk_of_small_records.mcap": lambda _: mcap(chunk(STATES + FEW * 150_000, "zstd")),
    "chunk_of_nothing.mcap": lambda _: mcap(chunk(STATES + bytes(30_000_000), "zstd")),
    "chunk_within_chunk.mcap": lambda _: mcap(
        reduce(lambda records, _: chunk(records * 2, "zstd"), range(50), STATES)
    ),
    "length.mcap": lambda _: mcap(STATES, struct.pack("<BQ", 5, (1 << 63) - 1) + bytes(100)),
    "summary.mcap": summary_that_lies,
    "definition_multiplies.mcap": lambda _: mcap(
        state_records([MESSAGE + bytes(400)] * 20, JOINTS + nested_definition())
    ),
    "message_lengths.mcap": lambda _: mcap(
        state_records([MESSAGE, *[MESSAGE[:4] + m for m in messages_that_lie(b"jaw\0")]])
    ),
    # Every message has a length of its own, and many elements that take no bytes.
    "lists_that_change.mcap": lambda _: mcap(
        state_records(
            [MESSAGE + struct.pack("<I", 60_000) + bytes(n) for n in range(2000)], EMPTY_LISTS
        )
    ),
}

# ----------------------------------------------------------------------------------------- ROS 1


def ros1_record(header: dict[str, bytes], data: bytes = b"", length: int | None = None) -> bytes:
    """Record of a ROS 1 bag."""
    packed, size = ros1_fields(header), len(data) if length is None else length
    return struct.pack("<I", len(packed)) + packed + struct.pack("<I", size) + data


def ros1_fields(header: dict[str, bytes]) -> bytes:
    """Fields of a record's header."""
    fields = [name.encode() + b"=" + value for name, value in header.items()]
    return b"".join(struct.pack("<I", len(field)) + field for field in fields)


def ros1_state(count: int, messages: Sequence[bytes] = ()) -> bytes:
    """Connection and messages of a joint state, all alike or those given."""
    about = {"topic": b"/measured_js", "type": b"sensor_msgs/JointState", "md5sum": b"0" * 32,
             "message_definition": JOINTS.encode()}  # fmt: skip
    message = struct.pack("<II3sIdII", 1, 3, b"jaw", 1, 0.5, 0, 0)
    rows = [
        ros1_record({"op": b"\2", "conn": bytes(4), "time": struct.pack("<II", 1, n)}, message)
        for n, message in enumerate(messages or [message] * count)
    ]
    topic = {"op": b"\7", "conn": bytes(4), "topic": b"/measured_js"}
    return b"".join([ros1_record(topic, ros1_fields(about)), *rows])


def ros1_chunk(packed: bytes, packing: bytes, length: int | None = None) -> bytes:
    """Chunk of a ROS 1 bag."""
    header = {"op": b"\5", "compression": packing, "size": bytes(4)}
    return ros1_record(header, packed, length)


def ros1(*records: bytes, index: int = 0) -> bytes:
    """Bag of ROS 1 whose index is said to begin there."""
    one = struct.pack("<I", 1)
    at = struct.pack("<Q", index)
    header = {"op": b"\3", "index_pos": at, "conn_count": one, "chunk_count": one}
    return b"".join([b"#ROSBAG V2.0\n", ros1_record(header, b" " * 4000), *records])


def index_that_lies(_: Path) -> bytes:
    """Count what is not there in an index, in a record that is said to be long."""
    header = {"op": b"\6", "ver": struct.pack("<I", 1), "chunk_pos": bytes(8),
              "start_time": bytes(8), "end_time": bytes(8), "count": b"\xff" * 4}  # fmt: skip
    entries = struct.pack("<II", 0, 0xFFFFFFFF) * 50_000
    index = ros1_record(header, entries) + ros1_record(header, b"", 0xFFFFFFFF)
    return ros1(ROWS, index, index=len(ros1(ROWS)))


def bomb() -> bytes:
    """Rows, and more than a small file may unpack to."""
    return ROWS + bytes((1 << 26) + 1)


def indexed(path: Path) -> None:
    """Pack large messages as rosbag does."""
    writer = rosbag1.Writer(path)
    writer.set_compression(rosbag1.Writer.CompressionFormat.BZ2)
    with writer:
        store = get_typestore(Stores.ROS1_NOETIC)
        topic = writer.add_connection("/measured_js", STATE, typestore=store)
        for number in range(2):
            writer.write(topic, number, bytes((1 << 25) + 100))


ROWS = ros1_state(20)
SHORT = ros1_record({"op": b"\2", "conn": bytes(4), "time": bytes(8)})

KINDS |= {
    "chunks_bz2.bag": lambda _: ros1(
        *[ros1_chunk(bz2.compress(ROWS + bytes(1 << 22)), b"bz2")] * 600
    ),
    "chunks_lz4.bag": lambda _: ros1(*[ros1_chunk(lz4.frame.compress(bomb()), b"lz4")] * 3),
    "chunk_of_small_records.bag": lambda _: ros1(
        ros1_chunk(lz4.frame.compress(ROWS + SHORT * 60_000), b"lz4")
    ),
    "chunk_cut.bag": lambda _: ros1(
        ros1_chunk(bz2.compress(ros1_state(2000))[:-40], b"bz2", (1 << 32) - 1)
    ),
    "message_lengths.bag": lambda _: ros1(ros1_state(0, messages_that_lie(b"jaw"))),
    "length.bag": lambda _: ros1(ROWS, struct.pack("<I", (1 << 32) - 1) + bytes(100)),
    "chunks_bz2_indexed.bag": indexed,
    "index.bag": index_that_lies,
}

# ----------------------------------------------------------------------------------- other files


def npz(path: Path) -> None:
    """Pack an array of zeros."""
    np.savez_compressed(path, rows=np.zeros(1 << 22))


def parquet(path: Path) -> None:
    """State few rows, in pages that unpack to much."""
    rows = np.zeros((1 << 22) + 1)
    table = pa.table({"t": rows, "measured/jaw": rows})
    pq.write_table(table, path, compression="zstd", use_dictionary=False, data_page_size=1 << 30)


def forged_page(path: Path, size: int = 1 << 28) -> None:
    """Put a page of a few rows that unpacks to `size` bytes in place of an honest one."""
    rows = np.random.default_rng(0).random(20_000)
    table = pa.table({"t": np.sort(rows), "measured/jaw": rows})
    pq.write_table(table, path, compression="zstd", use_dictionary=False)
    packed, count = zstd.compress(bytes(size)), compact(len(rows))
    head = b"\x15\0\x15" + compact(size) + b"\x15" + compact(len(packed))
    page = head + b"\x2c\x15" + count + b"\x15\0\x15\6\x15\6\0\0" + packed
    data = path.read_bytes()
    path.write_bytes(data[:4] + page + data[4 + len(page) :])


def compact(number: int) -> bytes:
    """Whole number as Thrift packs it, seven bits a byte."""
    bits = [2 * number >> shift & 0x7F for shift in range(0, (2 * number).bit_length(), 7)]
    return bytes([*(bit | 0x80 for bit in bits[:-1]), bits[-1]])


def stream(path: Path) -> None:
    """State more rows in a block of a recorder's stream than there are."""
    from truejoint.recordings.table.stream_file import StreamWriter

    StreamWriter(path, {"provenance": {"robot": "raven2"}, "robot": {}, "gap_limit": 0.1}).close()
    with path.open("ab") as file:
        file.write(b'{"stream": "state", "columns": [], "rows": 1099511627776}\n' + bytes(1 << 20))


KINDS |= {
    "rows.npz": npz,
    "rows.parquet": parquet,
    "page_forged.parquet": forged_page,
    "blocks.stream": stream,
}

# ----------------------------------------------------------------------------------------- trial

COMMANDS = {
    "extract": ("extract", "-o", "out.parquet"),
    "doctor": ("doctor",),
    "calibrate": ("calibrate", "-e", "offset", "-o", "m.safetensors"),
    "list": ("extract",),
}
READING = ("extract", "doctor", "calibrate")
BAGS = ".bag", ".db3", ".mcap"
LISTED = ("view_of_topics.db3", "computed_slowly.db3", "messages_zstd.db3", "summary.mcap",
          "chunk_of_small_records.mcap", "chunks_bz2_indexed.bag", "index.bag")  # fmt: skip
"""Those that a list of topics could be long at."""
ROBOT = "--robot", "davinci_grasper"  # where a file does not say it
STOPPED = "Ctrl-C"
"""Besides: extract without the bounds, and Ctrl-C while it runs."""
ENDLESS_KINDS = ("view.db3", "view_joined.db3", "pages_that_multiply.db3", "messages_zstd.db3",
                 "chunks_zstd.mcap", "chunk_of_small_records.mcap", "chunks_bz2.bag")  # fmt: skip
"""Those that without the bounds take longer than it takes to press Ctrl-C."""


def attempts(*, some: bool, kinds: Sequence[str] = ()) -> list[tuple[str, str]]:
    """Kinds with commands: all; or for each one that reads, in turn; some listed, some stopped."""
    chosen, turn = kinds or list(KINDS), cycle(READING)
    if some:
        by_kind = [(k, next(turn) if k.endswith(BAGS) else "doctor") for k in chosen]
        lists = [(kind, "list") for kind in LISTED]
        return [*by_kind, *lists, *((kind, STOPPED) for kind in ENDLESS_KINDS)]
    return [(name, command) for name in chosen for command in (*COMMANDS, STOPPED)]


def lift_bounds() -> None:
    """Take away what ends the reading of a hostile file by itself."""
    from truejoint.recordings import bounded_file
    from truejoint.recordings.read.bags import container

    bounded_file.Allowance.take = bounded_file.Allowance.check_piece = lambda *_: None
    container._STEPS_PER_BYTE = 10**9
    container._PLAIN_TABLES = (
        "SELECT name FROM sqlite_master AS here WHERE NOT EXISTS (SELECT 1 FROM "
        "pragma_table_xinfo(here.name) WHERE hidden)"
    )


def run(words: Sequence[str]) -> int:
    """Run a command in this process; its exit code."""
    from truejoint.cli.app import main as truejoint_main

    sys.argv = ["truejoint", *words]
    try:
        truejoint_main()
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0


def child(words: Sequence[str], said: int) -> None:
    """Run a command with bounded memory in this process, which ends with it."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + MEMORY,) * 2)
    for stream in (1, 2):
        os.dup2(said, stream)
    code = 1
    try:
        code = run(words)
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        os._exit(code)


def cpu_seconds(process: int) -> float:
    """Processor time that a process has had [s] (proc(5))."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def attempt(path: Path, command: str, folder: Path) -> dict[str, Any]:
    """Give a file to a command: exit code, CPU seconds, bytes of memory, what it said.

    The seconds are those of the processor, since others may have it meanwhile; after Ctrl-C, those
    from then on.
    """
    words = [*COMMANDS["extract" if command == STOPPED else command], str(path)]
    if command != "list" and path.suffix not in (".stream", ".parquet"):
        words += ROBOT
    for made in ("out.parquet", "m.safetensors"):
        (folder / made).unlink(missing_ok=True)
    with tempfile.TemporaryFile(dir=folder) as said:
        began, stop_at, asked, before = time.monotonic(), 0.0, 0.0, 0.0
        process = os.fork()
        if process == 0:
            signal.signal(signal.SIGINT, signal.default_int_handler)
            os.chdir(folder)
            if command == STOPPED:
                lift_bounds()
            child(words, said.fileno())
        while True:
            done, status, usage = os.wait4(process, os.WNOHANG)
            took = time.monotonic() - began
            if done:
                break
            if asked == 0.0 and stop_at == 0.0 and os.fstat(said.fileno()).st_size:
                stop_at = took + 0.1  # it reads
            if command == STOPPED and asked == 0.0 and took > (stop_at or 1.0):
                asked, before = took, cpu_seconds(process)
                os.kill(process, signal.SIGINT)
            if took > 12 * LONGEST:
                os.kill(process, signal.SIGKILL)
            time.sleep(0.005)
        said.seek(0)
        lines = [line for line in said.read().decode(errors="replace").splitlines() if line.strip()]
        lines = [line for line in lines if not line.endswith(" ...")]  # what it is at
    memory = usage.ru_maxrss * 1024
    took = round(usage.ru_utime + usage.ru_stime - before, 2)
    return {"kind": path.name, "command": command, "code": os.waitstatus_to_exitcode(status),
            "took": took, "memory": memory, "said": lines}  # fmt: skip


def main() -> None:
    """Try every kind, or those that are named, and print a line of JSON for each attempt."""
    from tests.synthetic import build_recording

    import truejoint

    asked = sys.argv[1:]
    kinds = [word for word in asked if word != "--some"]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        os.chdir(folder)
        good = folder / "good.bag"
        truejoint.recordings.write_bag(build_recording(400), good)
        nowhere = io.StringIO()
        with contextlib.redirect_stdout(nowhere), contextlib.redirect_stderr(nowhere):
            for words in COMMANDS.values():  # modules and kernels, before the memory is counted
                run([*words, str(good)])
        for made, command in attempts(some="--some" in asked, kinds=kinds):
            path = folder / made
            if not path.exists():
                if (writer := os.fork()) == 0:  # what it takes is not counted
                    with contextlib.suppress(Exception):
                        if (content := KINDS[made](path)) is not None:
                            path.write_bytes(content)
                    os._exit(0)
                os.waitpid(writer, 0)
            print(json.dumps(attempt(path, command, folder)), flush=True)
        os.chdir("/")


if __name__ == "__main__":
    main()
