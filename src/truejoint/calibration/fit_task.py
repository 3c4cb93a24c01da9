"""What an estimator is to learn from recordings, and how it is fitted to their rows."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple, Self

import numpy as np
from sklearn.base import clone

from truejoint.array_types import Array
from truejoint.calibration.compatibility import (
    check_unit,
    chosen_features,
    chosen_joints,
    common_robot,
    common_units,
)
from truejoint.calibration.rows import Rows
from truejoint.calibration.training_rows import fitted_rows, partly_known, training_rows
from truejoint.errors import CalibrationError
from truejoint.estimators.base import JointRegressor, Progress, constant_columns, untold
from truejoint.estimators.family import TARGETS, EstimatorData, Target
from truejoint.estimators.registry import BASELINES
from truejoint.estimators.wrapped import Regressor, get_estimator, joint_regressor
from truejoint.features.feature_set import (
    FeatureSet,
    check_sample_dt,
    default_gap_limit,
    sample_dt,
)
from truejoint.recordings import Recording
from truejoint.robots import Robot

_BASELINE_SHARE: Final = 0.1  # of the progress bar


def unfitted(
    estimator: str | Regressor, target: Target | None, random_state: int | None
) -> JointRegressor:
    """Unfitted copy that can predict the target; raises CalibrationError where it cannot."""
    if target not in (None, *TARGETS):
        raise CalibrationError(f"target {target!r} is not 'error' or 'position'")
    named = get_estimator(estimator) if isinstance(estimator, str) else estimator
    model: JointRegressor = clone(joint_regressor(named))
    if target is not None and target not in model.family.targets:
        raise CalibrationError(
            f"{model.name} cannot predict the {target}; use target "
            f"{' or '.join(map(repr, model.family.targets))}"
        )
    if random_state is not None:
        seeds = [name for name in model.get_params() if name.split("__")[-1] == "random_state"]
        model.set_params(**dict.fromkeys(seeds, random_state))
    model.check_params()
    return model


class Fitted(NamedTuple):
    """A fitted model, its baselines, and why one of these is absent or weak."""

    model: JointRegressor
    baselines: dict[str, EstimatorData]
    notes: dict[str, str]


@dataclass(frozen=True)
class FitTask:
    """What a model is to learn, determined before anything is fitted."""

    recordings: Sequence[Recording]
    robot: Robot
    model: JointRegressor  # unfitted
    target: Target
    joints: tuple[str, ...]
    feature_set: FeatureSet
    dt: float  # median time between rows [s]
    gap_limit: float  # [s]
    units: dict[str, str]

    @classmethod
    def of(
        cls,
        recordings: Sequence[Recording],
        estimator: str | Regressor,
        features: FeatureSet | Iterable[str] | None,
        joints: Sequence[str] | None,
        target: Target | None,
        random_state: int | None,
    ) -> Self:
        """Determine what is not stated, as `calibrate` says; raises CalibrationError as it does."""
        robot = common_robot(recordings)
        model = unfitted(estimator, target, random_state).for_recordings(recordings)
        chosen = chosen_joints(robot, recordings, joints)
        feature_set = chosen_features(model, robot, recordings, features)
        model = model.for_features(feature_set.names, robot, chosen)
        dt = sample_dt(recordings)
        if feature_set.counts_samples or model.family.counts_samples:
            for recording in recordings:
                check_sample_dt(recording, dt)
        return cls(
            recordings,
            robot,
            model,
            target or model.family.targets[0],
            chosen,
            feature_set,
            dt,
            default_gap_limit(recordings),
            common_units(recordings, feature_set, chosen),
        )

    def rows(self, stride: int) -> list[Rows]:
        """Rows of each recording; a fit uses every `stride`-th."""
        return training_rows(self.recordings, self.feature_set, self.joints, self.gap_limit, stride)

    def unused_features(self, parts: Sequence[Rows]) -> list[str]:
        """Features that never change in the rows of a fit, so nothing is learnt of them.

        Raises CalibrationError if the model insists on one, or it is the position of a joint.
        """
        names = self.feature_set.names
        constant = [names[i] for i in np.flatnonzero(constant_columns(fitted_rows(parts, "X")))]
        fixed = self.model.family.inputs is not None
        measured = {f"measured/{joint}" for joint in self.joints}
        stuck = [name for name in constant if fixed or name in measured]
        if stuck or len(constant) == len(names):
            raise CalibrationError(
                f"features {', '.join(stuck or constant)} never change in the training rows, so "
                "nothing can be learnt of them; move those joints, check their sensors, or leave "
                "the features or joints out"
            )
        return constant

    def fit(self, parts: Sequence[Rows], report: Progress = untold) -> Fitted:
        """Fit the model and its baselines; raises CalibrationError if there are too few rows."""
        n_features = len(self.feature_set) - len(self.unused_features(parts))
        n_rows = sum(len(part.fitted) for part in parts)
        needed = self.model.minimum_rows(n_features)
        if n_rows < needed:
            raise CalibrationError(
                f"{n_rows} rows with truth; {self.model.name} with {n_features} features needs "
                f"{needed}: record for longer, or choose fewer features or a simpler estimator"
            )
        report = within(report, 0.0, 1.0 - _BASELINE_SHARE)
        model = fit_model(clone(self.model), parts, self.target, report)
        return Fitted(model, *_fit_baselines(*partly_known(parts), n_features))


def within(report: Progress, begin: float, share: float) -> Progress:
    """Progress of a part of what `report` is called for, from `begin` on."""
    return lambda fraction: report(begin + share * fraction)


def fit_model(
    model: JointRegressor, parts: Sequence[Rows], target: Target, report: Progress = untold
) -> JointRegressor:
    """Fit a model to rows, those without truth included where it remembers them."""
    if model.partial:
        return model.fit(*partly_known(parts, target), report)
    if not model.family.remembers:
        known = "error" if target == "error" else "truth"
        return model.fit(fitted_rows(parts, "X"), fitted_rows(parts, known), report)
    inputs, targets, dt = (
        np.concatenate(values)
        for values in zip(*((p.X, p.fitted_targets(target), p.dt) for p in parts), strict=True)
    )
    names = model.truth_beside()
    loads = np.zeros((len(inputs), len(names)))  # [Nm], 0 where a recording has none
    pieces = np.split(loads, np.cumsum([len(part) for part in parts])[:-1])
    for part, columns in zip(parts, pieces, strict=True):
        for column, name in zip(columns.T, names, strict=True):
            if name in part.recording.units:
                check_unit(part.recording, name, "Nm", "and is learnt in")
                column[:] = part.recording.column(name)
    return model.fit(inputs, targets, report, dt, loads)


def data_of(model: JointRegressor) -> EstimatorData:
    """Give a fitted estimator as data; no file holds that of one that runs in memory alone."""
    return EstimatorData(model.family.name, model.model_params(), model.arrays_)


def _fit_baselines(
    X: Array, error: Array, n_features: int
) -> tuple[dict[str, EstimatorData], dict[str, str]]:
    """Baselines fitted to the error, and why one is weak or absent."""
    fitted: dict[str, EstimatorData] = {}
    notes: dict[str, str] = {}
    for name in BASELINES:
        model = get_estimator(name)
        try:
            fitted[name] = data_of(model.fit(X, error))
        except CalibrationError as reason:
            notes[name] = f"left out: {reason}"
            continue
        needed = model.minimum_rows(n_features)
        if len(X) < needed:
            notes[name] = f"fitted to {len(X)} rows, though it needs {needed}"
    return fitted, notes
