"""How far from the training rows a sample may be: thresholds, all derived from the model file."""

from types import SimpleNamespace
from typing import Any, Final

import numpy as np

from truejoint.array_types import Array
from truejoint.calibration.calibration import Calibration
from truejoint.calibration.conditions import CELLS
from truejoint.calibration.domain import TrainingDomain, partners, varies
from truejoint.errors import CalibrationError, ModelFileError
from truejoint.features.feature_set import MAX_RATE_RATIO, MAX_STEPS
from truejoint.products import padded

RANGE_MARGIN: Final = 0.5
"""Share of its trained range by which a feature may lie outside before it is out of range.

Up to there the interval widens instead (`Interval.growth`): with the zig-zags of peng2024 for
training, its random motion leaves the range of the shoulder by up to a third, where a network is
four times less accurate than inside, and still ten times more accurate than a fixed offset."""
REJECT_MARGIN: Final = 1.0
"""Share of its trained range by which a signal may lie outside before nothing remembers it."""
HELD_MARGIN: Final = 0.1
"""Share of the least trained range of a measured position by which one may move, in the same unit,
that stood still throughout the training: nothing is known of the model where it is elsewhere."""
DISTANCE_MARGIN: Final = 1.5
"""How much further from the middle than the furthest trained row a sample may be."""
SPIKE_MARGIN: Final = 3.0
"""How much faster than ever in training a signal may change."""
BRIEFLY: Final = 3.0
"""How many times as fast as that a measured position may move within one training time step."""
JUMP_MARGIN: Final = 3.0
"""Of what training shows beside smooth motion, how much more a measured position may jump."""
SLIP_SHARE: Final = 0.5
"""Of what it may change by, how much a measured position may still differ when it comes back from
a jump: one that slipped stays a jump until the whole of that has grown to it."""
AT_ONCE: Final = 2.0 / 3.0
"""Share of its largest change by which a jumping position's neighbouring changes differ. A jump is
three times the largest change of training or more, and what follows it no more than one."""
PARITY_MARGIN: Final = 2.0
"""How much further than in training a parity equation may be from its middle."""
SETPOINT_MARGIN: Final = 4.0
"""The same with a set point, which a joint follows the later the faster it moves: motion at random
after a zig-zag in which a joint hardly moved reached 2.5 times what that had shown (12 twins)."""
PARITY_FLOOR: Final = 0.02
"""Share of a joint's trained range of errors that it may be off by at least: less is no matter."""
PARITY_STEPS: Final = 3.0
"""Training time steps for which it may be further off before the zero is suspect for good."""
FROZEN_MARGIN: Final = 3.0
"""How much longer, or further past its partner, than in training a signal may stand still."""
FROZEN_TRAVEL: Final = 0.25
"""Share of its trained range that the partner of a signal may move at least meanwhile."""
FROZEN_STEPS: Final = 30.0
"""Training time steps for which all signals may stand still at least: 1 s at 30 Hz."""
ERROR_MARGIN: Final = 0.5
"""Share of the trained range of errors by which a correction may lie outside."""
PACE_MARGIN: Final = 1.4
"""How many times as fast, or as slow, as ever in training an arm is that moves unlike it."""
LOAD_TURNS: Final = 0.5
"""Share of its trained range by which a load may turn a joint off what its motor says."""
SHORTEST_STEP: Final = 1e-3
"""Share of the training time step below which two stamps are one.

Where features (`lag`) or the estimator count samples it is 1 / `MAX_RATE_RATIO`: such a model knows
no faster rate.
"""
RATE_STEPS: Final = 32.0
"""Over how many samples it is judged whether a loop is slower than a model knows: most of them come
later than `MAX_RATE_RATIO` times the training time step where it counts samples, `MAX_STEPS` times
where it remembers otherwise, as in a recording that is refused."""

Limits = SimpleNamespace
_ROUNDING: Final = 1e-9


