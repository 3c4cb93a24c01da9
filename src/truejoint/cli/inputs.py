"""From what a person names on the command line to recordings."""

from __future__ import annotations

import glob
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeAlias

import truejoint
from truejoint.cli.console import progress, say
from truejoint.errors import RecordingError, TruejointError, unknown
from truejoint.files import check_target
from truejoint.units import display_unit

Read: TypeAlias = "Callable[[], list[truejoint.Recording]]"


@dataclass(frozen=True)
class Files:
    """What a person says of recordings whose files do not say it themselves.

    What neither says of robot and arm is that of the `model` which is to correct them.
    """

    format: str | None = None
    columns: Path | None = None
    robot: str | None = None
    arm: str = ""
    model: truejoint.Calibration | None = None

    def __post_init__(self) -> None:
        if self.robot is not None:
            truejoint.get_robot(self.robot, self.arm)
        known = truejoint.recordings.format_names()
        if self.format is not None and self.format not in known:
            raise RecordingError(unknown("format", self.format, known))

    def find(
        self,
        names: Sequence[str],
        *,
        part: str | None = None,
        split: str | None = None,
        held_out: bool = True,
        joints: Sequence[str] = (),
        inputs: truejoint.models.FeatureSet | None = None,
    ) -> Read:
        """Find recordings of files, shell patterns and ``NAME:PATTERN`` of public data sets.

        What is given back reads them: `part` of each by time, ``FROM:TO``, or one side of the data
        set's recommended `split`, that to judge on if `held_out`. What is wrong with names, part or
        `joints` is raised here, before anything is read; reading ends at the first recording that
        lacks one of these, or a signal of the `inputs`.
        """
        span = None if part is None else parse_part(part)
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise RecordingError(f"{', '.join(twice)}: named twice; give each recording once")
        readers = [self._reader(name, joints) for name in names]
        if self.robot is not None:
            truejoint.get_robot(self.robot, self.arm).index(list(joints))
        if split is not None:
            return _split_side(only_dataset(names), split, held_out)

        def read() -> list[truejoint.Recording]:
            from truejoint.calibration.conformal import check_columns  # noqa: PLC0415  # imports much

            recordings: list[truejoint.Recording] = []
            what = names[0] if len(names) == 1 else f"{len(names)} recordings"
            with progress(f"Reading {what}") as done:
                for count, reader in enumerate(readers, 1):
                    recordings += reader()
                    for recording in recordings:
                        recording.robot.index(list(joints))
                        if inputs is not None:
                            check_columns(recording, inputs.signals, "features need")
                    done(count / len(names))
            for recording in recordings:
                say_dropped(recording)
            if span is None:
                return recordings
            return [truejoint.evaluation.part_by_time(whole, *span) for whole in recordings]

        return read if names else list

    def _reader(self, name: str, joints: Sequence[str]) -> Read:
        sets = truejoint.recordings.datasets
        wanted, _, pattern = name.partition(":")
        if Path(name).exists():
            paths = [name]
        elif wanted in sets.DATASETS:
            found = sets.get_dataset(wanted)
            found.match(pattern or "*")
            truejoint.get_robot(found.robot).index(list(joints))
            return partial(sets.read_dataset, wanted, pattern or "*")
        else:
            paths = sorted(glob.glob(name))  # noqa: PTH207  # absolute too
        if not paths:
            raise RecordingError(
                f"{name}: no such file or folder, and {unknown('data set', wanted, sets.DATASETS)}"
            )
        return lambda: [self._read(Path(path)) for path in paths]

    def _read(self, path: Path) -> truejoint.Recording:
        sets = truejoint.recordings
        kind = self.format or sets.detect_format(path, with_map=self.columns is not None)
        context = {"robot": self.robot, "arm": self.arm or None, "column_map": self.columns}
        given = {key: value for key, value in context.items() if value is not None}
        said = self.robot or (self.columns and sets.read_column_map(self.columns).robot)
        if self.model is not None and not said and kind in sets.FORMATS:
            for key, name in (("robot", self.model.robot), ("arm", self.model.arm)):
                if name and key in sets.FORMATS[kind].options:
                    given.setdefault(key, name)
        return sets.read_recording(path, kind, **given)


