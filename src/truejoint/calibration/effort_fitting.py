"""Fit an effort baseline to recordings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from truejoint.array_types import Array
from truejoint.calibration.efforts import (
    BEGINNINGS,
    FRICTION_MARGIN,
    MAX_JOINTS,
    RANGES_EACH_WAY,
    SHIFT_MARGIN,
    SMALLEST_FRICTION_SHIFT,
    SMALLEST_SHIFT,
    STEPS_PER_RANGE,
    STEPS_PER_TERM,
    EffortBaseline,
    count_effort_terms,
    effort_steps,
    largest_shifts,
)
from truejoint.calibration.zero import beginnings
from truejoint.errors import CalibrationError

if TYPE_CHECKING:
    from truejoint.calibration.calibration import Calibration
    from truejoint.recordings import Recording

_STARTS, _STARTS_EACH = 24, 3  # at least, from which beginnings are looked at; of each recording
_SMALLEST: Final = 1e-150  # [rad or m] of a deviation; its square is not 0 either


def fit_effort_baseline(
    calibration: Calibration, recordings: Sequence[Recording]
) -> EffortBaseline | None:
    """Learn efforts and errors from recordings, with truth, in which the calibration holds.

    None when there are more than 12 joints or one of them never moves. A joint is `monitored` when
    its effort is a signal of the calibration and it travels at least five of its ranges each way.
    """
    joints = calibration.joints
    positions = [recording.columns("measured", joints) for recording in recordings]
    together = np.concatenate(positions)
    lower, upper = together.min(axis=0), together.max(axis=0)
    if len(joints) > MAX_JOINTS or not (upper > lower).all():
        return None
    known = [f"effort/{joint}" in calibration.signals for joint in joints]
    steps = [_steps(recording, joints, known, lower, upper) for recording in _pieces(recordings)]
    n_terms = count_effort_terms(len(joints))
    coef, scale = np.zeros((len(joints), n_terms)), np.ones(len(joints))
    shift, friction, monitored = np.zeros((3, len(joints)))
    for j in range(len(joints)):
        own = [rows[rows[:, 0] == j] for rows in steps]
        if not known[j] or not _enough(np.concatenate(own), n_terms):
            continue
        coef[j], scale[j] = _fit_effort(np.concatenate(own))
        shift[j], friction[j] = _held_out_shifts(own)
        monitored[j] = 1.0
    residual, correlation, beginning = residual_statistics(
        calibration, recordings, (upper - lower) / STEPS_PER_RANGE
    )
    return EffortBaseline(
        lower=lower,
        upper=upper,
        monitored=monitored,
        coef=coef,
        scale=scale,
        shift_limit=np.maximum(SMALLEST_SHIFT, SHIFT_MARGIN * shift),
        friction_limit=np.maximum(SMALLEST_FRICTION_SHIFT, FRICTION_MARGIN * friction),
        residual=residual,
        correlation=correlation,
        beginning=beginning,
    )


def residual_statistics(
    calibration: Calibration, recordings: Sequence[Recording], step: Array
) -> tuple[Array, Array, Array]:
    """Give standard deviation [rad or m] and correlation time [s] of errors, each (n_joints,).

    About each recording's mean; in that time the autocorrelation falls to 1/e. And the deviation
    (n, n_joints) [rad or m] from that mean of the offset that the first `BEGINNINGS` of a motion
    show, over 24 starts or more, three or more in each recording: a fit knows how these began, but
    not what it takes for a beginning in their midst. A joint moves by a `step` (n_joints,) [rad or
    m], or rests. Raises CalibrationError if no recording has the truth of two rows.
    """
    errors, off = [], []
    count = max(_STARTS_EACH, -(-_STARTS // len(recordings)))
    for recording in recordings:
        corrected = calibration.correct(recording)
        error = recording.columns("truth", calibration.joints) - corrected
        known = np.isfinite(error).all(axis=1)
        if known.sum() >= 2:
            mean = error[known].mean(axis=0)
            errors.append((recording.t[known], error[known] - mean))
            found = beginnings(calibration, recording, corrected, count, step)
            off += [one - mean for one in found]
    if not errors:
        raise CalibrationError(
            "no recording has the truth of two rows, so nothing tells how errors vary; give one "
            "with a truth that goes on"
        )
    sizes = np.sqrt(np.mean(np.concatenate([error for _, error in errors]) ** 2, axis=0))
    times = [[_correlation_time(t, error[:, j]) for j in range(len(sizes))] for t, error in errors]
    beginning = _root_mean_square(np.reshape(off, (-1, len(BEGINNINGS), len(sizes))))
    return (
        np.maximum(sizes, _SMALLEST),
        np.maximum(np.median(times, axis=0), 1e-3),
        np.maximum(beginning, _SMALLEST),
    )


def _root_mean_square(off: Array) -> Array:
    """Root mean square (n, n_joints) of deviations (m, n, n_joints) that are known, not NaN.

    Of a beginning that is too long for any recording, or in which a joint never was in motion for
    so long, that of the next shorter one; of one in which no truth lies, that of the next longer.
    """
    known = np.isfinite(off)
    square = np.where(known, off, 0.0) ** 2
    found = np.sqrt(square.sum(axis=0) / np.maximum(known.sum(axis=0), 1))
    places = np.arange(off.shape[1])
    for values, seen in zip(found.T, np.any(known, axis=0).T, strict=True):
        if seen.any():
            there = np.searchsorted(places[seen], places, "right") - 1
            values[:] = values[seen][np.maximum(there, 0)]
    return np.asarray(found)


def _pieces(recordings: Sequence[Recording]) -> list[Recording]:
    """Split into what can be held out in turn: a single recording is cut in three by time."""
    if len(recordings) > 1:
        return list(recordings)
    parts = np.array_split(np.arange(len(recordings[0])), 3)
    if len(parts[0]) < 2:
        return list(recordings)
    return [recordings[0].rows(part.astype(np.int64)) for part in parts]


def _steps(
    recording: Recording, joints: Sequence[str], known: Sequence[bool], lower: Array, upper: Array
) -> Array:
    """Lay out a recording as `effort_steps` does; effort 0 where there is none."""
    n_joints = len(joints)
    position = np.ascontiguousarray(recording.columns("measured", joints))
    effort = np.zeros_like(position)
    for j, joint in enumerate(joints):
        if known[j]:
            effort[:, j] = recording.column(f"effort/{joint}")
    # A step is at least 1/200 of a range, so that travel bounds their number.
    travel = np.abs(np.diff(position, axis=0)).sum(axis=0) / (upper - lower)
    most = min(position.size, int(travel.sum() * STEPS_PER_RANGE) + n_joints)
    rows = np.empty((most + 1, 4 + count_effort_terms(n_joints)))
    count = effort_steps(np.array(recording.t), position, effort, lower, upper, rows)
    return rows[:count]


def _enough(rows: Array, n_terms: int) -> bool:
    """Whether steps of one joint pin its baseline down in both directions."""
    needed = max(RANGES_EACH_WAY * STEPS_PER_RANGE, STEPS_PER_TERM * n_terms)
    each_way = (np.sum(rows[:, 3] * (rows[:, 2] > 0.0)), np.sum(rows[:, 3] * (rows[:, 2] < 0.0)))
    return bool(min(each_way) >= RANGES_EACH_WAY and len(rows) >= needed and rows[:, 1].std() > 0.0)


def _fit_effort(rows: Array) -> tuple[Array, float]:
    """Coefficients (n_terms,) of one joint's effort and the standard deviation about them."""
    terms, effort = rows[:, 4:], rows[:, 1]
    coef = np.asarray(np.linalg.lstsq(terms, effort, rcond=None)[0], dtype=np.float64)
    deviation = float(np.std(effort - terms @ coef))
    return coef, max(deviation, 1e-9 * float(np.abs(effort).max()))


