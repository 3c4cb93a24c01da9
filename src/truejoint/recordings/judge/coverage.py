"""What recordings cover of a joint: range, directions, speed, effort."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from truejoint.array_types import Array
from truejoint.recordings.judge.finding import Finding
from truejoint.recordings.table.recording import Recording
from truejoint.recordings.table.signals import direction, velocity

_BINS: Final = 20


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


def judge_coverage(row: JointCoverage) -> Iterable[Finding]:
    """Yield what of the coverage is to be known before fitting."""
    moving, rarer = row.up + row.down, min(row.up, row.down)
    if moving > 0 and rarer < 0.3 * moving:
        what = f"one direction of motion holds only {100 * rarer / moving:.0f} % of the moving rows"
        yield Finding("warn", "directions", what, row.joint)
    if row.standing > 0.5:
        what = f"the joint stands still in {100 * row.standing:.0f} % of the rows"
        advice = "many equal rows outweigh the moving ones; cut long rests or record more motion"
        yield Finding("warn", "standstill", what, row.joint, advice)
    if row.filled < 0.9:
        what = f"{100 * (1 - row.filled):.0f} % of the range between its ends was hardly visited"
        yield Finding("warn", "hole", what, row.joint)
    if row.share_of_limits < 0.2:
        what = f"{100 * row.share_of_limits:.0f} % of the joint's travel is covered"
        yield Finding("info", "travel", what, row.joint)
