"""Calibrations small enough to check by hand."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from truejoint.calibration.origin import Origin
from truejoint.recordings.table.recording import Recording


@dataclass(frozen=True)
class LeastSquares:
    """Linear model of the error on the signals and, when asked, the sign of the speed."""

    joints: tuple[str, ...]
    signals: tuple[str, ...]
    weights: np.ndarray
    history: bool = False

    def correct(self, recording: Recording) -> np.ndarray:
        measured = recording.columns("measured", self.joints)
        return measured + self.inputs(recording) @ self.weights

    def inputs(self, recording: Recording) -> np.ndarray:
        columns = [np.ones(len(recording)), *(recording.column(name) for name in self.signals)]
        if self.history:
            measured = recording.columns("measured", self.joints)
            columns += list(np.sign(np.gradient(measured, recording.t, axis=0)).T)
        return np.column_stack(columns)


@dataclass(frozen=True)
class SmallCalibration:
    """A calibration with the baselines that an evaluation asks for."""

    joints: tuple[str, ...]
    model: LeastSquares
    baselines: Mapping[str, LeastSquares]
    metadata: Mapping[str, Any] = field(default_factory=dict)
    origin: Origin = field(default_factory=Origin)

    def correct(self, recording: Recording) -> np.ndarray:
        return self.model.correct(recording)


def fit(
    recordings: Sequence[Recording],
    signals: Sequence[str],
    *,
    history: bool = False,
    shake: float = 0.0,
    seed: int = 0,
) -> LeastSquares:
    joints = tuple(recordings[0].robot.positioning)
    blank = LeastSquares(joints, tuple(signals), np.zeros(0), history)
    inputs = np.concatenate([blank.inputs(r) for r in recordings])
    targets = np.concatenate([r.error(joints) for r in recordings])
    weights = np.linalg.lstsq(inputs, targets, rcond=None)[0]
    weights = weights * (1 + shake * np.random.default_rng(seed).normal(size=weights.shape))
    return LeastSquares(joints, tuple(signals), weights, history)


def make_calibration(recordings: Sequence[Recording], *, seed: int = 0) -> SmallCalibration:
    first = recordings[0]
    joints = tuple(first.robot.positioning)
    measured = [f"measured/{name}" for name in joints]
    efforts = [f"effort/{name}" for name in joints if f"effort/{name}" in first.units]
    baselines = {
        "offset": fit(recordings, []),
        "linear": fit(recordings, measured),
        "poly2": fit(recordings, measured, shake=0.01),
    }
    model = fit(recordings, measured + efforts, history=True, shake=0.002, seed=seed)
    return SmallCalibration(joints, model, baselines, {"random_state": seed, "rows": 100})


@pytest.fixture(scope="session")
def calibration_of() -> Callable[..., SmallCalibration]:
    return make_calibration


@pytest.fixture(scope="session")
def fit_of() -> Callable[..., LeastSquares]:
    return fit
