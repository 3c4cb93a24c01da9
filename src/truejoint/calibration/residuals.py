"""How large the residuals of a calibration are, how long they last, and how motions begin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from truejoint.array_types import Array
from truejoint.calibration.efforts import BEGINNINGS, time_in_motion
from truejoint.calibration.rows import Rows
from truejoint.errors import CalibrationError
from truejoint.features.feature_set import time_steps

if TYPE_CHECKING:
    from truejoint.calibration.calibration import Calibration
    from truejoint.recordings import Recording

_STARTS, _STARTS_EACH = 24, 3  # at least, in all recordings and in each
_SMALLEST: Final = 1e-150  # [rad or m] of a deviation; its square is not 0 either
_LEAST_PAST, _ENOUGH_PAST = 1e-3, 5.0  # [s]; the first row alone is worth something
_NEARLY: Final = 0.8  # of a time, in which a joint also turns, and rests there for a moment
_COMPARED, _LEAST_COMPARED = 10, 20  # one part in ten of a run, rows: do they forget the past?
_AGREED: Final = 0.01  # of the standard deviation of errors: two runs that agree to it are the same


class Residuals(NamedTuple):
    """Statistics of truth minus corrected position about each recording's mean."""

    size: Array  # (n_joints,), standard deviation [rad or m]
    correlation: Array  # (n_joints,), time [s] in which the autocorrelation falls to 1/e
    beginning: Array
    """(n, n_joints), standard deviation [rad or m] of the offset that the first `BEGINNINGS` of a
    motion show: a fit knows how its recordings began, but nothing of the past of other starts."""


def residual_statistics(
    calibration: Calibration, recordings: Sequence[Recording | Rows], step: Array
) -> Residuals:
    """Residuals of recordings with truth; beginnings are those of 24 starts or more.

    There are three starts or more in each recording. A joint moves by a `step` (n_joints,) [rad or
    m], or rests. Raises CalibrationError if no recording has the truth of two rows.
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
    return Residuals(
        np.maximum(size, _SMALLEST),
        np.maximum(np.median(times, axis=0), 1e-3),
        np.maximum(beginning, _SMALLEST),
    )


def _root_mean_square(off: Array) -> Array:
    """Root mean square (n, n_joints) of the deviations (m, n, n_joints) that are not NaN.

    A beginning that no recording or motion is long enough for has that of the next shorter one; a
    beginning without truth has that of the next longer one.
    """
    known = np.isfinite(off)
    square = np.where(known, off, 0.0) ** 2
    deviation = np.sqrt(square.sum(axis=0) / np.maximum(known.sum(axis=0), 1))
    places = np.arange(off.shape[1])
    for values, is_known in zip(deviation.T, np.asarray(known.any(axis=0)).T, strict=True):
        if is_known.any():
            there = np.searchsorted(places[is_known], places, "right") - 1
            values[:] = values[is_known][np.maximum(there, 0)]
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
    spans = [slice(*np.searchsorted(t, (start, start + length))) for start in starts]
    spans = [span for span in spans if span.stop > span.start]  # rows may be further apart
    if sum(span.stop - span.start for span in spans) < 2:
        return []
    near = _AGREED * np.nanstd(rows.truth - corrected, axis=0)
    offsets = []
    restarted = _corrected_anew(calibration, rows, spans, corrected, near)
    for span, positions in zip(spans, restarted, strict=True):
        in_motion = time_in_motion(t[span], rows.measured[span], step)
        weights = past_weights(calibration, t[span], in_motion)
        error = rows.truth[span] - positions
        is_known = np.isfinite(error).all(axis=1)
        if is_known.any():
            columns = (values[is_known].T for values in (in_motion, error, weights))
            offsets.append(np.transpose([_offsets(*joint) for joint in zip(*columns, strict=True)]))
    return offsets


def _offsets(in_motion: Array, error: Array, weights: Array) -> Array:
    """Offsets (n,) [rad or m] of the first `BEGINNINGS`, of one joint (m,); NaN where too long."""
    offsets = np.full(len(BEGINNINGS), np.nan)
    ends = np.searchsorted(in_motion, BEGINNINGS)
    for row, (end, duration) in enumerate(zip(ends, BEGINNINGS, strict=True)):
        if end and (row == 0 or in_motion[-1] >= _NEARLY * duration):
            offsets[row] = weighted_median(error[:end], weights[:end])
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
    again = _run(calibration, rows, [spans[k] for k in remembering])
    for k, restarted in zip(remembering, again, strict=True):
        positions[k] = restarted
    return positions


def _run(calibration: Calibration, rows: Rows, spans: Sequence[slice]) -> list[Array]:
    """Corrected positions (m, n_joints) of each of the `spans` of rows, all of them in one run."""
    if not spans:
        return []
    recording = rows.recording
    numbers = [np.arange(span.start, span.stop) for span in spans]
    spacing = recording.duration + 2.0 * calibration.gap_limit  # a history of its own for each
    t = np.concatenate([recording.t[own] + k * spacing for k, own in enumerate(numbers)])
    table = recording.table.iloc[np.concatenate(numbers)].reset_index(drop=True).assign(t=t)
    corrected = calibration.correct(rows.of_recording(replace(recording, table=table)))
    return np.split(corrected, np.cumsum([len(own) for own in numbers])[:-1])


def past_weights(calibration: Calibration, t: Array, in_motion: Array) -> Array:
    """How long the past in motion of each row, at `t` (n,) [s], is (n, n_joints) [s].

    1 where nothing looks at the past.
    """
    if not calibration.looks_back:
        return np.ones_like(in_motion)
    starts = time_steps(t, calibration.gap_limit) == 0.0
    past = in_motion - in_motion[starts][np.cumsum(starts) - 1]
    return np.asarray(np.clip(past, _LEAST_PAST, _ENOUGH_PAST))


def weighted_median(error: Array, weights: Array) -> float:
    """Median of errors (m,) of these weights (m,)."""
    if (weights == weights[0]).all():
        return float(np.median(error))
    order = np.argsort(error)  # as np.quantile with weights, which numpy has from 2.0 on
    reached = np.cumsum(weights[order])
    return float(error[order[np.argmax(reached >= 0.5 * reached[-1])]])


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
