"""Fit a calibration to recordings that hold the true joint positions."""

import hashlib
import platform
import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from importlib.metadata import version
from operator import attrgetter
from typing import Any, Final, get_args

import numpy as np
from numpy.typing import ArrayLike

from truejoint.calibration.baseline_fit import fit_effort_baseline, residual_baseline
from truejoint.calibration.calibration import Calibration, Fit
from truejoint.calibration.choose import (
    FITTED_ROWS,
    MOST_ROWS,
    Automatic,
    Say,
    choose,
    share_of,
    validate_zeros,
)
from truejoint.calibration.conditions import conditions_of
from truejoint.calibration.domain import fit_training_domain, resting_features
from truejoint.calibration.fit_task import FitTask, fitted_rows, recording_zeros, stride_of, within
from truejoint.calibration.folds import FEW, Fold, folds, wholes, without
from truejoint.calibration.origin import Origin, Session, ZeroOf, distinct
from truejoint.calibration.potentiometers import learn_reference
from truejoint.calibration.redundancy import fit_parity_equations
from truejoint.calibration.rows import Rows
from truejoint.errors import CalibrationError
from truejoint.estimators.base import Progress, shared_fits, untold
from truejoint.estimators.family import Target
from truejoint.estimators.registry import AUTO, DEFAULT
from truejoint.estimators.wrapped import Regressor
from truejoint.features.feature_set import FeatureSet, default_gap_limit
from truejoint.recordings import Recording
from truejoint.recordings.table.recording import as_recordings

_CHOICE_SHARE: Final = 0.7  # of the progress bar, where there is a choice,
_ZEROS_SHARE: Final = 0.2  # and of judging zeros then


