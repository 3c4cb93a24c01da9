"""A delay between the truth and the robot's state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from truejoint.array_types import Array
from truejoint.recordings.join.explained import SLOW, Explained
from truejoint.recordings.table.recording import Recording

LATE: Final = 0.015  # s, below which nothing is said

_SHIFTS: Final = np.linspace(-0.4, 0.4, 41)  # s
_NEAR: Final = np.linspace(-0.02, 0.02, 11)  # s, about the best of those
_BLOCKS: Final = 4  # of each recording, left out in turn for the uncertainty
_RIDGE: Final = 1e-7
_APART: Final = 2.0  # uncertainties of two delays that differ


@dataclass(frozen=True)
class Delay:
    """By how much the truth is late."""

    seconds: float
    uncertainty: float  # standard deviation by leaving parts out in turn, or between joints [s]
    drop: float  # share by which the residual's variance falls when the truth is shifted back
    slow: bool = False  # whether rows are too far apart to shift the truth between them


def estimate_delay(
    recordings: Sequence[Sequence[Recording]], explained: Sequence[Explained]
) -> Delay:
    """Delay of all truth joints together: the shift at which the signals explain most.

    For each shift the truth is interpolated and the regression of `explain` made anew, with its
    weights; the logarithms of the residual's variance are added over joints. Where rows are far
    apart, interpolating would average more noise than a shift explains: see `_by_velocity`.
    """
    pairs = list(zip(recordings, explained, strict=True))
    if np.median(np.diff(recordings[0][0].t)) > SLOW:
        return _by_velocity(pairs)
    squares = [_squares(*pair, _SHIFTS) for pair in pairs]  # (blocks, shifts) each
    coarse, drop = _lowest(_SHIFTS, [s.sum(axis=0) for s in squares])
    blocks = range(len(squares[0]))
    left_out = [_lowest(_SHIFTS, [s.sum(axis=0) - s[k] for s in squares])[0] for k in blocks]
    near = coarse + _NEAR
    seconds, _ = _lowest(near, [_squares(*pair, near).sum(axis=0) for pair in pairs])
    return Delay(seconds, float(np.sqrt((len(blocks) - 1) * np.var(left_out))), drop)


def delays_apart(
    recordings: Sequence[Sequence[Recording]], explained: Sequence[Explained]
) -> list[tuple[int, Delay]]:
    """Find recordings, by number, late by another time than the others.

    Each has a regression of its own.
    """
    count = len(recordings[0])
    if count < 2:
        return []
    alone = []
    for k in range(count):
        single = [replace(e, samples=e.samples[k : k + 1]) for e in explained]
        alone.append(estimate_delay([[each[k]] for each in recordings], single))
    values = np.array([(delay.seconds, delay.uncertainty) for delay in alone])
    late = []
    for k, delay in enumerate(alone):
        usual, uncertainty = np.median(np.delete(values, k, axis=0), axis=0)
        least = max(LATE, _APART * (delay.uncertainty + float(uncertainty)))
        if abs(delay.seconds - usual) > least:
            late.append((k, delay))
    return late


def _by_velocity(pairs: Sequence[tuple[Sequence[Recording], Explained]]) -> Delay:
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
            for part in np.array_split(np.arange(len(rows)), _BLOCKS):
                normal.append(rows[part].T @ (weights[part] * rows[part]))
                right.append(rows[part].T @ (sample.weights * sample.error)[part])
        penalty = np.diag(np.r_[0.0, np.full(len(inputs), _RIDGE * len(rows))])
        every = np.sum(normal, axis=0) + penalty, np.sum(right, axis=0)
        lags.append(-float(np.linalg.solve(*every)[0]))
        left_out = [
            -np.linalg.solve(every[0] - n, every[1] - r)[0]
            for n, r in zip(normal, right, strict=True)
        ]
        deviations.append(float(np.sqrt((len(left_out) - 1) * np.var(left_out))))
    within = float(np.sqrt(np.mean(np.square(deviations))))
    between = float(np.std(lags, ddof=1)) if len(lags) > 1 else 0.0
    return Delay(float(np.mean(lags)), max(within, between) / len(lags) ** 0.5, 0.0, slow=True)


def _lowest(shifts: Array, squares: Sequence[Array]) -> tuple[float, float]:
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
        blocks.append(np.arange(len(at)) * _BLOCKS // len(at) + _BLOCKS * number)
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
