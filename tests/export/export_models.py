"""Calibrations with random numbers in them, and recordings to run them on."""

from collections.abc import Sequence

import numpy as np

from truejoint.calibration import Calibration
from truejoint.calibration.domain import fit_training_domain
from truejoint.calibration.interval import Interval
from truejoint.calibration.origin import Origin
from truejoint.estimators.base import JointRegressor
from truejoint.estimators.family import EstimatorData
from truejoint.features.feature_set import FeatureSet
from truejoint.recordings import Provenance, Recording
from truejoint.robots import get_robot

PLAIN = ("measured/elbow", "effort/elbow", "effort/roll", "measured/insertion")
HISTORY = (
    "measured/elbow", "lag(effort/elbow, 3)", "rate(measured/shoulder, 0.02)",
    "lowpass(effort/elbow, 0.05)", "play(measured/insertion, 0.03)", "lag(measured/elbow, 1)",
)  # fmt: skip


def recording(columns: Sequence[str], n: int = 400, seed: int = 0, rate: float = 30.0) -> Recording:
    """Smooth random motion of every column, at a jittering rate [Hz]."""
    rng = np.random.default_rng(seed)
    t = 5.0 + np.cumsum(rng.uniform(0.8, 1.2, n)) / rate
    frequency, phase = rng.uniform(0.1, 0.6, (2, 3, len(columns)))
    waves = 0.1 * np.sin(2 * np.pi * t[:, None, None] * frequency + 6 * phase).sum(axis=1) + 0.5
    units = {name: "Nm" for name in columns if name.startswith("effort")}
    values = {"t": t} | dict(zip(columns, waves.T, strict=True))
    return Recording.from_columns(values, Provenance("raven2", arm="left"), units)


def columns(features: Sequence[str], joints: Sequence[str]) -> list[str]:
    """Columns that a calibration of `joints` by `features` needs."""
    measured = [f"measured/{joint}" for joint in joints]
    return list(dict.fromkeys([*FeatureSet.parse(features).signals, *measured]))


def calibration(
    estimator: JointRegressor,
    features: Sequence[str] = PLAIN,
    joints: Sequence[str] = ("shoulder", "elbow", "insertion"),
    target: str = "error",
    seed: int = 0,
    rezero: float | None = None,
    homing_ids: Sequence[str] = ("h1",),
) -> Calibration:
    """Calibration of which every learnt number is random; its predictions are of order 0.01.

    With `rezero` it has an interval, which holds after so many seconds of truth.
    """
    rng = np.random.default_rng(seed)
    feature_set = FeatureSet.parse(features)
    training = recording(columns(features, joints), seed=seed)
    X = feature_set.compute(training)
    family, params = estimator.family, estimator.model_params()
    shapes = family.shapes(params, len(feature_set), len(joints))
    arrays = {name: rng.normal(0, 0.5, shape) for name, shape in shapes.items()}
    arrays |= {n: 0.01 * arrays[n] for n in ("coef", "offset", "target_scale") if n in arrays}
    if "mean" in arrays:
        spread = X.std(axis=0)
        arrays["mean"] = X.mean(axis=0)
        arrays["inverse_scale"] = np.where(rng.random(len(spread)) < 0.1, 0.0, 1.0 / spread)
    model = type(estimator).from_data(
        EstimatorData(family.name, params, arrays), len(feature_set), len(joints)
    )
    needed = columns(features, joints)
    error = model.evaluate(X)
    resting = np.zeros(len(feature_set), dtype=bool)
    if target == "position":
        error = error - training.columns("measured", joints)
    widths = np.sort(rng.uniform(0.001, 0.01, (2, len(joints))), axis=0)
    return Calibration(
        machine=get_robot("raven2", "left"),
        joints=tuple(joints),
        feature_set=feature_set,
        target=target,
        units={name: training.units[name] for name in needed},
        gap_limit=0.3,
        lower=X.min(axis=0),
        upper=X.max(axis=0),
        fitted=model.data,
        learnt=model,
        fitted_baselines={},
        origin=Origin(sample_dt=1 / 30, homing_ids=tuple(homing_ids)),
        metadata={"data_sha256": "0" * 64},
        training_domain=fit_training_domain([training], needed, 0.3, X, error, resting, joints),
        interval=None
        if rezero is None
        else Interval(np.array([0.8, 0.9]), widths, 2.0, rezero, 12, 12),
    )  # fmt: skip
