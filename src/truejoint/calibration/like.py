"""A calibration of few seconds, by models of instruments of the same kind."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from truejoint.array_types import Array
from truejoint.calibration.calibration import Calibration, as_calibration
from truejoint.calibration.compatibility import common_robot
from truejoint.calibration.fit import calibrate, cross_fit
from truejoint.calibration.fit_task import within
from truejoint.calibration.folds import FOLDS, Fold, wholes
from truejoint.calibration.origin import distinct
from truejoint.errors import CalibrationError
from truejoint.estimators.base import Progress, untold
from truejoint.estimators.registry import DEFAULT
from truejoint.estimators.stack.learn import Expert, Pooled
from truejoint.estimators.stack.run import MAX_MEMBERS
from truejoint.recordings import Recording
from truejoint.recordings.table.recording import as_recordings
from truejoint.robots import Robot

_MOST: Final = MAX_MEMBERS - 1  # models, beside their offset
_SHARE: Final = 0.1  # of the progress bar, of the models' mean


def calibrate_like(
    recordings: Recording | Sequence[Recording],
    models: Sequence[Calibration],
    estimator: Any = DEFAULT,
    *,
    progress: Progress | None = None,
    **how: Any,
) -> Calibration:
    """Fit a calibration to few seconds of an instrument, by `models` of others of its kind.

    It is the weighted mean of the models, a slope and an offset (`Pooled`), which 20 s of truth
    tell. The models are left aside where they leave more of the new truth than a fixed offset does.
    An own fit of `estimator` is judged beside it on each of two or more recordings in turn, and the
    better one is taken. The metadata say so under ``like``.

    Parameters
    ----------
    recordings : Recording or sequence of Recording
        With truth, of one arm of the models' robot.
    models : sequence of Calibration
        One to nine, of the same robot and joints.
    estimator, progress, **how
        As `calibrate` takes them, for the own fit; `fit_rate` and `redundant` go for both.

    Raises
    ------
    CalibrationError
        If a model is of another robot or other joints, was re-zeroed by its motor, or takes columns
        or units that the recordings do not have; and as `calibrate`.

    Examples
    --------
    >>> like = truejoint.calibration.calibrate_like(test, [model, model])
    >>> like.estimator, like.metadata["like"]["weights"]["jaw"]
    ('pooled', [0.5, 0.5])
    """
    recordings, report = as_recordings(recordings), progress or untold
    robot = common_robot(recordings)
    priors = [_checked(as_calibration(model), robot, recordings) for model in models]
    if not 1 <= len(priors) <= _MOST:
        raise CalibrationError(f"like: {len(priors)} models; give 1 to {_MOST}")
    joints = priors[0].joints
    for prior in priors:
        if prior.joints != joints:
            raise CalibrationError(
                f"like: {_named(prior)} corrects {', '.join(prior.joints)}, {_named(priors[0])} "
                f"{', '.join(joints)}; give models of the same joints"
            )
    if how.get("joints") and tuple(how["joints"]) != joints:
        raise CalibrationError(
            f"like: the models correct {', '.join(joints)}; leave out the joints, or give models "
            f"of {', '.join(how['joints'])}"
        )
    measured = [f"measured/{joint}" for joint in joints]
    names = dict.fromkeys([*(n for prior in priors for n in prior.feature_set.names), *measured])
    experts = [_expert(prior, list(names), measured) for prior in priors]
    places = tuple(map(list(names).index, measured))
    common = {name: how[name] for name in ("fit_rate", "redundant") if name in how}
    pooled = calibrate(
        recordings, Pooled(experts, places), features=names, joints=joints, target="error",
        progress=within(report, 0.0, _SHARE), **common,
    )  # fmt: skip
    weights = pooled.fitted.arrays["weights"][: len(experts) * len(joints)].reshape(-1, len(joints))
    facts = {
        "models": [_named(prior) for prior in priors],
        "weights": {j: weights[:, k].round(4).tolist() for k, j in enumerate(joints)},
    }
    left_aside = _contradiction(pooled, recordings)
    different = distinct(recordings)
    if left_aside or len(different) > 1:
        later = within(report, _SHARE, 1.0 - _SHARE)
        alone = calibrate(recordings, estimator, progress=later, **how)
        if not left_aside and alone.joints == joints:
            rate = how.get("fit_rate")
            errors = [_left_out_rmse(fit, different, rate) for fit in (pooled, alone)]
            facts["rmse"] = dict(zip(("like", "own"), (e.tolist() for e in errors), strict=True))
            if np.log(errors[1]).mean() < np.log(errors[0]).mean():
                left_aside = "an own fit is better on the recordings that are left out in turn"
        if left_aside:
            return alone.with_metadata(like={**facts, "left_aside": left_aside})
    origin = pooled.origin  # so that none of the models' recordings is judged on
    sessions = (*origin.sessions, *(s for prior in priors for s in prior.origin.sessions))
    pooled = replace(pooled, origin=replace(origin, sessions=sessions))
    return pooled.with_metadata(like=facts)


def _checked(model: Calibration, robot: Robot, recordings: Sequence[Recording]) -> Calibration:
    """Give the fit of a model whose zero is to be found anew; CalibrationError if it is none."""
    if model.robot != robot.name:
        raise CalibrationError(
            f"like: {_named(model)} is of {model.title}, the recordings are of {robot.title}; give "
            "models of the same robot"
        )
    prior = replace(model.for_rezeroing, machine=robot)
    if prior.moves is not None or prior.family.row is None:
        raise CalibrationError(
            f"like: {_named(model)} was re-zeroed by its motor, or works offline only; give one "
            "that calibrate wrote, and that a control loop can run"
        )
    for recording in recordings:
        prior.check_recording(recording)
    return prior


def _named(model: Calibration) -> str:
    sessions = model.origin.sessions
    return f"{model.estimator} of {sessions[0].source if sessions else model.title}"


def _expert(prior: Calibration, names: list[str], measured: Sequence[str]) -> Expert:
    """Give the model as one that predicts the error from features called `names`."""
    direct = np.zeros((len(names), len(measured)))
    if prior.target == "position":
        direct[[names.index(name) for name in measured], range(len(measured))] = -1.0
    return Expert(prior.fitted, tuple(map(names.index, prior.feature_set.names)), direct)


def _contradiction(pooled: Calibration, recordings: Sequence[Recording]) -> str:
    """Say why the models do not fit the new truth, if they leave more of it than an offset does."""
    residuals, offset = (
        np.concatenate([r.columns("truth", pooled.joints) - fit.correct(r) for r in recordings])
        for fit in (pooled, pooled.baselines["offset"])
    )
    ours, plain = np.nanstd(residuals, axis=0), np.nanstd(offset, axis=0)
    times = np.where(ours > plain, ours / np.maximum(plain, 1e-12), 0.0)
    if not times.any():
        return ""
    worst, joint = times.max(), pooled.joints[int(np.argmax(times))]
    return f"the models leave {worst:.1f} times what a fixed offset leaves of {joint}"


def _left_out_rmse(
    fitted: Calibration, recordings: Sequence[Recording], fit_rate: float | None
) -> Array:
    """RMSE (n_joints,) [rad or m] on the first recordings, each left out of the fit in turn."""
    left_out = [Fold("", (part,)) for part in wholes(recordings)[:FOLDS]]
    fits = zip(cross_fit(fitted, recordings, left_out, fit_rate=fit_rate), recordings, strict=False)
    errors = [one.columns("truth", fit.joints) - fit.correct(one) for fit, one in fits]
    return np.asarray(np.sqrt(np.nanmean(np.concatenate(errors) ** 2, axis=0)))
