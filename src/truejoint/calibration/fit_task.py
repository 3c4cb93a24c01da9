"""What an estimator is to learn from recordings: their rows, zeros taken off these, and the fit."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Final, Self

import numpy as np
from sklearn.base import clone

from truejoint.array_types import Array
from truejoint.calibration import compatibility
from truejoint.calibration.calibration import Fit
from truejoint.calibration.rows import Rows
from truejoint.errors import CalibrationError
from truejoint.estimators.base import JointRegressor, Progress, constant_columns, untold
from truejoint.estimators.family import TARGETS, EstimatorData, Target
from truejoint.estimators.registry import BASELINES
from truejoint.estimators.wrapped import Regressor, get_estimator, joint_regressor
from truejoint.features.feature_set import FeatureSet, check_sample_dt, default_gap_limit, sample_dt
from truejoint.recordings import Recording
from truejoint.recordings.join.explained import gross_outliers
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
        robot = compatibility.common_robot(recordings)
        model = unfitted(estimator, target, random_state).for_recordings(recordings)
        chosen = compatibility.chosen_joints(robot, recordings, joints)
        feature_set = compatibility.chosen_features(model, robot, recordings, features)
        model = model.for_features(feature_set.names, robot, chosen)
        dt = sample_dt(recordings)
        if feature_set.counts_samples or model.family.counts_samples:
            for recording in recordings:
                check_sample_dt(recording, dt)
        target, gap_limit = target or model.family.targets[0], default_gap_limit(recordings)
        units = compatibility.common_units(recordings, feature_set, chosen)
        return cls(recordings, robot, model, target, chosen, feature_set, dt, gap_limit, units)

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

    def fit(self, parts: Sequence[Rows], report: Progress = untold) -> tuple[Fit, dict[str, str]]:
        """Fit the model and its baselines, and say why one of these is absent or weak.

        Raises CalibrationError if there are too few rows.
        """
        n_features = len(self.feature_set) - len(self.unused_features(parts))
        n_rows = sum(len(part.fitted) for part in parts)
        needed = self.model.minimum_rows(n_features)
        if n_rows < needed:
            raise CalibrationError(
                f"{n_rows} rows with truth; {self.model.name} with {n_features} features needs "
                f"{needed}: record for longer, or choose fewer features or a simpler estimator"
            )
        report = within(report, 0.0, 1.0 - _BASELINE_SHARE)
        model, target = clone(self.model), self.target
        if model.partial:
            model.fit(*partly_known(parts, target), report)
        elif not model.family.remembers:
            targets = np.concatenate([part.target(target)[part.fitted] for part in parts])
            model.fit(fitted_rows(parts, "X"), targets, report)
        else:  # of rows without truth too
            inputs, dt = (np.concatenate([getattr(p, n) for p in parts]) for n in ("X", "dt"))
            targets = np.concatenate([part.fitted_targets(target) for part in parts])
            names = model.truth_beside()
            loads = np.concatenate([known_loads(part.recording, names) for part in parts])
            model.fit(inputs, targets, report, dt, loads)
        X, error = partly_known(parts)
        fitted: dict[str, EstimatorData] = {}
        notes: dict[str, str] = {}
        for name in BASELINES:
            baseline = get_estimator(name)
            try:
                fitted[name] = data_of(baseline.fit(X, error))
            except CalibrationError as reason:
                notes[name] = f"left out: {reason}"
                continue
            needed = baseline.minimum_rows(n_features)
            if len(X) < needed:
                notes[name] = f"fitted to {len(X)} rows, though it needs {needed}"
        return Fit(data_of(model), fitted, model), notes


def within(report: Callable[..., None], begin: float, share: float) -> Callable[..., None]:
    """Progress of a part of what `report` is called for, from `begin` on."""
    return lambda fraction, *what: report(begin + share * fraction, *what)


def known_loads(recording: Recording, names: Sequence[str]) -> Array:
    """Give loads (n, k) [Nm] of the columns called so, 0 where the recording has none."""
    loads = np.zeros((len(recording), len(names)))
    for column, name in zip(loads.T, names, strict=True):
        if name in recording.units:
            compatibility.check_units(recording, {name: "Nm"}, "and is learnt in")
            column[:] = recording.column(name)
    return loads


def data_of(model: JointRegressor) -> EstimatorData:
    """Give a fitted estimator as data; no file holds that of one that runs in memory alone."""
    return EstimatorData(model.family.name, model.model_params(), model.arrays_)


def training_rows(
    recordings: Sequence[Recording],
    feature_set: FeatureSet,
    joints: tuple[str, ...],
    gap_limit: float,
    stride: int = 1,
) -> list[Rows]:
    """Rows of each recording, those with values that are grossly off their neighbours marked.

    Raises CalibrationError if truth is missing for more than a third of a recording on end.
    """
    outliers = zip(*(gross_outliers(recordings, joint) for joint in joints), strict=True)
    parts = [
        Rows.of(recording, feature_set, joints, gap_limit, outlier=mask, stride=stride)
        for recording, mask in zip(recordings, map(np.column_stack, outliers), strict=True)
    ]
    for part in parts:
        part.check_truth()
    return parts


def fitted_rows(parts: Sequence[Rows], name: str) -> Array:
    """Rows (m, ...) that a fit uses, of all parts, of the array called `name`."""
    return np.concatenate([getattr(part, name)[part.fitted] for part in parts])


def partly_known(parts: Sequence[Rows], target: Target = "error") -> tuple[Array, Array]:
    """Features (m, k) and targets (m, n_joints) of all parts, NaN where a value is left out."""
    X, targets = zip(*(part.partly_known(target) for part in parts), strict=True)
    return np.concatenate(X), np.concatenate(targets)


def stride_of(fit_rate: float | None, dt: float) -> int:
    """Stride of rows that are `dt` [s] apart, for a fit at `fit_rate` [Hz] at most."""
    if fit_rate is None:
        return 1
    if not (isinstance(fit_rate, Real) and 1e-9 <= fit_rate < math.inf):
        raise CalibrationError(
            f"fit rate is {fit_rate!r:.40} Hz; it must be above 0 Hz, 1e-9 at least"
        )
    return max(1, round(1.0 / (fit_rate * dt)))


def recording_zeros(parts: Sequence[Rows]) -> Array:
    """Zeros (n_parts, n_joints) [rad or m] about their mean: least squares with the linear model.

    The slopes are those within the recordings, so a feature that changes between them alone has
    none. A part that no row is fitted to counts for nothing.
    """
    sizes = np.array([len(part.fitted) for part in parts])
    rows = np.repeat(np.arange(len(parts)), sizes)
    X, error = (fitted_rows(parts, name) for name in ("X", "error"))
    inputs, errors = np.zeros_like(X), np.zeros_like(error)
    for number in np.flatnonzero(sizes):
        within_one = rows == number
        varies = ~constant_columns(X[within_one])
        centred = X[within_one] - X[within_one].mean(axis=0)
        inputs[np.ix_(within_one, varies)] = centred[:, varies]
        errors[within_one] = error[within_one] - error[within_one].mean(axis=0)
    residual = error - get_estimator("linear").fit(inputs, errors).predict(X)
    zeros = np.zeros((len(parts), error.shape[1]))
    zeros[sizes > 0] = [residual[rows == n].mean(axis=0) for n in np.flatnonzero(sizes)]
    return np.asarray(zeros - zeros[sizes > 0].mean(axis=0))
