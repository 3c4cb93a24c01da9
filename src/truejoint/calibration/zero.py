"""Re-zero a calibration: move its offset, and nothing else, to a brief truth."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from truejoint.array_types import Array
from truejoint.calibration.conformal import known_error, zero_offset

if TYPE_CHECKING:
    from truejoint.calibration.calibration import Calibration
    from truejoint.recordings import Recording


_MOST_ROWS: Final = 500  # that a standard deviation is worked out from, pair by pair


@dataclass(frozen=True, eq=False)
class Zero:
    """Where a brief truth says that the corrected positions are.

    Attributes
    ----------
    offset : ndarray, shape (n_joints,)
        Median of truth minus corrected position [rad or m]: what is to be added.
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


def find_zero(calibration: Calibration, recording: Recording) -> Zero:
    """Offset of a calibration against the truth in a recording, however little there is of it.

    Raises
    ------
    CalibrationError
        If the recording does not fit the calibration, or holds no truth.

    Examples
    --------
    >>> find_zero(model, test).offset.shape
    (1,)
    """
    t, error, _ = known_error(calibration, recording)
    chosen = np.linspace(0, len(t) - 1, min(len(t), _MOST_ROWS)).astype(np.int64)
    apart = np.abs(np.subtract.outer(t[chosen], t[chosen]))
    sd = np.full(len(calibration.joints), math.nan)
    baseline = calibration.effort_baseline
    if baseline is not None:
        sizes = zip(baseline.residual, baseline.correlation, strict=True)
        sd = np.array([size * math.sqrt(np.exp(-apart / time).mean()) for size, time in sizes])
    return Zero(zero_offset(t, error, math.inf)[0], sd, len(t), float(t[-1] - t[0]))


def rezeroed(calibration: Calibration, recording: Recording) -> Calibration:
    """Give the calibration whose offset is that of the truth in a recording.

    The baselines are re-zeroed likewise, each by its own errors, and the range of plausible
    corrections moves along. The metadata say so under ``rezeroed``, and of the new homing.

    Parameters
    ----------
    calibration : Calibration
    recording : Recording
        With a brief truth: see `find_zero`.

    Raises
    ------
    CalibrationError
        As `find_zero`, or if the estimator has no offset of its own.

    Examples
    --------
    >>> "rezeroed" in rezeroed(model, test).metadata
    True
    """
    zero = find_zero(calibration, recording)
    models = {
        name: baseline.model.shifted(find_zero(baseline, recording).offset)
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
    domain = calibration.training_domain
    if domain is not None:
        bounds = {n: getattr(domain, n) + zero.offset for n in ("error_lower", "error_upper")}
        domain = replace(domain, **bounds)
    model = calibration.model.shifted(zero.offset)
    moved = replace(calibration, model=model, baseline_models=models, training_domain=domain)
    if origin.homing_id:
        moved = moved.with_metadata(homing_ids=[origin.homing_id])
    return moved.with_metadata(rezeroed=facts)
