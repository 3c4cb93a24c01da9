"""The judge: what recordings cover, and what in them would mislead a calibration."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from truejoint.array_types import Array
from truejoint.errors import RecordingError
from truejoint.recordings.judge.columns import judge_columns
from truejoint.recordings.judge.finding import (
    HEADINGS,
    ORDER,
    Defect,
    Finding,
    Level,
    one_line_each,
)
from truejoint.recordings.judge.positions import judge_positions
from truejoint.recordings.table.recording import Recording, as_recordings
from truejoint.recordings.table.stream import direction, velocity
from truejoint.summary import Summarised, json_values
from truejoint.threads import one_thread

if TYPE_CHECKING:  # what it is called on says the rest
    from truejoint.calibration import Calibration

_EVERYWHERE: Final = "all recordings"
_STRANGE: Final = 10.0  # times as far from the middle as training rows: other motions reach 2 to 27
_ANOTHER: Final = 100.0  # no other motion does
_MARGIN: Final = 0.01  # of the range seen in training, by which rows may lie outside of it
_BINS: Final = 20


@dataclass(frozen=True)
class JointCoverage:
    """Coverage of one joint by a set of recordings.

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


@dataclass(frozen=True, repr=False)
class DataCheck(Summarised):
    """Findings, worst first, and what each joint covers.

    Examples
    --------
    >>> check = check_data(test, joints=["jaw"])
    >>> check.failed, len(check.findings)
    (False, 1)
    """

    findings: tuple[Finding, ...]
    coverage: tuple[JointCoverage, ...]
    accepted: tuple[str, ...] = ()  # names of failures that the user goes on with

    @property
    def failed(self) -> bool:
        """Whether a finding is of level ``"fail"`` and not accepted."""
        return bool(self.failures)

    @property
    def failures(self) -> tuple[str, ...]:
        """Names of the findings of level ``"fail"`` that are not accepted, each once."""
        failed = dict.fromkeys(f.name for f in self.findings if f.level == "fail")
        return tuple(name for name in failed if name not in self.accepted)

    def accept(self, names: Iterable[str]) -> "DataCheck":
        """Go on though there are failures of these `names`; a verdict keeps its reservation."""
        return replace(self, accepted=tuple(names))

    def by_heading(self) -> tuple[Finding, ...]:
        """Worst finding under each of `HEADINGS` that has one; its text counts those beside it."""
        worst: list[Finding] = []
        for heading in HEADINGS:
            group = [finding for finding in self.findings if finding.heading == heading]
            if group:
                more = sum(finding.level == group[0].level for finding in group) - 1
                what = group[0].what + (f" (and {more} more)" if more else "")
                worst.append(replace(group[0], what=what))
        return tuple(worst)

    def with_findings(self, findings: Iterable[Finding]) -> "DataCheck":
        """Add findings; those of a level stand before the ones that were there."""
        ordered = sorted([*findings, *self.findings], key=lambda finding: ORDER[finding.level])
        return replace(self, findings=tuple(ordered))

    def summary(self) -> dict[str, str]:
        """Joints, and the findings' names by level."""
        levels = {
            level: ", ".join(dict.fromkeys(f.name for f in self.findings if f.level == level))
            for level in ORDER
        }
        return {"joints": ", ".join(row.joint for row in self.coverage)} | {
            level: names or "-" for level, names in levels.items()
        }

    def to_dict(self) -> dict[str, Any]:
        """Values for JSON; SI units. Each finding says its heading."""
        values: dict[str, Any] = json_values(self)
        for shown, finding in zip(values["findings"], self.findings, strict=True):
            shown["heading"] = finding.heading
        return values


