"""The zero of a recording or homing: estimated with the model, and found again from brief truth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truejoint.array_types import Array, Mask
from truejoint.calibration.efforts import BEGINNINGS, time_in_motion
from truejoint.calibration.encoding import CalibrationData, as_calibration, as_recorded
from truejoint.errors import CalibrationError
from truejoint.features.feature_set import time_steps

if TYPE_CHECKING:
    from truejoint.calibration.calibration import Calibration
    from truejoint.recordings import Recording


CORRELATION_MARGIN: Final = 3.0
"""Errors may resemble each other for longer than in the motions of the baseline by this factor:
a slower motion stays longer where the calibration errs one way."""

_DOUBT: Final = 1.5  # deviations of an offset that errors may explain
_MOST_ROWS: Final = 500  # that a standard deviation is worked out from, pair by pair
_LEAST_PAST, _ENOUGH_PAST = 1e-3, 5.0  # [s]; the first row alone is worth something
_NEARLY: Final = 0.8  # of a time, in which a joint also turns, and rests there for a moment
_TRIED, _LEAST_TRIED = 10, 20  # one part in ten of a run, rows: looked at for a past forgotten
_AGREED: Final = 0.01  # of the standard deviation of errors: two runs that agree to it are the same
_MOST_ROUNDS: Final = 20  # of moving the inputs of a model until its output fits


@dataclass(frozen=True, eq=False)
class Zero:
    """Where a brief truth says that the corrected positions are.

    Attributes
    ----------
    offset : ndarray, shape (n_joints,)
        How far off the zero of the calibration is there [rad or m]: median of truth minus corrected
        position or, where it moves the measured positions, what brings that to nothing. Where the
        calibration looks at the past, a reading weighs as much as the joint was in motion before
        it, up to 5 s: how friction stood before a recording is not known.
    believed : ndarray, shape (n_joints,)
        By how much to move the zero [rad or m], as `truejoint.calibration.zero.believed_zero` says.
    sd : ndarray, shape (n_joints,)
        Standard deviation of `offset` as an estimate of the offset of a whole motion [rad or m].
        Errors of a model resemble each other over seconds of motion, so a brief truth knows less
        than its number of readings suggests, and a rest no more than one of them; and of what was
        before it starts a model knows nothing, so it is no less than what beginnings of the
        training with as much motion show. NaN where the calibration keeps no `EffortBaseline`.
    rows : int
        Readings of the truth.
    duration : float
        From the first to the last of them [s].

    Examples
    --------
    >>> truejoint.calibration.find_zero(model, test).rows
    400
    """

    offset: Array
    believed: Array
    sd: Array
    rows: int
    duration: float


def believed(offset: ArrayLike, sd: ArrayLike) -> Array:
    """Estimate zeros (n,) [rad or m] of offsets that are known to `sd` (n,), where few zeros move.

    That is ``offset (1 - (1.5 sd / offset)^2)``, and nothing below 1.5 `sd`. With 1 for 1.5 it is
    the mean of a Gaussian zero whose variance is what today's offset has beyond that of the errors
    (empirical Bayes, as Efron and Morris, JASA 68, 1973, here of a single mean; in form Breiman's
    non-negative garrote, Technometrics 37, 1995); 1.5 is for errors of beginnings, which now and
    then are several deviations. A zero that moved by ten deviations is found to two tenths of one
    more; errors of a brief stretch that lie all to one side are no zero. Where the zero did not
    move, the mean square error is 0.12 of that of the whole offset; the price is a zero that moved
    by more than 1.1 deviations: up to 2.2 times (at 2.6). All of an offset whose `sd` is NaN.

    Examples
    --------
    >>> believed([1.2, 10.0], [1.0, 1.0])
    array([0.   , 9.775])
    """
    whole, spread = (np.asarray(values, dtype=np.float64) for values in (offset, sd))
    spread = _DOUBT * spread
    by_errors = np.divide(spread**2, whole, out=whole.copy(), where=np.abs(whole) > spread)
    return np.where(np.isnan(spread), whole, whole - by_errors)


def believed_zero(calibration: CalibrationData[Any], offset: Array, sd: Array) -> Array:
    """By how much (n_joints,) [rad or m] to move the zero for an offset that is known to `sd`.

    Where the calibration was fitted with a zero for each recording or homing, zeros are known to
    move, and it is all of `offset`; else it is less, as `believed` says.
    """
    moves = calibration.metadata.get("zeros", {}).get("of", "shared") != "shared"
    return offset.copy() if moves else believed(offset, sd)


def find_zero(calibration: Calibration, recording: Recording, duration: float = math.inf) -> Zero:
    """Offset of a calibration against the truth in a recording, however little there is of it.

    Of the truth, the first `duration` [s] are used.

    Raises
    ------
    CalibrationError
        If the recording does not fit the calibration, or holds no truth, or the duration is not
        above 0.

    Examples
    --------
    >>> find_zero(model, test).offset.shape
    (1,)
    """
    if not duration > 0.0:
        raise CalibrationError(f"the time to re-zero from is {duration:g} s; give more than 0 s")
    t, error, known = known_error(calibration, recording)
    used = at_start(t, duration)
    rows = np.flatnonzero(known)[used]
    baseline = calibration.effort_baseline
    position = np.ascontiguousarray(recording.columns("measured", calibration.joints))
    step = np.zeros(position.shape[1]) if baseline is None else baseline.step  # else, all of time
    stamps = np.array(recording.t)
    in_motion = time_in_motion(stamps, position, step)
    weights = _past(calibration, stamps, in_motion)[rows]
    t, offset = t[used], _medians(error[used], weights)
    if calibration.moves is not None:
        # The outputs move about as far as the inputs, but not just as far.
        brief = recording.rows(slice(0, int(rows[-1]) + 1))
        left = offset
        for _ in range(_MOST_ROUNDS):
            now = _medians(known_error(moved(calibration, offset), brief)[1], weights)
            if not np.abs(now).max() < np.abs(left).max():
                break
            offset, left = offset + now, now
    sd = np.full(len(calibration.joints), math.nan)
    if baseline is not None:
        chosen = np.linspace(0, len(t) - 1, min(len(t), _MOST_ROWS)).astype(np.int64)
        times = CORRELATION_MARGIN * baseline.correlation
        by_joint = zip(in_motion[rows[chosen]].T, weights[chosen].T, times, strict=True)
        alike = [_alike(*one) for one in by_joint]
        at_beginnings = baseline.beginning_sd(in_motion[rows[-1]])
        sd = np.maximum(baseline.residual * np.sqrt(alike), at_beginnings)
    moved_by = believed_zero(calibration, offset, sd)
    return Zero(offset, moved_by, sd, len(t), float(t[-1] - t[0]))


def _alike(in_motion: Array, weights: Array, time: float) -> float:
    """Variance of the mean of readings of these `weights` (m,), each of a variance of 1.

    Those that are a `time` [s] apart `in_motion` (m,) [s] have a correlation of 1/e.
    """
    apart = np.abs(np.subtract.outer(in_motion, in_motion))
    pairs = np.outer(weights, weights) * np.exp(-apart / time)
    return float(pairs.sum() / weights.sum() ** 2)


def beginnings(
    calibration: Calibration, recording: Recording, corrected: Array, count: int, step: Array
) -> list[Array]:
    """Offsets (n, n_joints) [rad or m] of the first `BEGINNINGS` from each of `count` starts.

    NaN for those in which a joint, which moves by a `step` (n_joints,) [rad or m] or rests, was in
    motion for less, but for the shortest; of each start with a truth, spread evenly, as far as the
    longest, or half of the recording. The calibration starts there anew; `corrected` (m, n_joints)
    [rad or m] is what it gives in one go.
    """
    t, length = np.array(recording.t), min(BEGINNINGS[-1], 0.5 * recording.duration)
    truth = recording.columns("truth", calibration.joints)
    position = np.ascontiguousarray(recording.columns("measured", calibration.joints))
    starts = np.linspace(t[0], t[-1] - length, count)
    spans = [slice(*np.searchsorted(t, (one, one + length))) for one in starts]
    spans = [one for one in spans if one.stop > one.start]  # rows may be further apart
    if sum(one.stop - one.start for one in spans) < 2:
        return []
    near = _AGREED * np.nanstd(truth - corrected, axis=0)
    anew = _corrected_anew(calibration, recording, spans, corrected, near)
    found = []
    for span, own in zip(spans, anew, strict=True):
        in_motion = time_in_motion(t[span], position[span], step)
        weights = _past(calibration, t[span], in_motion)
        error = truth[span] - own
        known = np.isfinite(error).all(axis=1)
        if known.any():
            columns = (values[known].T for values in (in_motion, error, weights))
            found.append(np.transpose([_offsets(*one) for one in zip(*columns, strict=True)]))
    return found


def _offsets(in_motion: Array, error: Array, weights: Array) -> Array:
    """Offsets (n,) [rad or m] of the first `BEGINNINGS`, of one joint (m,); NaN where too long."""
    off = np.full(len(BEGINNINGS), np.nan)
    ends = np.searchsorted(in_motion, BEGINNINGS)
    for row, (end, duration) in enumerate(zip(ends, BEGINNINGS, strict=True)):
        if end and (row == 0 or in_motion[-1] >= _NEARLY * duration):
            off[row] = _median(error[:end], weights[:end])
    return off


def _corrected_anew(
    calibration: Calibration,
    recording: Recording,
    spans: Sequence[slice],
    corrected: Array,
    near: Array,
) -> list[Array]:
    """Corrected positions (m, n_joints) of each of the `spans` of rows, from which it starts anew.

    In a span in whose first tenth they come as `near` (n_joints,) [rad or m] to those of one run,
    `corrected` (n, n_joints), what was before is forgotten, and they are the same from there on.
    """
    found = [corrected[span] for span in spans]
    if not calibration.looks_back:
        return found
    lengths = [max(len(own) // _TRIED, min(len(own), _LEAST_TRIED)) for own in found]
    tried = [slice(one.start, one.start + n) for one, n in zip(spans, lengths, strict=True)]
    remembered = []
    for k, begun in enumerate(_run(calibration, recording, tried)):
        before, after = np.split(found[k], [len(begun)])
        late = len(begun) // 2
        if len(after) and not (np.abs(begun - before)[late:] <= near).all():
            remembered.append(k)
        else:
            found[k] = np.concatenate([begun, after])
    again = _run(calibration, recording, [spans[k] for k in remembered])
    for k, own in zip(remembered, again, strict=True):
        found[k] = own
    return found


def _run(calibration: Calibration, recording: Recording, spans: Sequence[slice]) -> list[Array]:
    """Corrected positions (m, n_joints) of each of the `spans` of rows, all of them in one run."""
    if not spans:
        return []
    rows = [np.arange(span.start, span.stop) for span in spans]
    apart = recording.duration + 2.0 * calibration.gap_limit  # a history of its own for each
    t = np.concatenate([recording.t[own] + k * apart for k, own in enumerate(rows)])
    table = recording.table.iloc[np.concatenate(rows)].reset_index(drop=True).assign(t=t)
    corrected = calibration.evaluate(replace(recording, table=table))
    return np.split(corrected, np.cumsum([len(own) for own in rows])[:-1])


def _past(calibration: Calibration, t: Array, in_motion: Array) -> Array:
    """How long the past in motion of each row, at `t` (n,) [s], is (n, n_joints) [s].

    1 where nothing looks at the past.
    """
    if not calibration.looks_back:
        return np.ones_like(in_motion)
    starts = time_steps(t, calibration.gap_limit) == 0.0
    past = in_motion - in_motion[starts][np.cumsum(starts) - 1]
    return np.asarray(np.clip(past, _LEAST_PAST, _ENOUGH_PAST))


def _medians(error: Array, weights: Array) -> Array:
    """Median (n_joints,) of errors (m, n_joints), each of its own weight (m, n_joints)."""
    return np.array([_median(*column) for column in zip(error.T, weights.T, strict=True)])


def _median(error: Array, weights: Array) -> float:
    """Median of errors (m,) of these weights (m,)."""
    if (weights == weights[0]).all():
        return float(np.median(error))
    order = np.argsort(error)  # as np.quantile with weights, which numpy has from 2.0 on
    reached = np.cumsum(weights[order])
    return float(error[order[np.argmax(reached >= 0.5 * reached[-1])]])


def rezeroed(
    calibration: Calibration, recording: Recording, duration: float = math.inf
) -> Calibration:
    """Give the calibration whose zero is that of the truth in a recording.

    It moves by `Zero.believed`. Where zeros were fitted (`calibrate`, `zero`), it is the fit with
    these. Each baseline moves by all of its own offset, and the range of plausible corrections
    moves along. The metadata say so under ``rezeroed``, and of the new homing.

    Parameters
    ----------
    calibration : Calibration
    recording : Recording
        With a brief truth: see `find_zero`.
    duration : float
        How much of the truth to use, from its beginning [s].

    Raises
    ------
    CalibrationError
        As `find_zero`.

    Examples
    --------
    >>> "rezeroed" in rezeroed(model, test).metadata
    True
    """
    calibration = as_calibration(calibration).fitted_for(rezeroing=True)
    zero = find_zero(calibration, recording, duration)
    offsets = {
        name: baseline.offset + find_zero(baseline, recording, duration).offset
        for name, baseline in calibration.baselines.items()
    }
    origin = recording.provenance
    facts = {
        "source": origin.source,
        "homing_id": origin.homing_id,
        "offset": zero.believed.tolist(),
        "sd": None if np.isnan(zero.sd).any() else zero.sd.tolist(),
        "rows": zero.rows,
        "duration": zero.duration,
    }
    own = moved(calibration, zero.believed)
    own = replace(own, offsets={**own.offsets, **offsets})
    if origin.homing_id:
        own = own.with_metadata(homing_ids=[origin.homing_id])
    return own.with_metadata(rezeroed=facts)


def moved(calibration: Calibration, offset: Array) -> Calibration:
    """Move the zero of the model by `offset` (n_joints,) [rad or m]; baselines stay."""
    domain = calibration.training_domain
    if domain is not None:
        bounds = {n: getattr(domain, n) + offset for n in ("error_lower", "error_upper")}
        domain = replace(domain, **bounds)
    offsets = {**calibration.offsets, "model": calibration.offset + offset}
    return replace(calibration, offsets=offsets, training_domain=domain)


def at_start(t: Array, duration: float) -> NDArray[np.bool_]:
    """Which stamps `t` (n,) [s] of known truth lie within `duration` [s] of the first."""
    return np.asarray(t - t[0] < duration)


def zeroed(calibration: Calibration, recording: Recording, duration: float) -> Calibration:
    """Move the zero of the model by what the first `duration` [s] of truth say of a recording.

    Where that is 0, nothing moves; raises CalibrationError as `find_zero`.
    """
    if duration == 0.0:
        return calibration
    return moved(calibration, find_zero(calibration, recording, duration).believed)


def known_error(
    calibration: Calibration, recording: Recording
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Stamps (m,), truth minus corrected (m, n_joints), and places (n,) of the rows with truth.

    Raises CalibrationError if the recording does not fit, or no row has the truth of all joints.
    """
    source = as_recorded(recording).provenance.source or "recording"
    without = [
        j for j in as_calibration(calibration).joints if f"truth/{j}" not in recording.table.columns
    ]
    if without:
        raise CalibrationError(
            f"{source} has no truth of {', '.join(without)}; record it with a sensor at the joint, "
            "if only for a moment"
        )
    error = recording.columns("truth", calibration.joints) - calibration.correct(recording)
    known = np.asarray(np.isfinite(error).all(axis=1))
    if not known.any():
        raise CalibrationError(
            f"{source}: no row has the truth of {', '.join(calibration.joints)}; an interval is "
            "made of, and judged by, true positions"
        )
    return recording.t[known], error[known], known


def judged_error(
    calibration: Calibration, recording: Recording, rezero: float, among: Mask | None = None
) -> tuple[Array, NDArray[np.int64]]:
    """Errors (m, n_joints) [rad or m] that are judged, and the rows (m,) that they are of.

    Those of all rows with truth (of the rows `among` (n,), where it is given) or, where the first
    `rezero` [s] of them set the zero, of those after; raises CalibrationError as `known_error`, or
    when nothing is left.
    """
    if among is not None:
        truth = {f"truth/{j}": recording.column(f"truth/{j}") for j in calibration.joints}
        kept = {column: np.where(among, values, np.nan) for column, values in truth.items()}
        recording = replace(recording, table=recording.table.assign(**kept))
    t, error, known = known_error(zeroed(calibration, recording, rezero), recording)
    used = at_start(t, rezero)
    if used.all():
        raise CalibrationError(
            f"{recording.provenance.source or 'recording'}: all of its truth lies within the "
            f"{rezero:g} s that re-zero it; nothing is left to judge, so give a longer recording"
        )
    return error[~used], np.flatnonzero(known)[~used]
