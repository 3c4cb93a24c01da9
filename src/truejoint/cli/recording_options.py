"""From what a person names on the command line to recordings, checked."""

from __future__ import annotations

import glob
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final, TypeAlias

import truejoint
from truejoint.cli import options
from truejoint.cli.console import err, progress, say
from truejoint.errors import RecordingError, unknown
from truejoint.files import check_target
from truejoint.recordings.judge.finding import FINDINGS
from truejoint.units import display_unit, plural

Read: TypeAlias = "Callable[[], list[truejoint.Recording]]"

_NUMBERS: Final = ("load_grams", "rate_hz")
_OF_RECORDING: Final = ("homing_id", "load_grams", "session")
METADATA: Final = (*_OF_RECORDING, "format", "rate_hz", "truth_zero")


def parse_metadata(
    texts: Sequence[str] | None, keys: Sequence[str] = _OF_RECORDING
) -> dict[str, Any]:
    """Read ``KEY=VALUE`` texts; raises CommandRefused for an unknown key or a value of no kind."""
    values: dict[str, Any] = {**options.split_pairs("--metadata", texts, "KEY=VALUE")}
    for key, value in values.items():
        if key not in keys:
            raise RecordingError(f"--metadata {key}: {unknown('key', key, keys)}")
        if key in _NUMBERS:
            values[key] = options.number("--metadata", f"{key}={value}", value)
    return values


