"""What the training rows looked like: the measure by which a control loop judges its samples."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from truejoint.array_types import Array, Integers, Mask
from truejoint.calibration.conditions import learn_motion
from truejoint.compiled import compiled

if TYPE_CHECKING:
    from truejoint.features.feature_set import FeatureSet
    from truejoint.recordings import Recording


SMALLEST_VARIANCE: Final = 1e-4  # of standardised features in any direction; less counts as this
FLICKER: Final = 0.1
"""Share of its own noise within which a signal stands still: a sensor that works flickers more, or,
where its counts are coarse, not at all."""
RESTING: Final = 0.2
"""Share of the longest range of a measured position, in the same unit, below which a joint that is
not corrected rests: cables, friction and its homing move it, no command. Where it stands beside the
others says little, and is new after each homing; how far it may go is said by its range alone."""

_MEDIAN_OF_NORMAL: Final = 0.6745  # absolute value, in standard deviations


@dataclass(frozen=True, eq=False)
class TrainingDomain:
    """Bounds of the training rows, all observed, none assumed."""

    dt: float  # median time between rows [s]
    signal_lower: Array  # (n_signals,), range of each signal that is needed, in its unit
    signal_upper: Array
    signal_step: Array  # (n_signals,), largest change from one row to the next
    signal_bend: Array  # (n_signals,), largest change of that change: noise, counts, reversals
    signal_flicker: Array  # (n_signals,), change below which a signal stands still
    # (n_signals,), largest share of its range that the partner of a signal (`partners`) moved while
    # the signal itself stood still
    signal_travel: Array
    hold: float  # longest time for which no signal changed [s]
    feature_mean: Array  # (k,)
    # (k, k), makes features less their mean uncorrelated and of unit variance; zero where a feature
    # never changed, or is of a joint that rested
    whitening: Array
    distance: float  # largest length of a whitened row
    error_lower: Array  # (n_joints,), range of truth minus measured [rad or m]
    error_upper: Array
    stride: Array  # (n_joints,), way that counts as a step, or as a turn back [rad or m]
    pace_lower: float  # least time of a step of the arm, averaged (`follow_motion`) [s]
    pace_upper: float  # 0 where it was never that long in motion
    swing_lower: Array  # (n_joints,), range of each measured position [rad or m]
    swing_upper: Array
    swings: Array  # (n_joints, CELLS ** 2), 1 for the last turning points, and those near them


def fit_training_domain(
    recordings: "Sequence[Recording]",
    signals: Sequence[str],
    gap_limit: float,
    features: Array,
    error: Array,
    resting: Mask,
    joints: Sequence[str],
) -> TrainingDomain:
    """Training domain of recordings: of the columns `signals`, and of the rows with truth.

    Those have the features (n, k) and the `error` (n, n_joints) [rad or m], truth minus measured;
    no change is looked at across `gap_limit` [s] without a row. `resting` are `resting_features`,
    `joints` those that are corrected.
    """
    columns = ([recording.column(signal) for signal in signals] for recording in recordings)
    tables = [np.ascontiguousarray(np.column_stack(arrays)) for arrays in columns]
    times = [np.array(recording.t) for recording in recordings]
    together = np.concatenate(tables)
    lower, upper = together.min(axis=0), together.max(axis=0)
    joined = [np.diff(t) <= gap_limit for t in times]  # no difference is across a gap
    bends = np.concatenate(
        [
            np.abs(np.diff(table, 2, axis=0))[near[1:] & near[:-1]]
            for near, table in zip(joined, tables, strict=True)
        ]
    )
    # White noise with such second differences; rows without a change say nothing of it.
    changed = [column[column > 0.0] for column in bends.T]
    usual = np.array([np.median(column) if len(column) else 0.0 for column in changed])
    flicker = FLICKER * (usual / (_MEDIAN_OF_NORMAL * np.sqrt(6.0)))
    step, travel, hold = np.zeros(len(signals)), np.zeros(len(signals)), np.zeros(1)
    moves, partner = upper > lower, partners(signals)
    for t, table in zip(times, tables, strict=True):
        watch_changes(t, table, gap_limit, moves, partner, flicker, step, travel, hold)
    at = [signals.index(f"measured/{joint}") for joint in joints]
    positions = [np.ascontiguousarray(table[:, at]) for table in tables]
    span = np.where(moves, upper - lower, 1.0)
    mean = features.mean(axis=0)
    used = varies(features.min(axis=0), features.max(axis=0)) & ~resting
    inverse = np.divide(1.0, features.std(axis=0), out=np.zeros(len(mean)), where=used)
    scaled = (features - mean) * inverse
    variance, directions = np.linalg.eigh(scaled.T @ scaled / len(scaled))
    weight = 1.0 / np.sqrt(np.maximum(variance, SMALLEST_VARIANCE))
    whitening = np.ascontiguousarray((directions * weight).T * inverse)
    return TrainingDomain(
        dt=float(np.median(np.concatenate([np.diff(t) for t in times]))),
        signal_lower=lower,
        signal_upper=upper,
        signal_step=step,
        signal_bend=bends.max(axis=0, initial=0.0),
        signal_flicker=flicker,
        signal_travel=travel / span[partner],
        hold=float(hold[0]),
        feature_mean=mean,
        whitening=whitening,
        distance=float(np.linalg.norm((features - mean) @ whitening.T, axis=1).max()),
        error_lower=error.min(axis=0),
        error_upper=error.max(axis=0),
        **learn_motion(times, positions, gap_limit, flicker[at] / FLICKER),
    )


def resting_features(
    recordings: "Sequence[Recording]",
    feature_set: "FeatureSet",
    joints: Sequence[str],
    units: Mapping[str, str],
) -> Mask:
    """Which features (k,) are of joints that rest (`RESTING`) in recordings, none of `joints`.

    `units` has that of each column that all of them have.
    """
    measured = [name for name in units if name.startswith("measured/")]
    positions = ([recording.column(name) for recording in recordings] for name in measured)
    ways = np.array([np.ptp(np.concatenate(arrays)) for arrays in positions])
    unit_of = np.array([units[name] for name in measured])
    channels = [name.partition("/")[2] for name in measured]
    longest = np.array([ways[unit_of == unit].max() for unit in unit_of])
    rests = ways < RESTING * longest
    resting = {c for c, is_resting in zip(channels, rests, strict=True) if is_resting} - set(joints)
    return np.array([f.signal.partition("/")[2] in resting for f in feature_set.features])


def partners(signals: Sequence[str]) -> Integers:
    """Index (n_signals,) of the next signal of the same channel, round and round; -1 if alone.

    Position and effort of a joint are partners: neither rests for long while the other moves far.
    """
    numbers: dict[str, list[int]] = {}
    for i, signal in enumerate(signals):
        numbers.setdefault(signal.partition("/")[2], []).append(i)
    partner = np.full(len(signals), -1, dtype=np.int64)
    for alike in numbers.values():
        if len(alike) > 1:
            partner[alike] = np.roll(alike, -1)
    return partner


@compiled
def watch_changes(
    t: Array,
    table: Array,
    gap_limit: float,
    varies: NDArray[np.bool_],
    partner: Integers,
    flicker: Array,
    step: Array,
    travel: Array,
    hold: Array,
) -> None:
    """Enlarge `step`, `travel` (n_signals,) and `hold` (1,) to what the rows of a table show.

    `travel` is in the unit of the partner here. `t` (n,), `table` (n, n_signals), `varies`,
    `partner` and `flicker` (n_signals,).
    """
    n_signals = table.shape[1]
    stood = np.empty(n_signals)  # where a signal stands, since its last change
    low, high = np.empty(n_signals), np.empty(n_signals)  # partner's range since then
    still_since = 0
    for row in range(table.shape[0]):
        fresh = row == 0 or not t[row] - t[row - 1] <= gap_limit
        changed = fresh
        for i in range(n_signals):
            other = table[row, partner[i]]
            if fresh or abs(table[row, i] - stood[i]) > flicker[i]:
                stood[i] = table[row, i]
                low[i] = high[i] = other
                changed = changed or varies[i]
            low[i], high[i] = min(low[i], other), max(high[i], other)
            if varies[i] and partner[i] >= 0:
                travel[i] = max(travel[i], high[i] - low[i])
            if not fresh:
                step[i] = max(step[i], abs(table[row, i] - table[row - 1, i]))
        if changed:
            still_since = row
        hold[0] = max(hold[0], t[row] - t[still_since])


def varies(lower: Array, upper: Array) -> Mask:
    """Whether features with such bounds (k,) changed by more than rounding."""
    return np.asarray(upper - lower > 1e-9 * np.maximum(np.abs(lower), np.abs(upper)))
