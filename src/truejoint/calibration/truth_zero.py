"""A zero by truth, and the errors that are left to judge."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from truejoint.array_types import Array, Integers, Mask
from truejoint.calibration.baseline_fit import past_weights, weighted_medians
from truejoint.calibration.calibration import as_calibration, as_recorded
from truejoint.calibration.compatibility import source_of
from truejoint.calibration.efforts import time_in_motion
from truejoint.calibration.rows import Rows
from truejoint.calibration.zero import Zero, believed
from truejoint.errors import CalibrationError

if TYPE_CHECKING:
    from truejoint.calibration.calibration import Calibration
    from truejoint.recordings import Recording

CORRELATION_MARGIN: Final = 3.0
"""Errors may resemble each other for longer than in the motions of the baseline by this factor:
a slower motion stays longer where the calibration errs one way."""

_MOST_ROWS: Final = 500  # that a standard deviation is worked out from, pair by pair
_MOST_ROUNDS: Final = 20  # of moving the inputs of a model until its output fits


def find_zero(
    calibration: Calibration, recording: Recording | Rows, duration: float = math.inf
) -> Zero:
    """Zero of a calibration by the truth in a recording, however little there is of it.

    The offset is the median of truth minus corrected position or, where it moves the measured
    positions, what brings that to nothing. If the calibration looks at the past, a reading weighs
    as much as the joint was in motion before it, up to 5 s: how friction stood before a recording
    is not known.

    Errors of a model resemble each other over seconds of motion, so a brief truth knows less than
    its readings suggest, and a rest counts as one; and the model knows nothing of the time before
    it. So the deviation is no less than what beginnings of the training with as much motion show.

    Parameters
    ----------
    calibration : Calibration
        The fit for re-zeroing is used where there is one, and each baseline has its own offset.
    recording : Recording or Rows
    duration : float
        How much of the truth to use, from its beginning [s].

    Raises
    ------
    CalibrationError
        If the recording does not fit the calibration, or holds no truth, or the duration is not
        above 0.

    Examples
    --------
    >>> zero = find_zero(model, test)
    >>> zero.offset.shape, model.at(zero).zero is zero
    ((1,), True)
    """
    if not duration > 0.0:
        raise CalibrationError(f"the time to re-zero from is {duration:g} s; give more than 0 s")
    calibration = as_calibration(calibration).for_rezeroing
    rows = rows_with_truth(calibration, recording)
    zero = _zero_of(calibration, rows, duration)
    offsets = {
        name: _zero_of(baseline, rows, duration).offset
        for name, baseline in calibration.baselines.items()
    }
    return replace(zero, baselines=offsets)


def _zero_of(calibration: Calibration, rows: Rows, duration: float) -> Zero:
    """Zero of the model alone, as `find_zero` says."""
    error, has_error = known_error(calibration, rows)
    used = np.flatnonzero(has_error)[at_start(rows.t[has_error], duration)]
    baseline = calibration.effort_baseline
    step = np.zeros(len(rows.joints)) if baseline is None else baseline.step  # else, all of time
    in_motion = time_in_motion(rows.t, rows.measured, step)
    weights = past_weights(calibration, rows.t, in_motion)[used]
    offset = _medians(error[used], weights)
    if calibration.moves is not None:
        # The outputs move about as far as the inputs, but not just as far.
        brief = rows.recording.rows(slice(0, int(used[-1]) + 1))
        remaining = offset
        for _ in range(_MOST_ROUNDS):
            again, is_known = known_error(calibration.shifted(offset), brief)
            now = _medians(again[is_known], weights)
            if not np.abs(now).max() < np.abs(remaining).max():
                break
            offset, remaining = offset + now, now
    deviation = np.full(len(rows.joints), math.nan)
    if baseline is not None:
        chosen = np.linspace(0, len(used) - 1, min(len(used), _MOST_ROWS)).astype(np.int64)
        moving, w = in_motion[used[chosen]].T, np.ascontiguousarray(weights[chosen].T)
        distance = np.abs(moving[:, :, None] - moving[:, None])
        alike = np.exp(-distance / (CORRELATION_MARGIN * baseline.correlation)[:, None, None])
        # of the mean of readings whose correlation falls with the time in motion
        pairs = w[:, :, None] * w[:, None] * alike
        variance = pairs.reshape(len(w), -1).sum(axis=1) / w.sum(axis=1) ** 2
        at_beginnings = baseline.beginning_sd(in_motion[used[-1]])
        deviation = np.maximum(baseline.residual * np.sqrt(variance), at_beginnings)
    origin = rows.recording.provenance
    zeros_move = calibration.origin.zeros is not None  # fitted with a zero for each group
    return Zero(
        offset,
        deviation,
        offset.copy() if zeros_move else believed(offset, deviation),
        file=origin.source,
        homing_id=origin.homing_id,
        rows=len(used),
        duration=float(rows.t[used[-1]] - rows.t[used[0]]),
    )


def _medians(error: Array, weights: Array) -> Array:
    """Median (n_joints,) of errors (m, n_joints), each of its own weight (m, n_joints)."""
    end, columns = np.array([len(error)]), zip(error.T, weights.T, strict=True)
    return np.concatenate([weighted_medians(*column, end) for column in columns])


def at_start(t: Array, duration: float) -> Mask:
    """Which stamps `t` (n,) [s] of known truth lie within `duration` [s] of the first."""
    return np.asarray(t - t[0] < duration)


def zeroed(calibration: Calibration, recording: Recording | Rows, duration: float) -> Calibration:
    """Move the zero of the model by the first `duration` [s] of truth in a recording.

    As `Calibration.at`, for judging: baselines, homing and `Calibration.zero` stay. Where the
    duration is 0, nothing moves; raises CalibrationError as `find_zero`.
    """
    if duration == 0.0:
        return calibration
    calibration = calibration.for_rezeroing
    rows = rows_with_truth(calibration, recording)
    return calibration.shifted(_zero_of(calibration, rows, duration).shift)


def rows_with_truth(calibration: Calibration, recording: Recording | Rows) -> Rows:
    """Rows of a recording that has the truth of all joints; raises CalibrationError otherwise."""
    joints = as_calibration(calibration).joints
    recorded = as_recorded(recording.recording if isinstance(recording, Rows) else recording)
    without = [j for j in joints if f"truth/{j}" not in recorded.table.columns]
    if without:
        raise CalibrationError(
            f"{source_of(recorded)} has no truth of {', '.join(without)}; record it with a sensor "
            "at the joint, if only for a moment"
        )
    return calibration.rows(recording)


def known_error(calibration: Calibration, recording: Recording | Rows) -> tuple[Array, Mask]:
    """Truth minus corrected position (n, n_joints), and in which rows (n,) it is known.

    Raises CalibrationError if the recording does not fit, or no row has the truth of all joints.
    """
    rows = rows_with_truth(calibration, recording)
    error = np.asarray(rows.truth - calibration.correct(rows))
    is_known = np.asarray(np.isfinite(error).all(axis=1))
    if not is_known.any():
        raise CalibrationError(
            f"{source_of(rows.recording)}: no row has the truth of "
            f"{', '.join(calibration.joints)}; an interval is made of, and judged by, true "
            "positions"
        )
    return error, is_known


def judged_error(
    calibration: Calibration, recording: Recording | Rows, rezero: float
) -> tuple[Array, Integers]:
    """Errors (m, n_joints) [rad or m] that are judged, and the rows (m,) that they are of.

    Those of all rows with truth or, where the first `rezero` [s] of them set the zero, of those
    after; raises CalibrationError as `known_error`, or when nothing is left.
    """
    rows = rows_with_truth(calibration, recording)
    error, is_known = known_error(zeroed(calibration, rows, rezero), rows)
    used = at_start(rows.t[is_known], rezero)
    if used.all():
        raise CalibrationError(
            f"{source_of(rows.recording)}: all of its truth lies within the "
            f"{rezero:g} s that re-zero it; nothing is left to judge, so give a longer recording"
        )
    judged = np.flatnonzero(is_known)[~used]
    return error[judged], judged
