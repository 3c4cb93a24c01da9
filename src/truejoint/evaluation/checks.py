"""Data checks: what a recording covers, and what about it would mislead a calibration."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import PurePath
from typing import Any, Final, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from truejoint.errors import RecordingError
from truejoint.evaluation.coverage import JointCoverage, joint_coverage
from truejoint.evaluation.defects import Observation, observe_defects
from truejoint.evaluation.results import json_values
from truejoint.recordings.recording import Recording, as_recordings

Array = NDArray[np.float64]
Level = Literal["fail", "warn", "info"]

_ORDER: Final = {"fail": 0, "warn": 1, "info": 2}


class Features(Protocol):
    """Inputs of a model, as `truejoint.models.FeatureSet` has them."""

    @property
    def names(self) -> tuple[str, ...]:
        """Text of each feature."""
        ...

    @property
    def signals(self) -> tuple[str, ...]:
        """Columns that the features are made of."""
        ...

    def compute(self, recording: Recording, gap_limit: float | None = None) -> Array:
        """Features (n, k) of every row."""
        ...


class TrainedOn(Protocol):
    """What a check needs of a calibration: joints, features, and their range in training."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints that it corrects."""
        ...

    @property
    def feature_set(self) -> Features:
        """Inputs of its model."""
        ...

    @property
    def gap_limit(self) -> float:
        """Time without a sample [s] after which the history starts anew."""
        ...

    @property
    def lower(self) -> Array:
        """Smallest value (k,) of each feature in training."""
        ...

    @property
    def upper(self) -> Array:
        """Largest value (k,) of each feature in training."""
        ...


@dataclass(frozen=True)
class Finding:
    """One thing that a data check found.

    Attributes
    ----------
    level : {"fail", "warn", "info"}
        ``"fail"``: results on these data would mislead; ``"warn"``: look before you trust them.
    what : str
        What was seen, with its number.
    where : str
        Which joint, signal and recordings.
    advice : str
        What to do about it.

    Examples
    --------
    >>> Finding("warn", "1 % of the truth is missing", "jaw", "look at the sensor").level
    'warn'
    """

    level: Level
    what: str
    where: str
    advice: str


@dataclass(frozen=True)
class DataCheck:
    """Findings, worst first, and what each joint covers.

    Examples
    --------
    >>> check = check_data(test, joints=["jaw"])
    >>> check.failed, len(check.findings)
    (False, 1)
    """

    findings: tuple[Finding, ...]
    coverage: tuple[JointCoverage, ...]

    @property
    def failed(self) -> bool:
        """Whether a finding is of level ``"fail"``."""
        return any(finding.level == "fail" for finding in self.findings)

    def to_dict(self) -> dict[str, Any]:
        """Values for JSON; SI units."""
        values: dict[str, Any] = json_values(asdict(self))
        return values


def check_data(
    recordings: Recording | Sequence[Recording],
    *,
    joints: Sequence[str] | None = None,
    calibration: TrainedOn | None = None,
) -> DataCheck:
    """Check recordings before they are used to fit or to judge a calibration.

    Parameters
    ----------
    recordings : Recording or sequence of Recording
        Of one arm.
    joints : sequence of str, optional
        Joints of interest; by default those of `calibration`, or all that have a measured and a
        true position.
    calibration : Calibration, optional
        Signals and ranges of its features; rows outside the ranges seen in training are counted
        as extrapolation. Without one, all measured and effort columns are examined.

    Returns
    -------
    DataCheck

    Raises
    ------
    RecordingError
        If there is no recording, or one lacks a joint or signal asked for.

    Examples
    --------
    >>> check_data(training).failed
    False
    """
    recordings = as_recordings(recordings)
    if not recordings:
        raise RecordingError("there is no recording to check; give at least one")
    if joints is None:
        joints = calibration.joints if calibration else joints_with_truth(recordings[0])
    signals = calibration.feature_set.signals if calibration else default_signals(recordings[0])
    coverage = tuple(joint_coverage(recordings, joint) for joint in joints)
    observations = [o for r in recordings for o in observe_defects(r, joints, signals)]
    findings = [*_merged(observations, len(recordings))]
    findings += [f for row in coverage for f in _judge_coverage(row)]
    findings += _judge_sessions(recordings)
    if calibration is not None:
        findings += _judge_extrapolation(recordings, calibration)
    findings.sort(key=lambda finding: _ORDER[finding.level])
    return DataCheck(tuple(findings), coverage)


def joints_with_truth(recording: Recording) -> tuple[str, ...]:
    """Joints that have a measured and a true position, in the recording's order."""
    return tuple(j for j in recording.joints_of("measured") if j in recording.joints_of("truth"))