@shared_fits()
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
    ``rows_without_truth`` and ``outliers``, beside the time that it took, ``fit_seconds``. The
    baselines and the network are still fitted to the other joints of a row with an outlier.

    Parameters
    ----------
    recordings : Recording or sequence of Recording
        Recordings of one arm, all with the same units.
    estimator : str, Regressor or Automatic
        A name in `estimator_names`, or an unfitted estimator with its own parameters: one of
        ours, or anything with scikit-learn's `fit` and `predict`; see `WrappedRegressor`. ``auto``,
        or `Automatic`: what is best on recordings that are left out in turn. This is the default.
    features : FeatureSet or iterable of str, optional
        Inputs of the model; measured position and effort of every channel by default, or those
        that the estimator was made for.
    joints : sequence of str or str, optional
        Joints to correct; by default the robot's positioning joints that have truth.
    target : {"error", "position"}, optional
        Predict truth minus measured (peng2024, II-J: more accurate), or the position itself; by
        default the first that the estimator can be fitted to.
    redundant : sequence of str, optional
        Columns by which a control loop checks the measured positions, such as ``"motor/elbow"``;
        all that every recording has by default. A `Corrector` needs those that tell something;
        correcting a recording needs none.
    fit_rate : float, optional
        Fit to rows at most at this rate [Hz]; features with a history still see every row.
    random_state : int, optional
        Seed, where the estimator has one; its own by default.
    zero : {"shared", "recording"}, optional
        Whether the recordings share one zero, as they do by default; of what was chosen
        automatically, one for each recording is kept beside where it is better: see `Automatic`.
        With ``"recording"``, the estimator is fitted a second time, with an offset of truth against
        measured position for each recording: that of a linear model on the same features. This fit
        (`Calibration.for_rezeroing`) is for motions that begin with re-zeroing and useless without,
        as all that differs between recordings has gone into the zeros.
    progress : callable, optional
        Called with the fraction done, 0 to 1.

    Raises
    ------
    CalibrationError
        If the recordings do not belong together, are fewer than two where each has a zero of its
        own, lack truth for more than a third of their time, have too few rows for the estimator, or
        the measured position of a joint never changes.
        Other features that never change are listed in the metadata as ``unused_features``.

    Examples
    --------
    >>> calibrate(training, "linear").joints
    ('jaw',)
    """
    recordings = as_recordings(recordings)
    report, began = progress or untold, time.perf_counter()
    _check_zero(zero, recordings)
    evidence, begin, share = dict[str, Any](), 0.0, 1.0
    if isinstance(estimator, Automatic) or estimator == AUTO:
        automatic = estimator if isinstance(estimator, Automatic) else Automatic()
        begin = _CHOICE_SHARE
        estimator, features, target, evidence = choose(
            recordings, automatic, features, joints, target, fit_rate, random_state,
            within(report, 0.0, begin),
        )  # fmt: skip
        random_state = None
        share = 1.0 - begin - (_ZEROS_SHARE if zero is None else 0.0)
    task = FitTask.of(recordings, estimator, features, joints, target, random_state)
    checks = fit_parity_equations(recordings, task.joints, tuple(task.units), redundant)
    parts = task.rows(stride_of(fit_rate, task.dt))
    own_share = 0.5 * share if zero == "recording" else share
    fitted = _assembled(task, parts, task.fit(parts, within(report, begin, own_share)), *checks)
    if zero == "recording":
        again = within(report, begin + own_share, own_share)
        fitted = _fitted_again(fitted, task, parts, True, again)
    held_out: ArrayLike = 0.0
    if evidence:  # the median of the folds: some errors lie far beyond what the others show
        held_out = [evidence["chosen"]["median"][joint] for joint in fitted.joints]
    if evidence and zero is None:
        say = automatic.say(within(report, 1.0 - _ZEROS_SHARE, _ZEROS_SHARE))
        own_zeros, evidence["zero"] = _judge_zeros(
            fitted, estimator, recordings, fit_rate, held_out, say
        )
        if own_zeros:
            fitted = _fitted_again(fitted, task, parts, True)
    if evidence:
        fitted = fitted.with_metadata(choice=evidence)
    baseline = fit_effort_baseline(fitted.for_rezeroing, parts, held_out)
    fitted = replace(fitted, effort_baseline=baseline)
    report(1.0)
    return fitted.with_metadata(fit_seconds=round(time.perf_counter() - began, 3))


def _assembled(
    task: FitTask,
    parts: Sequence[Rows],
    fitted: tuple[Fit, dict[str, str]],
    parity: Any,
    redundant: dict[str, str],
) -> Calibration:
    """Calibration of what was fitted, with its training domain, baselines and provenance."""
    X, error = fitted_rows(parts, "X"), fitted_rows(parts, "error")
    fit, notes = fitted
    identified = None if fit.learnt is None else fit.learnt.identified
    origin, facts = training_origin(parts)
    signals = (*task.units, *redundant)
    resting = resting_features(task.recordings, task.feature_set, task.joints, task.units)
    return Calibration(
        machine=task.robot,
        joints=task.joints,
        feature_set=task.feature_set,
        target=task.target,
        units=task.units,
        gap_limit=task.gap_limit,
        lower=X.min(axis=0),
        upper=X.max(axis=0),
        fitted=fit.fitted,
        fitted_baselines=fit.baselines,
        learnt=fit.learnt,
        training_domain=fit_training_domain(
            task.recordings, signals, task.gap_limit, X, error, resting, task.joints
        ),
        parity=parity,
        potentiometers=learn_reference(task.recordings, task.joints),
        redundant=redundant,
        origin=replace(origin, estimator=task.model.name, sample_dt=task.dt, baseline_notes=notes),
        metadata={
            **facts,
            "settings": " ".join(repr(task.model).split()),
            "unused_features": task.unused_features(parts),
            **({"identified": identified} if identified else {}),
        },
    )


def _check_zero(zero: ZeroOf | None, recordings: Sequence[Recording]) -> None:
    """Raise CalibrationError for another `zero`, or one recording with a separate zero."""
    if zero not in (None, *get_args(ZeroOf)):
        raise CalibrationError(f"zero {zero!r:.60}; choose {', '.join(get_args(ZeroOf))}")
    if zero == "recording" and len(recordings) < 2:
        raise CalibrationError(
            "a zero for each recording takes two recordings; give more, or let them share one zero"
        )


def _fitted_again(
    calibration: Calibration,
    task: FitTask,
    parts: Sequence[Rows],
    with_zeros: bool,
    report: Progress = untold,
) -> Calibration:
    """Add a second fit to rows, with one zero, or `with_zeros` with one for each recording."""
    origin = calibration.origin
    if with_zeros:
        zeros = recording_zeros(parts)
        parts = [replace(part, zero=zero) for part, zero in zip(parts, zeros, strict=True)]
        origin = replace(origin, zeros=zeros)
    return replace(calibration, rezeroed_fit=task.fit(parts, report)[0], origin=origin)


def _refitted(
    calibration: Calibration, task: FitTask, parts: Sequence[Rows], with_zeros: bool = False
) -> Calibration:
    """Fit a calibration anew to other rows."""
    again, X = _fitted_again(calibration, task, parts, with_zeros), fitted_rows(parts, "X")
    return replace(again.for_rezeroing, lower=X.min(axis=0), upper=X.max(axis=0))


def _judge_zeros(
    fitted: Calibration,
    estimator: str | Regressor,
    recordings: Sequence[Recording],
    fit_rate: float | None,
    held_out: ArrayLike,
    say: Say,
) -> tuple[bool, dict[str, Any]]:
    """Whether a zero for each recording is better, cross-validated, and the evidence.

    What is left out enters no fit that it judges, nor the residuals of that, but for their median
    over all folds, the errors `held_out` (n_joints,) of the choice.
    """
    few = distinct(recordings)
    if len(few) < FEW:
        return False, {"kept": False, "note": f"it takes {FEW} recordings"}
    if not fitted.counts_samples:
        most = share_of([len(recording) for recording in few], MOST_ROWS)
        few = [r.rows(np.arange(0, len(r), -(-len(r) // most))) for r in few]
    longest = max(default_gap_limit([r]) for r in few)  # each is thinned in its own way
    settled = estimator, fitted.feature_set, fitted.joints, fitted.target, None
    task = replace(FitTask.of(few, *settled), gap_limit=longest)
    stride = max(stride_of(fit_rate, task.dt), -(-sum(map(len, few)) // FITTED_ROWS))
    parts = task.rows(stride)
    bare = replace(fitted, gap_limit=longest, rezeroed_fit=None, effort_baseline=None)

    def fit(training: Sequence[int]) -> tuple[Calibration, Calibration]:
        hidden = [part.hide(np.ones(len(part), dtype=bool)) for part in parts]
        visible = [parts[k] if k in training else hidden[k] for k in range(len(parts))]
        shared, again = (_refitted(bare, task, visible, with_zeros) for with_zeros in (False, True))
        rows = [parts[index] for index in training]
        baseline = residual_baseline(shared, rows, held_out)
        return replace(shared, effort_baseline=baseline), replace(again, effort_baseline=baseline)

    uncut = set(wholes(few))
    left_out = [fold for fold in folds(few) if uncut.issuperset(fold.parts)]
    return validate_zeros(parts, left_out, fit, say)


def cross_fit(
    fitted: Calibration,
    recordings: Sequence[Recording],
    left_out: Sequence[Fold],
    *,
    fit_rate: float | None = None,
    progress: Progress | None = None,
) -> list[Calibration]:
    """Fit as a calibration was fitted, without each of some folds of its recordings in turn.

    Features are computed once for all fits. Intervals, checks and effort baselines are left out.
    Raises CalibrationError if a fold leaves too few rows.
    """
    unfitted = fitted.model.with_params()
    task = FitTask.of(recordings, unfitted, fitted.feature_set, fitted.joints, fitted.target, None)
    parts = task.rows(stride_of(fit_rate, task.dt))
    bare = replace(fitted, gap_limit=task.gap_limit, interval=None, effort_baseline=None)
    fits = []
    for number, fold in enumerate(left_out):
        training = without(parts, fold.parts)
        for part in training:
            part.check_truth()
        fits.append(_refitted(bare, task, training))
        (progress or untold)((number + 1) / len(left_out))
    return fits


def training_origin(parts: Sequence[Rows]) -> tuple[Origin, dict[str, Any]]:
    """Where the training rows come from: sessions and homings, and JSON values for people."""
    digest = hashlib.sha256()
    sessions: list[Session] = []
    for part in parts:
        for array in (part.t, part.X, part.truth, part.error):
            digest.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
        facts_of = {
            "rows": len(part.fitted),
            "rows_without_truth": int((~part.known).sum()) - part.outliers,
            "outliers": part.outliers,
            "duration": part.recording.duration,
            "conditions": conditions_of(part.recording, part.joints),
        }
        sessions.append(Session.of(part.recording, **facts_of))
    homing_ids = sorted({session.homing_id for session in sessions} - {""})
    versions = {name: version(name) for name in ("truejoint", "numpy", "scikit-learn")}
    counted = "rows", "rows_without_truth", "outliers", "duration"
    facts = {
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": {"python": platform.python_version(), **versions},
        **{name: sum(map(attrgetter(name), sessions)) for name in counted},
        "data_sha256": digest.hexdigest(),
    }
    return Origin(sessions=tuple(sessions), homing_ids=tuple(homing_ids)), facts
