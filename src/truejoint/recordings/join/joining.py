"""Truth from a file of its own, brought onto the robot's clock by the motion that both saw.

`find_path_offset` correlates two streams at any shift; the lag that is left is then found as the
judge finds it, beside what plays and efforts explain.
"""

import math
from dataclasses import dataclass, replace
from itertools import compress
from typing import Final

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.signal import argrelmax

from truejoint.array_types import Array, Integers
from truejoint.errors import RecordingError
from truejoint.recordings.join.explained import FEWEST, explain
from truejoint.recordings.join.lag import estimate_lag
from truejoint.recordings.table.recording import Recording, as_recording, nominal_rates
from truejoint.recordings.table.stream import BRIDGED_STEPS, Stream, synchronise, usable_rows
from truejoint.threads import one_thread

LEAST_OVERLAP: Final = 0.5  # share of the shorter stream
_MAX_GRID: Final = 1 << 19  # points of the longer stream, when clocks are compared at first
_LEAST_FIT: Final = 0.5  # share of a joint's variance that the other stream must explain
_RIVAL: Final = 1.3  # residuals up to this many times the least are as good an answer
_ROUNDS: Final = 2  # in which the lag that is left is estimated
_CLOSE: Final = 0.1  # s; a lag below it was estimated close enough to where it is none


