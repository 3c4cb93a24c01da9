"""Fit of an effort baseline, and of how the errors of a calibration vary over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import ArrayLike

from truejoint.array_types import Array, Integers, Mask
from truejoint.calibration.efforts import (
    BEGINNINGS,
    STEPS_PER_RANGE,
    EffortBaseline,
    count_effort_terms,
    effort_steps,
    largest_shifts,
    time_in_motion,
)
from truejoint.calibration.rows import Rows
from truejoint.errors import CalibrationError
from truejoint.features.feature_set import time_steps

if TYPE_CHECKING:
    from truejoint.calibration.calibration import Calibration
    from truejoint.recordings import Recording

RANGES_EACH_WAY: Final = 5.0  # that a joint travels at least for a baseline
STEPS_PER_TERM: Final = 20
MAX_JOINTS: Final = 12  # of a baseline, whose terms grow with the square
SMALLEST_SHIFT, SHIFT_MARGIN = 0.6, 5.5
SMALLEST_FRICTION_SHIFT, FRICTION_MARGIN = 4.0, 2.0
"""Limits are at least so many standard deviations of single efforts (most of which is ripple that
averages out), and so many times what a held-out training recording shows: a quarter of an hour of
zig-zags shows as little as a fifth of what two hours of work do (twelve virtual arms)."""

_STARTS, _STARTS_EACH = 24, 3  # at least, in all recordings and in each
_SMALLEST: Final = 1e-150  # [rad or m] of a deviation; its square is not 0 either
_LEAST_PAST, _ENOUGH_PAST = 1e-3, 5.0  # [s]; the first row alone is worth something
_NEARLY: Final = 0.8  # of a time, in which a joint also turns, and rests there for a moment
_COMPARED, _LEAST_COMPARED = 10, 20  # one part in ten of a run, rows: do they forget the past?
_AGREED: Final = 0.01  # of the standard deviation of errors: two runs that agree to it are the same


def residual_baseline(
    calibration: Calibration, parts: Sequence[Rows], held_out: ArrayLike = 0.0
) -> EffortBaseline | None:
    """Learn the size of errors from rows, without efforts: no joint is monitored.

    It is at least the one that was `held_out` (n_joints,) [rad or m]. None where joints are too
    many for a baseline, or one never moves.
    """
    positions = np.concatenate([part.measured for part in parts])
    lower, upper = positions.min(axis=0), positions.max(axis=0)
    n = len(lower)
    if n > MAX_JOINTS or not (upper > lower).all():
        return None
    step = (upper - lower) / STEPS_PER_RANGE
    residual, correlation, beginning = residual_statistics(calibration, parts, step)
    return EffortBaseline(
        lower,
        upper,
        **dict.fromkeys(("monitored", "shift_limit", "friction_limit"), np.zeros(n)),
        coef=np.zeros((n, count_effort_terms(n))),
        scale=np.ones(n),
        residual=np.maximum(residual, held_out),
        correlation=correlation,
        beginning=beginning,
    )


def fit_effort_baseline(
    calibration: Calibration, parts: Sequence[Rows], held_out: ArrayLike = 0.0
) -> EffortBaseline | None:
    """Learn efforts, and errors as `residual_baseline`, from rows in which a calibration holds.

    A joint is `monitored` when its effort is among the signals and it travels at least five of its
    ranges each way.
    """
    joints, bare = calibration.joints, residual_baseline(calibration, parts, held_out)
    if bare is None:
        return None
    has_effort = np.array([f"effort/{joint}" in calibration.signals for joint in joints])
    pieces = [part.recording for part in parts]
    if len(pieces) == 1 and len(pieces[0]) >= 4:  # in three by time, each held out in turn
        thirds = np.array_split(np.arange(len(pieces[0]), dtype=np.int64), 3)
        pieces = [pieces[0].rows(third) for third in thirds]
    steps = [_steps(piece, joints, has_effort, bare.lower, bare.upper) for piece in pieces]
    n_terms = count_effort_terms(len(joints))
    coef, scale = np.zeros((len(joints), n_terms)), np.ones(len(joints))
    shift, friction, monitored = np.zeros((3, len(joints)))
    for j in range(len(joints)):
        of_joint = [rows[rows[:, 0] == j] for rows in steps]
        rows = np.concatenate(of_joint)
        each_way = [np.sum(rows[way * rows[:, 2] > 0.0, 3]) for way in (1.0, -1.0)]
        if (
            not has_effort[j]
            or min(each_way) < RANGES_EACH_WAY
            or len(rows) < max(RANGES_EACH_WAY * STEPS_PER_RANGE, STEPS_PER_TERM * n_terms)
            or not rows[:, 1].std() > 0.0
        ):
            continue
        coef[j], scale[j] = _fit_effort(rows)
        for i, block in enumerate(of_joint):  # against the baseline of the others, in its scale
            rest = np.concatenate([block[:0], *of_joint[:i], *of_joint[i + 1 :]])
            if len(block) and len(rest) >= STEPS_PER_TERM * n_terms:
                coef_rest, scale_rest = _fit_effort(rest)
                deviation = (block[:, 1] - block[:, 4:] @ coef_rest) / scale_rest
                columns = block[:, 2].copy(), block[:, 3].copy()
                largest = largest_shifts(deviation, *columns)
                shift[j], friction[j] = np.maximum((shift[j], friction[j]), largest)
        monitored[j] = 1.0
    return replace(
        bare,
        monitored=monitored,
        coef=coef,
        scale=scale,
        shift_limit=np.maximum(SMALLEST_SHIFT, SHIFT_MARGIN * shift),
        friction_limit=np.maximum(SMALLEST_FRICTION_SHIFT, FRICTION_MARGIN * friction),
    )


def _steps(
    recording: Recording, joints: Sequence[str], has_effort: Mask, lower: Array, upper: Array
) -> Array:
    """Lay out a recording as `effort_steps` does; effort 0 where there is none."""
    n_joints = len(joints)
    position = np.ascontiguousarray(recording.columns("measured", joints))
    effort = np.zeros_like(position)
    effort[:, has_effort] = recording.columns("effort", np.array(joints)[has_effort].tolist())
    # A step is at least 1/200 of a range, so that travel bounds their number.
    travel = np.abs(np.diff(position, axis=0)).sum(axis=0) / (upper - lower)
    most = min(position.size, int(travel.sum() * STEPS_PER_RANGE) + n_joints)
    rows = np.empty((most + 1, 4 + count_effort_terms(n_joints)))
    return rows[: effort_steps(np.array(recording.t), position, effort, lower, upper, rows)]


def _fit_effort(rows: Array) -> tuple[Array, float]:
    """Coefficients (n_terms,) of one joint's effort and the standard deviation about them."""
    terms, effort = rows[:, 4:], rows[:, 1]
    coef = np.asarray(np.linalg.lstsq(terms, effort, rcond=None)[0], dtype=np.float64)
    deviation = float(np.std(effort - terms @ coef))
    return coef, max(deviation, 1e-9 * float(np.abs(effort).max()))


