"""Which estimator and features to use: those that are best on recordings that a fit did not see."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final, Protocol

import numpy as np

from truejoint.array_types import Array
from truejoint.calibration.calibration import Calibration
from truejoint.calibration.folds import FEW, Fold, errors_of, folds, without
from truejoint.errors import CalibrationError
from truejoint.estimators.base import JointRegressor, Progress
from truejoint.estimators.registry import LINEAR
from truejoint.estimators.wrapped import Regressor, candidates, joint_regressor
from truejoint.models.features import FeatureSet
from truejoint.recordings import Recording

_BETTER: Final = 0.05  # share by which an estimator must beat the linear model
_ERRORS: Final = 2.0  # standard errors of the mean over folds by which it must, too
_WORSE: Final = 0.05  # share by which it may be worse in one of the joints
_HOPELESS: Final = 0.5  # share by which one is worse that is given up at once
_ROWS: Final = 10_000  # that a fit for the choice sees, at most
_TRIED_ON: Final = 3  # folds, after which one that is not better yet is given up


@dataclass(frozen=True, eq=False)
class Automatic:
    """An estimator to be chosen: the linear model, unless another is better without doubt.

    Every candidate is fitted without some of the recordings in turn, never without single samples,
    and judged on these: see `truejoint.calibration.folds.folds`. The fits that serve the choice
    alone see ten thousand rows. A candidate is better where its RMSE is below that of the linear
    model by 5 % and by two standard errors, both of the logarithms' mean over the folds, and above
    it by 5 % in no joint. Of those the best is fitted to all. What was tried stands in the metadata
    under ``choice``.

    Parameters
    ----------
    candidates : sequence of Regressor
        What is tried; by default what the registry says: offset, linear, quadratic, the network
        until convergence, and boosted trees.
    default_features : bool
        Whether to try the default features too, where others are asked for and there are three
        recordings or more: parts of one motion do not tell which features hold on another.

    Examples
    --------
    >>> from sklearn.linear_model import Ridge
    >>> chosen = truejoint.calibrate(training, Automatic([Ridge(1e-3)]))
    >>> [trial["estimator"] for trial in chosen.metadata["choice"]["tried"]]
    ['linear', 'Ridge']
    """

    candidates: Sequence[Regressor] = field(default_factory=candidates)
    default_features: bool = False


class Fit(Protocol):
    """`truejoint.calibrate`, all but what is chosen."""

    def __call__(
        self,
        recordings: Sequence[Recording],
        estimator: JointRegressor,
        *,
        features: FeatureSet | None,
        fit_rate: float | None = None,
        progress: Progress | None = None,
    ) -> Calibration:
        """Fit to recordings."""


@dataclass(eq=False)
class _Trial:
    """One estimator with one set of features, and how it did."""

    candidate: JointRegressor
    features: FeatureSet | None
    estimator: JointRegressor  # that stands for the candidate once a first fit has settled it
    errors: list[Array] = field(default_factory=list)  # RMSE (n_joints,) of each fold
    seconds: float = 0.0
    note: str = ""
    names: Sequence[str] = ()  # of the features

    @property
    def name(self) -> str:
        return self.estimator.name

    def judge(
        self, fitted: Calibration, recordings: Sequence[Recording], fold: Fold
    ) -> Calibration:
        """Keep the errors of a fit on what it did not see, and what it settled."""
        self.errors.append(_rmse(fitted, recordings, fold))
        self.estimator, self.names = fitted.model.settled(), fitted.feature_set.names
        return fitted

    def ratios(self, reference: _Trial) -> Array:
        """Logarithms (n_folds, n_joints) of the errors over those of another."""
        own, other = np.array(self.errors), np.array(reference.errors[: len(self.errors)])
        smallest = np.finfo(float).tiny
        return np.asarray(np.log(np.maximum(own, smallest) / np.maximum(other, smallest)))

    def against(self, reference: _Trial) -> tuple[float, float]:
        """Mean over folds of the logarithm of its error over another's, and standard error."""
        by_fold = self.ratios(reference).mean(axis=1)
        if len(by_fold) < 2:
            return float(by_fold.mean()) if len(by_fold) else math.inf, math.inf
        return float(by_fold.mean()), float(by_fold.std(ddof=1) / math.sqrt(len(by_fold)))

    def is_hopeless(self, reference: _Trial) -> bool:
        """Whether more folds would hardly make it better than another."""
        mean = float(self.ratios(reference).mean())
        return mean > (0.0 if len(self.errors) >= _TRIED_ON else math.log(1.0 + _HOPELESS))

    def is_better(self, reference: _Trial) -> bool:
        """Whether it was tried on every fold, and is better by the rule of `Automatic`."""
        if len(self.errors) < len(reference.errors):
            return False
        mean, error = self.against(reference)
        worst = float(self.ratios(reference).mean(axis=0).max())
        enough = mean <= math.log(1.0 - _BETTER) and mean + _ERRORS * error < 0.0
        return enough and worst <= math.log(1.0 + _WORSE)


