"""Fit a calibration to recordings that hold the true joint positions."""

from __future__ import annotations

import hashlib
import math
import platform
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from sklearn.base import clone

from truejoint.array_types import Array
from truejoint.calibration.calibration import Calibration
from truejoint.calibration.conformal import session_of, source_of
from truejoint.calibration.effort_fitting import fit_effort_baseline
from truejoint.calibration.training_domain import fit_training_domain
from truejoint.errors import CalibrationError, meant
from truejoint.estimators.base import JointRegressor, Progress, constant_columns
from truejoint.estimators.lookup import get_estimator
from truejoint.estimators.registry import BASELINES, DEFAULT
from truejoint.estimators.wrapped import Regressor, joint_regressor
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
from truejoint.recordings.recording import as_recordings
from truejoint.robots import Robot

LONGEST_WITHOUT_TRUTH: Final = 1 / 3
"""Share of a recording's time that may pass without truth before it is refused."""

_BASELINE_SHARE: Final = 0.1  # of the progress bar


def calibrate(
    recordings: Recording | Sequence[Recording],
    estimator: str | Regressor = DEFAULT,
    *,
    features: FeatureSet | Iterable[str] | None = None,
    joints: Sequence[str] | None = None,
    target: Target | None = None,
    fit_rate: float | None = None,
    random_state: int | None = None,
    progress: Progress | None = None,
) -> Calibration:
    """Fit an estimator, and the baselines beside it, to recordings with truth (peng2024, II-C).

    Rows without truth are left out and counted in the metadata.

    Parameters
    ----------
    recordings : Recording or sequence of Recording
        Of one arm, all with the same units.
    estimator : str or Regressor
        A name in `estimator_names`, or an unfitted estimator with parameters of its own: one of
        ours, or anything with scikit-learn's `fit` and `predict`; see `WrappedRegressor`.
    features : FeatureSet or iterable of str, optional
        Inputs of the model; measured position and effort of every channel by default, or those
        that the estimator was made for.
    joints : sequence of str or str, optional
        Joints to correct; by default the robot's positioning joints that have truth.
    target : {"error", "position"}, optional
        Predict truth minus measured (peng2024, II-J: more accurate), or the position itself; by
        default the first that the estimator's family can be fitted to.
    fit_rate : float, optional
        Fit to rows at most at this rate [Hz], where more of them would only take longer; features
        with a history still see every row.
    random_state : int, optional
        Seed, where the estimator has one; its own by default.
    progress : callable, optional
        Called with the fraction done, 0 to 1.

    Returns
    -------
    Calibration

    Raises
    ------
    CalibrationError
        If the recordings do not belong together, lack truth for more than a third of their time,
        have too few rows for the estimator (ten for each coefficient; 1000 and 50 for each
        feature for a network), or a feature is constant though its channel is in use.

    Examples
    --------
    >>> calibrate(training, "linear").joints
    ('jaw',)
    """
    recordings = as_recordings(recordings)
    robot = _common_robot(recordings)
    model = _unfitted(estimator, target, random_state)
    target = target or model.family.targets[0]
    model.check_recordings(recordings)
    own_features = _own_features(model, features)
    chosen = _chosen_joints(robot, recordings, joints)
    feature_set = _chosen_features(robot, recordings, own_features)
    dt, gap_limit = sample_dt(recordings), default_gap_limit(recordings)
    if feature_set.counts_samples or model.family.counts_samples:
        for recording in recordings:
            check_sample_dt(recording, dt)
    units = _common_units(recordings, feature_set, chosen)
    stride = _stride(fit_rate, dt)
    rows = _gather(recordings, feature_set, chosen, gap_limit, stride)
    unused = _unused_features(rows.X, feature_set, robot)
    _check_count(rows, model, len(feature_set) - len(unused))
    report = progress or (lambda _fraction: None)

    def model_report(fraction: float) -> None:
        report((1.0 - _BASELINE_SHARE) * fraction)

    if model.family.remembers:
        targets, times = _sequence(recordings, chosen, target, gap_limit, stride)
        model.fit(np.concatenate(rows.features), targets, model_report, times)
    else:
        model.fit(rows.X, rows.error if target == "error" else rows.truth, model_report)
    baselines, notes = _fit_baselines(rows, len(feature_set) - len(unused))
    report(1.0)
    fitted = Calibration(
        robot=robot.name,
        arm=robot.arm,
        joints=chosen,
        feature_set=feature_set,
        target=target,
        units=units,
        gap_limit=gap_limit,
        lower=rows.X.min(axis=0),
        upper=rows.X.max(axis=0),
        model=model,
        baseline_models=baselines,
        training_domain=fit_training_domain(
            recordings, tuple(units), gap_limit, rows.X, rows.error
        ),
        metadata={
            **_origin(recordings, rows),
            "estimator": model.name,
            "settings": " ".join(repr(model).split()),
            "unused_features": unused,
            "baseline_notes": notes,
        },
    )
    return replace(fitted, effort_baseline=fit_effort_baseline(fitted, recordings))


