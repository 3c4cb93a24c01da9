"""The worst stretches: windows of time in which a model was furthest from the truth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from truejoint.evaluation.results import JointVerdict, Stretch, Trace

Array = NDArray[np.float64]

_COUNT = 3  # windows of each joint


def worst_windows(
    t: Array, error: Array, window: float, count: int
) -> list[tuple[int, int, float]]:
    """Windows of one recording with the largest RMSE, at most `count`, worst first, apart.

    Each is (first, end, rmse): rows ``first:end`` of the stamps `t` (n,) [s] and the `error` (n,),
    which sets the unit. A shorter recording is one window. One covers at least half of `window`
    [s], so that a few rows beside a gap do not count, unless all rows are so far apart.
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
    traces: Sequence[Trace], chosen: str, joints: Sequence[JointVerdict], window: float
) -> tuple[Stretch, ...]:
    """Find the worst windows [s] of each joint over all recordings, worst first.

    Windows of different joints are ordered by their RMSE as a multiple of the joint's limit.
    """
    ranked: list[tuple[float, Stretch]] = []
    for column, (joint, unit, limit) in enumerate((v.joint, v.unit, v.limit) for v in joints):
        own: list[tuple[float, Stretch]] = []
        for index, trace in enumerate(traces):
            error = trace.error(chosen)[:, column]
            for first, end, rmse in worst_windows(trace.t, error, window, _COUNT):
                largest = float(np.abs(error[first:end]).max())
                start, stop = float(trace.t[first]), float(trace.t[end - 1])
                stretch = Stretch(joint, unit, index, start, stop, rmse, largest)
                own.append((rmse / limit if limit > 0 else rmse, stretch))
        ranked += sorted(own, key=_rank)[:_COUNT]
    return tuple(stretch for _, stretch in sorted(ranked, key=_rank))


def _rank(pair: tuple[float, Stretch]) -> float:
    return -pair[0]
