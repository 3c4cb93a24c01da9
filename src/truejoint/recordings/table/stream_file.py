"""What a recorder has got so far, on disk while it records: one block after the other.

A block is a line of JSON with a hash, then its rows: stamps and columns, float64 little-endian. The
first one has no rows and says what is recorded.
"""

import math
import os
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np

from truejoint.array_types import Array
from truejoint.errors import RecordingError
from truejoint.files import reason
from truejoint.recordings.bounded_file import MAX_VALUES, require_file
from truejoint.recordings.table import parquet
from truejoint.recordings.table.recording import Provenance, Recording, nominal_rates
from truejoint.recordings.table.stream import BACK, Stream, forward_rows, synchronise
from truejoint.robots import Robot

SUFFIX: Final = ".stream"
STATE: Final = "state"
TRUTH: Final = "truth"
_END: Final = "end"  # whose one block stands last in a file that was closed
_CUT_SHORT: Final = "cut short while it was recorded"
_VERSION: Final = 2
_MAX_LINE_BYTES: Final = 1 << 22


class StreamWriter:
    """Writes blocks of several streams to one file as they come, each whole or not at all.

    What `write` has returned from survives the end of the process, however that comes. Each block
    has a hash. `header` holds JSON values that tell how a recording is made of the file. Raises
    RecordingError if the file exists or cannot be written.
    """

    def __init__(self, path: str | os.PathLike[str], header: Mapping[str, Any]) -> None:
        self.path: Final = Path(path)
        try:
            self._file: BinaryIO = self.path.open("xb")
        except OSError as error:
            raise RecordingError(f"{path}: {reason(error)}; choose another name") from None
        self._append({"version": _VERSION, **header}, np.empty((0, 1)))

    def write(self, stream: str, t: Array, columns: Mapping[str, Array]) -> None:
        """Append rows of one stream: stamps (n,) [s] and columns (n,) by name [SI].

        Raises RecordingError if the disk is full or gone; what was written before stays.
        """
        block = {"stream": stream, "columns": list(columns), "rows": len(t)}
        self._append(block, np.column_stack([t, *columns.values()]))

    def _append(self, block: Mapping[str, Any], rows: Array) -> None:
        if self._file.closed:
            raise RecordingError(f"{self.path}: is closed; open another")
        line = parquet.sign(block, {"rows": rows})
        try:
            self._file.write(line + b"\n" + rows.astype("<f8").tobytes())
            self._file.flush()
        except OSError as error:
            why = reason(error)
            raise RecordingError(f"{self.path}: {why}; what was written before is kept") from None

    def close(self, reason: str = "") -> None:
        """End the stream, with a `reason` if it has one; once more does nothing."""
        with suppress(RecordingError):
            self._append({"stream": _END, "reason": reason}, np.empty((0, 1)))
        with suppress(OSError):
            self._file.close()


def read_streams(path: str | os.PathLike[str]) -> tuple[dict[str, Any], dict[str, Stream], str]:
    """Header, streams by name, and in words why the file ends: empty if it is whole.

    Raises RecordingError if the file is not there, is none of these, or holds a block that is not
    as it was written.
    """
    source = require_file(Path(path))
    parts: dict[str, list[Stream]] = {}
    end, total = _CUT_SHORT, 0
    try:
        with source.open("rb") as file:
            blocks = _blocks(source, file)
            header, _ = next(blocks, ({}, None))
            if "version" not in header:
                raise RecordingError(f"{source}: is no stream of a recorder")
            parquet.check_version(source, header, _VERSION)
            for block, rows in blocks:
                name, columns = str(block.get("stream")), list(map(str, block.get("columns", [])))
                end = str(block.get("reason", "")) if name == _END else _CUT_SHORT
                if name == _END:
                    continue
                total += rows.size
                if total > MAX_VALUES:
                    raise RecordingError(f"{source}: more than {MAX_VALUES} values; record less")
                t, *values = rows.T
                piece = Stream(t, dict(zip(columns, values, strict=True)))
                parts.setdefault(name, []).append(piece)
                if piece.columns.keys() != parts[name][0].columns.keys():
                    raise RecordingError(f"{source}: the columns of {name} change on the way")
    except OSError as error:
        raise RecordingError(f"{source}: cannot be read: {reason(error)}") from None
    return header, {name: Stream.joined(pieces) for name, pieces in parts.items()}, end


def _blocks(source: Path, file: BinaryIO) -> Iterator[tuple[dict[str, Any], Array]]:
    """Give description and rows (n, 1 + n_columns) of each block, up to one that is cut short."""
    size = source.stat().st_size
    while (line := file.readline(_MAX_LINE_BYTES)).endswith(b"\n"):
        block = parquet.parse_header(line) or {}
        count, columns = block.get("rows", 0), block.get("columns", [])
        known = isinstance(count, int) and count >= 0 and isinstance(columns, list)
        shape = (count, 1 + len(columns)) if known else (0, 1)
        taken = 8 * math.prod(shape)
        if taken > size - file.tell():
            return
        rows = np.frombuffer(file.read(taken), "<f8").reshape(shape)
        if not known or not parquet.is_unchanged(block, {"rows": rows}):
            raise RecordingError(
                f"{source}: is not as a recorder wrote it; the file was damaged or edited"
            )
        yield block, rows


def read_stream_file(path: str | os.PathLike[str]) -> Recording:
    """Read what a recorder had written before it ended, however it ended.

    Raises RecordingError as `read_streams`, or if there are fewer than 2 rows of the state.
    """
    source = Path(path)
    header, streams, end = read_streams(source)
    provenance, robot = parquet.recorded(source, header)
    if not streams and end == _CUT_SHORT:
        raise RecordingError(f"{source}: holds no rows: {end}, before the first were written")
    try:
        limits = float(header["gap_limit"]), float(header["state_rate"] or math.inf)
    except (KeyError, TypeError, ValueError) as error:
        raise RecordingError(f"{source}: its header is damaged ({error!s:.80})") from None
    notes = "; ".join(filter(None, (provenance.notes, end)))
    origin = replace(provenance, source=str(source), notes=notes)
    return recording_of_streams(streams.get(STATE), streams.get(TRUTH), origin, robot, *limits)


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
