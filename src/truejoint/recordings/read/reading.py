"""Recordings from files, whose layout is found out where none is named."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from truejoint.errors import RecordingError
from truejoint.recordings.bounded_file import read_head, require_file
from truejoint.recordings.read import davinci_grasper, dvrk_berkeley, kflex, mapped, raven_csv
from truejoint.recordings.read.array_files import VERSION5_MARK
from truejoint.recordings.read.bags.container import is_bag
from truejoint.recordings.read.column_map import MapSource
from truejoint.recordings.read.formats import FORMATS, format_names, get_format
from truejoint.recordings.read.numeric_text import first_line, is_number, split_fields
from truejoint.recordings.table.parquet import PARQUET_MAGIC
from truejoint.recordings.table.recording import Recording, as_recordings
from truejoint.recordings.table.stream_file import SUFFIX, TOPICS_SUFFIX

PROVENANCE_OPTIONS: Final = ("load", "homing_id", "session", "notes")
"""What a caller may state about any file, and that replaces what the file says."""


def read_recording(
    path: str | os.PathLike[str],
    format: str | None = None,  # noqa: A002 - the word that a person types
    **context: Any,
) -> Recording:
    """Read a recording from a file or folder of any known layout into SI units.

    Parameters
    ----------
    path : path-like
    format : str, optional
        One of `format_names`; found out from the content by default, if it is truejoint's own.
    **context
        What the file does not say: ``robot``, ``arm``, ``column_map``, ``rate`` [Hz] of a file
        without time stamps, and ``truth_unit``, for the formats that take them (see `FORMATS`);
        ``load`` [kg], ``homing_id``, ``session`` and ``notes`` for any.

    Raises
    ------
    RecordingError
        One line that names the file, what is wrong with it and what to do.

    Examples
    --------
    >>> test.table.to_csv("run.csv", index=False)
    >>> read_recording("run.csv", robot="davinci_grasper").joints_of("truth")
    ('jaw',)
    """
    found = read_recordings(path, format, **context)
    if len(found) > 1:
        raise RecordingError(
            f"{path}: its clock restarts, so it holds {len(found)} recordings; "
            "read_recordings(path) gives all of them"
        )
    return found[0]


def read_recordings(
    path: str | os.PathLike[str],
    format: str | None = None,  # noqa: A002 - the word that a person types
    **context: Any,
) -> list[Recording]:
    """Read the recordings of a file: several where its clock restarts, a session each.

    Takes and raises what `read_recording` does.

    Examples
    --------
    >>> twice = pd.concat([test.table, training[0].table])
    >>> twice.to_csv("day.csv", index=False)
    >>> [r.provenance.session for r in read_recordings("day.csv", robot="davinci_grasper")]
    ['day#1', 'day#2']
    """
    if not isinstance(path, str | os.PathLike):
        raise RecordingError(
            f"a {type(path).__name__} is no path; Recording.from_columns(table, robot) makes a "
            "recording of a table"
        )
    source = Path(path)
    if not source.exists():
        raise RecordingError(f"{source}: there is no such file or folder; check the path")
    name = format or detect_format(source, with_map="column_map" in context)
    entry = get_format(name)
    about: dict[str, Any] = {key: context.pop(key) for key in PROVENANCE_OPTIONS if key in context}
    wrong = [key for key in context if key not in entry.options]
    if wrong:
        allowed = ", ".join((*entry.options, *PROVENANCE_OPTIONS))
        raise RecordingError(f"{source}: format {name!r} takes no {wrong[0]!r}; it takes {allowed}")
    if not entry.folder:
        require_file(source)
    try:
        found = as_recordings(entry.read(source, **context))
    except RecordingError as error:
        # The rules of a recording name it as its provenance does; a person wants the path.
        text = str(error)
        if text.startswith(f"{source.name}:") and str(source) != source.name:
            raise RecordingError(str(source) + text.removeprefix(source.name)) from None
        raise
    return state(found, about)


def state(recordings: Sequence[Recording], about: Mapping[str, Any]) -> list[Recording]:
    """State of recordings what a person says of them, any of `PROVENANCE_OPTIONS`."""
    if not about:  # nor check the tables again
        return list(recordings)
    stated = []
    for recording in recordings:
        facts = dict(about)
        _, part, count = recording.provenance.session.rpartition("#")
        if "session" in facts and len(recordings) > 1:
            facts["session"] += part + count
        stated.append(replace(recording, provenance=replace(recording.provenance, **facts)))
    return stated


def why_no_recording(
    path: Path,
    format: str | None = None,  # noqa: A002
    column_map: MapSource | None = None,
) -> str:
    """Say why a file that nobody named is none of the recordings among which it lies, else ``""``.

    One that is damaged counts as a recording: reading it says so.
    """
    try:
        name = detect_format(path, with_map=column_map is not None)
        if path.name.endswith(TOPICS_SUFFIX):
            return "holds the topics of another recording"
        if name == "csv":
            mapping, _, _ = mapped.read_header(path, column_map, rate=0.0)
            if not any(column.startswith("measured/") for column in mapping.columns):
                return "no 'measured/<joint>' column"
    except RecordingError as error:
        return str(error).removeprefix(f"{path}: ")
    own = format in FORMATS and not (format == "csv" and name == "arrays")
    return f"is {name}, not {format}" if own and name != format else ""


def detect_format(  # noqa: PLR0911  # one for each layout
    path: str | os.PathLike[str], *, with_map: bool = False
) -> str:
    """Name of the layout that a file or folder has.

    Parameters
    ----------
    path : path-like
    with_map : bool
        A column map comes with it: text is then plain CSV, and what is not text are arrays.

    Raises
    ------
    RecordingError
        If it is none of `FORMATS`; the message lists them.

    Examples
    --------
    >>> write_parquet(test, "test.parquet")
    >>> detect_format("test.parquet")
    'parquet'
    """
    source = Path(path)
    if source.is_dir():
        if is_bag(source, b""):
            return "bag"
        if all((source / name).is_file() for name in dvrk_berkeley.FILES):
            return "dvrk_psm_berkeley"
        raise _unknown(source, f"a folder without {', '.join(dvrk_berkeley.FILES)}")
    head = read_head(require_file(source))
    binary = {
        "bag": is_bag(source, head),
        "parquet": head.startswith(PARQUET_MAGIC),
        "arrows": source.suffix == SUFFIX,
    }
    if any(binary.values()):
        return next(name for name, fits in binary.items() if fits)
    if with_map:
        return "arrays" if b"\0" in head else "csv"
    if head.startswith(VERSION5_MARK):
        return "kuka_kr300_dual_encoder"
    # A version 4 MAT file starts with a number below 5000 and five rows named data_<k>.
    if head[20:25] == b"data_":
        return "bros_dual_encoder"
    if b"\0" in head:
        raise _unknown(source, "not text and of no known binary layout")
    return _detect_text(source, head.decode("utf-8-sig", errors="replace"))


def _detect_text(source: Path, head: str) -> str:
    if head.startswith("%") and davinci_grasper.HEADER_MARK in head:
        return "davinci_grasper_umn"
    line = first_line(source, "#")[1]
    fields = split_fields(line, ",")
    if not all(is_number(field) for field in fields):
        names = {field for d in ",;\t " for field in split_fields(line.replace('"', ""), d)}
        if "t" in names or any(name.startswith("measured/") for name in names):
            return "csv"
        raise _unknown(source, f"a header without 't'; {mapped.MAP_ADVICE}")
    count, ravens = len(fields), (raven_csv.STATE_COLUMNS, raven_csv.TRAINING_COLUMNS)
    if count in ravens:
        return f"raven_csv_{count}"
    if count in kflex.LAYOUTS:
        return "kflex_tendon_sheath"
    counts = ", ".join(map(str, (*ravens, *kflex.LAYOUTS)))
    raise _unknown(
        source, f"{count} columns without a header, expected {counts}; {mapped.MAP_ADVICE}"
    )


def _unknown(source: Path, found: str) -> RecordingError:
    return RecordingError(
        f"{source}: format not recognised ({found}); known: {', '.join(format_names())}"
    )
