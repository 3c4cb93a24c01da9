"""Scores of models from their errors, pooled over recordings and averaged over seeds; the worst."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from truejoint.array_types import Array
from truejoint.evaluation.metrics import max_abs, mean_error, percent_of, rmse
from truejoint.evaluation.results import (
    OFFSET,
    CartesianScore,
    JointVerdict,
    RecordingScore,
    Score,
    Stretch,
    Trace,
)

_COUNT = 3  # worst windows of each joint


@dataclass(frozen=True, eq=False)
class JudgedRecording:
    """One test recording: errors (n, n_joints) and tool errors (n, 3) by estimator and seed."""

    trace: Trace
    errors: Mapping[str, list[Array]]
    tool_errors: Mapping[str, list[Array]]


def joint_scores(
    tested: Sequence[JudgedRecording], joints: Sequence[str], units: Sequence[str]
) -> tuple[Score, ...]:
    """One `Score` per estimator and joint, over the rows of all recordings together."""
    pooled = {name: _pooled([test.errors[name] for test in tested]) for name in tested[0].errors}
    found = _over_seeds(pooled)
    inside = np.concatenate([test.trace.inside for test in tested])
    for name, seeds in pooled.items():
        for key, rows in (("rmse_inside", inside), ("rmse_outside", ~inside)):
            roots = [rmse(error[rows]) for error in seeds] if rows.any() else [math.nan]
            found[name][key] = np.broadcast_to(np.mean(roots, axis=0), len(joints))
    return tuple(
        Score(
            estimator=name,
            joint=joint,
            unit=unit,
            seeds=len(seeds),
            **{key: float(values[j]) for key, values in found[name].items()},
        )
        for name, seeds in pooled.items()
        for j, (joint, unit) in enumerate(zip(joints, units, strict=True))
    )


def recording_scores(
    tested: Sequence[JudgedRecording], joints: Sequence[str], units: Sequence[str]
) -> Iterator[RecordingScore]:
    """One `RecordingScore` per recording, estimator and joint."""
    for test in tested:
        for name, seeds in test.errors.items():
            for j, (joint, unit) in enumerate(zip(joints, units, strict=True)):
                own = [error[:, j] for error in seeds]
                root, bias = (np.mean([how(e) for e in own]) for how in (rmse, mean_error))
                values = map(float, (root, np.max([max_abs(e) for e in own]), bias))
                yield RecordingScore(test.trace.name, name, joint, unit, *values)


def cartesian_scores(tested: Sequence[JudgedRecording]) -> Iterator[CartesianScore]:
    """One `CartesianScore` per estimator; none where there are no tool errors."""
    pooled = {
        name: _pooled([test.tool_errors[name] for test in tested]) for name in tested[0].tool_errors
    }
    distances = {k: [np.linalg.norm(e, axis=1) for e in seeds] for k, seeds in pooled.items()}
    for name, found in _over_seeds(distances).items():
        axes = np.mean([rmse(error) for error in pooled[name]], axis=0)
        values = {key: float(value) for key, value in found.items() if key != "mean"}
        values |= dict(zip("xyz", map(float, axes), strict=True))
        yield CartesianScore(estimator=name, seeds=len(pooled[name]), **values)


def _pooled(by_recording: Sequence[Sequence[Array]]) -> list[Array]:
    """Rows of all recordings together, seed by seed."""
    return [np.concatenate(parts) for parts in zip(*by_recording, strict=True)]


def _over_seeds(errors: Mapping[str, Sequence[Array]]) -> dict[str, dict[str, Array]]:
    """RMSE and the like, () or (k,), of errors (n,) or (n, k) by estimator and seed."""
    roots = {name: np.array([rmse(error) for error in seeds]) for name, seeds in errors.items()}
    return {
        name: {
            "rmse": roots[name].mean(axis=0),
            "max_abs": np.max([max_abs(error) for error in seeds], axis=0),
            "mean": np.mean([mean_error(error) for error in seeds], axis=0),
            "percent_of_offset": percent_of(roots[name].mean(axis=0), roots[OFFSET].mean(axis=0)),
            "spread": spread(roots[name]),
        }
        for name, seeds in errors.items()
    }


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
    """Worst windows [s] of each joint over all recordings, by RMSE as a multiple of its limit."""
    ranked: list[tuple[float, Stretch]] = []
    for column, own in enumerate(joints):
        found = []
        for index, trace in enumerate(traces):
            error = trace.error(chosen)[:, column]
            for first, end, root in worst_windows(trace.t, error, window, _COUNT):
                largest = float(np.abs(error[first:end]).max())
                start, stop = float(trace.t[first]), float(trace.t[end - 1])
                stretch = Stretch(own.joint, own.unit, index, start, stop, root, largest)
                found.append((root / own.limit if own.limit > 0 else root, stretch))
        ranked += sorted(found, key=lambda pair: -pair[0])[:_COUNT]
    return tuple(stretch for _, stretch in sorted(ranked, key=lambda pair: -pair[0]))
