"""How far from the training rows a sample may be: thresholds, all derived from the model file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.calibration.encoding import CalibrationData
from truejoint.calibration.training_domain import TrainingDomain, partners
from truejoint.errors import CalibrationError, ModelFileError
from truejoint.models.family import EstimatorData, find_family
from truejoint.models.features import MAX_RATE_RATIO
from truejoint.models.products import padded

RANGE_MARGIN: Final = 0.5
"""Share of its trained range by which a feature may lie outside before it is out of range.

Up to there the interval widens instead (`Interval.growth`): with the zig-zags of peng2024 for
training, its random motion leaves the range of the shoulder by up to a third, where a network is
four times less accurate than inside, and still ten times more accurate than a fixed offset."""
REJECT_MARGIN: Final = 1.0
"""Share of its trained range by which a signal may lie outside before nothing remembers it."""
DISTANCE_MARGIN: Final = 1.5
"""How much further from the middle than the furthest trained row a sample may be."""
SPIKE_MARGIN: Final = 3.0
"""How much faster than ever in training a signal may change."""
FROZEN_MARGIN: Final = 3.0
"""How much longer, or further past its partner, than in training a signal may stand still."""
FROZEN_TRAVEL: Final = 0.25
"""Share of its trained range that the partner of a signal may move at least meanwhile."""
FROZEN_STEPS: Final = 30.0
"""Training time steps for which all signals may stand still at least: 1 s at 30 Hz."""
ERROR_MARGIN: Final = 0.5
"""Share of the trained range of errors by which a correction may lie outside."""
SHORTEST_STEP: Final = 1e-3
"""Share of the training time step below which two stamps are one.

Where features (`lag`) or the estimator count samples it is 1 / `MAX_RATE_RATIO`: such a model knows
no faster rate.
"""

_ROUNDING: Final = 1e-9


@dataclass(frozen=True, eq=False)
class Limits:
    """Thresholds of the corrector in SI units, each a field of its memory (`runtime.fields`)."""

    shortest: float
    longest: float
    training_dt: float
    hold: float
    square: float
    reach: Array  # (n_signals,), as what follows
    signal_lower: Array  # infinite for signals that never changed
    signal_upper: Array
    partner: Integers  # see `partners`; -1 also where a signal or its partner never changed
    travel: Array
    moves: Integers
    domain_mean: Array  # (k,)
    whitening: Array  # lower triangle (n_white, n_white)
    feature_lower: Array  # (k,), infinite for features that never changed
    feature_upper: Array
    correction_lower: Array  # (n_joints,)
    correction_upper: Array


def limits_of(data: CalibrationData[EstimatorData], range_margin: float = RANGE_MARGIN) -> Limits:
    """Thresholds for samples of a calibration; `range_margin` (0 to 1) is for `RANGE_MARGIN`.

    Raises CalibrationError if it is out of range, and ModelFileError if the calibration was made
    without the training domain.
    """
    if not 0.0 <= range_margin <= REJECT_MARGIN:
        raise CalibrationError(
            f"range margin {range_margin!r:.60} is not a share of the trained range from 0 to "
            f"{REJECT_MARGIN:g}"
        )
    seen = data.training_domain
    if seen is None:
        raise ModelFileError(
            "the model does not say what its training rows looked like, so samples cannot be "
            "checked; calibrate it again"
        )
    counts = data.feature_set.counts_samples or find_family(data.model.family).counts_samples
    shortest = 1.0 / MAX_RATE_RATIO if counts else SHORTEST_STEP
    low, high = seen.signal_lower, seen.signal_upper
    moves = high > low
    partner = partners(data.signals)
    partner = np.where(moves & (partner >= 0) & moves[partner], partner, -1)
    allowed = np.maximum(FROZEN_TRAVEL, FROZEN_MARGIN * seen.signal_travel)
    lower, upper = _widened(low, high, REJECT_MARGIN)
    used = np.abs(seen.whitening).sum(axis=0) > 0.0
    feature_lower, feature_upper = _widened(data.lower, data.upper, range_margin)
    distance = DISTANCE_MARGIN * seen.distance
    correction_lower, correction_upper = believable_corrections(seen)
    return Limits(
        shortest=shortest * seen.dt,
        longest=data.gap_limit,
        training_dt=seen.dt,
        hold=max(FROZEN_MARGIN * seen.hold, FROZEN_STEPS * seen.dt),
        square=distance * distance,
        reach=np.where(moves, SPIKE_MARGIN * seen.signal_step, np.inf),
        signal_lower=np.where(moves, lower, -np.inf),
        signal_upper=np.where(moves, upper, np.inf),
        partner=partner,
        travel=allowed * (high - low)[partner],
        moves=moves.astype(np.int64),
        domain_mean=seen.feature_mean,
        # The length of a whitened row is all that counts, so a triangular factor does as well.
        whitening=padded(np.asarray(np.linalg.qr(seen.whitening, mode="r")).T, rows=True),
        feature_lower=np.where(used, feature_lower, -np.inf),
        feature_upper=np.where(used, feature_upper, np.inf),
        correction_lower=correction_lower,
        correction_upper=correction_upper,
    )


def believable_corrections(seen: TrainingDomain) -> tuple[Array, Array]:
    """Range (n_joints,), (n_joints,) of corrections [rad or m] outside which none is believed."""
    return _widened(seen.error_lower, seen.error_upper, ERROR_MARGIN)


def _widened(lower: Array, upper: Array, margin: float) -> tuple[Array, Array]:
    """Range widened by a share of itself, and by rounding, at either end."""
    extra = margin * (upper - lower) + _ROUNDING * np.maximum(np.abs(lower), np.abs(upper))
    return lower - extra, upper + extra
