"""Fit a calibration to recordings that hold the true joint positions."""

from __future__ import annotations

import hashlib
import platform
import time
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from importlib.metadata import version
from typing import Any, Final, Literal, Self, get_args

import numpy as np
from sklearn.base import clone

from truejoint.array_types import Array, Integers, Mask
from truejoint.calibration.calibration import Calibration
from truejoint.calibration.choice import (
    FITTED_ROWS,
    MOST_ROWS,
    Automatic,
    Choice,
    Group,
    Rows,
    choose,
    share_of,
)
from truejoint.calibration.effort_fitting import fit_effort_baseline
from truejoint.calibration.folds import FEW, folds
from truejoint.calibration.parity import ParityEquations, fit_parity_equations
from truejoint.calibration.selection import (
    chosen_features,
    chosen_joints,
    chosen_redundant,
    common_robot,
    common_units,
    in_all,
)
from truejoint.calibration.sessions import distinct, session_of, source_of
from truejoint.calibration.signal_shift import shift_signals, signal_moves
from truejoint.calibration.training_domain import fit_training_domain, resting_features
from truejoint.calibration.training_rows import (
    RowRules,
    TrainingRows,
    fitted_rows,
    outlying_values,
    partly_known,
    stride_of,
)
from truejoint.calibration.zero_choice import judge_zeros
from truejoint.errors import CalibrationError
from truejoint.estimators.base import JointRegressor, Progress, constant_columns
from truejoint.estimators.registry import AUTO, BASELINES, DEFAULT
from truejoint.estimators.wrapped import Regressor, get_estimator, joint_regressor
from truejoint.models.family import TARGETS, Target
from truejoint.models.features import (
    FeatureSet,
    check_sample_dt,
    default_features,
    default_gap_limit,
    sample_dt,
)
from truejoint.recordings import Recording
from truejoint.recordings.recording import as_recordings
from truejoint.robots import Robot

ZeroOf = Literal["shared", "recording", "homing"]

_MORE: Final = ("measured", "effort"), ("measured", "effort", "current")
"""Quantities of which a choice tries all columns, where it chooses features."""
_RATE_TIME: Final = 0.02  # [s] of the low-pass whose slope is the rate that a choice tries
_RATE_DT: Final = 0.1  # [s] between rows, beyond which they show steps and no rates
_CHOICE_SHARE: Final = 0.7  # of the progress bar, where there is a choice,
_ZEROS_SHARE: Final = 0.2  # and of judging zeros then
_BASELINE_SHARE: Final = 0.1  # of the progress bar
_SETTLED: Final = 1e-7  # [rad or m] that zeros of homings are found to
_FOLLOWS: Final = 0.5  # of a zero that may be left when the measured positions moved by it


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
        all that every recording has by default, see `truejoint.calibration.parity`. A `Corrector`
        needs those that tell something; correcting a recording needs none.
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
    if isinstance(estimator, Automatic) or estimator == AUTO:
        wanted = estimator if isinstance(estimator, Automatic) else Automatic()
        choice = _choose(
            recordings, wanted, features, joints, target, fit_rate, random_state,
            within(report, 0.0, _CHOICE_SHARE),
        )  # fmt: skip
        fitted = calibrate(
            recordings, choice.estimator, features=choice.features, joints=joints,
            target=choice.target, redundant=redundant, fit_rate=fit_rate, zero=zero,
            progress=within(report, _CHOICE_SHARE, 1.0 - _CHOICE_SHARE - _ZEROS_SHARE),
        )  # fmt: skip
        told = dict(choice.told)
        if zero is None:
            last = within(report, 1.0 - _ZEROS_SHARE, _ZEROS_SHARE)
            sure = _of_unseen(fitted, choice)
            second, told["zero"] = _judged_zeros(sure, recordings, fit_rate, wanted.tell, last)
            fitted = fitted if second is None else _with_zeros(fitted, second)
        report(1.0)
        chosen = _of_unseen(fitted, choice)
        return chosen.with_metadata(choice=told, fit_seconds=_since(began))
    zero = zero or "shared"
    groups = None if zero == "shared" else _groups(recordings, zero)
    task = _Task.of(recordings, estimator, features, joints, target, random_state)
    checks = fit_parity_equations(
        recordings, task.joints, tuple(task.units), chosen_redundant(recordings, redundant)
    )
    parts = task.rows(stride_of(fit_rate, task.dt))
    fits = _fits(task, parts, groups, zero, report)
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
        model = _unfitted(estimator, target, random_state).for_recordings(recordings)
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
    at_zero, found = _at_one_zero(parts, index, moves, signals)
    again, others, _ = _fit(task, at_zero, n_features, report)
    zeros = {"of": zero, "names": names, "offsets": found.tolist()}
    return _SecondFit({"model": again, **others}, at_zero, moves, zeros)


