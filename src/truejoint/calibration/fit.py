"""Fit a calibration to recordings that hold the true joint positions."""

from __future__ import annotations

import hashlib
import platform
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any, Final, Self

import numpy as np
from sklearn.base import clone

from truejoint.array_types import Array, Integers
from truejoint.calibration.calibration import Calibration
from truejoint.calibration.candidates import choice_of, unfitted
from truejoint.calibration.choose import FITTED_ROWS, MOST_ROWS, Automatic, Choice, share_of
from truejoint.calibration.compatibility import check_unit, distinct, session_of
from truejoint.calibration.domain import fit_training_domain, resting_features
from truejoint.calibration.effort_fitting import fit_effort_baseline
from truejoint.calibration.folds import FEW, folds, wholes
from truejoint.calibration.own_zeros import ZeroOf, at_one_zero, zero_groups
from truejoint.calibration.redundancy import ParityEquations, fit_parity_equations
from truejoint.calibration.rows import (
    RowRules,
    TrainingRows,
    fitted_rows,
    outlying_values,
    partly_known,
    stride_of,
)
from truejoint.calibration.selection import (
    chosen_features,
    chosen_joints,
    chosen_redundant,
    common_robot,
    common_units,
)
from truejoint.calibration.signal_shift import signal_moves
from truejoint.calibration.zero_choice import judge_zeros
from truejoint.errors import CalibrationError
from truejoint.estimators.base import JointRegressor, Progress, constant_columns, untold
from truejoint.estimators.family import Target
from truejoint.estimators.registry import AUTO, BASELINES, DEFAULT
from truejoint.estimators.wrapped import Regressor, get_estimator
from truejoint.features.feature_set import FeatureSet, check_sample_dt, default_gap_limit, sample_dt
from truejoint.recordings import Recording
from truejoint.recordings.table.recording import as_recordings
from truejoint.robots import Robot

_CHOICE_SHARE: Final = 0.7  # of the progress bar, where there is a choice,
_ZEROS_SHARE: Final = 0.2  # and of judging zeros then
_BASELINE_SHARE: Final = 0.1  # of the progress bar


