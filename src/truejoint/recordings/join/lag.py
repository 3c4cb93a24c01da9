"""Lags between a robot's positions and their truth: one estimate, from coarse to fine.

`coarse_offset` correlates two streams at any shift; `fine_offset` regresses the truth on position,
direction and velocity, whose coefficient is the lag; `estimate_lag` asks at which shift plays and
efforts explain most of truth minus measured.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.signal import argrelmax

from truejoint.array_types import Array, Integers
from truejoint.errors import RecordingError
from truejoint.recordings.join.explained import SLOW, Explained
from truejoint.recordings.table.recording import Recording

LATE: Final = 0.015  # s, below which nothing is said
LEAST_OVERLAP: Final = 0.5  # share of the shorter stream

_MAX_GRID: Final = 1 << 19  # points of the longer stream, when clocks are compared at first
_LEAST_FIT: Final = 0.5  # share of a joint's variance that the other stream must explain
_RIVAL: Final = 1.3  # residuals up to this many times the least are as good an answer

_BLOCKS: Final = 10  # of the common time, to see how much its parts differ
_STANDS: Final = 0.1  # of the RMS speed; slower, a joint keeps its last direction
_ROUNDS: Final = 20
_MAX_ROWS: Final = 20_000  # of the truth, for the regressions

_SHIFTS: Final = np.linspace(-0.4, 0.4, 41)  # s
_NEAR: Final = np.linspace(-0.02, 0.02, 11)  # s, about the best of those
_PARTS: Final = 4  # of each recording, left out in turn for the deviation
_RIDGE: Final = 1e-7
_APART: Final = 2.0  # deviations of two lags that differ


def jackknife_sd(left_out: Sequence[float]) -> float:
    """Give the standard deviation of an estimate, by estimates that leave out a part each."""
    return math.sqrt(len(left_out) - 1) * float(np.std(left_out))


def coarse_offset(
    t: Array,
    measured: Array,
    truth_t: Array,
    truth: Array,
    who: str,
    near: float | None,
    likeness: Callable[[Array, Array, Integers], tuple[Array, Array]],
) -> float:
    """Shift [s] at which truth and measured positions are most alike, to a step of either.

    `likeness` takes both on one grid, and lags, and tells for each lag a score and the share of
    motion that the truth explains.
    """
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


def joint_likeness(ours: Array, theirs: Array, lags: Integers) -> tuple[Array, Array]:
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


def path_likeness(ours: Array, theirs: Array, lags: Integers) -> tuple[Array, Array]:
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


def fine_offset(
    t: Array, measured: Array, truth_t: Array, truth: Array, offset: float
) -> tuple[float, float]:
    """Offset [s] that leaves no delay between truth and measured positions, and its deviation."""
    velocity = np.column_stack([np.gradient(column, t) for column in measured.T])
    # Way that a joint moves or moved last, -1 to 1.
    moves = np.abs(velocity) > _STANDS * np.sqrt(np.mean(velocity**2, axis=0))
    last = np.maximum.accumulate(np.where(moves, np.arange(len(t))[:, None], 0))
    direction = np.take_along_axis(np.sign(velocity), last, axis=0)
    limit = np.median(np.diff(t)) + np.median(np.diff(truth_t))
    stride = -(-len(truth_t) // _MAX_ROWS)
    truth_t, truth = truth_t[::stride], truth[::stride]
    for _ in range(_ROUNDS):
        stamps = truth_t + offset
        inside = (stamps >= t[0]) & (stamps <= t[-1])
        position, speed, way = (
            np.column_stack([np.interp(stamps[inside], t, column) for column in values.T])
            for values in (measured, velocity, direction)
        )
        regressors = np.column_stack([np.ones(len(position)), position, way])
        step = _regressed_lag(regressors, speed, truth[inside])
        offset += float(np.clip(step, -limit, limit))
        if abs(step) < 1e-6:
            break
    parts = np.arange(len(regressors)) * _BLOCKS // len(regressors)
    left_out = [
        _regressed_lag(regressors[rows], speed[rows], truth[inside][rows])
        for rows in (parts != part for part in range(_BLOCKS))
    ]
    frictionless = _regressed_lag(regressors[:, : 1 + position.shape[1]], speed, truth[inside])
    return offset, math.hypot(jackknife_sd(left_out), frictionless - step)


def _regressed_lag(regressors: Array, velocity: Array, truth: Array) -> float:
    """Delay [s] of measured positions behind the truth, of each joint by how well it is known.

    Each truth is regressed on `regressors` (one, the positions, the directions) and its joint's
    velocity: a position that comes `d` too late lacks `d` times the velocity.
    """
    delays, weights = [], []
    for k in range(truth.shape[1]):
        X = np.column_stack([regressors, velocity[:, k]])
        coefficients, *_ = np.linalg.lstsq(X, truth[:, k])
        # What of the velocity nothing else explains tells how well its coefficient is known.
        unexplained = X[:, -1] - regressors @ np.linalg.lstsq(regressors, X[:, -1])[0]
        residual = np.sum((truth[:, k] - X @ coefficients) ** 2) + np.finfo(float).tiny
        slope = coefficients[1 + k]
        delays.append(coefficients[-1] / slope)
        weights.append(slope**2 * np.sum(unexplained**2) / residual)
    return float(np.average(delays, weights=weights))


@dataclass(frozen=True)
class Lag:
    """By how much the truth is late.

    `sd` is the standard deviation [s] by leaving parts out in turn, or between joints; `drop` the
    share by which the residual's variance falls when the truth is shifted back; `slow` says that
    rows are too far apart to shift the truth between them.
    """

    seconds: float
    sd: float
    drop: float
    slow: bool = False


def estimate_lag(recordings: Sequence[Sequence[Recording]], explained: Sequence[Explained]) -> Lag:
    """Delay of all truth joints together: the shift at which the signals explain most.

    For each shift the truth is interpolated and the regression of `explain` made anew, with its
    weights; the logarithms of the residual's variance are added over joints. Where rows are far
    apart, interpolating would average more noise than a shift explains: see `_lag_by_velocity`.
    """
    pairs = list(zip(recordings, explained, strict=True))
    if np.median(np.diff(recordings[0][0].t)) > SLOW:
        return _lag_by_velocity(pairs)
    squares = [_squares(*pair, _SHIFTS) for pair in pairs]  # (blocks, shifts) each
    coarse, drop = _least(_SHIFTS, [s.sum(axis=0) for s in squares])
    blocks = range(len(squares[0]))
    left_out = [_least(_SHIFTS, [s.sum(axis=0) - s[k] for s in squares])[0] for k in blocks]
    near = coarse + _NEAR
    seconds, _ = _least(near, [_squares(*pair, near).sum(axis=0) for pair in pairs])
    return Lag(seconds, jackknife_sd(left_out), drop)


def lags_unlike_others(
    recordings: Sequence[Sequence[Recording]], explained: Sequence[Explained]
) -> list[tuple[int, Lag]]:
    """Find recordings, by number, late by another time than the others.

    Each has a regression of its own.
    """
    count = len(recordings[0])
    if count < 2:
        return []
    alone = []
    for k in range(count):
        single = [replace(e, samples=e.samples[k : k + 1]) for e in explained]
        alone.append(estimate_lag([[each[k]] for each in recordings], single))
    values = np.array([(delay.seconds, delay.sd) for delay in alone])
    late = []
    for k, delay in enumerate(alone):
        usual, uncertainty = np.median(np.delete(values, k, axis=0), axis=0)
        least = max(LATE, _APART * (delay.sd + float(uncertainty)))
        if abs(delay.seconds - usual) > least:
            late.append((k, delay))
    return late


def _lag_by_velocity(pairs: Sequence[tuple[Sequence[Recording], Explained]]) -> Lag:
    """Delay by what velocity explains of the error, as much as it is late; mean of the joints.

    What a joint itself lags by differs between joints, so their scatter tells the uncertainty.
    """
    lags, deviations = [], []
    for recordings, explained in pairs:
        names = [*explained.features.names, "square", "cube"]
        inputs = [i for i, name in enumerate(names) if not name.startswith("lag(")]
        normal, right = [], []
        for recording, sample in zip(recordings, explained.samples, strict=True):
            measured = recording.column(f"measured/{explained.joint}")
            velocity = np.gradient(measured, recording.t)[sample.rows, None]
            rows = np.hstack([velocity, explained.scaled(sample.inputs)[:, inputs]])
            weights = sample.weights[:, None]
            rows -= (weights * rows).sum(axis=0) / weights.sum()
            for part in np.array_split(np.arange(len(rows)), _PARTS):
                normal.append(rows[part].T @ (weights[part] * rows[part]))
                right.append(rows[part].T @ (sample.weights * sample.error)[part])
        penalty = np.diag(np.r_[0.0, np.full(len(inputs), _RIDGE * len(rows))])
        every = np.sum(normal, axis=0) + penalty, np.sum(right, axis=0)
        lags.append(-float(np.linalg.solve(*every)[0]))
        left_out = [
            -np.linalg.solve(every[0] - n, every[1] - r)[0]
            for n, r in zip(normal, right, strict=True)
        ]
        deviations.append(jackknife_sd(left_out))
    within = float(np.sqrt(np.mean(np.square(deviations))))
    between = float(np.std(lags, ddof=1)) if len(lags) > 1 else 0.0
    return Lag(float(np.mean(lags)), max(within, between) / len(lags) ** 0.5, 0.0, slow=True)


def _least(shifts: Array, squares: Sequence[Array]) -> tuple[float, float]:
    """Shift [s] with the least sum of logarithms, by a parabola; fall of the variance to it."""
    curve = np.mean([np.log(np.maximum(s, 1e-300)) for s in squares], axis=0)
    at = int(np.argmin(curve))
    drop = float(1.0 - np.exp(curve[at] - curve[len(curve) // 2]))
    shift = float(shifts[at])
    if 0 < at < len(curve) - 1:
        before, here, after = curve[at - 1 : at + 2]
        bend = max(before - 2.0 * here + after, 1e-12)
        shift += 0.5 * float(shifts[1] - shifts[0]) * float((before - after) / bend)
    return shift, drop


def _squares(recordings: Sequence[Recording], explained: Explained, shifts: Array) -> Array:
    """Weighted sums of squared residuals (blocks, shifts), at `shifts` [s] of the truth."""
    samples = explained.samples
    channel = f"/{explained.joint}"
    targets, blocks = [], []
    for number, (recording, sample) in enumerate(zip(recordings, samples, strict=True)):
        t, truth = recording.t, recording.column("truth" + channel)
        has_truth = np.isfinite(truth)
        # Interpolating between rows averages noise; so does this, at every shift alike.
        padded = np.pad(truth[has_truth], 1, mode="edge")
        smooth = 0.25 * padded[:-2] + 0.5 * padded[1:-1] + 0.25 * padded[2:]
        at, measured = t[sample.rows], recording.column("measured" + channel)[sample.rows]
        shifted = [np.interp(at + shift, t[has_truth], smooth) for shift in shifts]
        targets.append(np.stack(shifted, axis=1) - measured[:, None])
        blocks.append(np.arange(len(at)) * _PARTS // len(at) + _PARTS * number)
    groups = np.repeat(np.arange(len(samples)), [len(sample.rows) for sample in samples])
    inputs = explained.scaled(np.concatenate([sample.inputs for sample in samples]))
    design = np.hstack([inputs, groups[:, None] == np.arange(len(samples))])
    weights = np.concatenate([sample.weights for sample in samples])[:, None]
    target = np.concatenate(targets)
    normal = design.T @ (weights * design)
    normal[np.diag_indices_from(normal)] += _RIDGE * len(design)
    error = target - design @ np.linalg.solve(normal, design.T @ (weights * target))
    block = np.concatenate(blocks)
    starts = np.flatnonzero(np.diff(block, prepend=-1))
    return np.asarray(np.add.reduceat(weights * error**2, starts, axis=0))
