"""The worst stretches: windows of time in which a model was furthest from the truth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from truejoint.evaluation.results import Stretch, Trace

Array = NDArray[np.float64]


def worst_windows(
    t: Array, error: Array, window: float, count: int
) -> list[tuple[int, int, float]]:
    """Windows of one recording with the largest RMSE, worst first, not overlapping.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Increasing time stamps [s].
    error : ndarray, shape (n,)
        Estimated minus true position [rad or m].
    window : float
        Length [s]; a shorter recording is one window. A window covers at least half of it, so
        that a few rows beside a gap do not count as a stretch, unless all rows are so far apart.
    count : int
        At most so many windows.

    Returns
    -------
    list of (first, end, rmse)
        Rows ``first:end`` and their RMSE [rad or m].
    """
    n = len(t)
    first = np.arange(n)
    end = np.searchsorted(t, t + window, side="right")
    total = np.concatenate(([0.0], np.cumsum(np.square(error))))
    mean_square = (total[end] - total[first]) / (end - first)
    long_enough = t[end - 1] - t >= 0.5 * min(window, float(t[-1] - t[0]))
    candidates = np.flatnonzero(long_enough) if long_enough.any() else first
    order = candidates[np.argsort(-mean_square[candidates], kind="stable")]
    free = np.ones(n, dtype=bool)
    found: list[tuple[int, int, float]] = []
    for row in order:
        if len(found) == count:
            break
        if free[row] and free[end[row] - 1]:
            free[row : end[row]] = False
            found.append((int(row), int(end[row]), float(np.sqrt(max(mean_square[row], 0.0)))))
    return found


def worst_stretches(
    traces: Sequence[Trace],
    chosen: str,
    joints: Sequence[str],
    units: Sequence[str],
    limits: Sequence[float],
    *,
    window: float = 10.0,
    count: int = 3,
) -> tuple[Stretch, ...]:
    """Find the `count` worst windows of each joint over all recordings, worst first.

    Parameters
    ----------
    traces : sequence of Trace
    chosen : str
        Estimator whose error counts.
    joints, units : sequence of str
    limits : sequence of float
        Tolerance of each joint [rad or m]; windows of different joints are ordered by their
        RMSE as a multiple of it.
    window, count
        See `worst_windows`.
    """
    ranked: list[tuple[float, Stretch]] = []
    for column, (joint, unit, limit) in enumerate(zip(joints, units, limits, strict=True)):
        own: list[tuple[float, Stretch]] = []
        for index, trace in enumerate(traces):
            error = trace.estimates[chosen][:, column] - trace.truth[:, column]
            for first, end, rmse in worst_windows(trace.t, error, window, count):
                largest = float(np.abs(error[first:end]).max())
                start, stop = float(trace.t[first]), float(trace.t[end - 1])
                stretch = Stretch(joint, unit, index, start, stop, rmse, largest)
                own.append((rmse / limit if limit > 0 else rmse, stretch))
        own.sort(key=lambda pair: -pair[0])
        ranked += own[:count]
    ranked.sort(key=lambda pair: -pair[0])
    return tuple(stretch for _, stretch in ranked)
