"""Scores of models from their errors, pooled over recordings and averaged over seeds; the worst."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from truejoint.array_types import Array, Mask
from truejoint.evaluation.metrics import percent_of
from truejoint.evaluation.results import OFFSET, TOOL, JointVerdict, Score, Stretch, Trace

_COUNT = 3  # worst windows of each joint


@dataclass(frozen=True, eq=False)
class JudgedRecording:
    """One test recording: errors (n, n_joints) and tool errors (n, 3) by estimator and seed."""

    trace: Trace
    errors: Mapping[str, list[Array]]
    tool_errors: Mapping[str, list[Array]]


def score_errors(
    tested: Sequence[JudgedRecording], joints: Sequence[str], units: Sequence[str]
) -> Iterator[Score]:
    """Score estimators in each joint over all recordings, the tool likewise, then each recording.

    Joints are `joints`, with their SI `units`.
    """
    pooled = _stacked([test.errors for test in tested])
    inside = np.concatenate([test.trace.inside for test in tested])
    yield from _scores(pooled, joints, units, inside=inside)
    vectors = _stacked([test.tool_errors for test in tested])
    lengths = {name: np.linalg.norm(e, axis=2)[..., None] for name, e in vectors.items()}
    for score in _scores(lengths, [TOOL], ["m"]):
        axes = _rmse(vectors[score.estimator]).mean(axis=0).tolist()
        yield replace(score, mean=math.nan, **dict(zip("xyz", axes, strict=True)))
    for test in tested:
        yield from _scores(_stacked([test.errors]), joints, units, recording=test.trace.name)


def _stacked(recordings: Sequence[Mapping[str, Sequence[Array]]]) -> dict[str, Array]:
    """Errors (seeds, rows, k) by estimator, the rows of all recordings together."""
    return {
        name: np.stack([np.concatenate(arrays) for arrays in zip(*parts, strict=True)])
        for name in recordings[0]
        if (parts := [errors[name] for errors in recordings])
    }


def _rmse(errors: Array) -> Array:
    """RMSE (seeds, k) of errors (seeds, rows, k); NaN without rows."""
    if not errors.shape[1]:
        return np.full(errors.shape[::2], np.nan)
    return np.asarray(np.sqrt(np.mean(np.square(errors), axis=1)))


def _scores(
    errors: Mapping[str, Array],
    joints: Sequence[str],
    units: Sequence[str],
    *,
    inside: Mask | None = None,
    recording: str = "",
) -> Iterator[Score]:
    """Score errors (seeds, rows, n_joints) by estimator; `inside` (rows,) splits them."""
    roots = {name: _rmse(error) for name, error in errors.items()}
    for name, error in errors.items():
        root = roots[name].mean(axis=0)
        columns = {
            "rmse": root,
            "max_abs": np.abs(error).max(axis=(0, 1)),
            "mean": error.mean(axis=1).mean(axis=0),
            "percent_of_offset": percent_of(root, roots[OFFSET].mean(axis=0)),
            "spread": spread(roots[name]),
        }
        if inside is not None:
            columns["rmse_inside"] = _rmse(error[:, inside]).mean(axis=0)
            columns["rmse_outside"] = _rmse(error[:, ~inside]).mean(axis=0)
        rows = zip(*(values.tolist() for values in columns.values()), strict=True)
        for joint, unit, row in zip(joints, units, rows, strict=True):
            values = dict(zip(columns, row, strict=True))
            yield Score(name, joint, unit, seeds=len(error), recording=recording, **values)


def spread(values: Array) -> Array:
    """Sample standard deviation over seeds (axis 0); NaN with fewer than two."""
    if len(values) < 2:
        return np.full(values.shape[1:], np.nan)
    return np.asarray(values.std(axis=0, ddof=1))


def worst_windows(
    t: Array, error: Array, window: float, count: int
) -> list[tuple[int, int, float]]:
    """Windows of one recording with the largest RMSE, at most `count`, worst first, apart.

    Each is (first, end, rmse): rows ``first:end`` of the stamps `t` (n,) [s] and the `error` (n,).
    One covers at least half of `window` [s], so that a few rows beside a gap do not count.
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
    windows: list[tuple[int, int, float]] = []
    for row in order:
        if len(windows) == count:
            break
        if free[row] and free[end[row] - 1]:
            free[row : end[row]] = False
            windows.append((int(row), int(end[row]), float(np.sqrt(max(mean_square[row], 0.0)))))
    return windows


def worst_stretches(
    traces: Sequence[Trace], chosen: str, joints: Sequence[JointVerdict], window: float
) -> tuple[Stretch, ...]:
    """Worst windows [s] of each joint over all recordings, by RMSE as a multiple of its limit."""
    ranked: list[tuple[float, Stretch]] = []
    for column, verdict in enumerate(joints):
        stretches = []
        for index, trace in enumerate(traces):
            error = trace.error(chosen)[:, column]
            for first, end, root in worst_windows(trace.t, error, window, _COUNT):
                largest = float(np.abs(error[first:end]).max())
                start, stop = float(trace.t[first]), float(trace.t[end - 1])
                stretch = Stretch(verdict.joint, verdict.unit, index, start, stop, root, largest)
                stretches.append((root / verdict.limit if verdict.limit > 0 else root, stretch))
        ranked += sorted(stretches, key=lambda pair: -pair[0])[:_COUNT]
    return tuple(stretch for _, stretch in sorted(ranked, key=lambda pair: -pair[0]))
