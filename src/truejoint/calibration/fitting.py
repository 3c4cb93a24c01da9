"""Fit a calibration to recordings that hold the true joint positions."""

from __future__ import annotations

import hashlib
import math
import platform
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any, Final, Literal, get_args

import numpy as np
from sklearn.base import clone

from truejoint.array_types import Array, Integers, Mask
from truejoint.calibration.calibration import Calibration
from truejoint.calibration.choice import Automatic, Choice, Group, Rows, choose
from truejoint.calibration.effort_fitting import fit_effort_baseline
from truejoint.calibration.folds import FEW, folds
from truejoint.calibration.parity import fit_parity_equations, redundant_columns
from truejoint.calibration.sessions import (
    check_arm,
    check_columns,
    check_unit,
    session_of,
    source_of,
)
from truejoint.calibration.signal_shift import shift_signals, signal_moves
from truejoint.calibration.training_domain import fit_training_domain
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
    time_steps,
)
from truejoint.recordings import Recording
from truejoint.recordings.checks.outliers import gross_outliers
from truejoint.recordings.recording import as_recordings
from truejoint.robots import Robot

LONGEST_WITHOUT_TRUTH: Final = 1 / 3  # share of a recording's time, beyond which it is refused

ZeroOf = Literal["shared", "recording", "homing"]

