"""Data checks: what a recording covers, and what about it would mislead a calibration."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from truejoint.errors import RecordingError
from truejoint.evaluation.coverage import JointCoverage, joint_coverage
from truejoint.evaluation.defects import Defect, Finding, find_defects
from truejoint.evaluation.results import json_values
from truejoint.recordings.recording import Recording, as_recordings

if TYPE_CHECKING:
    from truejoint.calibration import Calibration

Array = NDArray[np.float64]

_ORDER: Final = {"fail": 0, "warn": 1, "info": 2}
_EVERYWHERE: Final = "all recordings"


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