def _judged_zeros(
    fitted: Calibration,
    recordings: Sequence[Recording],
    fit_rate: float | None,
    tell: Callable[[str], None] | None,
    report: Progress,
) -> tuple[_SecondFit | None, dict[str, Any]]:
    """Fit what was chosen with a zero for each recording where that is better, and tell of it."""

    def of(some: Sequence[Recording]) -> _Task:
        model = fitted.model.settled()
        return _Task.of(some, model, fitted.feature_set, fitted.joints, fitted.target, None)

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
    task = of(few)
    stride = max(stride_of(fit_rate, task.dt), -(-sum(map(len, few)) // FITTED_ROWS))
    parts = task.rows(stride)
    plain = replace(fitted, gap_limit=task.gap_limit)

    def fit(seen: Sequence[int]) -> tuple[Calibration, Calibration]:
        own = [parts[index] for index in seen]
        each, _ = _at_one_zero(own, np.arange(len(own)), None, ())
        first, again = (
            replace(plain, model=_fit_model(clone(task.model), some, task.target, untold))
            for some in (own, each)
        )
        return first, again.with_metadata(zeros={"of": "recording"})

    kept, told = judge_zeros(few, folds(few), fit, say)
    if not kept:
        return None, told
    whole = of(recordings)
    n_features = len(whole.feature_set) - len(fitted.metadata["unused_features"])
    own_parts, groups = whole.rows(stride_of(fit_rate, whole.dt)), _groups(recordings, "recording")
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
    models = [_unfitted(fitted.model, fitted.target, one).for_features(*told) for one in seeds]
    return [
        replace(
            fitted,
            model=_fit_model(model, parts, fitted.target, untold),
            interval=None,
            effort_baseline=None,
        ).with_metadata(settings=" ".join(repr(model).split()))
        for model in models
    ]


def _choose(
    recordings: Sequence[Recording],
    wanted: Automatic,
    features: FeatureSet | Iterable[str] | None,
    joints: Sequence[str] | None,
    target: Target | None,
    fit_rate: float | None,
    random_state: int | None,
    progress: Progress,
) -> Choice:
    """Choose among the estimators that can predict the target, each with its features."""
    robot = common_robot(recordings)
    chosen = chosen_joints(robot, recordings, joints)
    recordings = distinct(recordings)
    named = dict.fromkeys(name for one in recordings for name in default_features(robot, one).names)
    usual = FeatureSet.parse(in_all(recordings, named))
    common_units(recordings, usual, chosen)  # refuses joints that are in rad here and in m there
    models = [_unfitted(one, None, random_state) for one in wanted.candidates]
    by_features, targets = _with_their_features(
        models, robot, recordings, usual if features is None else features, target
    )
    free = [one for ones in by_features.values() for one in ones if one.family.inputs is None]
    if free and wanted.default_features and features is not None and len(recordings) >= FEW:
        by_features.setdefault(usual, free)
    for quantities in _MORE if features is None and free else ():
        columns = [name for name in recordings[0].units if name.split("/")[0] in quantities]
        more = FeatureSet.parse(in_all(recordings, columns))
        if not any(set(more.names) == set(one.names) for one in by_features):
            by_features[more] = free
    for ones in by_features.values():  # what learns a filter's residual, without the filter too
        within_one = {name for one in ones for name in _member_names(one)}
        ones += [one for one in free if one.name in within_one and one not in ones]
    grouped = partial(
        _grouped, recordings, outlying_values(recordings, chosen), robot, chosen,
        stride_of(fit_rate, sample_dt(recordings)),
    )  # fmt: skip

    def with_rates(group: Group, names: Collection[str]) -> Group | None:
        """Give candidates of these names the rates of the group's measured positions as well."""
        positions = [name for name in group.features.names if name.startswith("measured/")]
        rates = [f"rate({name}, {_RATE_TIME:g})" for name in positions]
        tried = [one for one in free if one.name in names]
        more = FeatureSet.parse([*group.features.names, *rates])
        return grouped(more, tried, group.target) if rates else None

    groups = [
        grouped(feature_set, ones, targets.get(feature_set, target or TARGETS[0]))
        for feature_set, ones in by_features.items()
    ]
    shows_rates = len(recordings) >= FEW and sample_dt(recordings) <= _RATE_DT
    extended = with_rates if features is None and free and shows_rates else None
    found = choose(groups, folds(recordings), chosen, wanted.tell, progress, extended)
    lacking = [] if features is not None else [name for name in named if name not in usual.names]
    return replace(found, told={**found.told, "not_in_all": lacking})


def _with_their_features(
    models: Sequence[JointRegressor],
    robot: Robot,
    recordings: Sequence[Recording],
    asked: FeatureSet | Iterable[str],
    target: Target | None,
) -> tuple[dict[FeatureSet, list[JointRegressor]], dict[FeatureSet, Target]]:
    """Models that can be tried, by the features that they see, and what these then predict.

    Features are those that are `asked` for, or the model's own.
    """
    by_features: dict[FeatureSet, list[JointRegressor]] = {}
    targets: dict[FeatureSet, Target] = {}
    for model in models:
        own = model.family.inputs is not None
        wants = target or (model.family.targets if own else TARGETS)[0]
        knowing = _knowing(model, recordings)
        if wants not in model.family.targets or knowing is None:
            continue
        known = chosen_features(knowing, robot, recordings, None if own else asked)
        by_features.setdefault(known, []).append(knowing)
        targets.setdefault(known, wants)
    if not by_features:
        names = ", ".join(one.name for one in models)
        raise CalibrationError(
            f"none of {names} can be tried: the recordings lack what they take, or they predict no "
            f"{target or TARGETS[0]}; give other candidates"
        )
    return by_features, targets


def _grouped(
    recordings: Sequence[Recording],
    outlying: Sequence[Mask],
    robot: Robot,
    joints: tuple[str, ...],
    stride: int,
    feature_set: FeatureSet,
    candidates: Sequence[JointRegressor],
    target: Target,
) -> Group:
    """Candidates with the rows of recordings, as many as serve a choice, that they see."""
    rules = RowRules(feature_set, joints, default_gap_limit(recordings), stride)
    thinned = not any(one.family.counts_samples for one in candidates)
    sizes = [len(one) for one in recordings]
    most = share_of(sizes, MOST_ROWS) if thinned else max(sizes)
    rows = [Rows.of(part, target, most) for part in map(rules.rows, recordings, outlying)]
    told = [one.for_features(feature_set.names, robot, joints) for one in candidates]
    return Group(feature_set, rows, told, target)


def _knowing(model: JointRegressor, recordings: Sequence[Recording]) -> JointRegressor | None:
    """Unfitted copy that knows the recordings; None where they lack what it takes of its own."""
    own = model.family.inputs
    if own is None:
        return model.for_recordings(recordings)
    try:
        told = model.for_recordings(recordings)
    except CalibrationError:
        return None
    signals = FeatureSet.parse(own(told.model_params())).signals
    has_all = all(name in one.table.columns for one in recordings for name in signals)
    return told if has_all else None


def _member_names(model: JointRegressor) -> list[str]:
    """Names of the members of a combination with features of its own."""
    members = vars(model).get("members", ()) if model.family.inputs is not None else ()
    return [str(getattr(one, "name", one)) for one in members]


def untold(_fraction: float) -> None:
    """Progress that nobody asked for."""


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
    if not beside:
        return model.fit(inputs, targets, report, dt)
    loads = np.concatenate([known_loads(part.recording, beside) for part in parts])
    return model.fit(inputs, targets, report, dt, loads=loads)  # type: ignore[call-arg]  # it says so


def known_loads(recording: Recording, names: Sequence[str]) -> Array:
    """Look up loads (n, k) [Nm] in the columns called so, 0 where a recording has none."""
    none = np.zeros(len(recording))
    return np.column_stack([recording.table.get(name, none) for name in names])


def _groups(recordings: Sequence[Recording], zero: ZeroOf) -> tuple[list[str], Integers]:
    """Names of what recordings share a zero with, and which of them each does.

    A recording whose homing has no name is one of its own.
    """
    if zero not in get_args(ZeroOf):
        raise CalibrationError(f"zero {zero!r:.60}; choose {', '.join(get_args(ZeroOf))}")
    origins = [recording.provenance for recording in recordings]
    keys = [(zero == "homing" and one.homing_id) or i for i, one in enumerate(origins)]
    different = list(dict.fromkeys(keys))
    names = [key if isinstance(key, str) else source_of(recordings[key]) for key in different]
    if len(names) < 2:
        raise CalibrationError(
            f"a zero for each {zero} takes two of them; all recordings are of {names[0]}: give "
            "more, or let them share one zero"
        )
    return names, np.array([different.index(key) for key in keys])


def _at_one_zero(
    parts: Sequence[TrainingRows],
    group: Integers,
    moves: Array | None,
    signals: Sequence[str],
) -> tuple[Sequence[TrainingRows], Array]:
    """Parts without the zeros of their groups, and these zeros (n_groups, n_joints) [rad or m].

    `group` (n_parts,) numbers the groups. The zeros are taken off the truth, or with `moves`
    (n_signals, n_joints) added to the `signals`. They are about their mean. Raises CalibrationError
    where the signals leave open what was added to them.
    """
    found = _group_zeros(parts, group)
    if moves is None:
        pairs = zip(parts, found[group], strict=True)
        return [replace(p, error=p.error - z, truth=p.truth - z) for p, z in pairs], found
    zeros, at_zero, left = np.zeros_like(found), parts, found
    while np.abs(left).max() > _SETTLED:
        zeros = zeros + left
        at_zero = [
            part.rules.rows(shift_signals(part.recording, signals, moves @ own), part.outlying)
            for part, own in zip(parts, zeros[group], strict=True)
        ]
        before, left = left, _group_zeros(at_zero, group)
        if not np.abs(left).max() < _FOLLOWS * np.abs(before).max():
            raise CalibrationError(
                "the true position hardly follows the measured one where other signals are known, "
                "so the zero of a homing cannot be found; choose a zero for each recording"
            )
    return at_zero, zeros


def _group_zeros(parts: Sequence[TrainingRows], group: Integers) -> Array:
    """Zeros (n_groups, n_joints) [rad or m] about their mean: least squares with the linear model.

    The slopes are those within the groups, so a feature that changes between them alone has none.
    """
    rows = np.repeat(group, [len(part.fitted) for part in parts])
    X, error = (fitted_rows(parts, name) for name in ("features", "error"))
    inputs, errors = np.zeros_like(X), np.zeros_like(error)
    for number in range(int(group.max()) + 1):
        own = rows == number
        varies = ~constant_columns(X[own])
        inputs[np.ix_(own, varies)] = (X[own] - X[own].mean(axis=0))[:, varies]
        errors[own] = error[own] - error[own].mean(axis=0)
    left = error - get_estimator("linear").fit(inputs, errors).predict(X)
    zeros = np.array([left[rows == n].mean(axis=0) for n in range(int(group.max()) + 1)])
    return np.asarray(zeros - zeros.mean(axis=0))


def _unfitted(
    estimator: str | Regressor, target: Target | None, random_state: int | None
) -> JointRegressor:
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
