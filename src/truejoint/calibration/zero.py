"""The zero of a recording or homing: estimated with the model, and found again from brief truth."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from truejoint.array_types import Array, Mask
from truejoint.calibration.encoding import as_calibration, as_recorded
from truejoint.errors import CalibrationError

if TYPE_CHECKING:
    from truejoint.calibration.calibration import Calibration
    from truejoint.recordings import Recording


_MOST_ROWS: Final = 500  # that a standard deviation is worked out from, pair by pair
_MOST_ROUNDS: Final = 20  # of moving the inputs of a model until its output fits


@dataclass(frozen=True, eq=False)
class Zero:
    """Where a brief truth says that the corrected positions are.

    Attributes
    ----------
    offset : ndarray, shape (n_joints,)
        By how much the zero of the calibration has to move [rad or m]: median of truth minus
        corrected position or, where it moves the measured positions, what brings that to nothing.
    sd : ndarray, shape (n_joints,)
        Standard deviation of that as an estimate of the offset of a whole motion [rad or m].
        Errors of a model resemble each other over seconds, so a brief truth knows less than its
        number of readings suggests. NaN where the calibration keeps no `EffortBaseline`.
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
    sd: Array
    rows: int
    duration: float


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
    t, offset = t[used], np.median(error[used], axis=0)
    if calibration.moves is not None:
        # The outputs move about as far as the inputs, but not just as far.
        brief = recording.rows(slice(0, int(np.flatnonzero(known)[used][-1]) + 1))
        left = offset
        for _ in range(_MOST_ROUNDS):
            now = np.median(known_error(moved(calibration, offset), brief)[1], axis=0)
            if not np.abs(now).max() < np.abs(left).max():
                break
            offset, left = offset + now, now
    chosen = np.linspace(0, len(t) - 1, min(len(t), _MOST_ROWS)).astype(np.int64)
    apart = np.abs(np.subtract.outer(t[chosen], t[chosen]))
    sd = np.full(len(calibration.joints), math.nan)
    baseline = calibration.effort_baseline
    if baseline is not None:
        sizes = zip(baseline.residual, baseline.correlation, strict=True)
        sd = np.array([size * math.sqrt(np.exp(-apart / time).mean()) for size, time in sizes])
    return Zero(offset, sd, len(t), float(t[-1] - t[0]))


def rezeroed(
    calibration: Calibration, recording: Recording, duration: float = math.inf
) -> Calibration:
    """Give the calibration whose zero is that of the truth in a recording.

    Where zeros were fitted (`calibrate`, `zero`), it is the fit with these. The baselines are
    re-zeroed likewise, each by its own errors, and the range of plausible corrections moves along.
    The metadata say so under ``rezeroed``, and of the new homing.

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
        "offset": zero.offset.tolist(),
        "sd": None if np.isnan(zero.sd).any() else zero.sd.tolist(),
        "rows": zero.rows,
        "duration": zero.duration,
    }
    own = moved(calibration, zero.offset)
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
    """Move the zero of the model to that of the first `duration` [s] of truth in a recording.

    Where that is 0, nothing moves; raises CalibrationError as `find_zero`.
    """
    if duration == 0.0:
        return calibration
    return moved(calibration, find_zero(calibration, recording, duration).offset)


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
