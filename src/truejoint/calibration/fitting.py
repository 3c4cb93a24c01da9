"""Fit a calibration to recordings that hold the true joint positions."""

from __future__ import annotations

import hashlib
import math
import platform
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from sklearn.base import clone

from truejoint.array_types import Array, Integers
from truejoint.calibration.calibration import Calibration
from truejoint.calibration.conformal import (
    check_arm,
    check_columns,
    check_unit,
    session_of,
    source_of,
)
from truejoint.calibration.effort_baseline import fit_effort_baseline
from truejoint.calibration.training_domain import fit_training_domain
from truejoint.errors import CalibrationError
from truejoint.estimators.base import JointRegressor, Progress, constant_columns
from truejoint.estimators.registry import BASELINES, DEFAULT
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
from truejoint.recordings.recording import as_recordings
from truejoint.robots import Robot

LONGEST_WITHOUT_TRUTH: Final = 1 / 3  # share of a recording's time, beyond which it is refused

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

    Raises
    ------
    CalibrationError
        If the recordings do not belong together, lack truth for more than a third of their time,
        have too few rows for the estimator (ten for each coefficient; 1000 and 50 for each
        feature for a network), or the measured position of a joint never changes. Other features
        that never change are not learnt of, and listed in the metadata as ``unused_features``.

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
    chosen = _chosen_joints(robot, recordings, joints)
    feature_set = _chosen_features(model, robot, recordings, features)
    dt, gap_limit = sample_dt(recordings), default_gap_limit(recordings)
    if feature_set.counts_samples or model.family.counts_samples:
        for recording in recordings:
            check_sample_dt(recording, dt)
    units = _common_units(recordings, feature_set, chosen)
    stride = _stride(fit_rate, dt)
    parts = [_part(recording, feature_set, chosen, gap_limit, stride) for recording in recordings]
    X, error, truth = (
        np.concatenate([getattr(part, name)[part.fitted] for part in parts])
        for name in ("features", "error", "truth")
    )
    unused = _unused_features(X, feature_set, chosen, fixed=model.family.inputs is not None)
    n_features = len(feature_set) - len(unused)
    needed = model.minimum_rows(n_features)
    if len(X) < needed:
        raise CalibrationError(
            f"{len(X)} rows with truth; {model.name} with {n_features} features needs {needed}: "
            "record for longer, or choose fewer features or a simpler estimator"
        )
    report = progress or (lambda _fraction: None)

    def model_report(fraction: float) -> None:
        report((1.0 - _BASELINE_SHARE) * fraction)

    if model.family.remembers:
        inputs = np.concatenate([part.features for part in parts])
        times = [time_steps(np.array(recording.t), gap_limit) for recording in recordings]
        targets = np.concatenate([part.targets(target, stride) for part in parts])
        model.fit(inputs, targets, model_report, np.concatenate(times))
    else:
        model.fit(X, error if target == "error" else truth, model_report)
    baselines, notes = _fit_baselines(X, error, n_features)
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
        model=model,
        baseline_models=baselines,
        training_domain=fit_training_domain(recordings, tuple(units), gap_limit, X, error),
        metadata={
            **_origin(parts),
            "sample_dt": dt,
            "estimator": model.name,
            "settings": " ".join(repr(model).split()),
            "unused_features": unused,
            "baseline_notes": notes,
        },
    )
    return replace(fitted, effort_baseline=fit_effort_baseline(fitted, recordings))


@dataclass(frozen=True, eq=False)
class _Part:
    """What one recording gives to fit to."""

    recording: Recording
    features: Array  # (n, k)
    truth: Array  # (n, n_joints) [rad or m], not known in every row
    error: Array  # (n, n_joints), truth minus measured
    known: NDArray[np.bool_]  # (n,), where the truth of every joint is
    fitted: Integers  # (m,), rows fitted to of those

    def targets(self, target: Target, stride: int) -> Array:
        """Targets of every row (n, n_joints), NaN where they are not fitted to."""
        targets = np.array(self.error if target == "error" else self.truth)
        targets[~self.known | (np.arange(len(targets)) % stride != 0)] = np.nan
        return targets


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
    elif isinstance(features, FeatureSet):
        chosen = features
    else:
        chosen = FeatureSet.parse([features] if isinstance(features, str) else features)
    if features is not None:
        model.family.check_size(params, len(chosen))
    for recording in recordings:
        check_columns(recording, chosen.signals, "features need")
    return chosen


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


def _part(
    recording: Recording,
    feature_set: FeatureSet,
    joints: tuple[str, ...],
    gap_limit: float,
    stride: int,
) -> _Part:
    truth = recording.columns("truth", joints)
    known = np.asarray(np.isfinite(truth).all(axis=1))
    _check_truth(recording, known, joints)
    features, error = feature_set.compute(recording, gap_limit), recording.error(joints)
    return _Part(recording, features, truth, error, known, np.flatnonzero(known)[::stride])


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
        counts = {"rows": len(part.fitted), "rows_without_truth": int((~part.known).sum())}
        duration = {"duration": part.recording.duration}
        sessions.append(session_of(part.recording) | counts | duration)
    totals = ("rows", "rows_without_truth", "duration")
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
