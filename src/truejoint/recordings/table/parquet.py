"""Recordings on disk: one Parquet file with units, provenance and a hash in its schema."""

import json
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO, Final

import pyarrow as pa
import pyarrow.parquet as pq

from truejoint.array_types import Array
from truejoint.errors import RecordingError, RobotError, words
from truejoint.files import check_ending, content_hash, is_as_written, write_atomically
from truejoint.recordings.bounded_file import MAX_VALUES, Allowance, DamagedError, require_file
from truejoint.recordings.table.parquet_pages import chunks, page_sizes
from truejoint.recordings.table.recording import Provenance, Recording, as_recording
from truejoint.robots import Robot, robot_of

KEY: Final = b"truejoint"
"""Key of the header among an Arrow schema's metadata."""
_DAMAGED: Final = "its metadata is damaged; copy or record it again"


def sign(header: Mapping[str, Any], columns: Mapping[str, Array]) -> bytes:
    """JSON of a header with the hash of itself and of columns."""
    signed = {**header, "sha256": content_hash(header, columns)}
    return json.dumps(signed, allow_nan=False).encode()


def parse_header(text: bytes) -> dict[str, Any] | None:
    """Values of a header; None where it is none."""
    with suppress(ValueError, RecursionError):
        values = json.loads(text)
        return values if isinstance(values, dict) else None
    return None


def check_version(source: Path, header: Mapping[str, Any], version: int) -> None:
    """Raise RecordingError for a file of another version."""
    if header.get("version") != version:
        raise RecordingError(
            f"{source}: is of version {header.get('version')!s:.20}, this truejoint reads "
            f"{version}; update truejoint"
        )


def is_unchanged(header: dict[str, Any], columns: Mapping[str, Array]) -> bool:
    """Whether a header and columns are as they were signed; takes the hash out of the header."""
    return is_as_written(header.pop("sha256", None), header, columns)


def recording_header(provenance: Provenance, robot: Robot) -> dict[str, Any]:
    """Entries of a header that say what was recorded, and of which robot."""
    return {"provenance": provenance.to_dict(), "robot": robot.to_dict()}


def recorded(source: Path, header: Mapping[str, Any]) -> tuple[Provenance, Robot]:
    """Inverse of `recording_header`; raises RecordingError where the header is damaged."""
    values, robot = header.get("provenance"), header.get("robot")
    if not isinstance(values, dict) or not isinstance(robot, dict):
        raise RecordingError(f"{source}: {_DAMAGED}")
    try:
        return Provenance.from_dict(values), robot_of(robot, source.name)
    except (RecordingError, RobotError) as error:
        raise RecordingError(f"{source}: {str(error).removeprefix(f'{source.name}: ')}") from None


VERSION: Final = 2  # of the header; another one is refused
PARQUET_MAGIC: Final = b"PAR1"
_MAX_COLUMNS: Final = 4096
_MAX_METADATA_BYTES: Final = 1 << 22


def write_parquet(
    recording: Recording, path: str | os.PathLike[str], *, overwrite: bool = False
) -> None:
    """Write a recording to a Parquet file, whole or not at all.

    Parameters
    ----------
    recording : Recording
    path : path-like
    overwrite : bool
        Replace a file that is there; refused by default.

    Raises
    ------
    RecordingError
        If `path` exists and may not be replaced, its folder does not exist, or its ending says
        that it is another file.

    Examples
    --------
    >>> write_parquet(test, "test.parquet")
    >>> len(truejoint.read_recording("test.parquet"))
    400
    """
    target, recording = Path(path), as_recording(recording)
    check_ending(target, ".parquet", "a recording", RecordingError)
    columns = {str(name): column.to_numpy() for name, column in recording.table.items()}
    header = {
        "version": VERSION,
        "units": {name: unit for name, unit in recording.units.items() if name in columns},
        **recording_header(recording.provenance, recording.robot),
    }
    # Numbers that change a little from row to row pack best with their bytes split apart.
    packing = {"use_dictionary": False, "use_byte_stream_split": True, "compression": "zstd"}
    table = pa.table(columns, metadata={KEY: sign(header, columns)})

    def write(path: Path) -> None:
        with path.open("wb") as file:  # Arrow itself opens no name that is not UTF-8
            pq.write_table(table, file, **packing)

    write_atomically(target, write, overwrite=overwrite, error=RecordingError)


