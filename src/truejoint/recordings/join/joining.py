"""Truth from a file of its own, brought onto the robot's clock by the motion that both saw."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress
from typing import Final

import numpy as np

from truejoint.array_types import Array
from truejoint.errors import RecordingError
from truejoint.recordings.join.explained import OTHER_PLAYS, PLAYS, SLOW, explain
from truejoint.recordings.join.lag import (
    LEAST_OVERLAP,
    coarse_offset,
    estimate_lag,
    fine_offset,
    joint_likeness,
    path_likeness,
)
from truejoint.recordings.table.recording import Recording, as_recording, nominal_rates
from truejoint.recordings.table.stream import BRIDGED_STEPS, Stream, synchronise, usable_rows
from truejoint.threads import one_thread

_FEWEST: Final = 200  # rows of which plays and efforts can explain the error
_UNSURE: Final = 0.01  # s; an offset that is known better is left as it is
_SURE: Final = 3.0  # deviations by which a better offset may differ from a first one


@dataclass(frozen=True)
class ClockOffset:
    """What to add to the stamps of a truth to have those of the robot's clock.

    Attributes
    ----------
    seconds : float
        [s].
    sd : float
        Standard deviation [s]: how much parts of the motion differ (jackknife over ten), how much
        friction could pass for a delay, and that a reading may be as old as one step of its stream;
        NaN where the offset was stated. A lag of the joint itself is part of the offset.
    joints : tuple of str
        Whose motion it was found by; empty where it was stated.

    Examples
    --------
    >>> ClockOffset(12.5, 0.001, ("jaw",))
    ClockOffset(12.5 s ± 0.0010 s by jaw)
    """

    seconds: float
    sd: float = math.nan
    joints: tuple[str, ...] = ()

    def __repr__(self) -> str:
        basis = f" ± {self.sd:.4f} s by {', '.join(self.joints)}" if self.joints else " as stated"
        return f"{type(self).__name__}({self}{basis})"

    def __str__(self) -> str:
        return f"{round(self.seconds, 4):.14g} s"


def join_truth(
    recording: Recording,
    truth: Stream,
    offset: float | None = None,
    *,
    near: float | None = None,
) -> tuple[Recording, ClockOffset]:
    """Give a recording the truth that was recorded elsewhere, on a clock of its own.

    The offset of the two clocks is found by the motion: coarsely by normalised cross-correlation of
    truth and measured positions at any shift at which half of the shorter one remains, then by
    regression of the truth on position, direction and velocity, whose coefficient is the delay. The
    direction keeps friction and backlash apart from a delay. Where plays and efforts explain truth
    minus measured best at another shift, and tell it more surely, it is that. Truth is then
    interpolated as `synchronise` does.

    Parameters
    ----------
    recording : Recording
    truth : Stream
        With columns ``truth/<joint>`` [rad or m] of some of its joints.
    offset : float, optional
        To be added to the truth's stamps to have those of the recording's own clock [s], which
        count from `Provenance.start` where that is known; estimated by default.
    near : float, optional
        About how large it is [s], to choose by where a motion repeats itself.

    Raises
    ------
    RecordingError
        If the recording has truth or lacks a joint, no shift fits, several fit alike, or the
        truth is none.

    Examples
    --------
    >>> robot = Recording.from_columns(test.table.drop(columns="truth/jaw"), "davinci_grasper")
    >>> stamps = {"truth/jaw": test.column("truth/jaw")}
    >>> joined, clock = join_truth(robot, Stream(test.t + 30.0, stamps))
    >>> bool(abs(clock.seconds + 30.0) < 0.01), len(joined)
    (True, 400)
    """
    source = as_recording(recording).provenance.source or "recording"
    dropped: dict[str, int] = {}
    truth = usable_rows(truth, "truth", dropped)
    odd = [name for name in truth.columns if not name.startswith("truth/")]
    if odd or not truth.columns:
        raise RecordingError(f"truth: columns {odd} are none of it; call them truth/<joint>")
    joints = tuple(name.removeprefix("truth/") for name in truth.columns)
    if recording.joints_of("truth"):
        raise RecordingError(f"{source}: has a truth already; give one without")
    measured = recording.columns("measured", joints)
    begins = 0.0 if math.isnan(recording.provenance.start) else recording.provenance.start
    if offset is None:
        about = None if near is None else near - begins
        positions = np.column_stack([*truth.columns.values()])
        clock = find_clock_offset(recording.t, measured, truth.t, positions, joints, about)
        clock = _refined(recording, truth, clock)
        clock = replace(clock, seconds=clock.seconds + begins)
    elif math.isfinite(offset):
        clock = ClockOffset(float(offset))
    else:
        raise RecordingError(f"{source}: an offset of {offset} s; state a number")
    joined, counts = _shifted(recording, truth, clock.seconds - begins)
    provenance = recording.provenance
    sd = "" if math.isnan(clock.sd) else f" (sd {clock.sd:.2g} s)"
    notes = f"{clock}{sd} added to the stamps of the truth, a file of its own"
    described = replace(
        provenance,
        rates={**provenance.rates, **nominal_rates(truth=truth.t)},
        dropped={**provenance.dropped, **dropped, **counts},
        notes="; ".join(filter(None, (provenance.notes, notes))),
    )
    return replace(joined, provenance=described), clock


def cover_same_time(t: Array, other: Array) -> bool:
    """Whether stamps `t` (n,) and `other` (m,) [s] have half of the shorter time in common."""
    common = min(t[-1], other[-1]) - max(t[0], other[0])
    return bool(common >= LEAST_OVERLAP * min(np.ptp(t), np.ptp(other)))


def _shifted(
    recording: Recording, truth: Stream, offset: float
) -> tuple[Recording, dict[str, int]]:
    """Give a recording the truth at stamps later by `offset` [s], and rows without it by reason."""
    shifted = replace(truth, t=truth.t + offset)
    state = Stream(recording.t, {name: recording.column(name) for name in recording.units})
    gap_limit = BRIDGED_STEPS * float(np.median(np.diff(truth.t)))
    columns, counts = synchronise(state, shifted, gap_limit)
    units = {n: recording.units["measured" + n.removeprefix("truth")] for n in truth.columns}
    units = {**recording.units, **units}
    # Arrays of the other recording, and new ones.
    origin, robot = recording.provenance, recording.robot
    return Recording.from_columns(columns, origin, units, robot=robot, copy=False), counts


def _refined(recording: Recording, truth: Stream, coarse: ClockOffset) -> ClockOffset:
    """Offset at which the robot's signals explain most of truth minus measured.

    Plays and efforts tell friction from a delay where a motion of one speed, as a zig-zag is, does
    not. It counts where `coarse` is unsure, and this one is surer and no further off than may be.
    By how much it differs with plays of other half-widths is part of its deviation: of strokes that
    are all alike a wrong width and a delay explain the same. So is half its way from `coarse`: rows
    at a turn tell most, and what is far off at the first offset weighs little. Where it does not
    count, how far off it is adds to the deviation of `coarse`.
    """
    if coarse.sd < _UNSURE:
        return coarse
    joined, _ = _shifted(recording, truth, coarse.seconds)
    joined = joined.with_truth(coarse.joints)
    if len(joined) < _FEWEST or np.median(np.diff(joined.t)) > SLOW:
        return coarse
    with one_thread():
        lag, other = (
            estimate_lag(
                [[joined]] * len(coarse.joints),
                [explain([joined], joint, plays=plays) for joint in coarse.joints],
            )
            for plays in (PLAYS, OTHER_PLAYS)
        )
    deviation = math.hypot(lag.sd, other.seconds - lag.seconds)
    if not (deviation < coarse.sd and abs(lag.seconds) < _SURE * coarse.sd):
        farthest = max(abs(lag.seconds), abs(other.seconds))
        return replace(coarse, sd=math.hypot(coarse.sd, farthest))
    sd = math.hypot(deviation, lag.seconds / 2, *_age_sds(recording.t, truth.t))
    return replace(coarse, seconds=coarse.seconds - lag.seconds, sd=sd)


def _age_sds(*stamps: Array) -> list[float]:
    """Deviation [s] of each stream's stamps: a reading may be as old as a step of it."""
    return [float(np.median(np.diff(t))) / math.sqrt(12.0) for t in stamps]


