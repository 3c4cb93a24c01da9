"""A delay between the truth and the robot's state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from truejoint.array_types import Array
from truejoint.recordings.checks.explained import Explained
from truejoint.recordings.recording import Recording

_SHIFTS: Final = np.linspace(-0.4, 0.4, 41)  # s
_NEAR: Final = np.linspace(-0.02, 0.02, 11)  # s, about the best of those
_BLOCKS: Final = 4  # of each recording, left out in turn for the uncertainty
_RIDGE: Final = 1e-7


@dataclass(frozen=True)
class Delay:
    """By how much the truth is late."""

    seconds: float
    uncertainty: float  # standard deviation by leaving parts out in turn [s]
    drop: float  # share by which the residual's variance falls when the truth is shifted back


def estimate_delay(
    recordings: Sequence[Sequence[Recording]], explained: Sequence[Explained]
) -> Delay:
    """Delay of all truth joints together: the shift at which the signals explain most.

    For each shift the truth is interpolated and the regression of `explain` made anew, with its
    weights; the logarithms of the residual's variance are added over joints.
    """
    pairs = list(zip(recordings, explained, strict=True))
    squares = [_squares(*pair, _SHIFTS) for pair in pairs]  # (blocks, shifts) each
    coarse, drop = _lowest(_SHIFTS, [s.sum(axis=0) for s in squares])
    blocks = range(len(squares[0]))
    left_out = [_lowest(_SHIFTS, [s.sum(axis=0) - s[k] for s in squares])[0] for k in blocks]
    near = coarse + _NEAR
    seconds, _ = _lowest(near, [_squares(*pair, near).sum(axis=0) for pair in pairs])
    return Delay(seconds, float(np.sqrt((len(blocks) - 1) * np.var(left_out))), drop)


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
    own = f"/{explained.joint}"
    targets, blocks = [], []
    for number, (recording, sample) in enumerate(zip(recordings, samples, strict=True)):
        t, truth = recording.t, recording.column("truth" + own)
        known = np.isfinite(truth)
        # Interpolating between rows averages noise; so does this, at every shift alike.
        padded = np.pad(truth[known], 1, mode="edge")
        smooth = 0.25 * padded[:-2] + 0.5 * padded[1:-1] + 0.25 * padded[2:]
        at, measured = t[sample.rows], recording.column("measured" + own)[sample.rows]
        shifted = [np.interp(at + shift, t[known], smooth) for shift in shifts]
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
