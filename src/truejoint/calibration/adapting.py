"""A calibration of one arm, tool or day as the prior of the next."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from truejoint.calibration.calibration import Calibration
from truejoint.calibration.fitting import origin
from truejoint.calibration.selection import common_robot
from truejoint.calibration.training_rows import RowRules, outlying_values, stride_of
from truejoint.errors import CalibrationError
from truejoint.models.features import sample_dt
from truejoint.recordings import Recording
from truejoint.recordings.recording import as_recordings

_OF_THE_PRIOR: Final = ("held_out", "rezeroed", "accepted", "command")  # metadata that do not hold
_KEPT: Final = ("created", "rows", "duration", "data_sha256")  # of its metadata, under "prior"


def adapted(
    prior: Calibration,
    recordings: Recording | Sequence[Recording],
    *,
    fit_rate: float | None = None,
) -> Calibration:
    """Calibration of another day, tool or arm: a prior, changed as far as recordings say.

    Each joint's coefficients are those of the prior and of a ridge regression of what it leaves on
    the recordings, whose penalty is chosen on blocks of time that are left out in turn; where these
    say so, the zero alone moves. Baselines go the same way. Estimator, features, joints and target
    are the prior's, and so is what counts as trained; its interval and its baseline of the efforts
    are left out, as they may not hold. The metadata say so under ``prior``.

    Parameters
    ----------
    prior : Calibration
        By ``offset``, ``linear``, ``poly2``, ``poly2_ridge`` or ``rich_play``.
    recordings : Recording or sequence of Recording
        With truth, of one arm of the prior's robot.
    fit_rate : float, optional
        Use rows at most at this rate [Hz].

    Raises
    ------
    CalibrationError
        If the prior is of another robot, its estimator cannot be changed so, or its zeros are those
        of homings; if the recordings do not fit it, or have fewer than 50 rows with truth.

    Examples
    --------
    >>> adapted(model, test).metadata["prior"]["rows"]
    800
    """
    recordings = as_recordings(recordings)
    robot = common_robot(recordings)
    if robot.name != prior.robot:
        raise CalibrationError(
            f"the prior is of {prior.title}, the recordings are of {robot.title}; give a prior of "
            "the same robot"
        )
    if prior.moves is not None:
        raise CalibrationError(
            "the prior has a zero for each homing, which moves its inputs; give one that was "
            "calibrated with a shared zero, or one for each recording"
        )
    own = replace(prior.fitted_for(rezeroing=True), arm=robot.arm)
    for recording in recordings:
        own.check_recording(recording)
    stride = stride_of(fit_rate, sample_dt(recordings))
    rules = RowRules(own.feature_set, own.joints, own.gap_limit, stride)
    parts = list(map(rules.rows, recordings, outlying_values(recordings, own.joints)))
    X, dt = (np.concatenate([getattr(p, name) for p in parts]) for name in ("features", "dt"))
    models, penalties = {}, np.empty(0)
    for name, model in {**own.baseline_models, "model": own.model}.items():
        target = own.target if name == "model" else "error"
        y = np.concatenate([part.targets(target) for part in parts])
        models[name], penalties = model.adapted(X, y - own.offsets.get(name, 0.0), dt)
    known = np.concatenate([part.known for part in parts])
    error = np.concatenate([part.error for part in parts])[known]
    domain = own.training_domain
    if domain is not None:
        lower = np.minimum(domain.error_lower, error.min(axis=0))
        upper = np.maximum(domain.error_upper, error.max(axis=0))
        domain = replace(domain, error_lower=lower, error_upper=upper)
    facts = origin(parts)
    facts["sessions"] += own.metadata.get("sessions", [])  # so that neither is judged on
    before = {name: own.metadata.get(name) for name in _KEPT}
    told = {"robot": prior.title, "penalties": [p if math.isfinite(p) else None for p in penalties]}
    old = {name: value for name, value in own.metadata.items() if name not in _OF_THE_PRIOR}
    return replace(
        own,
        model=models.pop("model"),
        baseline_models=models,
        rezero_models={},
        lower=np.minimum(own.lower, X[known].min(axis=0)),
        upper=np.maximum(own.upper, X[known].max(axis=0)),
        training_domain=domain,
        interval=None,
        effort_baseline=None,
        metadata={**old, **facts, "prior": {**before, **told}},
    )