def limits_of(data: Calibration, range_margin: float = RANGE_MARGIN) -> Limits:
    """Thresholds for samples of a calibration; `range_margin` (0 to 1) is for `RANGE_MARGIN`.

    They are fields of a corrector's memory (`runtime.fields`), in SI units. A threshold is infinite
    where a sample cannot break it: `travel` for a signal without a partner that changes with it,
    ``signal_lower`` for one that is no position and never changed.

    Raises CalibrationError if it is out of range, and ModelFileError if the calibration was made
    without the training domain.
    """
    if not 0.0 <= range_margin <= REJECT_MARGIN:
        raise CalibrationError(
            f"range margin {range_margin!r:.60} is not a share of the trained range from 0 to "
            f"{REJECT_MARGIN:g}"
        )
    domain = data.training_domain
    if domain is None:
        raise ModelFileError(
            "the model does not say what its training rows looked like, so samples cannot be "
            "checked; calibrate it again"
        )
    family = data.family
    counts = data.feature_set.counts_samples or family.counts_samples
    shortest = 1.0 / MAX_RATE_RATIO if counts else SHORTEST_STEP
    slowest = MAX_RATE_RATIO if counts else MAX_STEPS if data.looks_back else np.inf
    low, high = domain.signal_lower, domain.signal_upper
    moves = high > low
    signals = data.loop_signals
    partner = partners(signals)
    watched = moves & (partner >= 0) & moves[partner]
    partner = np.where(watched, partner, np.arange(len(signals)))
    is_position = np.array([signal.startswith("measured/") for signal in signals])
    reach = np.where(moves, SPIKE_MARGIN * domain.signal_step, np.inf)
    jump = np.where(is_position, np.minimum(JUMP_MARGIN * domain.signal_bend, reach), reach)
    allowed = np.maximum(FROZEN_TRAVEL, FROZEN_MARGIN * domain.signal_travel)
    lower, upper = _widened(low, high, REJECT_MARGIN)
    # How far positions that stood in training may move; other signals do as they like.
    units = np.array([data.units.get(name, "") for name in signals])
    held = np.full(len(signals), np.inf)
    for i in np.flatnonzero(is_position & ~moves):
        alike = is_position & moves & (units == units[i])
        held[i] = HELD_MARGIN * np.min((high - low)[alike], initial=np.inf)
    used = varies(data.lower, data.upper)
    feature_lower, feature_upper = _widened(data.lower, data.upper, range_margin)
    distance = DISTANCE_MARGIN * domain.distance
    correction_lower, correction_upper = believable_corrections(domain)
    hold = max(FROZEN_MARGIN * domain.hold, FROZEN_STEPS * domain.dt)
    if family.bears_load(data.fitted.params):
        # It holds a load as still as its encoders' counts show, for as long as it takes.
        distance = hold = np.inf
        turned = LOAD_TURNS * (high - low)[[signals.index(f"measured/{j}") for j in data.joints]]
        correction_lower, correction_upper = correction_lower - turned, correction_upper + turned
    return Limits(
        shortest=shortest * domain.dt,
        slowest=slowest * domain.dt,
        longest=data.gap_limit,
        training_dt=domain.dt,
        hold=hold,
        square=distance * distance,
        reach=reach,
        jump=jump,
        flicker=domain.signal_flicker,
        signal_lower=np.where(moves, lower, low - held),
        signal_upper=np.where(moves, upper, high + held),
        partner=partner,
        travel=np.where(watched, allowed * (high - low)[partner], np.inf),
        moves=moves.astype(np.int64),
        is_position_signal=is_position.astype(np.int64),
        **_parity(data, domain),
        stride=domain.stride,
        pace_lower=domain.pace_lower / PACE_MARGIN,
        pace_upper=PACE_MARGIN * domain.pace_upper or np.inf,
        swing_lower=domain.swing_lower,
        cells=CELLS / np.maximum(domain.swing_upper - domain.swing_lower, _ROUNDING),
        swings=domain.swings,
        patience=PARITY_STEPS * domain.dt,
        domain_mean=domain.feature_mean,
        # The length of a whitened row is all that counts, so a triangular factor does as well.
        whitening=padded(np.asarray(np.linalg.qr(domain.whitening, mode="r")).T, axes=2),
        feature_lower=np.where(used, feature_lower, -np.inf),
        feature_upper=np.where(used, feature_upper, np.inf),
        correction_lower=correction_lower,
        correction_upper=correction_upper,
    )


def _parity(data: Calibration, domain: TrainingDomain) -> dict[str, Any]:
    """Parity equations with their bounds; one that says nothing where there are none."""
    equations = data.parity
    matrix, intercept = np.zeros((1, len(data.loop_signals))), np.zeros(1)
    middle, half = np.zeros(1), np.full(1, np.inf)
    if equations is not None:
        matrix, intercept = equations.matrix, equations.intercept
        errors = (domain.error_upper - domain.error_lower)[equations.joint.astype(int)]
        middle = 0.5 * (equations.lower + equations.upper)
        setpoints = [column.startswith("setpoint/") for column in data.loop_signals]
        late = (matrix[:, setpoints] != 0.0).any(axis=1)
        margin = np.where(late, SETPOINT_MARGIN, PARITY_MARGIN)
        half = margin * (equations.upper - middle) + PARITY_FLOOR * errors
    used = matrix != 0.0
    n_terms = max(int(used.sum(axis=1).max()), 1)
    terms = np.argsort(~used, axis=1, kind="stable")[:, :n_terms]
    return {
        "parity": np.take_along_axis(matrix, terms, axis=1), "parity_terms": terms,
        "parity_intercept": intercept, "parity_lower": middle - half,
        "parity_upper": middle + half,
    }  # fmt: skip


def believable_corrections(domain: TrainingDomain) -> tuple[Array, Array]:
    """Range (n_joints,), (n_joints,) of corrections [rad or m] outside which none is believed."""
    return _widened(domain.error_lower, domain.error_upper, ERROR_MARGIN)


def _widened(lower: Array, upper: Array, margin: float) -> tuple[Array, Array]:
    """Range widened by a share of itself, and by rounding, at either end."""
    extra = margin * (upper - lower) + _ROUNDING * np.maximum(np.abs(lower), np.abs(upper))
    return lower - extra, upper + extra