def say_dropped(recording: truejoint.Recording) -> None:
    """Tell how many rows were dropped when a recording was made or read, and why."""
    dropped = recording.provenance.dropped
    if dropped:
        reasons = ", ".join(f"{count} {reason}" for reason, count in dropped.items())
        name = Path(recording.provenance.source).name or recording.provenance.session
        say(f"  {name}: rows dropped or without truth: {reasons}")


def only_dataset(names: Sequence[str]) -> str | None:
    """Name the public data set that all of `names` are of; None when they are not."""
    first, *others = {name.partition(":")[0] for name in names}
    if others or any(Path(name).exists() for name in names):
        return None
    return first if first in truejoint.recordings.datasets.DATASETS else None


def check_free(path: Path, force: bool, option: str = "--out") -> None:
    """Refuse to overwrite unasked, before anything long is done; raises TruejointError."""
    if path.exists() and not force:
        raise TruejointError(f"{path}: is there already; choose another {option}, or --force")


def check_writable(path: Path, force: bool, option: str = "--out") -> None:
    """Refuse as `check_free` does, and a path that cannot become a file."""
    check_free(path, force, option)
    check_target(path, overwrite=True)


def check_model_free(path: Path, force: bool, option: str = "--out") -> None:
    """Refuse as `check_writable` does, and a name that is not for a model file."""
    from truejoint.calibration.model_file import check_name  # noqa: PLC0415  # needs NumPy

    check_writable(check_name(path), force, option)


def _split_side(dataset: str | None, name: str, held_out: bool) -> Read:
    if dataset is None:
        raise RecordingError(
            f"--split {name!r} is for one public data set by name; use --part for files"
        )
    sets, evaluation = truejoint.recordings.datasets, truejoint.evaluation
    split = sets.get_dataset(dataset).split(name)
    side = "the held-out" if held_out else "the training"

    def read() -> list[truejoint.Recording]:
        with progress(f"Reading {side} recordings of {dataset}, split {name}") as done:
            recordings = sets.read_dataset(dataset, split.files, progress=done)
        if split.test:
            return [r for r in recordings if split.holds_out(r.provenance.session) == held_out]
        pairs = [evaluation.split_by_time(whole, 1 - split.test_fraction) for whole in recordings]
        return [test if held_out else train for train, test in pairs]

    return read


def parse_part(text: str) -> tuple[float, float]:
    """Read ``"0.7:1"``; raises RecordingError when they are not 0 <= from < to <= 1."""
    first, separator, last = text.partition(":")
    with suppress(ValueError):
        begin, end = float(first or 0), float(last or 1)
        if separator and 0 <= begin < end <= 1:
            return begin, end
    raise RecordingError(
        f"--part {text!r}: write FROM:TO with 0 <= FROM < TO <= 1, for instance 0.7:1"
    )


def parse_tolerances(texts: Sequence[str], units: Mapping[str, str]) -> dict[str, float]:
    """Largest accepted RMSE [rad or m] by joint, of texts like ``shoulder=0.2``; `units` are SI."""
    tolerances = {}
    for text in texts:
        joint, _, number = text.partition("=")
        if joint not in units:
            raise RecordingError(f"--tolerance {text!r}: {unknown('joint', joint, units)}")
        shown = display_unit(units[joint])
        value = 0.0
        with suppress(ValueError):
            value = float(number.removesuffix(shown.name))
        if not value > 0:
            message = f"--tolerance {text!r}: write {joint}=VALUE in {shown.name}, above 0"
            raise RecordingError(message)
        tolerances[joint] = value / shown.scale
    return tolerances
