"""A recording whose signals are unlike those of all others, as of another instrument."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import numpy as np

from truejoint.array_types import Array
from truejoint.recordings.join.explained import Explained

_FEWEST: Final = 4  # recordings, of which one can stand apart
_FARTHER: Final = 10.0  # times as far as the others
_SMALLEST_VARIANCE: Final = 1e-4  # of scaled inputs in any direction


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