def as_provenance(metadata: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of a `Provenance` that metadata state."""
    fields = {key: value for key, value in metadata.items() if key in _OF_RECORDING}
    if "load_grams" in fields:
        fields["load"] = fields.pop("load_grams") / 1000.0
    return fields


@dataclass(frozen=True)
class Files:
    """How recordings are read whose files do not say it themselves, an option each."""

    robot: str | None = None
    metadata: list[str] | None = None
    columns: Path | None = None

    @cached_property
    def overrides(self) -> dict[str, Any]:
        """Values of ``--metadata`` by key; raises RecordingError as `parse_metadata`."""
        return parse_metadata(self.metadata, METADATA)

    @cached_property
    def column_map(self) -> Any:
        """What ``--columns`` says, read; None without it."""
        return self.columns and truejoint.recordings.read_column_map(self.columns)

    @property
    def arm(self) -> tuple[str, str]:
        """Name or file of the robot, and its arm; empty where the files say it, or by default."""
        return options.robot_and_arm(self.robot or "")

    def stated(self) -> dict[str, Any]:
        """Fields of a `Provenance` that the options state, but for the arm."""
        return as_provenance(self.overrides)

    def find(
        self,
        names: Sequence[str],
        *,
        part: str | None = None,
        split: str | None = None,
        held_out: bool = True,
        joints: Sequence[str] = (),
        inputs: truejoint.features.FeatureSet | None = None,
        model: truejoint.Calibration | None = None,
    ) -> Read:
        """Find recordings of files, folders, shell patterns and ``NAME:PATTERN`` of data sets.

        What is given back reads them: `part` of each by time, ``FROM:TO``, or one side of the data
        set's recommended `split`, that to judge on if `held_out`. What is wrong with names, part or
        `joints` is raised here, before anything is read; reading ends at the first recording that
        lacks one of these, or a signal of the `inputs`. Robot and arm are those of the `model`
        where neither a person nor a file says them.
        """
        from truejoint.calibration.compatibility import check_columns

        files = self._checked(joints, model)
        span = None if part is None else parse_part(part)
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise RecordingError(f"{', '.join(twice)}: named twice; give each recording once")
        readers = [files._reader(name, joints, model) for name in names]
        if split is not None:
            return files._split_side(only_dataset(names), split, held_out)
        what = names[0] if len(names) == 1 else f"{len(names)} recordings"

        def read() -> list[truejoint.Recording]:
            recordings: list[truejoint.Recording] = []
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

    def one(self, name: str, *, model: truejoint.Calibration | None = None) -> truejoint.Recording:
        """Read the one recording that `name` means; `model` as of `find`."""
        recordings = self.find([name], model=model)()
        if len(recordings) != 1:
            raise RecordingError(f"{name}: {len(recordings)} recordings; this takes one at a time")
        return recordings[0]

    def _checked(self, joints: Sequence[str], model: truejoint.Calibration | None) -> Files:
        """Check format, robot and joints; a `model` that carries this robot stands for its name."""
        formats, kind = truejoint.recordings.format_names(), self.overrides.get("format")
        if kind is not None and kind not in formats:
            raise RecordingError(unknown("format", kind, formats))
        if model is not None and self.robot in (model.robot, f"{model.robot}:{model.arm}"):
            is_carried = model.robot not in truejoint.robots.robot_names()
            return replace(self, robot=None) if is_carried else self
        if self.robot is not None:
            options.get_robot(self.robot).index(list(joints))
        return self

    def _reader(
        self, name: str, joints: Sequence[str], model: truejoint.Calibration | None
    ) -> Read:
        from truejoint.recordings.read import reading

        sets = truejoint.recordings.datasets
        wanted, _, pattern = name.partition(":")
        path = Path(name)
        if path.exists():
            is_whole = not path.is_dir() or not reading.why_no_recording(path)
            paths = [path] if is_whole else self._without_strangers(name, sorted(path.iterdir()))
        elif wanted in sets.DATASETS:
            dataset = sets.get_dataset(wanted)
            dataset.match(pattern or "*")
            truejoint.get_robot(dataset.robot).index(list(joints))
            return lambda: reading.state(sets.read_dataset(wanted, pattern or "*"), self.stated())
        else:
            paths = [Path(match) for match in sorted(glob.glob(name))]  # noqa: PTH207  # absolute too
            if not paths:
                nearest = unknown("data set", wanted, sets.DATASETS)
                raise RecordingError(f"{name}: no such file or folder, and {nearest}")
            paths = self._without_strangers(name, paths)
        return lambda: [recording for path in paths for recording in self._read(path, model)]

    def _without_strangers(self, name: str, paths: Sequence[Path]) -> list[Path]:
        """Those of the paths that nobody named one by one which are recordings; tell the others."""
        from truejoint.recordings.read import reading

        kind = self.overrides.get("format")
        reasons = {path: reading.why_no_recording(path, kind, self.columns) for path in paths}
        for path, reason in reasons.items():
            if reason:
                say(f"  {path}: left out: {reason}")
        if all(reasons.values()):
            raise RecordingError(f"{name}: none of {len(paths)} files there is a recording")
        return [path for path, reason in reasons.items() if not reason]

    def _read(self, path: Path, model: truejoint.Calibration | None) -> list[truejoint.Recording]:
        sets, overrides, (robot, arm) = truejoint.recordings, self.overrides, self.arm
        has_map = self.columns is not None
        kind = overrides.get("format") or sets.detect_format(path, with_map=has_map)
        stated: dict[str, Any] = {"robot": robot, "arm": arm, "column_map": self.columns}
        stated |= {"truth_zero": overrides.get("truth_zero"), "rate": overrides.get("rate_hz")}
        is_named = self.robot or (has_map and self.column_map.robot)
        if model is not None and not is_named and kind in sets.FORMATS:
            of_model = {"robot": model.machine, "arm": model.arm}
            takes = sets.FORMATS[kind].options
            stated |= {key: name for key, name in of_model.items() if key in takes}
        how = {key: value for key, value in stated.items() if value not in (None, "")}
        recordings = sets.read_recordings(path, kind, **how, **self.stated())
        if len(recordings) > 1:
            say(f"  {path}: its clock restarts: read as {len(recordings)} recordings")
        return recordings

    def _split_side(self, dataset: str | None, name: str, held_out: bool) -> Read:
        from truejoint.evaluation.evaluate import split_sides
        from truejoint.recordings.read import reading

        if dataset is None:
            raise RecordingError(
                f"--split {name!r} is for one public data set by name; use --part for files"
            )
        sets = truejoint.recordings.datasets
        about = sets.get_dataset(dataset)
        sides = about.split(name)
        which = "the held-out" if held_out else "the training"

        def read() -> list[truejoint.Recording]:
            with progress(f"Reading {which} recordings of {dataset}, split {name}") as done:
                whole = sets.read_dataset(dataset, sides.files, progress=done)
            return reading.state(split_sides(whole, about, sides)[held_out], self.stated())

        return read


def say_dropped(recording: truejoint.Recording) -> None:
    """Tell how many rows were dropped when a recording was made or read, and its notes."""
    provenance = recording.provenance
    dropped, name = provenance.dropped, Path(provenance.source).name or provenance.session
    if dropped:
        reasons = ", ".join(f"{count} {reason}" for reason, count in dropped.items())
        say(f"  {name}: rows dropped or without truth: {reasons}")
    if provenance.notes:
        say(f"  {name}: {provenance.notes}")


def only_dataset(names: Sequence[str]) -> str | None:
    """Name the public data set that all of `names` are of; None when they are not."""
    first, *others = {name.partition(":")[0] for name in names}
    if others or any(Path(name).exists() for name in names):
        return None
    return first if first in truejoint.recordings.datasets.DATASETS else None


def read_trajectory(path: Path) -> truejoint.motion.Trajectory:
    """Read a trajectory file and say what its notes do."""
    trajectory = truejoint.motion.read_trajectory(path)
    if "notes" in trajectory.meta:
        say(f"  {path}: {trajectory.meta['notes']}")
    return trajectory


@dataclass(frozen=True)
class DataCheck:
    """Findings of the data check that are accepted, an option for each."""

    accept: list[str] | None = None

    def __post_init__(self) -> None:
        for name in self.accept or ():
            if name not in FINDINGS:
                raise RecordingError(f"--accept {unknown('finding', name, FINDINGS)}")

    def run(
        self, recordings: Sequence[truejoint.Recording], **how: Any
    ) -> truejoint.recordings.DataCheck:
        """Check recordings as `check_data` does and say what was found, but for information."""
        with progress(f"Checking {plural(len(recordings), 'recording')}"):
            check = truejoint.recordings.check_data(recordings, **how).accept(self.accept or ())
        for finding in check.findings:
            if finding.level != "info":
                evidence = f"{finding.where}: {finding.what}; {finding.advice}"
                went_on = finding.level == "fail" and finding.name in check.accepted
                level = "accepted" if went_on else finding.level
                err.print(f"{level}: {finding.name}: {evidence}", soft_wrap=True)
        return check


def say_failed(check: truejoint.recordings.DataCheck) -> None:
    """Name in one line what failed, if anything did, and how to go on all the same."""
    if check.failed:
        names = check.failures
        accept = " ".join(f"--accept {name}" for name in names)
        failed = f"the data check failed ({', '.join(names)}): mend the data, or go on with"
        err.print(f"truejoint: {failed} {accept}", style="red", soft_wrap=True)


@dataclass(frozen=True)
class NewModel:
    """Model file to write, an option each; refused before anything long is done."""

    output: Path
    force: bool = False

    def __post_init__(self) -> None:
        from truejoint.calibration.model_file import check_name

        check_target(check_name(self.output), overwrite=self.force)

    def write(self, model: truejoint.Calibration) -> None:
        """Write the model."""
        truejoint.write_calibration(model, self.output, overwrite=self.force)


def check_page_target(path: Path | None, force: bool) -> None:
    """Refuse, before anything long is done, a path at which no page can be written, if any."""
    from truejoint.evaluation.report import page

    if path is not None:
        check_target(page.check_name(path), overwrite=force)


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


def parse_tolerances(texts: Sequence[str] | None, model: truejoint.Calibration) -> dict[str, float]:
    """Largest accepted RMSE [rad or m] by joint of a model, of texts like ``shoulder=0.2``."""
    units = {joint: model.units[f"measured/{joint}"] for joint in model.joints}
    tolerances = options.joint_values("--tolerance", texts, units)
    for joint, value in tolerances.items():
        if not value > 0:
            unit = display_unit(units[joint]).name
            raise RecordingError(f"--tolerance {joint}: give {unit} above 0")
    return tolerances