def check_data(
    recordings: Recording | Sequence[Recording],
    *,
    joints: Sequence[str] | None = None,
    model: "Calibration | None" = None,
    needs_truth: bool = True,
) -> DataCheck:
    """Check recordings before they are used to fit or to judge a calibration.

    Besides each column by itself, it looks at truth minus measured, less what the robot's other
    signals explain of it: sign, unit, gross outliers, a delay, zeros that moved; and at redundant
    sensors of one joint.

    Parameters
    ----------
    recordings : Recording or sequence of Recording
        Recordings of one arm.
    joints : sequence of str, optional
        Joints of interest; by default those of `model`, or all that have a measured and a true
        position.
    model : Calibration, optional
        Signals and ranges of its features; rows outside the ranges seen in training are counted
        as extrapolation. Without one, all measured and effort columns are examined.
    needs_truth : bool
        Whether truth that is missing is a finding; correcting a recording needs none.

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
        joints = model.joints if model else [j for j in measured if j in with_truth]
    # What a calibration reads unless told otherwise.
    read = [f"{what}/{j}" for what in ("measured", "effort") for j in first.joints_of(what)]
    signals = model.feature_set.signals if model else read
    coverage = tuple(joint_coverage(recordings, joint) for joint in joints)
    columns = [
        (defect, recording)
        for recording in recordings
        for defect in judge_columns(recording, joints, signals, needs_truth=needs_truth)
    ]
    with one_thread():  # many small regressions, which two threads make slower
        positions = list(judge_positions(recordings, joints, signals, columns))
    findings = [
        *one_line_each([pair for pair in columns if pair[0].name != "stop"], recordings),
        *positions,
        *(finding for row in coverage for finding in _judge_coverage(row)),
        *_judge_sessions(recordings),
        *(_judge_extrapolation(recordings, model) if model else ()),
    ]
    return DataCheck((), coverage).with_findings(findings)


def _judge_sessions(recordings: Sequence[Recording]) -> Iterable[Finding]:
    homings = sorted({r.provenance.homing_id for r in recordings} - {""})
    if len(homings) > 1:
        what = f"{len(homings)} homings ({', '.join(homings[:4])})"
        yield Finding("warn", "homing", what, _EVERYWHERE)
    loads = [r.provenance.load for r in recordings if np.isfinite(r.provenance.load)]
    unknown = len(recordings) - len(loads)
    masses = ", ".join(f"{1e3 * load:.0f} g" for load in sorted(set(loads)))
    if unknown:
        what = f"the load at the tool is not stated in {unknown} of {len(recordings)} recordings"
        what += f"; elsewhere {masses}" if masses else ""
        yield Finding("info", "load", what, _EVERYWHERE)
    elif len(set(loads)) == 1:
        advice = "accuracy under another load is not shown by these data"
        yield Finding("info", "load", f"one load only: {masses}", _EVERYWHERE, advice)


def _judge_extrapolation(
    recordings: Sequence[Recording], model: "Calibration"
) -> Iterable[Finding]:
    features = model.feature_set
    by_recording = [features.compute(r, model.gap_limit) for r in recordings]
    yield from one_line_each(_strange(recordings, by_recording, model), recordings)
    rows = np.concatenate(by_recording)
    worst: dict[str, tuple[float, str]] = {}
    ranges = zip(features.features, features.names, model.lower, model.upper, strict=True)
    for values, (feature, name, low, high) in zip(rows.T, ranges, strict=True):
        slack = _MARGIN * (high - low)
        share = float(np.mean((values < low - slack) | (values > high + slack)))
        # Features of one signal leave their ranges together; the worst speaks for all.
        worst[feature.signal] = max(worst.get(feature.signal, (0.0, "")), (share, name))
    for share, name in worst.values():
        if share > 0.02:
            what = f"{100 * share:.0f} % of the rows lie outside the range seen in training"
            yield Finding("fail" if share > 0.5 else "warn", "range", what, name)


def _strange(
    recordings: Sequence[Recording], rows: Sequence[Array], model: "Calibration"
) -> Iterable[tuple[Defect, Recording]]:
    """Find recordings whose signals are far from the training's, as another instrument's are.

    The Mahalanobis distance of half of a recording's `rows` (n, k), in that of a training row.
    """
    domain = model.training_domain
    if domain is None:
        return
    usual = np.sqrt(np.count_nonzero(np.abs(domain.whitening).sum(axis=0)))
    for recording, features in zip(recordings, rows, strict=True):
        away = np.linalg.norm((features - domain.feature_mean) @ domain.whitening.T, axis=1)
        times = float(np.median(away) / max(usual, 1.0))
        if times > _STRANGE:
            level: Level = "fail" if times > _ANOTHER else "warn"
            what = f"they lie {times:.0f} times as far from the training's middle as those in it"
            surely = "it is of another instrument, mounting or unit: calibrate that one"
            advice = surely if level == "fail" else ""
            yield Defect(level, "instrument", what, "signals", advice, size=times), recording


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
        yield Finding("warn", "directions", what, row.joint)
    if row.standing > 0.5:
        what = f"the joint stands still in {100 * row.standing:.0f} % of the rows"
        yield Finding("warn", "standstill", what, row.joint)
    if row.filled < 0.9:
        what = f"{100 * (1 - row.filled):.0f} % of the range between its ends was hardly visited"
        yield Finding("warn", "hole", what, row.joint)
    if row.share_of_limits < 0.2:
        what = f"{100 * row.share_of_limits:.0f} % of the joint's travel is covered"
        yield Finding("info", "travel", what, row.joint)