def residual_statistics(
    calibration: Calibration, recordings: Sequence[Recording | Rows], step: Array
) -> tuple[Array, Array, Array]:
    """Statistics of truth minus corrected position about each recording's mean.

    Standard deviation (n_joints,) [rad or m]; time (n_joints,) [s] in which the autocorrelation
    falls to 1/e; standard deviation (n, n_joints) [rad or m] of the offset that the first
    `BEGINNINGS` of a motion show: a fit knows how its recordings began, but nothing of the past of
    other starts, of which there are 24 or more, and three in each recording. A joint moves by a
    `step` (n_joints,) [rad or m], or rests. Raises CalibrationError if no recording has the truth
    of two rows.
    """
    errors, offsets = [], []
    count = max(_STARTS_EACH, -(-_STARTS // len(recordings)))
    for rows in map(calibration.rows, recordings):
        corrected = calibration.correct(rows)
        error = rows.truth - corrected
        is_known = np.isfinite(error).all(axis=1)
        if is_known.sum() >= 2:
            mean = error[is_known].mean(axis=0)
            errors.append((rows.t[is_known], error[is_known] - mean))
            starts = beginning_offsets(calibration, rows, corrected, count, step)
            offsets += [offset - mean for offset in starts]
    if not errors:
        raise CalibrationError(
            "no recording has the truth of two rows, so the size of the errors is unknown; give "
            "one with more truth"
        )
    size = np.sqrt(np.mean(np.concatenate([error for _, error in errors]) ** 2, axis=0))
    times = [[_correlation_time(t, error[:, j]) for j in range(len(size))] for t, error in errors]
    beginning = _root_mean_square(np.reshape(offsets, (-1, len(BEGINNINGS), len(size))))
    return (
        np.maximum(size, _SMALLEST),
        np.maximum(np.median(times, axis=0), 1e-3),
        np.maximum(beginning, _SMALLEST),
    )


def _root_mean_square(off: Array) -> Array:
    """Root mean square (n, n_joints) of the deviations (m, n, n_joints) that are not NaN.

    A beginning that no recording or motion is long enough for has that of the next shorter one; a
    beginning without truth has that of the next longer one.
    """
    has_value = np.isfinite(off)
    square = np.where(has_value, off, 0.0) ** 2
    deviation = np.sqrt(square.sum(axis=0) / np.maximum(has_value.sum(axis=0), 1))
    places = np.arange(off.shape[1])
    for values, reached in zip(deviation.T, np.asarray(has_value.any(axis=0)).T, strict=True):
        if reached.any():
            there = np.searchsorted(places[reached], places, "right") - 1
            values[:] = values[reached][np.maximum(there, 0)]
    return np.asarray(deviation)


def beginning_offsets(
    calibration: Calibration, rows: Rows, corrected: Array, count: int, step: Array
) -> list[Array]:
    """Offsets (n, n_joints) [rad or m] of the first `BEGINNINGS` from each of `count` starts.

    NaN for those in which a joint was in motion for less, but for the shortest. The starts are
    spread evenly; each is followed as far as the longest beginning, or half of the recording. The
    calibration starts there anew; `corrected` (m, n_joints) [rad or m] is what it gives in one go.
    A joint moves by a `step` (n_joints,) [rad or m], or rests.
    """
    t = rows.t
    length = min(BEGINNINGS[-1], 0.5 * rows.recording.duration)
    starts = np.linspace(t[0], t[-1] - length, count)
    edges = np.searchsorted(t, [starts, starts + length])
    if np.diff(edges, axis=0).sum() < 2:
        return []
    spans = [slice(first, end) for first, end in edges.T if end > first]  # rows may be far apart
    near = _AGREED * np.nanstd(rows.truth - corrected, axis=0)
    offsets, long = [], _NEARLY * np.array(BEGINNINGS[1:])
    restarted = _corrected_anew(calibration, rows, spans, corrected, near)
    for span, positions in zip(spans, restarted, strict=True):
        in_motion = time_in_motion(t[span], rows.measured[span], step)
        error = rows.truth[span] - positions
        is_known = np.isfinite(error).all(axis=1)
        if not is_known.any():
            continue
        weights = past_weights(calibration, t[span], in_motion)[is_known]
        of_start = np.empty((len(BEGINNINGS), len(step)))
        for j, moving in enumerate(in_motion[is_known].T):
            ends = np.searchsorted(moving, BEGINNINGS)
            ends[1:] *= moving[-1] >= long
            of_start[:, j] = weighted_medians(error[is_known, j], weights[:, j], ends)
        offsets.append(of_start)
    return offsets


def _corrected_anew(
    calibration: Calibration, rows: Rows, spans: Sequence[slice], corrected: Array, near: Array
) -> list[Array]:
    """Corrected positions (m, n_joints) of each of the `spans` of rows, from which it starts anew.

    A span whose first tenth agrees within `near` (n_joints,) [rad or m] with one run over all rows,
    `corrected` (n, n_joints), has forgotten the past, and agrees from there on.
    """
    positions = [corrected[span] for span in spans]
    if not calibration.looks_back:
        return positions
    lengths = [max(len(p) // _COMPARED, min(len(p), _LEAST_COMPARED)) for p in positions]
    heads = [slice(s.start, s.start + n) for s, n in zip(spans, lengths, strict=True)]
    remembering = []
    for k, head in enumerate(_run(calibration, rows, heads)):
        before, after = np.split(positions[k], [len(head)])
        late = len(head) // 2
        if len(after) and not (np.abs(head - before)[late:] <= near).all():
            remembering.append(k)
        else:
            positions[k] = np.concatenate([head, after])
    if remembering:
        again = _run(calibration, rows, [spans[k] for k in remembering])
        for k, restarted in zip(remembering, again, strict=True):
            positions[k] = restarted
    return positions


def _run(calibration: Calibration, rows: Rows, spans: Sequence[slice]) -> list[Array]:
    """Corrected positions (m, n_joints) of each of the `spans` of rows, all of them in one run."""
    recording = rows.recording
    numbers = [np.arange(span.start, span.stop) for span in spans]
    spacing = recording.duration + 2.0 * calibration.gap_limit  # a history of its own for each
    t = np.concatenate([recording.t[indices] + k * spacing for k, indices in enumerate(numbers)])
    table = recording.table.iloc[np.concatenate(numbers)].reset_index(drop=True).assign(t=t)
    corrected = calibration.correct(rows.of_recording(replace(recording, table=table)))
    return np.split(corrected, np.cumsum([len(indices) for indices in numbers])[:-1])


def past_weights(calibration: Calibration, t: Array, in_motion: Array) -> Array:
    """How long the past in motion of each row, at `t` (n,) [s], is (n, n_joints) [s].

    1 where nothing looks at the past.
    """
    if not calibration.looks_back:
        return np.ones_like(in_motion)
    starts = time_steps(t, calibration.gap_limit) == 0.0
    past = in_motion - in_motion[starts][np.cumsum(starts) - 1]
    return np.asarray(np.clip(past, _LEAST_PAST, _ENOUGH_PAST))


def weighted_medians(error: Array, weights: Array, ends: Integers) -> Array:
    """Median of the first of the errors (m,) of these weights (m,), up to each of `ends` (k,).

    NaN of none.
    """
    medians = np.full(len(ends), np.nan)
    for k, end in enumerate(ends):
        errors, w = error[:end], weights[:end]
        if (w == w[:1]).all():
            medians[k] = np.median(errors) if end else np.nan
        else:
            order = np.argsort(errors)  # as np.quantile with weights, which numpy has from 2.0 on
            reached = np.cumsum(w[order])
            medians[k] = errors[order[np.argmax(reached >= 0.5 * reached[-1])]]
    return medians


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
