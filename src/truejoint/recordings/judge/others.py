"""Recordings compared with all the others: a zero that moved, signals of another instrument."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np

from truejoint.array_types import Array
from truejoint.recordings.join.explained import Explained, robust_spread

_RIDGE: Final = 1e-2  # of the rows, for standardised columns: a recording left out may lie outside
_FEWEST: Final = 4  # recordings, of which one can stand apart
_FARTHER: Final = 10.0  # times as far as the others
_SMALLEST_VARIANCE: Final = 1e-4  # of scaled inputs in any direction


@dataclass(frozen=True, eq=False)
class Zeros:
    """Median residuals of recordings, each by a model that was fitted to the others."""

    raw: Array  # (n,), each from what the others predict [rad or m]
    spread: float  # of a left-out recording's residual about its median, the median of all

    @property
    def offsets(self) -> Array:
        """Those about their median (n,): one that moved shifts what is predicted of the others."""
        return np.asarray(self.raw - np.median(self.raw))


def left_out_zeros(explained: Explained) -> Zeros:
    """Offset of each of two or more recordings from what the others, with one zero, predict."""
    inputs = [explained.scaled(s.inputs) for s in explained.samples]
    designs = [np.hstack([x, np.ones((len(x), 1))]) for x in inputs]
    pairs = list(zip(designs, explained.samples, strict=True))
    normal = np.array([(d * s.weights[:, None]).T @ d for d, s in pairs])
    right = np.array([d.T @ (s.weights * s.error) for d, s in pairs])
    all_normal, all_right = normal.sum(axis=0), right.sum(axis=0)
    medians, spreads = [], []
    for matrix, own_right, (design, sample) in zip(normal, right, pairs, strict=True):
        others = all_normal - matrix
        k = len(others) - 1
        others[np.arange(k), np.arange(k)] += _RIDGE * others[-1, -1]
        residual = sample.error - design @ np.linalg.solve(others, all_right - own_right)
        medians.append(float(np.median(residual)))
        spreads.append(robust_spread(residual))
    return Zeros(np.array(medians), float(np.median(spreads)))


def distances(explained: Explained) -> Array:
    """Root mean square Mahalanobis distance (n,) of each recording's inputs from the others'."""
    inputs = [explained.scaled(sample.inputs) for sample in explained.samples]
    sums = np.array([x.sum(axis=0) for x in inputs])
    squares = np.array([x.T @ x for x in inputs])
    counts = np.array([len(x) for x in inputs])
    rms = []
    for index, x in enumerate(inputs):
        n = counts.sum() - counts[index]
        mean = (sums.sum(axis=0) - sums[index]) / n
        covariance = (squares.sum(axis=0) - squares[index]) / n - np.outer(mean, mean)
        values, vectors = np.linalg.eigh(covariance)
        away = (x - mean) @ vectors / np.sqrt(np.maximum(values, _SMALLEST_VARIANCE))
        rms.append(np.sqrt(np.mean(away**2)))
    return np.array(rms)


def foreign(explained: Explained) -> Iterable[tuple[int, float]]:
    """Yield recordings, by number, and how many times as far away they are as is usual."""
    if len(explained.samples) >= _FEWEST:
        away = distances(explained)
        times = away / np.median(away)
        yield from ((int(k), float(times[k])) for k in np.flatnonzero(times > _FARTHER))
