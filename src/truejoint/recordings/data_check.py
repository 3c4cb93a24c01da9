"""Data checks: what a recording covers, and what about it would mislead a calibration."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from truejoint.array_types import Array, Mask
from truejoint.errors import RecordingError
from truejoint.recordings.recording import Recording, as_recordings, runs
from truejoint.recordings.signals import GAP_STEPS, direction, gaps, velocity
from truejoint.summary import json_values

if TYPE_CHECKING:  # what it is called on says the rest
    from truejoint.calibration import Calibration

_ORDER: Final = {"fail": 0, "warn": 1, "info": 2}
_BINS: Final = 20
_EVERYWHERE: Final = "all recordings"


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

    level: Literal["fail", "warn", "info"]
    what: str
    where: str
    advice: str


@dataclass(frozen=True)
class Defect(Finding):
    """A defect of one recording; `size` orders those with the same `where` and `advice`."""

    size: float


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
        for defect in _defects_of(recording, joints, signals):
            groups.setdefault((defect.advice, defect.where), []).append((defect, name))
    for group in groups.values():
        worst, name = max(group, key=lambda pair: (-_ORDER[pair[0].level], pair[0].size))
        others = len(group) - 1
        more = f" and {others} more of {len(recordings)} recordings" if others else ""
        yield Finding(worst.level, worst.what, f"{worst.where} in {name}{more}", worst.advice)


def _defects_of(
    recording: Recording, joints: Sequence[str], signals: Sequence[str]
) -> Iterable[Defect]:
    """Examine measured and true positions of `joints`, and whether `signals`, columns, vary."""
    yield from _clock(recording.t)
    yield from _dropped(recording)
    for name in signals:
        values = recording.column(name)
        used = name.partition("/")[2] not in recording.robot.unused_channels
        if used and values.min() == values.max():
            what = f"the signal is {values[0]:.4g} in every row"
            advice = "a model learns nothing from it; is the sensor connected?"
            yield Defect("warn", what, name, advice, 1.0)
    for joint in joints:
        measured = recording.column(f"measured/{joint}")
        yield from _jumps(recording, f"measured/{joint}", recording.t, measured)
        if f"truth/{joint}" in recording.units:
            truth = recording.column(f"truth/{joint}")
            known = np.isfinite(truth)
            yield from _missing_truth(recording.t, joint, known)
            if known.sum() >= 2:
                t = recording.t[known]
                yield from _jumps(recording, f"truth/{joint}", t, truth[known])
                yield from _frozen(joint, t, truth[known], measured[known])


def _clock(t: Array) -> Iterable[Defect]:
    step = np.diff(t)
    usual = float(np.median(step))
    after = gaps(t)
    if len(after):
        longest = float(step.max())
        lost = float(step[after].sum() / (t[-1] - t[0]))
        what = (
            f"{_count(len(after), 'gap')} longer than {GAP_STEPS:g} samples, up to {longest:.3g} "
            f"s, {100 * lost:.2g} % of the time"
        )
        advice = (
            "a model with history starts anew after each; look for lost messages or a clock jump"
        )
        yield Defect("warn", what, "time stamps", advice, longest)
    irregular = float(np.mean(np.abs(step - usual) > 0.5 * usual))
    if irregular > 0.05:
        what = (
            f"{100 * irregular:.0f} % of the steps are more than half off the median of "
            f"{1e3 * usual:.4g} ms"
        )
        advice = "record stamps of the sensor rather than of arrival"
        yield Defect("info" if irregular < 0.2 else "warn", what, "time stamps", advice, irregular)


def _dropped(recording: Recording) -> Iterable[Defect]:
    dropped = {reason: n for reason, n in recording.provenance.dropped.items() if n}
    total = sum(dropped.values())
    share = total / (total + len(recording))
    if total:
        reasons = ", ".join(f"{n} {reason}" for reason, n in dropped.items())
        what = (
            f"{_count(total, 'row')} ({100 * share:.2g} %) dropped when the file was read: "
            f"{reasons}"
        )
        advice = "look at the streams if the share is not what you expect"
        yield Defect("warn" if share > 0.05 else "info", what, "rows", advice, share)


def _missing_truth(t: Array, joint: str, known: Mask) -> Iterable[Defect]:
    share = 1.0 - float(known.mean())
    if share > 0.05:
        what = f"{100 * share:.0f} % of the rows have no true position"
        advice = "only rows with truth are used; check the joint sensor and its clock"
        yield Defect("fail" if share > 0.5 else "warn", what, f"truth/{joint}", advice, share)
    silent = float(t[-1] - t[known][-1]) if known.any() else 0.0
    if silent > 0.1 * (t[-1] - t[0]):
        what = f"the truth stops {silent:.1f} s before the end"
        advice = "the joint sensor stopped; what follows is not used"
        yield Defect("warn", what, f"truth/{joint}", advice, silent)


def _jumps(recording: Recording, name: str, t: Array, values: Array) -> Iterable[Defect]:
    """Find steps far beyond what the joint does otherwise; whole turns are encoder wraps."""
    size = np.abs(np.diff(values))
    size[gaps(t)] = 0.0
    far = (size > 6.0 * np.quantile(size, 0.99)) & (size > 0.1 * np.ptp(values))
    if not far.any():
        return
    unit, largest = recording.units[name], float(size.max())
    turns = size[far] / (2.0 * math.pi)
    whole = np.round(turns)
    wrapped = unit == "rad" and bool(np.all((np.abs(turns - whole) < 0.02) & (whole >= 1)))
    what = (
        f"{_count(int(far.sum()), 'whole turn' if wrapped else 'sudden jump')}, the first at "
        f"{t[int(np.argmax(far)) + 1]:.3f} s, the largest {largest:.3g} {unit}"
    )
    advice = "unwrap the encoder before use" if wrapped else "cut the rows out or record again"
    yield Defect("fail" if wrapped else "warn", what, name, advice, largest)


def _frozen(joint: str, t: Array, truth: Array, measured: Array) -> Iterable[Defect]:
    """Find a sensor that repeats one value while the other end of the cable moves far."""
    for name, still, other in (("truth", truth, measured), ("measured", measured, truth)):
        repeats = runs(np.diff(still) == 0.0)
        first, last = max(repeats, key=lambda run: run[1] - run[0], default=(0, 0))
        moved, span = np.ptp(other[first : last + 1]), np.ptp(other)
        if span > 0.0 and moved > 0.25 * span:  # less may be honest backlash
            seconds = float(t[last] - t[first])
            what = (
                f"the sensor repeats one value for {seconds:.1f} s, from {t[first]:.1f} s, while "
                "the joint moves"
            )
            advice = "check the sensor; cut the stretch out before fitting or judging"
            yield Defect("fail", what, f"{name}/{joint}", advice, seconds)


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}" + ("" if number == 1 else "s")


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
