"""A calibration of one arm, tool or day as the prior of the next."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from scipy.spatial import KDTree

from truejoint.array_types import Array, Integers
from truejoint.calibration.calibration import Calibration
from truejoint.calibration.compatibility import session_of, trained_on
from truejoint.calibration.encoding import as_calibration
from truejoint.calibration.fit import origin
from truejoint.calibration.rows import (
    RowRules,
    TrainingRows,
    outlying_values,
    stride_of,
)
from truejoint.calibration.selection import common_robot
from truejoint.errors import CalibrationError
from truejoint.estimators.adapting import check_rows
from truejoint.features.feature_set import sample_dt
from truejoint.recordings import Recording
from truejoint.recordings.table.recording import as_recordings
from truejoint.robots import Robot

_OF_THE_PRIOR: Final = ("held_out", "rezeroed", "accepted", "command", "fit_seconds", "choice")
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
    fit_rate: float | None = None,
) -> Calibration:
    """Calibration of another day, tool or arm: a prior, changed as far as recordings say.

    Of less than 50 s, the zero alone: the mean of what the prior leaves. Of more, each joint's
    coefficients are those of the prior and of a ridge regression of what it leaves on the
    recordings, whose penalty is chosen on blocks of time that are left out in turn; where these
    say so, again the zero alone moves. Baselines go the same way. Estimator, features, joints and
    target are the prior's, and so is what counts as trained; its interval and its baseline of the
    efforts are left out, as they may not hold. The metadata say so under ``prior``.

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
        Those that the prior was made from, or others that it holds for. What it leaves there, mean
        of the eight rows whose measured positions and efforts are most like those of a new row
        (each over its standard deviation), is taken off what it leaves in this. It tells most
        where the new recordings follow the same motion.
    fit_rate : float, optional
        Use rows at most at this rate [Hz].

    Raises
    ------
    CalibrationError
        If the prior is of another robot, its estimator cannot be changed so, or its zeros are those
        of homings; if recordings do not fit it, or the new ones have fewer than 50 rows with truth.

    Examples
    --------
    >>> adapted(model, test, reference=training).metadata["prior"]["rows"]
    800
    """
    recordings, reference = as_recordings(recordings), as_recordings(reference)
    robot = common_robot(recordings)
    _check_prior(prior, robot)
    theirs = prior.fitted_for(rezeroing=True)
    own = replace(theirs, arm=robot.arm)
    parts = _rows(own, recordings, stride_of(fit_rate, sample_dt(recordings)))
    check_rows(sum(int(part.known.sum()) for part in parts))
    before = _rows(theirs, reference, 1) if reference else []
    each = bool(prior.rezero_models)
    always = _always_left(theirs, before, parts, is_each_zeroed=each)
    if sum(one.duration for one in recordings) < SLOPES_FROM:
        penalties = np.full(len(own.joints), math.inf)
        own = _moved(own, parts, always)
    else:
        own, penalties = _changed(own, parts, always)
    told = {name: own.metadata.get(name) for name in _KEPT} | {
        "robot": prior.title,
        "penalties": [p if math.isfinite(p) else None for p in penalties],
        "reference": [one.provenance.source for one in reference],
    }
    old = {name: value for name, value in own.metadata.items() if name not in _OF_THE_PRIOR}
    facts = _origin(own, parts, reference)
    return _widened(replace(own, metadata={**old, **facts, "prior": told}), parts)


def _check_prior(prior: Calibration, robot: Robot) -> None:
    """Refuse a prior that says nothing of such a robot, or whose zeros no recording can move."""
    if robot.name != as_calibration(prior).robot:
        raise CalibrationError(
            f"the prior is of {prior.title}, the recordings are of {robot.title}; give a prior of "
            "the same robot"
        )
    if prior.moves is not None:
        raise CalibrationError(
            "the prior has a zero for each homing, which moves its inputs; give one that was "
            "calibrated with a shared zero, or one for each recording"
        )


def _origin(
    own: Calibration, parts: Sequence[TrainingRows], reference: Sequence[Recording]
) -> dict[str, Any]:
    """Metadata of what a calibration was changed by; its sessions are all that it knows of."""
    facts = origin(parts)
    facts["sessions"] += own.metadata.get("sessions", [])  # so that none is judged on
    facts["sessions"] += [session_of(one) for one in reference if not trained_on(facts, one)]
    return facts


def _widened(own: Calibration, parts: Sequence[TrainingRows]) -> Calibration:
    """Have it count as trained what it was changed by; without what may no longer hold."""
    known = np.concatenate([part.known for part in parts])
    X = np.concatenate([part.features for part in parts])[known]
    error = np.concatenate([part.error for part in parts])[known]
    domain = own.training_domain
    if domain is not None:
        lower = np.minimum(domain.error_lower, error.min(axis=0))
        upper = np.maximum(domain.error_upper, error.max(axis=0))
        domain = replace(domain, error_lower=lower, error_upper=upper)
    return replace(
        own,
        rezero_models={},
        lower=np.minimum(own.lower, X.min(axis=0)),
        upper=np.maximum(own.upper, X.max(axis=0)),
        training_domain=domain,
        interval=None,
        effort_baseline=None,
    )


def _rows(own: Calibration, recordings: Sequence[Recording], stride: int) -> list[TrainingRows]:
    """Rows of recordings that fit a calibration."""
    for recording in recordings:
        own.check_recording(recording)
    rules = RowRules(own.feature_set, own.joints, own.gap_limit, stride)
    return list(map(rules.rows, recordings, outlying_values(recordings, own.joints)))


def _all(calibration: Calibration) -> dict[str, Calibration]:
    """Give a calibration, as ``model``, and its baselines."""
    return {**calibration.baselines, "model": calibration}


def _left(one: Calibration, part: TrainingRows) -> Array:
    """Truth minus corrected position (n, n_joints) of every row."""
    return np.asarray(part.truth - one.correct(part.recording))


def _always_left(
    theirs: Calibration,
    before: Sequence[TrainingRows],
    parts: Sequence[TrainingRows],
    *,
    is_each_zeroed: bool,
) -> dict[str, Array]:
    """Give what each model has always left (n, n_joints) at rows like those of `parts`.

    Where each recording `before` has a zero of its own, that is no part of it.
    """
    n = sum(len(part.truth) for part in parts)
    if not before:
        return dict.fromkeys(_all(theirs), np.zeros((n, len(theirs.joints))))
    near = _most_alike(parts, before)
    found = {}
    for name, one in _all(theirs).items():
        left = [_left(one, part)[part.known] for part in before]
        if is_each_zeroed:
            left = [values - values.mean(axis=0) for values in left]
        found[name] = np.concatenate(left)[near].mean(axis=1)
    return found


def _most_alike(parts: Sequence[TrainingRows], before: Sequence[TrainingRows]) -> Integers:
    """Places (n, 8) among all rows with truth `before` of those most like each row of `parts`."""
    tables = [part.recording.table for part in (*parts, *before)]
    names = [f"{quantity}/{joint}" for quantity in _LIKE for joint in parts[0].rules.joints]
    names = [name for name in names if all(name in table.columns for table in tables)]
    there = np.concatenate([part.recording.table[names].to_numpy()[part.known] for part in before])
    deviation = there.std(axis=0)
    inverse = np.divide(1.0, deviation, out=np.zeros(len(names)), where=deviation > 0.0)
    here = np.concatenate([part.recording.table[names].to_numpy() for part in parts])
    nearest = np.arange(1, 1 + min(_NEIGHBOURS, len(there)))
    return np.asarray(KDTree(there * inverse).query(here * inverse, nearest)[1], dtype=np.int64)


def _moved(
    own: Calibration, parts: Sequence[TrainingRows], always: Mapping[str, Array]
) -> Calibration:
    """Move the zero alone, of the model and of each baseline."""
    known = np.concatenate([part.known for part in parts])
    offsets = {}
    for name, one in _all(own).items():
        left = np.concatenate([_left(one, part) for part in parts]) - always[name]
        offsets[name] = one.offset + left[known].mean(axis=0)
    return replace(own, offsets=offsets)


def _changed(
    own: Calibration, parts: Sequence[TrainingRows], always: Mapping[str, Array]
) -> tuple[Calibration, Array]:
    """Change coefficients by ridge regression; also its penalties (n_joints,) on the model's."""
    X, dt = (np.concatenate([getattr(p, name) for p in parts]) for name in ("features", "dt"))
    models, penalties = {}, np.empty(0)
    for name, one in _all(own).items():
        y = np.concatenate([part.targets(one.target) for part in parts])
        models[name], penalties = one.model.adapted(X, y - one.offset - always[name], dt)
    return replace(own, model=models.pop("model"), baseline_models=models), penalties
