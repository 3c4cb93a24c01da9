"""Recordings from files, whose layout is found out where none is named."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from truejoint.errors import RecordingError
from truejoint.files import is_folder
from truejoint.recordings.bounded_file import Head, require_file
from truejoint.recordings.read import mapped, raven_csv
from truejoint.recordings.read.bags.container import is_bag
from truejoint.recordings.read.formats import FORMATS, format_names, get_format
from truejoint.recordings.read.mapped import MapSource
from truejoint.recordings.read.numeric_text import text_layout
from truejoint.recordings.table.parquet import PARQUET_MAGIC
from truejoint.recordings.table.recording import Recording, as_recordings
from truejoint.recordings.table.stream_file import SUFFIX

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
        without time stamps, ``truth_zero``, for the formats that take them (see `FORMATS`);
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
    recordings = read_recordings(path, format, **context)
    if len(recordings) > 1:
        raise RecordingError(
            f"{path}: its clock restarts, so it holds {len(recordings)} recordings; "
            "read_recordings(path) gives all of them"
        )
    return recordings[0]


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
    if not os.path.exists(source):  # noqa: PTH110  # of any length
        raise RecordingError(f"{source}: there is no such file or folder; check the path")
    head = None if format or is_folder(source) else Head.of(source)
    name = format or _detect(source, head, with_map="column_map" in context)
    entry = get_format(name)
    about: dict[str, Any] = {key: context.pop(key) for key in PROVENANCE_OPTIONS if key in context}
    wrong = [key for key in context if key not in entry.options]
    if wrong:
        allowed = ", ".join((*entry.options, *PROVENANCE_OPTIONS))
        raise RecordingError(f"{source}: format {name!r} takes no {wrong[0]!r}; it takes {allowed}")
    if not entry.folder:
        require_file(source)
    try:
        if entry.reads_head:
            context["head"] = head
        recordings = as_recordings(entry.read(source, **context))
    except RecordingError as error:
        # The rules of a recording name it as its provenance does; a person wants the path.
        text = str(error)
        if text.startswith(f"{source.name}:") and str(source) != source.name:
            raise RecordingError(str(source) + text.removeprefix(source.name)) from None
        raise
    return state(recordings, about)


def state(recordings: Sequence[Recording], about: Mapping[str, Any]) -> list[Recording]:
    """State of recordings what a person says of them, any of `PROVENANCE_OPTIONS`."""
    if not about:  # nor check the tables again
        return list(recordings)
    stated = []
    for recording in recordings:
        origin, facts = recording.provenance, dict(about)
        if "session" in facts and len(recordings) > 1:
            facts["session"] += "".join(origin.session.rpartition("#")[1:])
        stated.append(replace(recording, provenance=replace(origin, **facts)))
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
        head = None if is_folder(path) else Head.of(path)
        name = _detect(path, head, with_map=column_map is not None)
        if name == "csv" and head is not None:
            header = mapped.read_header(head, column_map)
            if not any(column.startswith("measured/") for column in header.columns.columns):
                return "no 'measured/<joint>' column"
    except RecordingError as error:
        return str(error).removeprefix(f"{path}: ")
    is_ours = format in FORMATS and not (format == "csv" and name == "arrays")
    return f"is {name}, not {format}" if is_ours and name != format else ""


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
    return _detect(source, None if is_folder(source) else Head.of(source), with_map=with_map)


def _detect(source: Path, head: Head | None, *, with_map: bool) -> str:
    """Name of the layout of a file that begins with `head`, or of a folder."""
    if is_bag(source, head.data if head else b""):
        return "bag"
    if head is None:
        why = "a folder that is no bag"
    elif head.data.startswith(PARQUET_MAGIC):
        return "parquet"
    elif source.suffix == SUFFIX:
        return "stream"
    elif with_map:
        return "csv" if head.is_text else "arrays"
    elif not head.is_text:
        why = f"not text and of no known binary layout; {mapped.MAP_ADVICE}"
    else:
        layout, fields, named = text_layout(head)
        if named and ("t" in fields or any(field.startswith("measured/") for field in fields)):
            return "csv"
        if not named and layout.columns in raven_csv.COUNTS:
            return "raven_csv"
        expected = ", ".join(map(str, raven_csv.COUNTS))
        bare = f"{layout.columns} columns without a header, expected {expected}"
        why = ("a header without 't'" if named else bare) + f"; {mapped.MAP_ADVICE}"
    raise RecordingError(
        f"{source}: format not recognised ({why}); known: {', '.join(format_names())}"
    )