@dataclass(frozen=True, eq=False)
class _Rows:
    """Rows fitted to, of those of all recordings in which every joint's truth is known."""

    features: tuple[Array, ...]  # of every row, recording by recording
    X: Array
    error: Array
    truth: Array
    counts: tuple[int, ...]
    without_truth: tuple[int, ...]
    data_sha256: str


def _common_robot(recordings: Sequence[Recording]) -> Robot:
    if not recordings:
        raise CalibrationError("no recordings to calibrate on; give at least one")
    robot = recordings[0].robot
    for recording in recordings:
        other = recording.robot
        if (other.name, other.arm) != (robot.name, robot.arm):
            raise CalibrationError(
                f"{source_of(recording)} is of {other.title}, {source_of(recordings[0])} of "
                f"{robot.title}; calibrate each arm on its own recordings"
            )
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


def _own_features(
    model: JointRegressor, features: FeatureSet | Iterable[str] | None
) -> FeatureSet | None:
    """Features asked for, which must be as many as the model takes; its own by default."""
    params = model.model_params()
    if features is None:
        own = model.family.inputs
        return FeatureSet.parse(own(params)) if own else None
    if not isinstance(features, FeatureSet):
        features = FeatureSet.parse([features] if isinstance(features, str) else features)
    model.family.check_size(params, len(features))
    return features


def _sequence(
    recordings: Sequence[Recording],
    joints: tuple[str, ...],
    target: Target,
    gap_limit: float,
    stride: int,
) -> tuple[Array, Array]:
    """Targets and time steps of every row; targets only where they are fitted to."""
    targets, dt = [], []
    for recording in recordings:
        truth = np.array(recording.columns("truth", joints))
        truth[~np.isfinite(truth).all(axis=1)] = np.nan
        truth[np.arange(len(truth)) % stride != 0] = np.nan
        measured = recording.columns("measured", joints)
        targets.append(truth - measured if target == "error" else truth)
        dt.append(time_steps(np.array(recording.t), gap_limit))
    return np.concatenate(targets), np.concatenate(dt)


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
    robot: Robot, recordings: Sequence[Recording], features: FeatureSet | None
) -> FeatureSet:
    feature_set = default_features(robot, recordings[0]) if features is None else features
    for recording in recordings:
        check_signals(recording, feature_set)
    return feature_set


def check_signals(recording: Recording, feature_set: FeatureSet) -> None:
    """Raise CalibrationError if a recording lacks a column that the features need."""
    missing = [s for s in feature_set.signals if s not in recording.table.columns]
    if missing:
        raise CalibrationError(
            f"{source_of(recording)} lacks {', '.join(missing)}, which the features need;"
            f"{meant(missing[0], recording.units)} it has {', '.join(recording.units)}"
        )


def _common_units(
    recordings: Sequence[Recording], feature_set: FeatureSet, joints: Sequence[str]
) -> dict[str, str]:
    """Units of the columns that the calibration will need; the truth must share them."""
    first = recordings[0]
    columns = (*feature_set.signals, *(f"measured/{joint}" for joint in joints))
    units = {column: first.units[column] for column in columns}
    for recording in recordings:
        for column, unit in units.items():
            if recording.units[column] != unit:
                raise CalibrationError(
                    f"{source_of(recording)}: {column!r} is in {recording.units[column]}, in "
                    f"{source_of(first)} in {unit}; convert it where the file is read"
                )
        for joint in joints:
            truth, measured = recording.units[f"truth/{joint}"], units[f"measured/{joint}"]
            if truth != measured:
                raise CalibrationError(
                    f"{source_of(recording)}: 'truth/{joint}' is in {truth}, 'measured/{joint}' in "
                    f"{measured}; convert it where the file is read"
                )
    return units