def read_parquet(path: str | os.PathLike[str]) -> Recording:
    """Read a recording that `write_parquet` wrote, with its units and provenance.

    Raises
    ------
    RecordingError
        If the file is not there, cut short, damaged, edited (its content differs from its hash),
        larger than is read, from another version, or was not written by truejoint.

    Examples
    --------
    >>> write_parquet(test, "test.parquet")
    >>> read_parquet("test.parquet").provenance.source
    'motion_9.csv'
    """
    source = require_file(Path(path))
    header, columns = _read(source)
    units = header.get("units") or {}
    named = isinstance(units, dict) and set(units) == set(columns) - {"t"}
    if not named or not all(isinstance(unit, str) for unit in units.values()):
        raise RecordingError(f"{source}: {_DAMAGED}")
    provenance, robot = recorded(source, header)
    try:
        return Recording.from_columns(columns, provenance, units, robot=robot)
    except RecordingError as error:
        raise RecordingError(f"{source}: {str(error).removeprefix(f'{source.name}: ')}") from None


def _read(source: Path) -> tuple[dict[str, Any], dict[str, Array]]:
    try:
        with (
            source.open("rb") as raw,
            pq.ParquetFile(
                raw, thrift_string_size_limit=_MAX_METADATA_BYTES, thrift_container_size_limit=10**6
            ) as file,
        ):
            _check_size(source, file.metadata, raw)
            header = _check_schema(source, file.schema_arrow)
            table = file.read(use_threads=False)
        columns = {name: table[name].to_numpy() for name in table.column_names}
    except MemoryError:
        raise RecordingError(
            f"{source}: takes more memory than there is; close other programs, or read it where "
            "there is more"
        ) from None
    except (pa.ArrowException, DamagedError, OSError, UnicodeDecodeError) as error:
        raise RecordingError(
            f"{source}: is not a whole Parquet file ({words(error)}); "
            "it was cut short or damaged: copy or record it again"
        ) from None
    if not is_unchanged(header, columns):
        raise RecordingError(
            f"{source}: its content does not match its hash; it was damaged or edited: copy or "
            "record it again"
        )
    return header, columns


def _check_size(source: Path, metadata: Any, file: BinaryIO) -> None:
    """Refuse, with RecordingError, a Parquet file of more than is read, by metadata and pages."""
    values = metadata.num_rows * metadata.num_columns
    if metadata.num_columns > _MAX_COLUMNS or values > MAX_VALUES:
        raise RecordingError(
            f"{source}: {metadata.num_rows} rows of {metadata.num_columns} columns; at most "
            f"{MAX_VALUES} values in {_MAX_COLUMNS} columns are read"
        )
    of_chunks = chunks(file)
    counted = max(values, sum(chunk.values for chunk in of_chunks))
    for sizes in ([8 * counted], page_sizes(file, of_chunks)):
        room = Allowance.of_size(source, source.stat().st_size)
        for size in sizes:
            room.take(size)


def _check_schema(source: Path, schema: Any) -> dict[str, Any]:
    """Header of a file whose columns are numbers."""
    if KEY not in (schema.metadata or {}):
        raise RecordingError(
            f"{source}: is no recording of truejoint's: it states neither robot nor units; "
            "save it as CSV and read that with a column map"
        )
    other = [field.name for field in schema if field.type != pa.float64()]
    if other:
        raise RecordingError(f"{source}: columns {other[:5]} are not float64; was it edited?")
    if len(set(schema.names)) != len(schema.names):
        raise RecordingError(f"{source}: two columns have the same name; was the file edited?")
    header = parse_header(schema.metadata[KEY])
    if header is None or not isinstance(header.get("version"), int):
        raise RecordingError(f"{source}: {_DAMAGED}")
    check_version(source, header, VERSION)
    return header