def calibrate(
    recordings: Recording | Sequence[Recording],
    estimator: str | Regressor | Automatic = DEFAULT,
    *,
    features: FeatureSet | Iterable[str] | None = None,
    joints: Sequence[str] | None = None,
    target: Target | None = None,
    redundant: Sequence[str] | None = None,
    fit_rate: float | None = None,
    random_state: int | None = None,
    zero: ZeroOf | None = None,
    progress: Progress | None = None,
) -> Calibration:
    """Fit an estimator, and the baselines beside it, to recordings with truth (peng2024, II-C).

    Rows without truth, and gross outliers of it, are left out and counted in the metadata as
    ``rows_without_truth`` and ``outliers``, beside the time that it took, ``fit_seconds``. Of a row
    with an outlier, the baselines and the network are still fitted to the other joints
    (`JointRegressor.partial`).

    Parameters
    ----------
    recordings : Recording or sequence of Recording
        Of one arm, all with the same units.
    estimator : str, Regressor or Automatic
        A name in `estimator_names`, or an unfitted estimator with parameters of its own: one of
        ours, or anything with scikit-learn's `fit` and `predict`; see `WrappedRegressor`. ``auto``,
        or `Automatic`: what is best on recordings that are left out in turn.
    features : FeatureSet or iterable of str, optional
        Inputs of the model; measured position and effort of every channel by default, or those
        that the estimator was made for.
    joints : sequence of str or str, optional
        Joints to correct; by default the robot's positioning joints that have truth.
    target : {"error", "position"}, optional
        Predict truth minus measured (peng2024, II-J: more accurate), or the position itself; by
        default the first that the estimator's family can be fitted to.
    redundant : sequence of str, optional
        Columns by which a control loop checks the measured positions, such as ``"motor/elbow"``;
        all that every recording has by default, see `truejoint.calibration.redundancy`. A
        `Corrector` needs those that tell something; correcting a recording needs none.
    fit_rate : float, optional
        Fit to rows at most at this rate [Hz], where more of them would only take longer; features
        with a history still see every row.
    random_state : int, optional
        Seed, where the estimator has one; its own by default.
    zero : {"shared", "recording", "homing"}, optional
        Whether the recordings share one zero, as they do by default; of what was chosen
        automatically, one for each recording is kept beside where it is better: see `Automatic`.
        With ``"recording"``, the estimator is fitted a second time, with an offset of truth against
        measured position for each recording; with ``"homing"``, for each homing, by which the
        measured positions themselves are off, inputs of the model included. The zeros are those of
        a linear model on the same features. The second fit (`Calibration.fitted_for`) is for
        motions that begin with re-zeroing and is useless without, as all that differs between
        recordings has gone into the zeros.
    progress : callable, optional
        Called with the fraction done, 0 to 1.

    Raises
    ------
    CalibrationError
        If the recordings do not belong together, are fewer than two where each has a zero of its
        own, lack truth for more than a third of their time, do not tell the zeros of homings,
        have too few rows for the estimator (ten for each coefficient; 300 and ten for each
        feature for a network), or the measured position of a joint never changes. Other features
        that never change are not learnt of, and listed in the metadata as ``unused_features``.

    Examples
    --------
    >>> calibrate(training, "linear").joints
    ('jaw',)
    """
    recordings = as_recordings(recordings)
    report, began = progress or untold, time.perf_counter()
    groups = None if zero is None or zero == "shared" else zero_groups(recordings, zero)
    if isinstance(estimator, Automatic) or estimator == AUTO:
        wanted = estimator if isinstance(estimator, Automatic) else Automatic()
        zeros_share = _ZEROS_SHARE if zero is None else 0.0
        choice = choice_of(
            recordings, wanted, features, joints, target, fit_rate, random_state,
            within(report, 0.0, _CHOICE_SHARE),
        )  # fmt: skip
        fitted = calibrate(
            recordings, choice.estimator, features=choice.features, joints=joints,
            target=choice.target, redundant=redundant, fit_rate=fit_rate, zero=zero,
            progress=within(report, _CHOICE_SHARE, 1.0 - _CHOICE_SHARE - zeros_share),
        )  # fmt: skip
        told = dict(choice.told)
        if zero is None:
            last = within(report, 1.0 - zeros_share, zeros_share)
            second, told["zero"] = _judged_zeros(
                fitted, choice, recordings, fit_rate, wanted.tell, last
            )
            fitted = fitted if second is None else _with_zeros(fitted, second)
        report(1.0)
        chosen = _of_unseen(fitted, choice)
        return chosen.with_metadata(choice=told, fit_seconds=_since(began))
    task = _Task.of(recordings, estimator, features, joints, target, random_state)
    checks = fit_parity_equations(
        recordings, task.joints, tuple(task.units), chosen_redundant(recordings, redundant)
    )
    parts = task.rows(stride_of(fit_rate, task.dt))
    fits = _fits(task, parts, groups, zero or "shared", report)
    report(1.0)
    return _assembled(task, parts, fits, *checks).with_metadata(fit_seconds=_since(began))


def _since(began: float) -> float:
    """Time [s] that has gone by, to a millisecond."""
    return round(time.perf_counter() - began, 3)


def _of_unseen(fitted: Calibration, choice: Choice) -> Calibration:
    """State as its size of errors that on what the fits of a choice did not see, if larger.

    The median of the parts: some lie far beyond what the others show.
    """
    baseline = fitted.effort_baseline
    if baseline is None:
        return fitted
    unseen = [choice.told["chosen"]["median"][joint] for joint in fitted.joints]
    baseline = replace(baseline, residual=np.maximum(baseline.residual, unseen))
    return replace(fitted, effort_baseline=baseline)


@dataclass(frozen=True)
class _Task:
    """What a model is to learn of recordings, as it is told and found before anything is fitted."""

    recordings: Sequence[Recording]
    robot: Robot
    model: JointRegressor
    target: Target
    joints: tuple[str, ...]
    feature_set: FeatureSet
    dt: float
    gap_limit: float
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
        """Find what is not told, as `calibrate` says; raises CalibrationError as it does."""
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

    def rows(self, stride: int) -> list[TrainingRows]:
        """Rows of each recording, of which every `stride`-th is fitted to."""
        rules = RowRules(self.feature_set, self.joints, self.gap_limit, stride)
        outlying = outlying_values(self.recordings, self.joints)
        return list(map(rules.rows, self.recordings, outlying))

    def unused_features(self, X: Array) -> list[str]:
        """Features that never change in the training rows `X`: nothing is learnt of them.

        Refused are those that the model insists on, and positions of the joints.
        """
        names = self.feature_set.names
        constant = [names[i] for i in np.flatnonzero(constant_columns(X))]
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