def choose(
    recordings: Sequence[Recording],
    automatic: Automatic,
    fit: Fit,
    features: FeatureSet | None,
    fit_rate: float | None = None,
    progress: Progress | None = None,
) -> Calibration:
    """Choose as `Automatic` says, and fit the chosen one to all recordings.

    A fold without which the linear model cannot be fitted (a feature never changes in the rest) is
    passed over; raises CalibrationError if that is every one.
    """
    report = progress or (lambda _fraction: None)
    feature_sets = [features]
    if automatic.default_features and features is not None and len(recordings) >= FEW:
        feature_sets.append(None)
    trials = list(_trials(automatic.candidates, feature_sets))
    fit_briefly = partial(fit, fit_rate=_brief_rate(recordings, fit_rate))
    left_out = folds(recordings)
    steps = len(left_out) + 1
    judged: list[Fold] = []
    raw: list[Array] = []
    for k, fold in enumerate(left_out):
        is_last = fold is left_out[-1]
        try:
            raw.append(_try(trials, recordings, fold, fit_briefly, is_last=is_last))
            judged.append(fold)
        except CalibrationError:
            if is_last and not judged:
                raise
        report((k + 1) / steps)
    reference = trials[0]
    best = min(
        (trial for trial in trials if trial is reference or trial.is_better(reference)),
        key=lambda trial: trial.against(reference)[0],
    )

    def report_last(fraction: float) -> None:
        report((steps - 1 + fraction) / steps)

    fitted = fit(
        recordings, best.candidate, features=best.features, fit_rate=fit_rate, progress=report_last
    )
    return fitted.with_metadata(choice=_told(judged, trials, best, raw, fitted.joints))


def _try(
    trials: Sequence[_Trial],
    recordings: Sequence[Recording],
    fold: Fold,
    fit: Fit,
    *,
    is_last: bool,
) -> Array:
    """Fit what is not given up without a fold, and judge it; RMSE (n_joints,) of raw positions.

    Raises CalibrationError if the reference, the first, cannot be fitted.
    """
    training = without(recordings, fold.parts)
    known: dict[FeatureSet | None, Calibration] = {}  # which bring baselines along
    reference, *others = trials
    fitted = reference.judge(_fitted(reference, training, fit, known), recordings, fold)
    for trial in (one for one in others if not one.note):
        began = time.perf_counter()
        try:
            trial.judge(_fitted(trial, training, fit, known), recordings, fold)
        except CalibrationError as reason:
            trial.note = str(reason)
        trial.seconds += time.perf_counter() - began
        if not trial.note and not is_last and trial.is_hopeless(reference):
            trial.note = f"given up after {len(trial.errors)} folds"
    return _raw_rmse(fitted, recordings, fold)


def _trials(
    tried: Sequence[Regressor], feature_sets: Sequence[FeatureSet | None]
) -> Iterator[_Trial]:
    """Every candidate with every set of features, the linear model with the first before all."""
    linear = next(one for one in candidates() if one.name == LINEAR)
    known = [joint_regressor(one) for one in tried]
    for features in feature_sets:
        for one in (linear, *(one for one in known if one.name != LINEAR)):
            yield _Trial(one, features, one)


def _brief_rate(recordings: Sequence[Recording], fit_rate: float | None) -> float | None:
    """Rate [Hz] at which the fits for the choice take rows."""
    if sum(map(len, recordings)) <= _ROWS:
        return fit_rate
    few = _ROWS / sum(recording.duration for recording in recordings)
    return few if fit_rate is None else min(few, fit_rate)


def _fitted(
    trial: _Trial,
    training: Sequence[Recording],
    fit: Fit,
    known: dict[FeatureSet | None, Calibration],
) -> Calibration:
    """Fit, unless a fit with the same features has brought the same along as a baseline."""
    other = known.get(trial.features)
    if other is not None and other.target == "error" and trial.name in other.baselines:
        same = other.baselines[trial.name]
        parameters = same.model.get_params() == trial.estimator.get_params()
        if parameters and trial.name not in other.metadata["baseline_notes"]:
            return same
    known[trial.features] = fit(training, trial.estimator, features=trial.features)
    return known[trial.features]


def _rmse(calibration: Calibration, recordings: Sequence[Recording], fold: Fold) -> Array:
    """RMSE (n_joints,) [rad or m] over all rows of a fold."""
    errors = [errors_of(calibration, recordings, part)[0] for part in fold.parts]
    return np.asarray(np.sqrt(np.mean(np.concatenate(errors) ** 2, axis=0)))


def _raw_rmse(calibration: Calibration, recordings: Sequence[Recording], fold: Fold) -> Array:
    """RMSE (n_joints,) of the measured position, likewise."""
    errors = []
    for part in fold.parts:
        _, rows = errors_of(calibration, recordings, part)
        errors.append(recordings[part.recording].error(calibration.joints)[rows])
    return np.asarray(np.sqrt(np.mean(np.concatenate(errors) ** 2, axis=0)))


def _told(
    left_out: Sequence[Fold],
    trials: Sequence[_Trial],
    best: _Trial,
    raw: Sequence[Array],
    joints: Sequence[str],
) -> dict[str, Any]:
    """Tell what was tried, as JSON values: RMSE [rad or m] over folds, and ratio to linear."""

    def by_joint(errors: Sequence[Array]) -> dict[str, float]:
        pooled = np.sqrt(np.mean(np.square(errors), axis=0))
        return {joint: float(value) for joint, value in zip(joints, pooled, strict=True)}

    tried = []
    for trial in trials:
        entry: dict[str, Any] = {
            "estimator": trial.name,
            "features": list(trial.names),
            "folds": len(trial.errors),
            "seconds": round(trial.seconds, 3),
            "chosen": trial is best,
            "note": trial.note,
        }
        if trial.errors:
            mean, error = trial.against(trials[0])
            entry |= {"rmse": by_joint(trial.errors), "ratio": math.exp(mean)}
            if math.isfinite(error):
                entry["standard_error"] = error
        tried.append(entry)
    return {
        "reference": trials[0].name,
        "left_out": [fold.name for fold in left_out],
        "raw": by_joint(raw),
        "tried": tried,
    }
