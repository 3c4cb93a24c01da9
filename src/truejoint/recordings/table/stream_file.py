"""What a recorder has got so far, on disk while it records: an Arrow stream of blocks."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np
import pandas as pd
import pyarrow as pa

from truejoint.array_types import Array
from truejoint.crtk.topics import OPERATING_STATE, STATES, TOPICS
from truejoint.errors import RecordingError, words
from truejoint.files import reason
from truejoint.recordings.bounded_file import MAX_VALUES, require_file
from truejoint.recordings.table import parquet
from truejoint.recordings.table.recording import Provenance, Recording, nominal_rates
from truejoint.recordings.table.stream import BACK, Stream, forward_rows, synchronise
from truejoint.robots import Robot

SUFFIX: Final = ".arrows"  # Arrow's own for streams
TOPICS_SUFFIX: Final = f".topics{SUFFIX}"  # of what stands beside a recording
STATE: Final = "state"
TRUTH: Final = "truth"
_END: Final = "end"  # whose one block stands last in a file that was closed
_VERSION: Final = 1
_DAMAGE: Final = (pa.ArrowException, OSError, MemoryError, UnicodeDecodeError)  # says Arrow
# A block is one row of bytes, float64 little-endian: arrays that Arrow itself would unpack could,
# damaged, end the process.
_SCHEMA: Final = pa.schema([("t", pa.binary()), ("values", pa.binary())])


@dataclass
class StreamSize:
    """How much of one stream is in a file."""

    rows: int = 0
    size: int = 0  # bytes that they take
    first: float = math.nan  # stamps of the first and the last row [s]
    last: float = math.nan

    @property
    def rate(self) -> float:
        """Mean rate [Hz]; NaN of fewer than 2 rows."""
        span = self.last - self.first
        return (self.rows - 1) / span if self.rows > 1 and span > 0.0 else math.nan

    def __str__(self) -> str:
        rate = "" if math.isnan(self.rate) else f" at {self.rate:.4g} Hz"
        return f"{self.rows} rows{rate}, {self.size / 1e6:.2f} MB"


class StreamWriter:
    """Writes blocks of several streams to one file as they come, each whole or not at all.

    What `write` has returned from survives the end of the process, however that comes. Each block
    has a hash. `header` holds JSON values that tell how a recording is made of the file. Raises
    RecordingError if the file exists or cannot be written.
    """

    def __init__(self, path: str | os.PathLike[str], header: Mapping[str, Any]) -> None:
        self.path: Final = Path(path)
        self.streams: Final[dict[str, StreamSize]] = {}  # what was written
        try:
            self._file: BinaryIO = self.path.open("xb")
        except OSError as error:
            raise RecordingError(f"{path}: {reason(error)}; choose another name") from None
        signed = {parquet.KEY: parquet.sign({"version": _VERSION, **header}, {})}
        self._stream = pa.ipc.new_stream(self._file, _SCHEMA.with_metadata(signed))
        self.size = self._file.tell()  # bytes so far

    def write(self, stream: str, t: Array, columns: Mapping[str, Array]) -> None:
        """Append rows of one stream: stamps (n,) [s] and columns (n,) by name [SI].

        Raises RecordingError if the disk is full or gone; what was written before stays.
        """
        values = np.column_stack([*columns.values()]) if columns else np.empty((len(t), 0))
        block = {"stream": stream, "columns": list(columns)}
        signed = {parquet.KEY: parquet.sign(block, {"t": t, "values": values})}
        row = [pa.array([np.asarray(a, "<f8").tobytes()], pa.binary()) for a in (t, values)]
        batch = pa.record_batch(row, schema=_SCHEMA)
        if self._file.closed:
            raise RecordingError(f"{self.path}: is closed; open another")
        try:
            self._stream.write_batch(batch, custom_metadata=signed)
            self._file.flush()
        except (OSError, pa.ArrowException) as error:
            why = reason(error) if isinstance(error, OSError) else words(error)
            raise RecordingError(f"{self.path}: {why}; what was written before is kept") from None
        if len(t):
            size = self.streams.setdefault(stream, StreamSize(first=float(t[0])))
            size.rows, size.last = size.rows + len(t), float(t[-1])
            size.size += self._file.tell() - self.size
        self.size = self._file.tell()

    def close(self) -> None:
        """End the stream; once more does nothing."""
        if not self._file.closed:
            with suppress(RecordingError):
                self.write(_END, np.empty(0), {})
            with suppress(OSError, pa.ArrowException):
                self._stream.close()
            self._file.close()


def read_streams(
    path: str | os.PathLike[str], wanted: Callable[[str], bool] = lambda _: True
) -> tuple[dict[str, Any], dict[str, Stream], str]:
    """Header, streams by name, and how the file ends: empty, or in words that it was cut short.

    Streams whose name is not `wanted` are left out. Raises RecordingError if the file is not there,
    is none of these, or holds a block that is not as it was written.
    """
    source = require_file(Path(path))
    blocks: dict[str, list[tuple[list[str], Array, Array]]] = {}
    whole, total = False, 0
    try:
        with pa.memory_map(str(source)) as file, suppress(*_DAMAGE):
            if any(map(_is_packed, pa.ipc.MessageReader.open_stream(file))):
                raise RecordingError(f"{source}: was packed, as no recorder's stream is")
        with source.open("rb") as file, pa.ipc.open_stream(file) as reader:
            header = _header(source, reader.schema)
            while True:
                try:
                    batch, described = reader.read_next_batch_with_custom_metadata()
                except (StopIteration, *_DAMAGE):  # for a damaged length there is no memory
                    break
                name, block = _block(source, batch, described)
                whole = name == _END
                if not whole and wanted(name):
                    total += block[2].size
                    if total > MAX_VALUES:
                        raise RecordingError(
                            f"{source}: more than {MAX_VALUES} values; record less"
                        )
                    blocks.setdefault(name, []).append(block)
    except _DAMAGE as error:
        raise RecordingError(f"{source}: is no stream of a recorder ({words(error)})") from None
    end = "" if whole else "cut short while it was recorded"
    streams = {}
    for name, parts in blocks.items():
        names = parts[0][0]
        if any(columns != names for columns, _, _ in parts):
            raise RecordingError(f"{source}: the columns of {name} change on the way")
        t, values = (np.concatenate([part[k] for part in parts]) for k in (1, 2))
        streams[name] = Stream(t, dict(zip(names, values.T, strict=True)))
    return header, streams, end


def read_stream_file(path: str | os.PathLike[str]) -> Recording:
    """Read what a recorder had written before it ended, however it ended.

    Raises RecordingError as `read_streams`, or if there are fewer than 2 rows of the state.
    """
    source = Path(path)
    header, streams, end = read_streams(source, lambda name: name in (STATE, TRUTH))
    provenance, robot = parquet.recorded(source, header)
    try:
        limits = float(header["gap_limit"]), float(header["state_rate"] or math.inf)
    except (KeyError, TypeError, ValueError) as error:
        raise RecordingError(f"{source}: its header is damaged ({error!s:.80})") from None
    notes = "; ".join(filter(None, (provenance.notes, end)))
    origin = replace(provenance, source=str(source), notes=notes)
    return recording_of_streams(streams.get(STATE), streams.get(TRUTH), origin, robot, *limits)


def read_recorded_topics(path: str | os.PathLike[str]) -> dict[str, pd.DataFrame]:
    """CRTK topics that a recorder kept, a table each: stamps ``t`` [s] and fields, at its own rate.

    Fields are those of `truejoint.crtk.topics.topic_columns`; ``operating_state`` has the state's
    name, and whether the arm was homed and busy. Stamps are on the arm's clock, those of the
    recording beside it count from its ``provenance.start``.

    Raises
    ------
    RecordingError
        As `read_streams`, or if no topic is in the file.

    Examples
    --------
    >>> with truejoint.recordings.Recorder(arm, path="a.parquet", topics={"measured_cp": 50.0}):
    ...     arm.wait(1.0)
    >>> topics = truejoint.recordings.read_recorded_topics("a.topics.arrows")
    >>> len(topics["measured_cp"])
    50
    """
    _, streams, _ = read_streams(path, lambda name: name in TOPICS)
    if not streams:
        raise RecordingError(f"{path}: holds no topic; record some, with `collect --topic`")
    tables = {
        name: pd.DataFrame({"t": stream.t, **stream.columns}) for name, stream in streams.items()
    }
    if OPERATING_STATE in tables:
        # Told by several threads, one of which may have come late.
        states = tables[OPERATING_STATE].sort_values("t", kind="stable", ignore_index=True)
        tables[OPERATING_STATE] = states
        numbers = states["state"].to_numpy()
        if not np.isin(numbers, range(len(STATES))).all():
            raise RecordingError(f"{path}: names operating states that this truejoint lacks")
        states["state"] = [STATES[int(number)] for number in numbers]
        for name in ("is_homed", "is_busy"):
            states[name] = states[name] > 0.0
    return tables


def recording_of_streams(
    state: Stream | None,
    truth: Stream | None,
    provenance: Provenance,
    robot: Robot,
    gap_limit: float,
    state_rate: float,
) -> Recording:
    """Make a recording of its streams, the truth at the stamps of the state.

    `state_rate` [Hz] is that of the recorder, infinite where it kept all rows. Raises
    RecordingError if there are fewer than 2 rows of the state.
    """
    if state is None or len(state.t) < 2:
        raise RecordingError(
            f"{provenance.source}: {0 if state is None else len(state.t)} rows; an arm reports "
            "only while homed and moving or holding"
        )
    state, dropped = _forward(state, "state")
    columns = {"t": state.t, **state.columns}
    rates = nominal_rates(state=state.t)
    if not math.isinf(state_rate):
        rates |= {"state": state_rate}
    if truth is not None and len(truth.t) >= 2:
        truth, counts = _forward(truth, "truth")
        columns, unmatched = synchronise(state, truth, gap_limit)
        dropped |= counts | unmatched
        rates |= nominal_rates(truth=truth.t)
    start = float(columns["t"][0])
    columns["t"] = columns["t"] - start
    dropped = {**provenance.dropped, **dropped}
    origin = replace(provenance, rates=rates, dropped=dropped, start=start)
    return Recording.from_columns(columns, origin, robot=robot)


def _forward(stream: Stream, name: str) -> tuple[Stream, dict[str, int]]:
    """All rows but those of a clock that was set back, and how many those are."""
    forward = forward_rows(stream.t)
    return stream.rows(forward), {f"{name}: {BACK}": int((~forward).sum())}


def _header(source: Path, schema: Any) -> dict[str, Any]:
    header = parquet.parse_header(schema.metadata)
    if header is None or not schema.equals(_SCHEMA):
        raise RecordingError(f"{source}: was not written by truejoint's recorder")
    parquet.check_version(source, header, _VERSION)
    if not parquet.is_unchanged(header, {}):
        raise RecordingError(f"{source}: its header is not as it was written; the file was damaged")
    return header


def _block(source: Path, batch: Any, metadata: Any) -> tuple[str, tuple[list[str], Array, Array]]:
    """Stream that a block belongs to, its columns, stamps (n,) and values (n, n_columns)."""
    batch.validate(full=True)
    block = parquet.parse_header(metadata) or {}
    names = block.get("columns")
    if isinstance(names, list) and batch.num_rows == 1:
        pair = [column[0].as_py() for column in batch.columns]
        whole = all(isinstance(a, bytes) and len(a) % 8 == 0 for a in pair)
        t, values = (np.frombuffer(a, "<f8") if whole else np.empty(1) for a in pair)
        if whole and values.size == len(t) * len(names):
            values = values.reshape(len(t), len(names))
            if parquet.is_unchanged(block, {"t": t, "values": values}):
                return str(block["stream"]), (names, t, values)
    raise RecordingError(
        f"{source}: a block is not as it was written; the file was damaged or edited"
    )


def _is_packed(message: Any) -> bool:
    """Whether a message of Arrow is compressed, which Arrow itself would unpack without a bound.

    Arrow has checked that its metadata is a flatbuffer (format/Message.fbs).
    """
    data = message.metadata.to_pybytes()

    def number(at: int, size: int = 4) -> int:
        return int.from_bytes(data[at : at + size], "little")

    def field(table: int, index: int) -> int:
        """Place of what a field of a table refers to; 0 if it has no such field."""
        names = (table - number(table)) % (1 << 32)
        there = 4 + 2 * index < number(names, 2) and number(names + 4 + 2 * index, 2)
        return table + there + number(table + there) if there else 0

    header = field(number(0), 2)
    return bool(header and field(header, 3))