_CHOICE_SHARE: Final = 0.9  # of the progress bar, where there is a choice
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
    zero: ZeroOf = "shared",
    progress: Progress | None = None,
) -> Calibration:
    """Fit an estimator, and the baselines beside it, to recordings with truth (peng2024, II-C).

    Rows without truth, and gross outliers of it, are left out and counted in the metadata as
    ``rows_without_truth`` and ``outliers``. Of a row with an outlier, the baselines and the network
    are still fitted to the other joints (`JointRegressor.partial`).

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
    zero : {"shared", "recording", "homing"}
        Whether the recordings share one zero. With ``"recording"``, the estimator is fitted a
        second time, with an offset of truth against measured position for each recording; with
        ``"homing"``, for each homing, by which the measured positions themselves are off, inputs of
        the model included. The zeros are those of a linear model on the same features. The second
        fit (`Calibration.fitted_for`) is for motions that begin with re-zeroing and is useless
        without, as all that differs between recordings has gone into the zeros.
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
    report = progress or (lambda _fraction: None)
    if isinstance(estimator, Automatic) or estimator == AUTO:
        wanted = estimator if isinstance(estimator, Automatic) else Automatic()
        choice = _choose(
            recordings,
            wanted,
            features,
            joints,
            target,
            fit_rate,
            random_state,
            lambda fraction: report(_CHOICE_SHARE * fraction),
        )
        fitted = calibrate(
            recordings, choice.estimator, features=choice.features, joints=joints, target=target,
            redundant=redundant, fit_rate=fit_rate, zero=zero,
            progress=lambda fraction: report(_CHOICE_SHARE + (1.0 - _CHOICE_SHARE) * fraction),
        )  # fmt: skip
        return fitted.with_metadata(choice=choice.told)
    robot = _common_robot(recordings)
    groups = _groups(recordings, zero)
    model = _unfitted(estimator, target, random_state)
    target = target or model.family.targets[0]
    model = model.for_recordings(recordings)
    chosen = _chosen_joints(robot, recordings, joints)
    feature_set = _chosen_features(model, robot, recordings, features)
    dt, gap_limit = sample_dt(recordings), default_gap_limit(recordings)
    if feature_set.counts_samples or model.family.counts_samples:
        for recording in recordings:
            check_sample_dt(recording, dt)
    units = _common_units(recordings, feature_set, chosen)
    parity, redundant_units = fit_parity_equations(
        recordings, chosen, tuple(units), _redundant_columns(recordings, redundant)
    )
    stride = _stride(fit_rate, dt)
    parts = [
        _part(recording, outlying, feature_set, chosen, gap_limit, stride)
        for recording, outlying in zip(recordings, _outlying(recordings, chosen), strict=True)
    ]
    X, error = (_fitted_rows(parts, name) for name in ("features", "error"))
    unused = _unused_features(X, feature_set, chosen, fixed=model.family.inputs is not None)
    n_features = len(feature_set) - len(unused)
    needed = model.minimum_rows(n_features)
    if len(X) < needed:
        raise CalibrationError(
            f"{len(X)} rows with truth; {model.name} with {n_features} features needs {needed}: "
            "record for longer, or choose fewer features or a simpler estimator"
        )
    fits = 1 if groups is None else 2

    def fit(parts: Sequence[_Part], done: int) -> tuple[dict[str, JointRegressor], dict[str, str]]:
        """Model and baselines, the fit after `done` of them, and notes on the latter."""
        share = (1.0 - _BASELINE_SHARE) / fits
        own = _fit_model(
            clone(model), parts, target, stride, gap_limit, lambda f: report(share * (done + f))
        )
        baselines, notes = _fit_baselines(*_partly(parts, stride), n_features)
        return {"model": own, **baselines}, notes

    baselines, notes = fit(parts, 0)
    zeros: dict[str, Any] = {"of": zero}
    rezero_models: dict[str, JointRegressor] = {}
    moves: Array | None = None
    at_zero: Sequence[_Part] = parts
    if groups is not None:
        names, index = groups
        moves = signal_moves(recordings, tuple(units), chosen) if zero == "homing" else None

        def part_of(recording: Recording, outlying: Mask) -> _Part:
            return _part(recording, outlying, feature_set, chosen, gap_limit, stride)

        at_zero, found = _at_one_zero(parts, index, moves, tuple(units), part_of)
        rezero_models, _ = fit(at_zero, 1)
        zeros |= {"names": names, "offsets": found.tolist()}
    report(1.0)
    fitted = Calibration(
        robot=robot.name,
        arm=robot.arm,
        joints=chosen,
        feature_set=feature_set,
        target=target,
        units=units,
        gap_limit=gap_limit,
        lower=X.min(axis=0),
        upper=X.max(axis=0),
        model=baselines.pop("model"),
        baseline_models=baselines,
        rezero_models=rezero_models,
        moves=moves,
        training_domain=fit_training_domain(
            recordings, (*units, *redundant_units), gap_limit, X, error
        ),
        parity=parity,
        redundant=redundant_units,
        metadata={
            **_origin(parts),
            "sample_dt": dt,
            "estimator": model.name,
            "settings": " ".join(repr(model).split()),
            "unused_features": unused,
            "baseline_notes": notes,
            "zeros": zeros,
        },
    )
    used = fitted.fitted_for(rezeroing=True)
    baseline = fit_effort_baseline(used, [part.recording for part in at_zero])
    return replace(fitted, effort_baseline=baseline)


def _choose(
    recordings: Sequence[Recording],
    wanted: Automatic,
    features: FeatureSet | Iterable[str] | None,
    joints: Sequence[str] | None,
    target: Target | None,
    fit_rate: float | None,
    random_state: int | None,
    progress: Progress | None,
) -> Choice:
    """Choose among the estimators that can predict the target, each with its features."""
    robot = _common_robot(recordings)
    chosen = _chosen_joints(robot, recordings, joints)
    models = [_unfitted(one, None, random_state) for one in wanted.candidates]
    target = target or TARGETS[0]
    by_features: dict[FeatureSet, list[JointRegressor]] = {}
    for model in (one for one in models if target in one.family.targets):
        model = model.for_recordings(recordings)  # noqa: PLW2901
        own = features if model.family.inputs is None else None
        by_features.setdefault(_chosen_features(model, robot, recordings, own), []).append(model)
    if wanted.default_features and features is not None and len(recordings) >= FEW:
        usual = default_features(robot, recordings[0])
        by_features.setdefault(usual, next(iter(by_features.values())))
    gap_limit, stride = default_gap_limit(recordings), _stride(fit_rate, sample_dt(recordings))
    outlying = _outlying(recordings, chosen)
    groups = []
    for feature_set, candidates in by_features.items():
        rows = []
        for recording, out in zip(recordings, outlying, strict=True):
            part = _part(recording, out, feature_set, chosen, gap_limit, stride)
            dt = time_steps(np.array(recording.t), gap_limit)
            targets = part.targets(target, stride)
            rows.append(Rows(recording.t, dt, part.features, targets, part.error))
        groups.append(Group(feature_set, rows, candidates))
    return choose(groups, folds(recordings), chosen, wanted.tell, progress)


@dataclass(frozen=True, eq=False)
class _Part:
    """What one recording gives to fit to."""

    recording: Recording
    features: Array  # (n, k)
    truth: Array  # (n, n_joints) [rad or m], not known in every row
    error: Array  # (n, n_joints), truth minus measured
    known: Mask  # (n,), where the truth of every joint is, and not outlying
    outlying: Mask  # (n, n_joints), values that are left out
    fitted: Integers  # (m,), rows fitted to of those

    @property
    def outliers(self) -> int:
        """Rows with truth of which a value is left out."""
        return int((np.isfinite(self.truth).all(axis=1) & self.outlying.any(axis=1)).sum())

    def partly(self, stride: int, target: Target = "error") -> tuple[Array, Array]:
        """Features and targets of rows (m, ...) with truth, outlying values NaN."""
        rows = np.flatnonzero(np.isfinite(self.truth).all(axis=1) & ~self.outlying.all(axis=1))
        rows = rows[::stride]
        known = self.error if target == "error" else self.truth
        return self.features[rows], np.where(self.outlying[rows], np.nan, known[rows])

    def targets(self, target: Target, stride: int) -> Array:
        """Targets of every row (n, n_joints), NaN where they are not fitted to."""
        targets = np.array(self.error if target == "error" else self.truth)
        targets[~self.known | (np.arange(len(targets)) % stride != 0)] = np.nan
        return targets


def _fitted_rows(parts: Sequence[_Part], name: str) -> Array:
    """Rows (m, ...) that are fitted to, of all parts, of the array called `name`."""
    rows = [getattr(part, name)[part.fitted] for part in parts]
    return np.asarray(np.concatenate(rows))


def _partly(parts: Sequence[_Part], stride: int, target: Target = "error") -> tuple[Array, Array]:
    """Features (m, k) and targets (m, n_joints) of all parts, NaN where a value is left out."""
    features, targets = zip(*(part.partly(stride, target) for part in parts), strict=True)
    return np.concatenate(features), np.concatenate(targets)


def _fit_model(
    model: JointRegressor,
    parts: Sequence[_Part],
    target: Target,
    stride: int,
    gap_limit: float,
    report: Progress,
) -> JointRegressor:
    if model.partial:
        return model.fit(*_partly(parts, stride, target), report)
    if not model.family.remembers:
        known = "error" if target == "error" else "truth"
        return model.fit(_fitted_rows(parts, "features"), _fitted_rows(parts, known), report)
    inputs = np.concatenate([part.features for part in parts])
    times = [time_steps(np.array(part.recording.t), gap_limit) for part in parts]
    targets = np.concatenate([part.targets(target, stride) for part in parts])
    return model.fit(inputs, targets, report, np.concatenate(times))


def _groups(recordings: Sequence[Recording], zero: ZeroOf) -> tuple[list[str], Integers] | None:
    """Names of what recordings share a zero with, and which of them each does; None: one for all.

    A recording whose homing has no name is one of its own.
    """
    if zero not in get_args(ZeroOf):
        raise CalibrationError(f"zero {zero!r:.60}; choose {', '.join(get_args(ZeroOf))}")
    if zero == "shared":
        return None
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
    parts: Sequence[_Part],
    group: Integers,
    moves: Array | None,
    signals: Sequence[str],
    part_of: Callable[[Recording, Mask], _Part],
) -> tuple[Sequence[_Part], Array]:
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
            part_of(shift_signals(part.recording, signals, moves @ own), part.outlying)
            for part, own in zip(parts, zeros[group], strict=True)
        ]
        before, left = left, _group_zeros(at_zero, group)
        if not np.abs(left).max() < _FOLLOWS * np.abs(before).max():
            raise CalibrationError(
                "the true position hardly follows the measured one where other signals are known, "
                "so the zero of a homing cannot be found; choose a zero for each recording"
            )
    return at_zero, zeros


def _group_zeros(parts: Sequence[_Part], group: Integers) -> Array:
    """Zeros (n_groups, n_joints) [rad or m] about their mean: least squares with the linear model.

    The slopes are those within the groups, so a feature that changes between them alone has none.
    """
    rows = np.repeat(group, [len(part.fitted) for part in parts])
    X, error = (_fitted_rows(parts, name) for name in ("features", "error"))
    within, errors = np.zeros_like(X), np.zeros_like(error)
    for number in range(int(group.max()) + 1):
        own = rows == number
        varies = ~constant_columns(X[own])
        within[np.ix_(own, varies)] = (X[own] - X[own].mean(axis=0))[:, varies]
        errors[own] = error[own] - error[own].mean(axis=0)
    left = error - get_estimator("linear").fit(within, errors).predict(X)
    zeros = np.array([left[rows == n].mean(axis=0) for n in range(int(group.max()) + 1)])
    return np.asarray(zeros - zeros.mean(axis=0))


def _common_robot(recordings: Sequence[Recording]) -> Robot:
    if not recordings:
        raise CalibrationError("no recordings to calibrate on; give at least one")
    robot = recordings[0].robot
    for recording in recordings:
        other = f"{source_of(recordings[0])} of {robot.title}"
        check_arm(recording, (robot.name, robot.arm), other)
    return robot


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


def _chosen_joints(
    robot: Robot, recordings: Sequence[Recording], joints: Sequence[str] | None
) -> tuple[str, ...]:
    """Joints asked for, or the positioning joints of which each recording has the truth."""
    if joints is None:
        with_truth = [set(recording.joints_of("truth")) for recording in recordings]
        chosen = tuple(j for j in robot.positioning if all(j in known for known in with_truth))
        if not chosen:
            raise CalibrationError(
                f"{source_of(recordings[0])} has no truth column of {', '.join(robot.positioning)}"
                "; a calibration needs the true position of a joint that positions the tool"
            )
    else:
        chosen = tuple(dict.fromkeys([joints] if isinstance(joints, str) else joints))
        robot.index(chosen)
        if not chosen:
            raise CalibrationError(
                f"no joints to correct; {robot.title} has {', '.join(robot.joint_names)}"
            )
    for recording in recordings:
        for column in (f"{q}/{joint}" for q in ("measured", "truth") for joint in chosen):
            if column not in recording.table.columns:
                raise CalibrationError(
                    f"{source_of(recording)} has no column {column!r}, which calibrating "
                    f"{', '.join(chosen)} needs; it has {', '.join(recording.units)}"
                )
    return chosen


def _chosen_features(
    model: JointRegressor,
    robot: Robot,
    recordings: Sequence[Recording],
    features: FeatureSet | Iterable[str] | None,
) -> FeatureSet:
    """Features asked for, which must be as many as the model takes; its own by default."""
    params, own = model.model_params(), model.family.inputs
    if features is None:
        chosen = FeatureSet.parse(own(params)) if own else default_features(robot, recordings[0])
    else:
        chosen = FeatureSet.parse(features)
    if features is not None:
        model.family.check_size(params, len(chosen))
    for recording in recordings:
        check_columns(recording, chosen.signals, "features need")
    return chosen


def _redundant_columns(
    recordings: Sequence[Recording], asked: Sequence[str] | None
) -> dict[str, str]:
    """Units of the redundant columns that are asked for; of all by default."""
    there = redundant_columns(recordings)
    if asked is None:
        return there
    for column in asked:
        if column not in there:
            raise CalibrationError(
                f"column {column!r:.60} cannot check a measured position; these can, being in "
                f"every recording: {', '.join(there) or 'none'}"
            )
    return {column: there[column] for column in asked}


def _common_units(
    recordings: Sequence[Recording], feature_set: FeatureSet, joints: Sequence[str]
) -> dict[str, str]:
    """Units of the columns that the calibration will need; the truth must share them."""
    first = recordings[0]
    columns = (*feature_set.signals, *(f"measured/{joint}" for joint in joints))
    units = {column: first.units[column] for column in columns}
    for recording in recordings:
        for column, unit in units.items():
            check_unit(recording, column, unit, f"in {source_of(first)} in")
        for joint in joints:
            measured = f"measured/{joint}"
            check_unit(recording, f"truth/{joint}", units[measured], f"{measured!r} in")
    return units


def _outlying(recordings: Sequence[Recording], joints: Sequence[str]) -> list[Mask]:
    """Values (n, n_joints) of each recording that are grossly off their neighbours."""
    by_joint = [gross_outliers(recordings, joint) for joint in joints]
    return [np.column_stack(masks) for masks in zip(*by_joint, strict=True)]


def _part(
    recording: Recording,
    outlying: Mask,
    feature_set: FeatureSet,
    joints: tuple[str, ...],
    gap_limit: float,
    stride: int,
) -> _Part:
    truth = recording.columns("truth", joints)
    known = np.asarray(np.isfinite(truth).all(axis=1))
    _check_truth(recording, known, joints)
    features, error = feature_set.compute(recording, gap_limit), recording.error(joints)
    known &= ~outlying.any(axis=1)
    return _Part(
        recording, features, truth, error, known, outlying, np.flatnonzero(known)[::stride]
    )


def _stride(fit_rate: float | None, dt: float) -> int:
    """Every how many rows one is fitted to, of rows that are `dt` [s] apart."""
    if fit_rate is None:
        return 1
    if not 1e-9 <= fit_rate < math.inf:
        raise CalibrationError(f"fit rate is {fit_rate} Hz; it must be above 0 Hz, 1e-9 at least")
    return max(1, round(1.0 / (fit_rate * dt)))


def _check_truth(recording: Recording, known: Mask, joints: Sequence[str]) -> None:
    """Refuse a recording whose truth is missing for more than a third of its time on end."""
    t = recording.t
    what = ", ".join(f"truth/{joint}" for joint in joints)
    if not known.any():
        raise CalibrationError(
            f"{source_of(recording)}: {what} known together in none of {len(t)} rows; check that "
            "the joint sensors ran and share the clock of the robot"
        )
    marks = np.concatenate([t[:1], t[known], t[-1:]])
    worst = int(np.argmax(np.diff(marks)))
    longest = float(marks[worst + 1] - marks[worst])
    if longest > LONGEST_WITHOUT_TRUTH * recording.duration:
        raise CalibrationError(
            f"{source_of(recording)}: {what} missing from {marks[worst]:.2f} s to "
            f"{marks[worst + 1]:.2f} s, {100 * longest / recording.duration:.0f} % of the "
            "recording (a third is allowed); cut it to the part with truth or record it again"
        )


def _unused_features(
    X: Array, feature_set: FeatureSet, joints: Sequence[str], *, fixed: bool
) -> list[str]:
    """Features that never change: nothing is learnt of them.

    Refused are those that a model insists on (`fixed`), and positions of `joints`.
    """
    constant = [feature_set.names[i] for i in np.flatnonzero(constant_columns(X))]
    stuck = [name for name in constant if fixed or name in {f"measured/{j}" for j in joints}]
    if stuck or len(constant) == len(feature_set):
        raise CalibrationError(
            f"features {', '.join(stuck or constant)} never change in the training rows, so "
            "nothing can be learnt of them; move those joints, check their sensors, or leave the "
            "features or joints out"
        )
    return constant


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


def _origin(parts: Sequence[_Part]) -> dict[str, Any]:
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
