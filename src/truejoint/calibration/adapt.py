"""A calibration of one arm, tool or day as the prior of the next."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from scipy.spatial import KDTree

from truejoint.array_types import Array
from truejoint.calibration.calibration import Calibration, as_calibration
from truejoint.calibration.compatibility import common_robot
from truejoint.calibration.fit import training_origin
from truejoint.calibration.fit_task import training_rows
from truejoint.calibration.origin import Session
from truejoint.calibration.rows import Rows
from truejoint.calibration.zero import Zero
from truejoint.errors import CalibrationError
from truejoint.estimators.polynomial.learn import check_row_count
from truejoint.recordings import Recording
from truejoint.recordings.table.recording import as_recordings

_OF_THE_PRIOR: Final = ("command", "fit_seconds", "choice")
"""Metadata that do not hold."""
_KEPT: Final = ("created", "rows", "duration", "data_sha256")  # of its metadata, under "prior"
_LIKE: Final = ("measured", "effort")  # quantities by which rows are like others
_NEIGHBOURS: Final = 8  # rows of a reference that are like one
SLOPES_FROM: Final = 50.0
"""Time [s] of recordings from which more than the zero changes: five blocks of which each is longer
than the errors of a model resemble each other."""


def adapted(
    prior: Calibration,
    recordings: Recording | Sequence[Recording],
    *,
    reference: Recording | Sequence[Recording] = (),
) -> Calibration:
    """Calibration of another day, tool or arm: a prior, changed as far as recordings say.

    Less than 50 s move the zero alone: the mean of what the prior leaves. More seconds also move
    each joint's coefficients, by a ridge regression of what the prior leaves on the recordings. Its
    penalty is chosen on blocks of time that are left out in turn; where these say so, again the
    zero alone moves. Baselines go the same way. Estimator, features, joints and target are the
    prior's, and so is what counts as trained; its interval and its baseline of the efforts are left
    out, as they may not hold. The metadata say so under ``prior``.

    A few seconds see a few places, and what a prior leaves there is also what it has always left
    there: curves and friction that it does not follow. A `reference` tells the two apart.

    Parameters
    ----------
    prior : Calibration
        By ``offset``, ``linear``, ``poly2``, ``poly2_ridge`` or ``rich_play``; any, for the zero
        of less than 50 s.
    recordings : Recording or sequence of Recording
        With truth, of one arm of the prior's robot.
    reference : Recording or sequence of Recording
        Those that the prior was made from, or others that it holds for. Its residual there is the
        mean of the eight rows most like a new row in measured positions and efforts (each over its
        standard deviation). This residual is taken off that in the new row. It tells most where the
        new recordings follow the same motion.

    Raises
    ------
    CalibrationError
        If the prior is of another robot, its estimator cannot be changed so, or its motor re-zeroed
        it; if recordings do not fit it, or the new ones have fewer than 50 rows with truth.

    Examples
    --------
    >>> adapted(model, test, reference=training).metadata["prior"]["rows"]
    800
    """
    recordings, reference = as_recordings(recordings), as_recordings(reference)
    robot = common_robot(recordings)
    if robot.name != as_calibration(prior).robot:
        raise CalibrationError(
            f"the prior is of {prior.title}, the recordings are of {robot.title}; give a prior of "
            "the same robot"
        )
    if prior.for_rezeroing.moves is not None:
        raise CalibrationError(
            "the prior was re-zeroed by its motor, which moves its inputs; give the one that "
            "calibrate wrote"
        )
    before = prior.for_rezeroing
    after = replace(before, machine=robot)
    for recording in recordings:
        after.check_recording(recording)
    for recording in reference:
        before.check_recording(recording)
    how = before.feature_set, before.joints, before.gap_limit
    parts = training_rows(recordings, *how)
    check_row_count(sum(int(part.known.sum()) for part in parts))
    models = {**after.baselines, "model": after}
    is_each_zeroed = prior.rezeroed_fit is not None
    known = training_rows(reference, *how) if reference else []
    usual = _usual_residuals(models, known, parts, is_each_zeroed)
    after, penalties = _changed(after, models, parts, usual)
    origin, facts = training_origin(parts)
    sessions = [*origin.sessions, *before.origin.sessions]  # so that none is judged on
    sessions += [Session.of(r) for r in reference if not any(s.overlaps(r) for s in sessions)]
    origin = replace(
        before.origin, sessions=tuple(sessions), homing_ids=origin.homing_ids,
        interval_sessions=(), accepted=(),
    )  # fmt: skip
    of_prior = {name: prior.metadata.get(name) for name in _KEPT} | {
        "robot": prior.title,
        "penalties": [p if math.isfinite(p) else None for p in penalties],
        "reference": [recording.provenance.source for recording in reference],
    }
    old = {name: value for name, value in prior.metadata.items() if name not in _OF_THE_PRIOR}
    X = np.concatenate([part.X[part.known] for part in parts])
    error = np.concatenate([part.error[part.known] for part in parts])
    domain = before.training_domain  # what counts as trained is the prior's, and the new rows
    if domain is not None:
        lower = np.minimum(domain.error_lower, error.min(axis=0))
        upper = np.maximum(domain.error_upper, error.max(axis=0))
        domain = replace(domain, error_lower=lower, error_upper=upper)
    return replace(
        after,
        lower=np.minimum(after.lower, X.min(axis=0)),
        upper=np.maximum(after.upper, X.max(axis=0)),
        training_domain=domain,
        interval=None,
        effort_baseline=None,
        metadata={**old, **facts, "prior": of_prior},
        origin=origin,
        zero=None,
    )


def _usual_residuals(
    models: Mapping[str, Calibration],
    known: Sequence[Rows],
    parts: Sequence[Rows],
    is_each_zeroed: bool,
) -> dict[str, Array]:
    """Residuals (n, n_joints) of each model on rows of the reference like those of `parts`.

    Where each recording of the reference has a zero of its own, that is no part of them.
    """
    if not known:
        shape = sum(len(part) for part in parts), len(parts[0].joints)
        return dict.fromkeys(models, np.zeros(shape))
    tables = [part.recording.table for part in (*parts, *known)]
    names = [f"{quantity}/{joint}" for quantity in _LIKE for joint in parts[0].joints]
    names = [name for name in names if all(name in table.columns for table in tables)]
    values = [table[names].to_numpy() for table in tables]
    here = np.concatenate(values[: len(parts)])
    is_known = np.concatenate([part.known for part in known])
    there = np.concatenate(values[len(parts) :])[is_known]
    deviation = there.std(axis=0)
    inverse = np.divide(1.0, deviation, out=np.zeros(len(names)), where=deviation > 0.0)
    nearest = np.arange(1, 1 + min(_NEIGHBOURS, len(there)))
    near = KDTree(there * inverse).query(here * inverse, nearest)[1]  # rows, neighbours
    usual = {}
    for name, model in models.items():
        residuals = [(part.truth - model.correct(part))[part.known] for part in known]
        if is_each_zeroed:
            residuals = [values - values.mean(axis=0) for values in residuals]
        usual[name] = np.concatenate(residuals)[near].mean(axis=1)
    return usual


def _changed(
    prior: Calibration,
    models: Mapping[str, Calibration],
    parts: Sequence[Rows],
    usual: Mapping[str, Array],
) -> tuple[Calibration, Array]:
    """Change the model and each baseline; also give the penalties (n_joints,) on the model's.

    Of little time the zero alone moves, to the mean residual; of more, coefficients change by
    ridge regression.
    """
    if sum(part.recording.duration for part in parts) < SLOPES_FROM:
        is_known = np.concatenate([part.known for part in parts])
        offsets = {}
        for name, model in models.items():
            residuals = np.concatenate([part.truth - model.correct(part) for part in parts])
            offsets[name] = (residuals - usual[name])[is_known].mean(axis=0)
        moved = prior.at(Zero(offsets.pop("model"), baselines=offsets))
        return moved, np.full(len(prior.joints), math.inf)
    X, dt = (np.concatenate([getattr(p, name) for p in parts]) for name in ("X", "dt"))
    changed, penalties = {}, np.empty(0)
    for name, model in models.items():
        y = np.concatenate([part.fitted_targets(model.target) for part in parts])
        changed[name], penalties = model.model.adapted(X, y - model.offset - usual[name], dt)
    fitted = changed.pop("model")
    baselines = {name: model.data for name, model in changed.items()}
    return replace(prior, fitted=fitted.data, learnt=fitted, fitted_baselines=baselines), penalties
