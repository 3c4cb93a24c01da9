"""Data checks: what a recording covers, and what about it would mislead a calibration."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from truejoint.array_types import Array
from truejoint.errors import RecordingError
from truejoint.evaluation.defects import Defect, Finding, find_defects
from truejoint.evaluation.results import json_values
from truejoint.evaluation.signals import direction, velocity
from truejoint.recordings.recording import Recording, as_recordings

if TYPE_CHECKING:
    from truejoint.calibration import Calibration


_ORDER: Final = {"fail": 0, "warn": 1, "info": 2}
_BINS: Final = 20
_EVERYWHERE: Final = "all recordings"


@dataclass(frozen=True)
class JointCoverage:
    """What a set of recordings covers of one joint.

    Attributes
    ----------
    joint, unit : str
    lowest, highest : float
        Measured position [rad or m].
    share_of_limits : float
        Covered range as a share of the travel between the joint's limits; NaN without limits.
    filled : float
        Share of 20 equal parts of the covered range that hold at least a twentieth of the rows
        that an even coverage would put there.
    up, down, standing : float
        Shares of the rows by direction of motion.
    speed_median, speed_high : float
        Median and 95th percentile of the speed while moving [rad/s or m/s].
    effort_low, effort_high, effort_unit : float, float, str
        1st and 99th percentile of the effort; NaN where none was recorded.
    truth_missing : float
        Share of rows without truth; NaN where no truth was recorded.
    rows, duration : int, float
        Sums over recordings [1, s].

    Examples
    --------
    >>> check_data(training).coverage[0].rows
    800
    """

    joint: str
    unit: str
    lowest: float
    highest: float
    share_of_limits: float
    filled: float
    up: float
    down: float
    standing: float
    speed_median: float
    speed_high: float
    effort_low: float
    effort_high: float
    effort_unit: str
    truth_missing: float
    rows: int
    duration: float


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
        values: dict[str, Any] = json_values(self)
        return values


def check_data(
    recordings: Recording | Sequence[Recording],
    *,
    joints: Sequence[str] | None = None,
    calibration: Calibration | None = None,
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
    first = recordings[0]
    measured, with_truth = first.joints_of("measured"), first.joints_of("truth")
    if joints is None:
        joints = calibration.joints if calibration else [j for j in measured if j in with_truth]
    # What a calibration reads unless told otherwise.
    read = [f"{what}/{j}" for what in ("measured", "effort") for j in first.joints_of(what)]
    signals = calibration.feature_set.signals if calibration else read
    coverage = tuple(joint_coverage(recordings, joint) for joint in joints)
    findings = [
        *_defects(recordings, joints, signals),
        *(finding for row in coverage for finding in _judge_coverage(row)),
        *_judge_sessions(recordings),
        *(_judge_extrapolation(recordings, calibration) if calibration else ()),
    ]
    findings.sort(key=lambda finding: _ORDER[finding.level])
    return DataCheck(tuple(findings), coverage)


def outside_share(values: Array, low: float, high: float, margin: float = 0.01) -> float:
    """Share of `values` (n,) outside ``[low, high]`` by more than `margin` of its width."""
    slack = margin * (high - low)
    return float(np.mean((values < low - slack) | (values > high + slack)))


def _defects(
    recordings: Sequence[Recording], joints: Sequence[str], signals: Sequence[str]
) -> Iterable[Finding]:
    """One finding for each kind of defect and signal; the worst recording speaks for all."""
    groups: dict[tuple[str, str], list[tuple[Defect, str]]] = {}
    for recording in recordings:
        name = PurePath(recording.provenance.source).name or "recording"
        for defect in find_defects(recording, joints, signals):
            groups.setdefault((defect.advice, defect.where), []).append((defect, name))
    for group in groups.values():
        worst, name = max(group, key=lambda pair: (-_ORDER[pair[0].level], pair[0].size))
        others = len(group) - 1
        more = f" and {others} more of {len(recordings)} recordings" if others else ""
        yield Finding(worst.level, worst.what, f"{worst.where} in {name}{more}", worst.advice)


def joint_coverage(recordings: Sequence[Recording], joint: str) -> JointCoverage:
    """Coverage of `joint` over all recordings; raises RecordingError if one lacks it."""
    paths = [(r.t, r.column(f"measured/{joint}")) for r in recordings]
    position = np.concatenate([x for _, x in paths])
    moves = np.concatenate([direction(t, x) for t, x in paths])
    speed = np.concatenate([np.abs(velocity(t, x)) for t, x in paths])
    moving = speed[moves != 0]
    lowest, highest = float(position.min()), float(position.max())
    limits = recordings[0].robot.joint(joint)
    travel = limits.upper - limits.lower
    filled = np.histogram(position, bins=_BINS)[0] >= 0.05 * len(position) / _BINS
    effort, truth = (_pooled(recordings, f"{name}/{joint}") for name in ("effort", "truth"))
    low, high = (math.nan, math.nan) if effort is None else np.quantile(effort, [0.01, 0.99])
    return JointCoverage(
        joint=joint,
        unit=limits.unit,
        lowest=lowest,
        highest=highest,
        share_of_limits=(highest - lowest) / travel if math.isfinite(travel) else math.nan,
        filled=float(np.mean(filled)) if lowest < highest else 0.0,
        up=float(np.mean(moves > 0)),
        down=float(np.mean(moves < 0)),
        standing=float(np.mean(moves == 0)),
        speed_median=float(np.median(moving)) if len(moving) else 0.0,
        speed_high=float(np.quantile(moving, 0.95)) if len(moving) else 0.0,
        effort_low=float(low),
        effort_high=float(high),
        effort_unit="1" if effort is None else recordings[0].units[f"effort/{joint}"],
        truth_missing=math.nan if truth is None else float(np.mean(np.isnan(truth))),
        rows=len(position),
        duration=sum(r.duration for r in recordings),
    )


def _pooled(recordings: Sequence[Recording], column: str) -> Array | None:
    """Values (n,) over all recordings; None where one has no such column."""
    if any(column not in r.units for r in recordings):
        return None
    return np.concatenate([r.column(column) for r in recordings])


def _judge_coverage(row: JointCoverage) -> Iterable[Finding]:
    moving, rarer = row.up + row.down, min(row.up, row.down)
    if moving > 0 and rarer < 0.3 * moving:
        what = f"one direction of motion holds only {100 * rarer / moving:.0f} % of the moving rows"
        advice = "friction and hysteresis differ by direction; record both about equally"
        yield Finding("warn", what, row.joint, advice)
    if row.standing > 0.5:
        what = f"the joint stands still in {100 * row.standing:.0f} % of the rows"
        advice = "many equal rows outweigh the moving ones; cut long rests or record more motion"
        yield Finding("warn", what, row.joint, advice)
    if row.filled < 0.9:
        what = f"{100 * (1 - row.filled):.0f} % of the range between its ends was hardly visited"
        advice = "move through the whole range, so that the model need not guess between"
        yield Finding("warn", what, row.joint, advice)
    if row.share_of_limits < 0.2:
        what = f"{100 * row.share_of_limits:.0f} % of the joint's travel is covered"
        advice = "trust the calibration inside the covered range only"
        yield Finding("info", what, row.joint, advice)


def _judge_sessions(recordings: Sequence[Recording]) -> Iterable[Finding]:
    homings = sorted({r.provenance.homing_id for r in recordings} - {""})
    if len(homings) > 1:
        what = f"{len(homings)} homings ({', '.join(homings[:4])})"
        advice = (
            "positions of two homings differ by an offset; re-zero or calibrate each on its own"
        )
        yield Finding("warn", what, _EVERYWHERE, advice)
    loads = [r.provenance.load for r in recordings if np.isfinite(r.provenance.load)]
    unknown = len(recordings) - len(loads)
    known = ", ".join(f"{1e3 * load:.0f} g" for load in sorted(set(loads)))
    if unknown:
        what = (
            f"the load at the tool is not stated in {unknown} of {len(recordings)} recordings"
            + (f"; elsewhere {known}" if known else "")
        )
        advice = "state it when recording: cables stretch with load"
        yield Finding("info", what, _EVERYWHERE, advice)
    elif len(set(loads)) == 1:
        what = f"one load only: {known}"
        advice = "accuracy under another load is not shown by these data"
        yield Finding("info", what, _EVERYWHERE, advice)


def _judge_extrapolation(
    recordings: Sequence[Recording], calibration: Calibration
) -> Iterable[Finding]:
    features = calibration.feature_set
    rows = np.concatenate([features.compute(r, calibration.gap_limit) for r in recordings])
    worst: dict[str, tuple[float, str]] = {}
    ranges = zip(features.names, calibration.lower, calibration.upper, strict=True)
    for column, (name, low, high) in enumerate(ranges):
        share = outside_share(rows[:, column], float(low), float(high))
        # Features of one signal leave their ranges together; the worst speaks for all.
        signal = next(s for s in features.signals if s in name)
        worst[signal] = max(worst.get(signal, (0.0, "")), (share, name))
    for share, name in worst.values():
        if share > 0.02:
            what = f"{100 * share:.0f} % of the rows lie outside the range seen in training"
            advice = "the model extrapolates there; train on a wider range or expect less"
            yield Finding("fail" if share > 0.5 else "warn", what, name, advice)
