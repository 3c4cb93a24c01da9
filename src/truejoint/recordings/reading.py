"""Recordings from files, whose layout is found out where none is named."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from truejoint.errors import RecordingError
from truejoint.recordings.array_files import VERSION5_MARK
from truejoint.recordings.files import read_head, require_file
from truejoint.recordings.formats import format_names, get_format
from truejoint.recordings.numeric_text import first_line, is_number, split_fields
from truejoint.recordings.parquet import PARQUET_MAGIC
from truejoint.recordings.readers import davinci_grasper, dvrk_berkeley, kflex, raven_csv
from truejoint.recordings.recording import Recording

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
        What the file does not say: ``robot``, ``arm``, ``column_map`` and ``truth_unit`` for the
        formats that take them (see `FORMATS`), ``load`` [kg], ``homing_id``, ``session`` and
        ``notes`` for any.

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
    about = {key: context.pop(key) for key in PROVENANCE_OPTIONS if key in context}
    wrong = [key for key in context if key not in entry.options]
    if wrong:
        allowed = ", ".join((*entry.options, *PROVENANCE_OPTIONS))
        raise RecordingError(f"{source}: format {name!r} takes no {wrong[0]!r}; it takes {allowed}")
    if not entry.folder:
        require_file(source)
    try:
        recording = entry.read(source, **context)
    except RecordingError as error:
        # The rules of a recording name it as its provenance does; a person wants the path.
        text = str(error)
        if text.startswith(f"{source.name}:") and str(source) != source.name:
            raise RecordingError(str(source) + text.removeprefix(source.name)) from None
        raise
    if not about:  # nor check the table again
        return recording
    return replace(recording, provenance=replace(recording.provenance, **about))


def detect_format(path: str | os.PathLike[str], *, with_map: bool = False) -> str:
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
        if all((source / name).is_file() for name in dvrk_berkeley.FILES):
            return "dvrk_psm_berkeley"
        raise _unknown(source, f"a folder without {', '.join(dvrk_berkeley.FILES)}")
    head = read_head(require_file(source))
    if head.startswith(PARQUET_MAGIC):
        return "parquet"
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
        if "t" in names:
            return "csv"
        raise _unknown(source, "a header without 't'; give a column map")
    count, ravens = len(fields), (raven_csv.STATE_COLUMNS, raven_csv.TRAINING_COLUMNS)
    if count in ravens:
        return f"raven_csv_{count}"
    if count in kflex.LAYOUTS:
        return "kflex_tendon_sheath"
    counts = ", ".join(map(str, (*ravens, *kflex.LAYOUTS)))
    raise _unknown(
        source, f"{count} columns without a header, expected {counts}; give a column map"
    )


def _unknown(source: Path, found: str) -> RecordingError:
    return RecordingError(
        f"{source}: format not recognised ({found}); known: {', '.join(format_names())}"
    )
