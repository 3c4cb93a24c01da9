"""Recordings of an arm: one table with named columns, units and provenance."""

from truejoint.recordings.column_map import ColumnMap, MappedColumn, load_column_map
from truejoint.recordings.formats import (
    FORMATS,
    Format,
    detect_format,
    format_names,
    read_recording,
)
from truejoint.recordings.parquet import read_parquet, write_parquet
from truejoint.recordings.recorder import Recorder
from truejoint.recordings.recording import Provenance, Recording
from truejoint.recordings.synchronise import Stream, synchronise

__all__ = [
    "FORMATS",
    "ColumnMap",
    "Format",
    "MappedColumn",
    "Provenance",
    "Recorder",
    "Recording",
    "Stream",
    "detect_format",
    "format_names",
    "load_column_map",
    "read_parquet",
    "read_recording",
    "synchronise",
    "write_parquet",
]