def _held_out_shifts(pieces: Sequence[Array]) -> tuple[float, float]:
    """Largest shifts that recordings show against the baseline of the others, in its scale."""
    shift, friction = 0.0, 0.0
    for i, own in enumerate(pieces):
        others = [rows for k, rows in enumerate(pieces) if k != i and len(rows)]
        if not others or not len(own):
            continue
        rest = np.concatenate(others)
        if len(rest) < STEPS_PER_TERM * (rest.shape[1] - 4):
            continue
        coef, scale = _fit_effort(rest)
        deviation = (own[:, 1] - own[:, 4:] @ coef) / scale
        seen = largest_shifts(deviation, own[:, 2].copy(), own[:, 3].copy())
        shift, friction = max(shift, seen[0]), max(friction, seen[1])
    return shift, friction


def _correlation_time(t: Array, error: Array) -> float:
    """Time [s] after which the autocorrelation of errors (n,) first falls below 1/e."""
    dt = float(np.median(np.diff(t)))
    n = len(error)
    spectrum = np.fft.rfft(error, 2 * n)
    covariance = np.fft.irfft(spectrum * spectrum.conj())[:n]
    if not covariance[0] > 0.0:
        return dt
    below = np.flatnonzero(covariance < covariance[0] / np.e)
    return dt * float(below[0] if below.size else n)