def default_signals(recording: Recording) -> tuple[str, ...]:
    """Measured positions and efforts: what a calibration reads unless told otherwise."""
    return tuple(
        f"{quantity}/{name}"
        for quantity in ("measured", "effort")
        for name in recording.joints_of(quantity)
    )


def outside_share(values: Array, low: float, high: float, margin: float = 0.01) -> float:
    """Share of `values` (n,) outside ``[low, high]`` by more than `margin` of its width."""
    slack = margin * (high - low)
    return float(np.mean((values < low - slack) | (values > high + slack)))


def _merged(observations: Iterable[Observation], total: int) -> Iterable[Finding]:
    """One finding for each kind of defect and signal; the worst recording speaks for all."""
    groups: dict[tuple[str, str], list[Observation]] = {}
    for observation in observations:
        groups.setdefault((observation.kind, observation.subject), []).append(observation)
    for group in groups.values():
        worst = max(group, key=lambda o: (-_ORDER[o.level], o.size))
        name = PurePath(worst.recording).name or "recording"
        where = f"{worst.subject} in {name}" if worst.subject else name
        if len(group) > 1:
            where += f" and {len(group) - 1} more of {total} recordings"
        yield Finding(worst.level, worst.what, where, worst.advice)


def _judge_coverage(row: JointCoverage) -> Iterable[Finding]:
    if row.up + row.down > 0 and min(row.up, row.down) < 0.3 * (row.up + row.down):
        share = 100 * min(row.up, row.down) / (row.up + row.down)
        yield Finding(
            "warn",
            f"one direction of motion holds only {share:.0f} % of the moving rows",
            row.joint,
            "friction and hysteresis differ by direction; record both about equally",
        )
    if row.standing > 0.5:
        yield Finding(
            "warn",
            f"the joint stands still in {100 * row.standing:.0f} % of the rows",
            row.joint,
            "many equal rows outweigh the moving ones; cut long rests or record more motion",
        )
    if row.filled < 0.9:
        yield Finding(
            "warn",
            f"{100 * (1 - row.filled):.0f} % of the range between its ends was hardly visited",
            row.joint,
            "move through the whole range, so that the model need not guess between",
        )
    if row.share_of_limits < 0.2:
        yield Finding(
            "info",
            f"{100 * row.share_of_limits:.0f} % of the joint's travel is covered",
            row.joint,
            "trust the calibration inside the covered range only",
        )


def _judge_sessions(recordings: Sequence[Recording]) -> Iterable[Finding]:
    homings = sorted({r.provenance.homing_id for r in recordings} - {""})
    if len(homings) > 1:
        yield Finding(
            "warn",
            f"{len(homings)} homings ({', '.join(homings[:4])})",
            "all recordings",
            "positions of two homings differ by an offset; re-zero or calibrate each on its own",
        )
    loads = {r.provenance.load for r in recordings if np.isfinite(r.provenance.load)}
    unknown = sum(not np.isfinite(r.provenance.load) for r in recordings)
    known = ", ".join(f"{1e3 * load:.0f} g" for load in sorted(loads))
    if unknown:
        yield Finding(
            "info",
            f"the load at the tool is not stated in {unknown} of {len(recordings)} recordings"
            + (f"; elsewhere {known}" if known else ""),
            "all recordings",
            "state it when recording: cables stretch with load",
        )
    elif len(loads) == 1:
        yield Finding(
            "info",
            f"one load only: {known}",
            "all recordings",
            "accuracy under another load is not shown by these data",
        )


def _judge_extrapolation(
    recordings: Sequence[Recording], calibration: TrainedOn
) -> Iterable[Finding]:
    rows = np.concatenate(
        [calibration.feature_set.compute(r, calibration.gap_limit) for r in recordings]
    )
    worst: dict[str, tuple[float, str]] = {}
    ranges = zip(calibration.feature_set.names, calibration.lower, calibration.upper, strict=True)
    for column, (name, low, high) in enumerate(ranges):
        share = outside_share(rows[:, column], float(low), float(high))
        # Features of one signal leave their ranges together; the worst speaks for all.
        signal = next(s for s in calibration.feature_set.signals if s in name)
        worst[signal] = max(worst.get(signal, (0.0, "")), (share, name))
    for share, name in worst.values():
        if share > 0.02:
            yield Finding(
                "fail" if share > 0.5 else "warn",
                f"{100 * share:.0f} % of the rows lie outside the range seen in training",
                name,
                "the model extrapolates there; train on a wider range or expect less",
            )