def find_clock_offset(
    t: Array,
    measured: Array,
    truth_t: Array,
    truth: Array,
    joints: Sequence[str],
    near: float | None = None,
) -> ClockOffset:
    """Offset to be added to the stamps of the truth [s], by the motion; raises RecordingError.

    `measured` (n, k) and `truth` (m, k) are positions of `joints` at stamps `t` (n,) and `truth_t`
    (m,) [s] that rise, without a NaN.
    """
    moves = (np.ptp(measured, axis=0) > 0) & (np.ptp(truth, axis=0) > 0)
    if not moves.any():
        raise RecordingError(
            f"{', '.join(joints)} stand still: no motion tells the offset of the clocks; state it"
        )
    joints = tuple(compress(joints, moves))
    motion = t, measured[:, moves], truth_t, truth[:, moves]
    coarse = coarse_offset(*motion, ", ".join(joints), near, joint_likeness)
    with one_thread():  # many small regressions, of which each would wait for its threads
        seconds, sd = fine_offset(*motion, coarse)
    return ClockOffset(seconds, math.hypot(sd, *_age_sds(t, truth_t)), joints)


def find_path_offset(
    t: Array, path: Array, truth_t: Array, truth: Array, near: float | None = None
) -> float:
    """Shift [s] of the stamps of a path (m, 3) that lays it over another (n, 3) by one rigid move.

    To a step of either; the frames of the two paths need not be known. Raises RecordingError as
    `join_truth` does where no shift fits or several do.
    """
    return coarse_offset(t, path, truth_t, truth, "the tool", near, path_likeness)
