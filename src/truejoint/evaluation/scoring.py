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
    found = _over_seeds(pooled)
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
    distances = {k: [np.linalg.norm(e, axis=1) for e in seeds] for k, seeds in pooled.items()}
    rows = []
    for name, found in _over_seeds(distances).items():
        axes = np.mean([rmse(error) for error in pooled[name]], axis=0)
        values = {key: float(value) for key, value in found.items() if key != "mean"}
        values |= dict(zip("xyz", map(float, axes), strict=True))
        rows.append(CartesianScore(estimator=name, seeds=len(pooled[name]), **values))
    return tuple(rows)


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
