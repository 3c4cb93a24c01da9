"""From what a person names on the command line to recordings."""

from __future__ import annotations

import glob
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from truejoint.cli.console import progress, say
from truejoint.errors import RecordingError
from truejoint.evaluation import part_by_time, split_by_time
from truejoint.recordings import Recording, read_recording
from truejoint.recordings.datasets import DATASETS, get_dataset, open_dataset
from truejoint.units import display_unit


def load_recordings(
    names: list[str],
    *,
    reader: str | None = None,
    columns: Path | None = None,
    robot: str | None = None,
    arm: str = "",
    part: str | None = None,
    split: str | None = None,
    held_out: bool = True,
) -> list[Recording]:
    """Load recordings of files, folders, shell patterns and ``NAME:PATTERN`` of public data sets.

    Parameters
    ----------
    names : list of str
    reader, columns, robot, arm
        As `truejoint.recordings.read_recording` takes them.
    part : str, optional
        Part of each recording by time, ``FROM:TO``.
    split : str, optional
        Recommended split of the data set that `names` is.
    held_out : bool
        Which side of the split: the recordings to judge on, or those to train on.

    Raises
    ------
    RecordingError
        If one cannot be read, is named twice, or the part is not ``FROM:TO``.
    """
    span = None if part is None else parse_part(part)
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise RecordingError(f"{', '.join(twice)}: named twice; give each recording once")
    if split is not None:
        dataset = only_dataset(names)
        if dataset is None:
            raise RecordingError(
                f"--split {split!r} is for one public data set by name; use --part for files"
            )
        return _split_side(dataset, split, held_out)
    context = {"robot": robot, "arm": arm or None, "column_map": columns}
    given = {key: value for key, value in context.items() if value is not None}
    recordings: list[Recording] = []
    with progress(f"Reading {names[0] if len(names) == 1 else f'{len(names)} recordings'}") as done:
        for count, name in enumerate(names, 1):
            recordings += _load(name, reader, given)
            done(count / len(names))
    for recording in recordings:
        say_dropped(recording)
    if span is None:
        return recordings
    return [part_by_time(recording, *span) for recording in recordings]


def say_dropped(recording: Recording) -> None:
    """Tell how many rows were dropped when a recording was made or read, and why."""
    dropped = recording.provenance.dropped
    if dropped:
        reasons = ", ".join(f"{count} {reason}" for reason, count in dropped.items())
        name = Path(recording.provenance.source).name or recording.provenance.session
        say(f"  {name}: rows dropped or without truth: {reasons}")


def only_dataset(names: list[str]) -> str | None:
    """Name the public data set that all of `names` are of; None when they are not."""
    sets = {name.partition(":")[0] for name in names}
    if len(sets) == 1 and not any(Path(name).exists() for name in names):
        name = sets.pop()
        return name if name in DATASETS else None
    return None


def _split_side(dataset: str, name: str, held_out: bool) -> list[Recording]:
    split = get_dataset(dataset).split(name)
    side = "the held-out" if held_out else "the training"
    with progress(f"Reading {side} recordings of {dataset}, split {name}") as done:
        recordings = open_dataset(dataset, split.files, progress=done)
    if split.test:
        return [r for r in recordings if split.holds_out(r.provenance.session) == held_out]
    pairs = [split_by_time(recording, 1 - split.test_fraction) for recording in recordings]
    return [test if held_out else train for train, test in pairs]


def _load(name: str, reader: str | None, context: Mapping[str, Any]) -> list[Recording]:
    data_set, separator, pattern = name.partition(":")
    if data_set in DATASETS and not Path(name).exists():
        return open_dataset(data_set, pattern if separator else "*")
    paths = [name] if Path(name).exists() else sorted(glob.glob(name))  # noqa: PTH207  # absolute too
    if not paths:
        raise RecordingError(
            f"{name}: no such file, folder or public data set; check the path, or see "
            "`truejoint datasets`"
        )
    return [read_recording(path, reader, **context) for path in paths]


def parse_part(text: str) -> tuple[float, float]:
    """Read ``"0.7:1"``; raises RecordingError when they are not 0 <= from < to <= 1."""
    first, separator, last = text.partition(":")
    try:
        begin, end = float(first or 0), float(last or 1)
    except ValueError:
        separator = ""
    if not separator or not 0 <= begin < end <= 1:
        raise RecordingError(
            f"--part {text!r}: write FROM:TO with 0 <= FROM < TO <= 1, for instance 0.7:1"
        )
    return begin, end


def parse_tolerances(texts: list[str], units: Mapping[str, str]) -> dict[str, float]:
    """Read the largest accepted RMSE [rad or m] by joint, of texts like ``shoulder=0.2``.

    Parameters
    ----------
    texts : list of str
    units : mapping
        SI unit by joint.

    Raises
    ------
    RecordingError
        If a joint is unknown or a number is not positive.
    """
    tolerances = {}
    for text in texts:
        joint, _, number = text.partition("=")
        if joint not in units:
            raise RecordingError(f"--tolerance {text!r}: no joint {joint!r}; {', '.join(units)}")
        shown = display_unit(units[joint])
        try:
            value = float(number.removesuffix(shown.name))
        except ValueError:
            value = 0.0
        if not value > 0:
            raise RecordingError(
                f"--tolerance {text!r}: write {joint}=VALUE in {shown.name}, above 0"
            )
        tolerances[joint] = value / shown.scale
    return tolerances