@dataclass(frozen=True)
class _SecondFit:
    """Models for motions that begin with re-zeroing, and the rows that they are of."""

    models: dict[str, JointRegressor]
    parts: Sequence[TrainingRows]
    moves: Array | None
    zeros: dict[str, Any]


@dataclass(frozen=True)
class _Fits:
    """What was fitted to the rows of a task."""

    model: JointRegressor
    baselines: dict[str, JointRegressor]
    notes: dict[str, str]  # on these
    unused: list[str]  # features that never change
    second: _SecondFit


def _fits(
    task: _Task,
    parts: Sequence[TrainingRows],
    groups: tuple[list[str], Integers] | None,
    zero: ZeroOf,
    report: Progress,
) -> _Fits:
    """Fit model and baselines, and once more where there are `groups` with zeros of their own."""
    X = fitted_rows(parts, "features")
    unused = task.unused_features(X)
    n_features = len(task.feature_set) - len(unused)
    _check_enough(task.model, len(X), n_features)
    share = 1.0 if groups is None else 0.5
    own, baselines, notes = _fit(task, parts, n_features, within(report, 0.0, share))
    second = _SecondFit({}, parts, None, {"of": zero})
    if groups is not None:
        second = _fit_at_one_zero(
            task, parts, groups, zero, n_features, within(report, share, share)
        )
    return _Fits(own, baselines, notes, unused, second)


def _assembled(
    task: _Task,
    parts: Sequence[TrainingRows],
    fits: _Fits,
    parity: ParityEquations | None,
    redundant: dict[str, str],
) -> Calibration:
    """Calibration of what was fitted, with its training domain, baselines and provenance."""
    X, error = (fitted_rows(parts, name) for name in ("features", "error"))
    fitted = Calibration(
        robot=task.robot.name,
        arm=task.robot.arm,
        joints=task.joints,
        feature_set=task.feature_set,
        target=task.target,
        units=task.units,
        gap_limit=task.gap_limit,
        lower=X.min(axis=0),
        upper=X.max(axis=0),
        model=fits.model,
        baseline_models=fits.baselines,
        training_domain=fit_training_domain(
            task.recordings,
            (*task.units, *redundant),
            task.gap_limit,
            X,
            error,
            resting_features(task.recordings, task.feature_set, task.joints, task.units),
        ),
        parity=parity,
        redundant=redundant,
        metadata={
            **origin(parts),
            "sample_dt": task.dt,
            "estimator": task.model.name,
            "settings": " ".join(repr(task.model).split()),
            "unused_features": fits.unused,
            "baseline_notes": fits.notes,
            **({"identified": fits.model.identified} if fits.model.identified else {}),
        },
    )
    return _with_zeros(fitted, fits.second)


def _with_zeros(fitted: Calibration, second: _SecondFit) -> Calibration:
    """Calibration with what was fitted once more beside it, and what is known of its errors."""
    fitted = replace(fitted, rezero_models=second.models, moves=second.moves)
    fitted = fitted.with_metadata(zeros=second.zeros)
    used = fitted.fitted_for(rezeroing=True)
    baseline = fit_effort_baseline(used, [part.recording for part in second.parts])
    return replace(fitted, effort_baseline=baseline)


def _fit_at_one_zero(
    task: _Task,
    parts: Sequence[TrainingRows],
    groups: tuple[list[str], Integers],
    zero: ZeroOf,
    n_features: int,
    report: Progress,
) -> _SecondFit:
    """Fit once more, with a zero for each of the `groups` of recordings."""
    names, index = groups
    signals = tuple(task.units)
    moves = signal_moves(task.recordings, signals, task.joints) if zero == "homing" else None
    at_zero, found = at_one_zero(parts, index, moves, signals)
    again, others, _ = _fit(task, at_zero, n_features, report)
    zeros = {"of": zero, "names": names, "offsets": found.tolist()}
    return _SecondFit({"model": again, **others}, at_zero, moves, zeros)