@dataclass(frozen=True)
class ClockOffset:
    """Time to add to the stamps of a truth to have those of the robot's clock.

    Attributes
    ----------
    seconds : float
        [s].
    sd : float
        Standard deviation [s]: the spread of motion's parts and joints, friction that could pass
        for a delay, and the age of a reading, up to one step of its stream; NaN where the offset
        was stated. A lag of the joint itself is part of the offset.
    joints : tuple of str
        Joints by whose motion it was found; empty where it was stated.

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
    recording: Recording, truth: Stream, offset: float | None = None, *, near: float | None = None
) -> tuple[Recording, ClockOffset]:
    """Give a recording the truth that was recorded elsewhere, on another clock.

    The offset of the two clocks is found by the motion: coarsely by normalised cross-correlation of
    truth and measured positions at any shift that leaves half of the shorter one. Then it is
    refined by what velocity explains of the truth beside positions, direction, plays and efforts.
    These keep friction and backlash apart from a delay. Truth is then interpolated as `synchronise`
    does.

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
        If the recording has truth or lacks a joint, no shift fits, several fit alike, or there is
        no truth.

    Examples
    --------
    >>> robot = Recording.from_columns(test.table.drop(columns="truth/jaw"), "davinci_grasper")
    >>> stamps = {"truth/jaw": test.column("truth/jaw")}
    >>> joined, clock = join_truth(robot, Stream(test.t + 30.0, stamps))
    >>> bool(abs(clock.seconds + 30.0) < 0.01), len(joined)
    (True, 400)
    """
    provenance = as_recording(recording).provenance
    source = provenance.source or "recording"
    dropped: dict[str, int] = {}
    truth = usable_rows(truth, "truth", dropped)
    odd = [name for name in truth.columns if not name.startswith("truth/")]
    if odd or not truth.columns:
        raise RecordingError(f"truth: columns {odd} are none of it; call them truth/<joint>")
    joints = [name.removeprefix("truth/") for name in truth.columns]
    if recording.joints_of("truth"):
        raise RecordingError(f"{source}: has a truth already; give one without")
    recording.columns("measured", joints)  # which must be there
    begins = 0.0 if math.isnan(provenance.start) else provenance.start
    if offset is None:
        about = None if near is None else near - begins
        clock = find_clock_offset(recording, truth, about)
        clock = replace(clock, seconds=clock.seconds + begins)
    elif math.isfinite(offset):
        clock = ClockOffset(float(offset))
    else:
        raise RecordingError(f"{source}: an offset of {offset} s; state a number")
    joined, counts = _shifted(recording, truth, clock.seconds - begins)
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
    gap_limit = BRIDGED_STEPS * float(np.median(np.diff(truth.t)))
    shifted = replace(truth, t=truth.t + offset)
    columns, counts = synchronise(Stream(recording.t, {}), shifted, gap_limit)
    columns = {name: recording.column(name) for name in ("t", *recording.units)} | columns
    origin, units, robot = recording.provenance, recording.units, recording.robot
    # Arrays of the other recording, and new ones.
    joined = Recording.from_columns(columns, origin, units, robot=robot, copy=False)
    return joined, counts


def find_clock_offset(
    recording: Recording, truth: Stream, near: float | None = None
) -> ClockOffset:
    """Offset to be added to the stamps of a truth without a NaN [s], by the motion.

    It counts against the stamps of the rows of `recording`. Raises RecordingError as `join_truth`.
    """
    joints = [name.removeprefix("truth/") for name in truth.columns]
    measured = recording.columns("measured", joints)
    positions = np.column_stack([*truth.columns.values()])
    middle = np.quantile(measured, [0.02, 0.98], axis=0)  # a twitch is no motion
    moves = (np.ptp(middle, axis=0) > 0) & (np.ptp(positions, axis=0) > 0)
    if not moves.any():
        raise RecordingError(
            f"{', '.join(joints)} stand still: no motion tells the offset of the clocks; state it"
        )
    moving = tuple(compress(joints, moves))
    motion = recording.t, measured[:, moves], truth.t, positions[:, moves]
    offset = find_path_offset(*motion, near, ", ".join(moving))
    # A reading may be as old as a step of its stream.
    ages = [float(np.median(np.diff(t))) / math.sqrt(12.0) for t in (recording.t, truth.t)]
    sd = 0.0
    for _ in range(_ROUNDS):
        joined = _shifted(recording, truth, offset)[0].with_truth(moving)
        if len(joined) < FEWEST:
            break
        with one_thread():  # many small regressions, of which each would wait for its threads
            explained = [explain([joined], joint) for joint in moving]
            lag = estimate_lag([[joined]] * len(moving), explained)
        offset, sd = offset - lag.seconds, lag.sd
        if abs(lag.seconds) < _CLOSE:
            break
    return ClockOffset(offset, math.hypot(sd, *ages), moving)


def find_path_offset(
    t: Array,
    measured: Array,
    truth_t: Array,
    truth: Array,
    near: float | None = None,
    joints: str = "",
) -> float:
    """Shift [s] of the stamps of a path (m, 3) that lays it over another (n, 3) by one rigid move.

    To a step of either; the frames of the two paths need not be known. Or, of `joints`, that at
    which truth (m, k) and measured positions (n, k) are most alike. Raises RecordingError as
    `join_truth` does where no shift fits or several do.
    """
    likeness, who = (_joint_likeness, joints) if joints else (_path_likeness, "the tool")
    if near is not None and not math.isfinite(near):
        raise RecordingError(f"an offset of about {near} s; state a number")
    spans = (t[-1] - t[0], truth_t[-1] - truth_t[0])
    steps = [float(np.median(np.diff(stamps))) for stamps in (t, truth_t)]
    dt = max(*steps, max(spans) / _MAX_GRID)
    grids = [np.arange(round(span / dt) + 1) * dt for span in spans]
    least = int(LEAST_OVERLAP * min(len(grid) for grid in grids))
    lags = np.arange(least - len(grids[1]), len(grids[0]) - least + 1)
    ours, theirs = (
        np.column_stack([np.interp(grid, stamps - stamps[0], column) for column in values.T])
        for grid, stamps, values in ((grids[0], t, measured), (grids[1], truth_t, truth))
    )
    score, fit = likeness(ours, theirs, lags)
    best = int(np.argmax(score))
    if fit[best] < _LEAST_FIT:
        raise RecordingError(
            f"no offset of the clocks makes the truth follow {who} (at best "
            f"{100 * fit[best]:.0f} % of its motion); are both of one motion, with the same "
            "joints and signs? else state the offset"
        )
    offsets = t[0] - truth_t[0] + lags * dt
    # Residual variances of all joints together, relative to the least.
    peaks = [p for p in argrelmax(score)[0] if score[best] - score[p] < 2.0 * math.log(_RIVAL)]
    if near is not None:
        return float(offsets[min((best, *peaks), key=lambda place: abs(offsets[place] - near))])
    # Noise makes ripples on one peak; another one lies behind a valley.
    valleys = [score[min(p, best) : max(p, best) + 1].min() for p in peaks]
    deep = math.log(_RIVAL)
    rivals = [p for p, low in zip(peaks, valleys, strict=True) if score[p] - low > deep]
    if rivals:
        rival = max(rivals, key=lambda place: score[place])
        raise RecordingError(
            f"the motion repeats itself: offsets of {offsets[best]:.2f} s and "
            f"{offsets[rival]:.2f} s fit alike; state it, about (near; --near-s of extract, join "
            "and track) or exactly (offset; --offset-s)"
        )
    return float(offsets[best])


def _joint_likeness(ours: Array, theirs: Array, lags: Integers) -> tuple[Array, Array]:
    """Log of the residual variances of all joints (n, k), and the best explained joint's share.

    The share is the squared correlation, if it is positive, at `lags`: rows by which `theirs`
    begins later.
    """
    shares = []
    for pair in zip(ours.T, theirs.T, strict=True):
        covariance, variance, of_theirs = _moments(*pair, lags)
        # Where one stands still there is nothing to compare, but for rounding.
        moves = (variance > 1e-9 * variance.max()) & (of_theirs > 1e-9 * of_theirs.max())
        product = np.where(moves, variance * of_theirs, np.inf)
        shares.append(np.clip(np.maximum(covariance, 0.0) ** 2 / product, 0.0, 1.0 - 1e-12))
    explained = np.array(shares)
    return -np.log(1.0 - explained).sum(axis=0), explained.max(axis=0)


def _path_likeness(ours: Array, theirs: Array, lags: Integers) -> tuple[Array, Array]:
    """Share of the motion of a path (n, 3) that another explains, turned as fits best.

    The best turn leaves what the singular values of the paths' covariance say (Kabsch, Acta Cryst.
    A32, 1976).
    """
    pairs = [[_moments(axis, truth_axis, lags) for truth_axis in theirs.T] for axis in ours.T]
    covariance = np.array([[pair[0] for pair in row] for row in pairs]).transpose(2, 0, 1)
    spread = sum(pairs[k][k][1] + pairs[k][k][2] for k in range(3))
    sizes = np.linalg.svd(covariance, compute_uv=False)
    mirrored = np.linalg.det(covariance) < 0
    alike = sizes.sum(axis=1) - 2.0 * sizes[:, 2] * mirrored
    fit = np.clip(2.0 * alike / np.maximum(spread, 1e-9 * np.max(spread)), 0.0, 1.0 - 1e-12)
    # Residual variances of three axes, as of three joints.
    return -3.0 * np.log(1.0 - fit), fit


def _moments(ours: Array, theirs: Array, lags: Integers) -> tuple[Array, Array, Array]:
    """Covariance and both variances, each times the rows that overlap, at `lags`.

    By FFT (Padfield, IEEE Trans. Image Process. 21(5), 2012).
    """
    size = next_fast_len(len(ours) + len(theirs) - 1, real=True)
    ours, theirs = ours - ours.mean(), theirs - theirs.mean()

    def across(a: Array, b: Array) -> Array:
        product: Array = irfft(rfft(a, size) * np.conj(rfft(b, size)), size)[lags]
        return product

    unit, truth_unit = np.ones(len(ours)), np.ones(len(theirs))
    count = np.round(across(unit, truth_unit))
    mine, their = across(ours, truth_unit), across(unit, theirs)
    covariance = across(ours, theirs) - mine * their / count
    variance = across(ours**2, truth_unit) - mine**2 / count
    of_theirs = across(unit, theirs**2) - their**2 / count
    return covariance, variance, of_theirs
