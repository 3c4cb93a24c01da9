"""Synthetic recordings of any robot, and calibrations small enough to check by hand."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from truejoint.recordings.recording import Provenance, Recording
from truejoint.robots import get_robot


def make_recording(
    robot: str = "raven2",
    arm: str = "",
    *,
    seconds: float = 30.0,
    rate: float = 30.0,
    seed: int = 0,
    effort: bool = True,
    source: str = "",
    **provenance: Any,
) -> Recording:
    """Sinusoids on every joint; the truth lags behind the motor side by stretch and play."""
    random = np.random.default_rng(seed)
    model = get_robot(robot, arm)
    t = np.arange(round(seconds * rate)) / rate
    columns: dict[str, np.ndarray] = {"t": t}
    truths = {}
    for joint in model.joints:
        scale = 0.5 if joint.unit == "rad" else 0.04
        centre = 1.0 if joint.unit == "rad" else 0.38
        speed, phase = random.uniform(0.4, 1.2), random.uniform(0, 6)
        position = centre + scale * np.sin(speed * t + phase) * np.cos(0.13 * t)
        way = np.tanh(8 * np.gradient(position, t) / scale)
        load = np.cos(position) + 0.4 * way
        columns[f"measured/{joint.name}"] = position
        if effort:
            columns[f"effort/{joint.name}"] = load + random.normal(0, 0.02, len(t))
        noise = random.normal(0, 0.002 * scale, len(t))
        truths[joint.name] = position - scale * (0.05 + 0.02 * load + 0.01 * way) + noise
    for name in model.positioning:
        columns[f"truth/{name}"] = truths[name]
    information = Provenance(
        robot=model.name, arm=model.arm, source=source or f"synthetic-{seed}.csv", **provenance
    )
    units = {f"effort/{joint.name}": joint.effort_unit for joint in model.joints} if effort else {}
    return Recording.from_columns(columns, information, units)


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
def recording_of() -> Callable[..., Recording]:
    return make_recording


@pytest.fixture(scope="session")
def calibration_of() -> Callable[..., SmallCalibration]:
    return make_calibration


@pytest.fixture(scope="session")
def fit_of() -> Callable[..., LeastSquares]:
    return fit