def _judged_zeros(
    fitted: Calibration,
    choice: Choice,
    recordings: Sequence[Recording],
    fit_rate: float | None,
    tell: Callable[[str], None] | None,
    report: Progress,
) -> tuple[_SecondFit | None, dict[str, Any]]:
    """Fit what was chosen with a zero for each recording where that is better, and tell of it.

    What a part that is left out shows enters no fit that it judges, nor what that knows of its own
    errors, but for their median over all parts and what the choice settled, a network's epochs.
    """

    def of(some: Sequence[Recording]) -> _Task:
        return _Task.of(some, choice.estimator, choice.features, fitted.joints, choice.target, None)

    def say(what: str, share: float) -> None:
        report(share)
        if tell is not None:
            tell(what)

    few = distinct(recordings)
    if len(few) < FEW:
        return None, {"kept": False, "note": f"it takes {FEW} recordings"}
    if not (fitted.feature_set.counts_samples or fitted.model.family.counts_samples):
        most = share_of([len(one) for one in few], MOST_ROWS)
        few = [one.rows(np.arange(0, len(one), -(-len(one) // most))) for one in few]
    longest = max(default_gap_limit([one]) for one in few)  # each is thinned in its own way
    task = replace(of(few), gap_limit=longest)
    stride = max(stride_of(fit_rate, task.dt), -(-sum(map(len, few)) // FITTED_ROWS))
    parts = task.rows(stride)
    plain = replace(fitted, gap_limit=task.gap_limit)

    def fit(seen: Sequence[int]) -> tuple[Calibration, Calibration]:
        own = [parts[index] for index in seen]
        each, _ = at_one_zero(own, np.arange(len(own)), None, ())
        first, again = (
            replace(plain, model=_fit_model(clone(task.model), some, task.target, untold))
            for some in (own, each)
        )
        known = fit_effort_baseline(first, [few[index] for index in seen])
        first = _of_unseen(replace(first, effort_baseline=known), choice)
        return first, again.with_metadata(zeros={"of": "recording"})

    uncut = set(wholes(few))
    left_out = [fold for fold in folds(few) if uncut.issuperset(fold.parts)]
    kept, told = judge_zeros(few, left_out, fit, say)
    if not kept:
        return None, told
    whole = of(recordings)
    n_features = len(whole.feature_set) - len(fitted.metadata["unused_features"])
    own_parts = whole.rows(stride_of(fit_rate, whole.dt))
    groups = zero_groups(recordings, "recording")
    second = _fit_at_one_zero(whole, own_parts, groups, "recording", n_features, untold)
    return second, told


def reseeded(
    fitted: Calibration,
    recordings: Recording | Sequence[Recording],
    seeds: Iterable[int],
    *,
    fit_rate: float | None = None,
) -> list[Calibration]:
    """Calibrations that differ from a fitted one by the estimator's seed alone.

    As `calibrate` makes them, but what they share is worked out once. Interval and baseline of the
    efforts, which they do not share, are left out.

    Parameters
    ----------
    fitted : Calibration
        With one zero for all recordings.
    recordings : Recording or sequence of Recording
        Those that it was fitted to.
    seeds : iterable of int
        One for each calibration that is wanted.
    fit_rate : float, optional
        As it was fitted at [Hz].

    Raises
    ------
    CalibrationError
        If each recording or homing has a zero of its own, or as `calibrate`.

    Examples
    --------
    >>> first = calibrate(training, truejoint.estimators.get_estimator("dnn").set_params(epochs=1))
    >>> len(reseeded(first, training, [1, 2]))
    2
    """
    if fitted.rezero_models:
        raise CalibrationError(
            "the calibration has zeros of recordings or homings; `calibrate` each seed by itself"
        )
    recordings = as_recordings(recordings)
    stride = stride_of(fit_rate, fitted.metadata["sample_dt"])
    rules = RowRules(fitted.feature_set, fitted.joints, fitted.gap_limit, stride)
    parts = list(map(rules.rows, recordings, outlying_values(recordings, fitted.joints)))
    told = fitted.feature_set.names, common_robot(recordings), fitted.joints
    models = [unfitted(fitted.model, fitted.target, one).for_features(*told) for one in seeds]
    return [
        replace(
            fitted,
            model=_fit_model(model, parts, fitted.target, untold),
            interval=None,
            effort_baseline=None,
        ).with_metadata(settings=" ".join(repr(model).split()))
        for model in models
    ]


def within(report: Progress, begin: float, share: float) -> Progress:
    """Progress of a part of what `report` is told of, from `begin` on."""
    return lambda fraction: report(begin + share * fraction)


def _check_enough(model: JointRegressor, n: int, n_features: int) -> None:
    """Refuse to fit a model to fewer rows `n` than it needs."""
    needed = model.minimum_rows(n_features)
    if n < needed:
        raise CalibrationError(
            f"{n} rows with truth; {model.name} with {n_features} features needs {needed}: "
            "record for longer, or choose fewer features or a simpler estimator"
        )


def _fit(
    task: _Task, parts: Sequence[TrainingRows], n_features: int, report: Progress
) -> tuple[JointRegressor, dict[str, JointRegressor], dict[str, str]]:
    """Fitted model, baselines, and notes on these."""
    report = within(report, 0.0, 1.0 - _BASELINE_SHARE)
    own = _fit_model(clone(task.model), parts, task.target, report)
    return own, *_fit_baselines(*partly_known(parts), n_features)


def _fit_model(
    model: JointRegressor, parts: Sequence[TrainingRows], target: Target, report: Progress
) -> JointRegressor:
    if model.partial:
        return model.fit(*partly_known(parts, target), report)
    if not model.family.remembers:
        known = "error" if target == "error" else "truth"
        return model.fit(fitted_rows(parts, "features"), fitted_rows(parts, known), report)
    inputs, targets, dt = (
        np.concatenate(values)
        for values in zip(*((p.features, p.targets(target), p.dt) for p in parts), strict=True)
    )
    beside = model.truth_beside()
    loads = np.concatenate([known_loads(part.recording, beside) for part in parts])
    return model.fit(inputs, targets, report, dt, loads)


def known_loads(recording: Recording, names: Sequence[str]) -> Array:
    """Look up loads (n, k) [Nm] in the columns called so, 0 where a recording has none.

    Raises CalibrationError if one is in another unit.
    """
    columns = np.zeros((len(recording), len(names)))
    for column, name in zip(columns.T, names, strict=True):
        if name in recording.units:
            check_unit(recording, name, "Nm", "and is learnt in")
            column[:] = recording.column(name)
    return columns


def _fit_baselines(
    X: Array, error: Array, n_features: int
) -> tuple[dict[str, JointRegressor], dict[str, str]]:
    """Baselines fitted to the error, and what is to be known about one that is weak or absent."""
    fitted: dict[str, JointRegressor] = {}
    notes: dict[str, str] = {}
    for name in BASELINES:
        model = get_estimator(name)
        try:
            fitted[name] = model.fit(X, error)
        except CalibrationError as reason:
            notes[name] = f"left out: {reason}"
            continue
        needed = model.minimum_rows(n_features)
        if len(X) < needed:
            notes[name] = f"fitted to {len(X)} rows, though it needs {needed}"
    return fitted, notes


def origin(parts: Sequence[TrainingRows]) -> dict[str, Any]:
    """Where the training rows come from, as JSON values."""
    digest = hashlib.sha256()
    sessions: list[dict[str, Any]] = []
    for part in parts:
        for array in (part.recording.t, part.features, part.truth, part.error):
            digest.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
        counts = {
            "rows": len(part.fitted),
            "rows_without_truth": int((~part.known).sum()) - part.outliers,
            "outliers": part.outliers,
        }
        duration = {"duration": part.recording.duration}
        sessions.append(session_of(part.recording) | counts | duration)
    totals = ("rows", "rows_without_truth", "outliers", "duration")
    return {
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": {
            "python": platform.python_version(),
            **{name: version(name) for name in ("truejoint", "numpy", "scikit-learn")},
        },
        **{name: sum(session[name] for session in sessions) for name in totals},
        "sessions": sessions,
        "homing_ids": sorted({part.recording.provenance.homing_id for part in parts} - {""}),
        "data_sha256": digest.hexdigest(),
    }
