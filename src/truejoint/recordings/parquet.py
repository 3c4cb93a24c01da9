"""Recordings on disk: one Parquet file with units, provenance and a hash in its schema."""

from __future__ import annotations

import json
import os
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq

from truejoint.errors import RecordingError, RobotError
from truejoint.files import UNHASHED, content_hash, is_as_written, write_atomically
from truejoint.recordings.files import most_unpacked, require_file
from truejoint.recordings.numeric_text import MAX_VALUES
from truejoint.recordings.recording import Provenance, Recording, as_recording
from truejoint.robots import adopt_robot

METADATA_KEY: Final = b"truejoint"
# Of the JSON under `METADATA_KEY`: a newer one is refused; that of version 1 has no hash.
VERSION: Final = 2
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
        If `path` exists and may not be replaced, or its folder does not exist.

    Examples
    --------
    >>> write_parquet(test, "test.parquet")
    >>> len(truejoint.read_recording("test.parquet"))
    400
    """
    target, recording = Path(path), as_recording(recording)
    header = {
        "version": VERSION,
        "units": dict(recording.units),
        "provenance": recording.provenance.to_dict(),
        "robot": recording.robot.to_dict(),
    }
    columns = {str(name): column.to_numpy() for name, column in recording.table.items()}
    signed = {**header, "sha256": content_hash(header, columns)}
    table = pa.table(columns, metadata={METADATA_KEY: json.dumps(signed, allow_nan=False).encode()})
    # Values that change a little from row to row pack best with their bytes split apart.
    packing = {"compression": "zstd", "use_dictionary": False, "use_byte_stream_split": True}
    write = partial(pq.write_table, table, **packing)
    write_atomically(target, write, overwrite=overwrite, error=RecordingError)


def read_parquet(path: str | os.PathLike[str]) -> Recording:
    """Read a recording that `write_parquet` wrote, with its units and provenance.

    Raises
    ------
    RecordingError
        If the file is not there, cut short, damaged, edited (its content differs from its hash),
        larger than is read, from a newer version, or was not written by truejoint. One from before
        there were hashes is read, and its notes say so.

    Examples
    --------
    >>> write_parquet(test, "test.parquet")
    >>> read_parquet("test.parquet").provenance.source
    'motion_9.csv'
    """
    source = require_file(Path(path))
    try:
        with pq.ParquetFile(
            source, thrift_string_size_limit=_MAX_METADATA_BYTES, thrift_container_size_limit=10**6
        ) as file:
            _check_size(source, file)
            header = _header(source, file.schema_arrow)
            table = file.read(use_threads=False)
    except MemoryError:
        raise RecordingError(
            f"{source}: takes more memory than there is; close other programs, or read it where "
            "there is more"
        ) from None
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        raise RecordingError(
            f"{source}: is not a whole Parquet file ({str(error).splitlines()[0][:100]}); "
            "it was cut short or damaged: copy or record it again"
        ) from None
    columns = {name: table.column(name).to_numpy() for name in table.column_names}
    digest = header.pop("sha256", None)
    unhashed = digest is None and header["version"] == 1
    if not unhashed and not is_as_written(digest, header, columns):
        raise RecordingError(
            f"{source}: its content does not match its hash; it was damaged or edited: copy or "
            "record it again"
        )
    try:
        provenance = Provenance.from_dict(header["provenance"])
        if unhashed and UNHASHED not in provenance.notes:
            notes = "; ".join(filter(None, (provenance.notes, UNHASHED)))
            provenance = replace(provenance, notes=notes)
        if "robot" in header:
            adopt_robot(header["robot"], source.name)
        return Recording.from_columns(columns, provenance, header["units"])
    except (RecordingError, RobotError) as error:
        raise RecordingError(f"{source}: {str(error).removeprefix(f'{source.name}: ')}") from None


def _check_size(source: Path, file: Any) -> None:
    metadata, schema = file.metadata, file.schema_arrow
    values = metadata.num_rows * metadata.num_columns
    if metadata.num_columns > _MAX_COLUMNS or values > MAX_VALUES:
        raise RecordingError(
            f"{source}: {metadata.num_rows} rows of {metadata.num_columns} columns; at most "
            f"{MAX_VALUES} values in {_MAX_COLUMNS} columns are read"
        )
    size = source.stat().st_size
    if 8 * values > most_unpacked(size):
        raise RecordingError(
            f"{source}: its {size} bytes unpack to {8 * values}, which no measurement does; "
            "is it one?"
        )
    other = [field.name for field in schema if field.type != pa.float64()]
    if other:
        raise RecordingError(
            f"{source}: columns {other[:5]} are not float64; was it written by truejoint?"
        )
    if len(set(schema.names)) != len(schema.names):
        raise RecordingError(f"{source}: two columns have the same name; was the file edited?")


def _header(source: Path, schema: Any) -> dict[str, Any]:
    text = (schema.metadata or {}).get(METADATA_KEY)
    if text is None:
        raise RecordingError(
            f"{source}: was not written by truejoint: it states neither robot nor units; "
            "save it as CSV and read that with a column map"
        )
    damaged = RecordingError(f"{source}: its metadata is damaged; copy or record it again")
    header = None
    with suppress(ValueError, RecursionError):
        header = json.loads(text)
    if not isinstance(header, dict):
        raise damaged
    version = header.get("version")
    if not isinstance(version, int) or version < 1:
        raise damaged
    if version > VERSION:
        raise RecordingError(
            f"{source}: is of version {version!s:.20}, this truejoint reads up to {VERSION}; "
            "update truejoint"
        )
    units = header.get("units", {})
    others = header.get("robot", {}), header.get("provenance")
    if not all(isinstance(part, dict) for part in (units, *others)):
        raise damaged
    texts = all(isinstance(unit, str) for unit in units.values())
    if not texts or set(units) != set(schema.names) - {"t"}:
        raise damaged
    return header
