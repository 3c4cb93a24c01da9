"""Recordings on disk: one Parquet file with units, provenance and a hash in its schema."""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from truejoint.array_types import Array
from truejoint.errors import RecordingError, RobotError, words
from truejoint.files import check_ending, content_hash, is_as_written, write_atomically
from truejoint.recordings.bounded_file import MAX_VALUES, Allowance, require_file
from truejoint.recordings.table.recording import Provenance, Recording, as_recording
from truejoint.robots import Robot, robot_of

KEY: Final = b"truejoint"
"""Key of the header among an Arrow schema's metadata."""


def sign(header: Mapping[str, Any], columns: Mapping[str, Array | list[str]]) -> bytes:
    """JSON of a header with the hash of itself and of columns of numbers or text."""
    signed = {**header, "sha256": content_hash(*_hashed(header, columns))}
    return json.dumps(signed, allow_nan=False).encode()


def _hashed(
    header: Mapping[str, Any], columns: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Split what a file is hashed by: all that is text, and the numbers."""
    texts = {name: column for name, column in columns.items() if isinstance(column, list)}
    return {**header, **texts}, {n: c for n, c in columns.items() if n not in texts}


def parse_header(metadata: Mapping[bytes, bytes] | None) -> dict[str, Any] | None:
    """Values of the header among an Arrow schema's metadata; None where there is none."""
    with suppress(ValueError, RecursionError):
        values = json.loads((metadata or {}).get(KEY, b""))
        return values if isinstance(values, dict) else None
    return None


def check_version(source: Path, header: Mapping[str, Any], version: int) -> None:
    """Raise RecordingError for a file of another version."""
    if header.get("version") != version:
        raise RecordingError(
            f"{source}: is of version {header.get('version')!s:.20}, this truejoint reads "
            f"{version}; update truejoint"
        )


def is_unchanged(header: dict[str, Any], columns: Mapping[str, Array | list[str]]) -> bool:
    """Whether a header and columns are as they were signed; takes the hash out of the header."""
    return is_as_written(header.pop("sha256", None), *_hashed(header, columns))


def recording_header(provenance: Provenance, robot: Robot) -> dict[str, Any]:
    """Entries of a header that say what was recorded, and of which robot."""
    return {"provenance": provenance.to_dict(), "robot": robot.to_dict()}


def recorded(source: Path, header: Mapping[str, Any]) -> tuple[Provenance, Robot]:
    """Inverse of `recording_header`; raises RecordingError where the header is damaged."""
    values, robot = header.get("provenance"), header.get("robot")
    if not isinstance(values, dict) or not isinstance(robot, dict):
        raise RecordingError(f"{source}: its metadata is damaged; copy or record it again")
    try:
        return Provenance.from_dict(values), robot_of(robot, source.name)
    except (RecordingError, RobotError) as error:
        raise RecordingError(f"{source}: {str(error).removeprefix(f'{source.name}: ')}") from None


VERSION: Final = 2  # of the header; another one is refused
PARQUET_MAGIC: Final = b"PAR1"

_DAMAGED: Final = "its metadata is damaged; copy or record it again"
_CORRECTED: Final = "corrected"
_TEXTS: Final = ("recording", "status")  # columns of text, of a corrected table alone
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
    _write(target, header, columns, overwrite=overwrite)


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


def write_corrected(
    table: pd.DataFrame, path: str | os.PathLike[str], *, overwrite: bool = False
) -> None:
    """Write a table of corrected positions, as ``truejoint correct`` makes it, with its hash.

    Parameters
    ----------
    table : DataFrame
        ``recording`` and ``status``, if it has them, are text; the other columns numbers [SI].
    path : path-like
        Any program that reads Parquet reads it.
    overwrite : bool
        Replace a file that is there; refused by default.

    Raises
    ------
    RecordingError
        If `path` exists and may not be replaced, its folder does not exist, or the table holds
        something else.

    Examples
    --------
    >>> write_corrected(model.correct_table(test).assign(status="OK"), "corrected.parquet")
    """
    try:
        columns = {
            str(name): column.tolist() if name in _TEXTS else column.to_numpy(np.float64)
            for name, column in table.items()
        }
    except (AttributeError, OverflowError, TypeError, ValueError) as error:
        raise RecordingError(
            f"{path}: {error}; give a table of numbers, as `Calibration.correct_table` makes it"
        ) from None
    header = {"version": VERSION, "kind": _CORRECTED}
    _write(Path(path), header, columns, overwrite=overwrite)


def read_corrected(path: str | os.PathLike[str]) -> pd.DataFrame:
    """Read what `write_corrected` wrote, if it still is what was written.

    Raises
    ------
    RecordingError
        If the file is not there, damaged, edited, larger than is read, or something else.

    Examples
    --------
    >>> write_corrected(model.correct_table(test).assign(status="OK"), "corrected.parquet")
    >>> read_corrected("corrected.parquet")["status"].iloc[0]
    'OK'
    """
    source = require_file(Path(path))
    header, columns = _read(source, _TEXTS)
    if header.get("kind") != _CORRECTED:
        raise RecordingError(f"{source}: is no table of corrected positions that states its hash")
    return pd.DataFrame(columns)


def is_corrected(path: Path) -> bool:
    """Whether a file says that it is a table of corrected positions."""
    with suppress(pa.ArrowException, OSError, ValueError):
        with path.open("rb") as file:
            header = parse_header(pq.read_schema(file).metadata) or {}
        return header.get("kind") == _CORRECTED
    return False


def _write(
    path: Path, header: Mapping[str, Any], columns: Mapping[str, Any], *, overwrite: bool
) -> None:
    """Write columns of numbers, and lists of text, with a hash of all that is said."""
    texts = [name for name, column in columns.items() if isinstance(column, list)]
    numbers = [name for name in columns if name not in texts]
    # Numbers that change a little from row to row pack best with their bytes split apart.
    packing = {"use_dictionary": texts, "use_byte_stream_split": numbers}
    table = pa.table(columns, metadata={KEY: sign(header, columns)})

    def write(path: Path) -> None:
        with path.open("wb") as file:  # Arrow itself opens no name that is not UTF-8
            pq.write_table(table, file, compression="zstd", **packing)

    write_atomically(path, write, overwrite=overwrite, error=RecordingError)


def _read(source: Path, texts: Collection[str] = ()) -> tuple[dict[str, Any], dict[str, Any]]:
    """Header and columns of a file, those in `texts` lists of text."""
    try:
        with (
            source.open("rb") as raw,
            pq.ParquetFile(
                raw, thrift_string_size_limit=_MAX_METADATA_BYTES, thrift_container_size_limit=10**6
            ) as file,
        ):
            check_size(source, file)
            header = _check_schema(source, file.schema_arrow, texts)
            table = file.read(use_threads=False)
        columns = {
            name: table[name].to_pylist() if name in texts else table[name].to_numpy()
            for name in table.column_names
        }
    except MemoryError:
        raise RecordingError(
            f"{source}: takes more memory than there is; close other programs, or read it where "
            "there is more"
        ) from None
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
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


def check_size(source: Path, file: Any) -> None:
    """Refuse, with RecordingError, a Parquet file of more than is read."""
    metadata = file.metadata
    values = metadata.num_rows * metadata.num_columns
    if metadata.num_columns > _MAX_COLUMNS or values > MAX_VALUES:
        raise RecordingError(
            f"{source}: {metadata.num_rows} rows of {metadata.num_columns} columns; at most "
            f"{MAX_VALUES} values in {_MAX_COLUMNS} columns are read"
        )
    Allowance.of_size(source, source.stat().st_size).take(8 * values)


def _check_schema(source: Path, schema: Any, texts: Collection[str]) -> dict[str, Any]:
    """Header of a file whose columns are numbers, those in `texts` text."""
    kinds = {name: pa.string() for name in texts}
    other = [f.name for f in schema if f.type != kinds.get(f.name, pa.float64())]
    if other:
        raise RecordingError(
            f"{source}: columns {other[:5]} are not float64; is it a recording of truejoint's?"
        )
    if len(set(schema.names)) != len(schema.names):
        raise RecordingError(f"{source}: two columns have the same name; was the file edited?")
    if KEY not in (schema.metadata or {}):
        raise RecordingError(
            f"{source}: was not written by truejoint: it states neither robot nor units; "
            "save it as CSV and read that with a column map"
        )
    header = parse_header(schema.metadata)
    if header is None or not isinstance(header.get("version"), int):
        raise RecordingError(f"{source}: {_DAMAGED}")
    check_version(source, header, VERSION)
    return header