def _gather(
    recordings: Sequence[Recording],
    feature_set: FeatureSet,
    joints: tuple[str, ...],
    gap_limit: float,
    stride: int,
) -> _Rows:
    digest = hashlib.sha256()
    features, inputs, errors, truths, counts, without = [], [], [], [], [], []
    for recording in recordings:
        truth = recording.columns("truth", joints)
        known = np.asarray(np.isfinite(truth).all(axis=1))
        _check_truth(recording, known, joints)
        X = feature_set.compute(recording, gap_limit)
        error = recording.error(joints)
        for array in (recording.t, X, truth, error):
            digest.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
        fitted = np.flatnonzero(known)[::stride]
        features.append(X)
        inputs.append(X[fitted])
        truths.append(truth[fitted])
        errors.append(error[fitted])
        counts.append(len(fitted))
        without.append(int((~known).sum()))
    return _Rows(
        tuple(features),
        np.concatenate(inputs),
        np.concatenate(errors),
        np.concatenate(truths),
        tuple(counts),
        tuple(without),
        digest.hexdigest(),
    )


def _stride(fit_rate: float | None, dt: float) -> int:
    """Every how many rows one is fitted to, of rows that are `dt` [s] apart."""
    if fit_rate is None:
        return 1
    if not (math.isfinite(fit_rate) and fit_rate > 0):
        raise CalibrationError(f"fit rate is {fit_rate} Hz; it must be above 0 Hz")
    return max(1, round(1.0 / (fit_rate * dt)))


def _check_truth(recording: Recording, known: NDArray[np.bool_], joints: Sequence[str]) -> None:
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


def _unused_features(X: Array, feature_set: FeatureSet, robot: Robot) -> list[str]:
    """Constant features of channels without a joint; any other constant feature is refused."""
    constant = [feature_set.features[i] for i in np.flatnonzero(constant_columns(X))]
    unused = [f for f in constant if f.signal.partition("/")[2] in robot.unused_channels]
    stuck = [str(f) for f in constant if f not in unused]
    if stuck:
        raise CalibrationError(
            f"features {', '.join(stuck)} never change in the training rows, so nothing can be "
            "learnt of them; move those joints, check their sensors, or leave the features out"
        )
    return [str(f) for f in unused]


def _check_count(rows: _Rows, model: JointRegressor, n_features: int) -> None:
    needed = model.minimum_rows(n_features)
    if len(rows.X) < needed:
        raise CalibrationError(
            f"{len(rows.X)} rows with truth; {model.name} with {n_features} features needs "
            f"{needed}: record for longer, or choose fewer features or a simpler estimator"
        )


def _fit_baselines(
    rows: _Rows, n_features: int
) -> tuple[dict[str, JointRegressor], dict[str, str]]:
    """Baselines fitted to the error, and what is to be known about one that is weak or absent."""
    fitted: dict[str, JointRegressor] = {}
    notes: dict[str, str] = {}
    for name in BASELINES:
        model = get_estimator(name)
        try:
            fitted[name] = model.fit(rows.X, rows.error)
        except CalibrationError as error:
            notes[name] = f"left out: {error}"
            continue
        needed = model.minimum_rows(n_features)
        if len(rows.X) < needed:
            notes[name] = f"fitted to {len(rows.X)} rows, though it needs {needed}"
    return fitted, notes


def _origin(recordings: Sequence[Recording], rows: _Rows) -> dict[str, Any]:
    """Where the training rows come from, as JSON values."""
    sessions: list[Mapping[str, Any]] = []
    for recording, count, without in zip(recordings, rows.counts, rows.without_truth, strict=True):
        counts = {"rows": count, "rows_without_truth": without, "duration": recording.duration}
        sessions.append(session_of(recording) | counts)
    return {
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": {
            "python": platform.python_version(),
            **{name: version(name) for name in ("truejoint", "numpy", "scikit-learn")},
        },
        "rows": len(rows.X),
        "rows_without_truth": sum(rows.without_truth),
        "duration": float(sum(recording.duration for recording in recordings)),
        "sample_dt": sample_dt(recordings),
        "sessions": sessions,
        "homing_ids": sorted({r.provenance.homing_id for r in recordings} - {""}),
        "data_sha256": rows.data_sha256,
    }
