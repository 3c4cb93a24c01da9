"""Scores of models from their errors: pooled over recordings, averaged over seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truejoint.evaluation.metrics import max_abs, mean_error, percent_of, rmse
from truejoint.evaluation.results import OFFSET, CartesianScore, RecordingScore, Score, Trace

Array = NDArray[np.float64]


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
    roots = {name: np.array([rmse(error) for error in seeds]) for name, seeds in pooled.items()}
    offset = roots[OFFSET].mean(axis=0)
    rows = []
    for name, seeds in pooled.items():
        value, spread = roots[name].mean(axis=0), _spread(roots[name])
        largest = np.max([max_abs(error) for error in seeds], axis=0)
        bias = np.mean([mean_error(error) for error in seeds], axis=0)
        percent = percent_of(value, offset)
        rows += [
            Score(
                estimator=name,
                joint=joint,
                unit=unit,
                rmse=float(value[j]),
                max_abs=float(largest[j]),
                mean=float(bias[j]),
                percent_of_offset=float(percent[j]),
                spread=float(spread[j]),
                seeds=len(seeds),
            )
            for j, (joint, unit) in enumerate(zip(joints, units, strict=True))
        ]
    return tuple(rows)


def recording_scores(
    tested: Sequence[JudgedRecording], joints: Sequence[str], units: Sequence[str]
) -> tuple[RecordingScore, ...]:
    """One `RecordingScore` per recording, estimator and joint."""
    return tuple(
        RecordingScore(
            recording=test.trace.name,
            estimator=name,
            joint=joint,
            unit=unit,
            rmse=float(np.mean([rmse(error[:, j]) for error in seeds])),
            max_abs=float(np.max([max_abs(error[:, j]) for error in seeds])),
            mean=float(np.mean([mean_error(error[:, j]) for error in seeds])),
        )
        for test in tested
        for name, seeds in test.errors.items()
        for j, (joint, unit) in enumerate(zip(joints, units, strict=True))
    )


def cartesian_scores(tested: Sequence[JudgedRecording]) -> tuple[CartesianScore, ...]:
    """One `CartesianScore` per estimator; none where there are no tool errors."""
    pooled = {
        name: _pooled([test.tool_errors[name] for test in tested]) for name in tested[0].tool_errors
    }
    if not pooled:
        return ()
    distances = {
        name: [np.linalg.norm(error, axis=1) for error in seeds] for name, seeds in pooled.items()
    }
    roots = {name: np.array([rmse(d) for d in seeds]) for name, seeds in distances.items()}
    offset = roots[OFFSET].mean()
    rows = []
    for name, seeds in pooled.items():
        x, y, z = np.mean([rmse(error) for error in seeds], axis=0)
        rows.append(
            CartesianScore(
                estimator=name,
                rmse=float(roots[name].mean()),
                max_abs=float(np.max([d.max() for d in distances[name]])),
                x=float(x),
                y=float(y),
                z=float(z),
                percent_of_offset=float(percent_of(roots[name].mean(), offset)),
                spread=float(_spread(roots[name])),
                seeds=len(seeds),
            )
        )
    return tuple(rows)


def _pooled(by_recording: Sequence[Sequence[Array]]) -> list[Array]:
    """Rows of all recordings together, seed by seed."""
    return [np.concatenate(parts) for parts in zip(*by_recording, strict=True)]


def _spread(values: Array) -> Array:
    """Sample standard deviation over seeds (axis 0); NaN with fewer than two."""
    if len(values) < 2:
        return np.full(values.shape[1:], np.nan)
    return np.asarray(values.std(axis=0, ddof=1))
