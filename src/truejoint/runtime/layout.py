"""The memory of a corrector: two flat arrays, so that a call from Python stays cheap.

`numbers` holds sizes, switches and where each block of `memory` starts; the fields of both, and the
blocks, are named here. What a check compares with is in `Limits`.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import accumulate, count
from typing import Final

import numpy as np
from numpy.typing import NDArray

from truejoint.calibration.encoding import CalibrationData
from truejoint.calibration.interval import inverse_span
from truejoint.models.families import EstimatorData
from truejoint.runtime.limits import Limits

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

# Fields of `numbers`.
N_SIGNALS: Final = 0
N_FEATURES: Final = 1
N_JOINTS: Final = 2
IS_POSITION: Final = 3  # 1: the model predicts the position, 0: the error
HOMING: Final = 4  # status bits of the homing
FUNCTION: Final = 5  # address of the row function
HAS_STAMP: Final = 6  # whether there was a sample
HAS_REFERENCE: Final = 7  # whether a sample was used
_BLOCKS: Final = 8

# Fields of `memory`.
T: Final = 0  # stamp of this sample [s]
STAMP: Final = 1  # of the last sample with a usable one [s]
REFERENCE_T: Final = 2  # of the last sample that was used [s]
CHANGED_T: Final = 3  # when any signal last changed [s]
SHORTEST: Final = 4
LONGEST: Final = 5
INTERVAL: Final = 6
HOLD: Final = 7
DISTANCE: Final = 8
GROWTH: Final = 9
_SCALARS: Final = 10

_block = count(_BLOCKS)
# Blocks of `memory` with a number for each signal; numbers[BLOCK] is where one starts.
SAMPLE: Final = next(_block)
REFERENCE: Final = next(_block)  # last sample that was used
LATEST: Final = next(_block)  # last sample that could be believed
PARTNER_LOW: Final = next(_block)  # range of the partner since the signal last changed
PARTNER_HIGH: Final = next(_block)
REACH: Final = next(_block)
SIGNAL_LOWER: Final = next(_block)
SIGNAL_UPPER: Final = next(_block)
TRAVEL: Final = next(_block)
# For each feature.
FEATURES: Final = next(_block)
PARAMETER: Final = next(_block)
CENTRED: Final = next(_block)
WHITE: Final = next(_block)
MEAN: Final = next(_block)
FEATURE_LOWER: Final = next(_block)
FEATURE_UPPER: Final = next(_block)
TRAINED_LOWER: Final = next(_block)
TRAINED_UPPER: Final = next(_block)
PER_SPAN: Final = next(_block)
# For each joint.
POSITION: Final = next(_block)
HALF_WIDTH: Final = next(_block)
CORRECTION: Final = next(_block)
OFFSET: Final = next(_block)
PREDICTED: Final = next(_block)
PREDICTED_WIDTH: Final = next(_block)
BASE_WIDTH: Final = next(_block)
CORRECTION_LOWER: Final = next(_block)
CORRECTION_UPPER: Final = next(_block)
# Others.
WHITENING: Final = next(_block)
FEATURE_MEMORY: Final = next(_block)
CLOCK: Final = next(_block)
# Blocks of `numbers` itself.
PARTNER: Final = next(_block)
MOVES: Final = next(_block)
OPERATION: Final = next(_block)
SOURCE: Final = next(_block)
SLOT: Final = next(_block)
MEASURED: Final = next(_block)
_HEADER: Final = next(_block)


def pack(
    data: CalibrationData[EstimatorData], limits: Limits, level: float
) -> tuple[Integers, Array]:
    """Memory of a corrector before its first sample, but for `FUNCTION` and `HOMING`.

    Parameters
    ----------
    data : CalibrationData
    limits : Limits
    level : float
        Which half-widths of the interval to use, where there is one.

    Returns
    -------
    numbers : ndarray of int, 1-D
    memory : ndarray, 1-D
    """
    operation, source, parameter, slot = data.feature_set.program
    measured = [data.signals.index(f"measured/{joint}") for joint in data.joints]
    per_joint, per_signal = np.zeros(len(data.joints)), np.zeros(len(data.signals))
    per_feature = np.zeros(len(data.feature_set))
    base, growth = _widths(data, level)
    blocks = {
        SAMPLE: per_signal, REFERENCE: per_signal, LATEST: per_signal, PARTNER_LOW: per_signal,
        PARTNER_HIGH: per_signal, REACH: limits.reach, SIGNAL_LOWER: limits.signal_lower,
        SIGNAL_UPPER: limits.signal_upper, TRAVEL: limits.travel, FEATURES: per_feature,
        PARAMETER: parameter, CENTRED: per_feature, WHITE: per_feature, MEAN: limits.mean,
        FEATURE_LOWER: limits.feature_lower, FEATURE_UPPER: limits.feature_upper,
        TRAINED_LOWER: data.lower, TRAINED_UPPER: data.upper,
        PER_SPAN: inverse_span(data.lower, data.upper), POSITION: np.full_like(per_joint, np.nan),
        HALF_WIDTH: np.full_like(per_joint, np.inf), CORRECTION: np.full_like(per_joint, np.nan),
        OFFSET: per_joint, PREDICTED: per_joint, PREDICTED_WIDTH: per_joint, BASE_WIDTH: base,
        CORRECTION_LOWER: limits.correction_lower, CORRECTION_UPPER: limits.correction_upper,
        WHITENING: limits.whitening.ravel(), FEATURE_MEMORY: data.feature_set.start().memory,
        CLOCK: np.zeros(2),
    }  # fmt: skip
    lists = {
        PARTNER: limits.partner, MOVES: limits.moves, OPERATION: operation, SOURCE: source,
        SLOT: slot, MEASURED: np.array(measured, dtype=np.int64),
    }  # fmt: skip
    header = np.zeros(_HEADER, dtype=np.int64)
    header[[N_SIGNALS, N_FEATURES, N_JOINTS]] = len(per_signal), len(per_feature), len(per_joint)
    header[IS_POSITION] = data.target == "position"
    header[list(blocks)] = _starts(_SCALARS, blocks.values())
    header[list(lists)] = _starts(_HEADER, lists.values())
    scalars = np.zeros(_SCALARS)
    scalars[[SHORTEST, LONGEST, INTERVAL]] = (
        limits.shortest_step, limits.longest_step, limits.interval,
    )  # fmt: skip
    scalars[[HOLD, DISTANCE, GROWTH]] = limits.hold, limits.distance, growth
    return np.concatenate([header, *lists.values()]), np.concatenate([scalars, *blocks.values()])


def block(numbers: Integers, memory: Array, start: int, length: int) -> Array:
    """View of the first `length` numbers of a block of `memory`."""
    return memory[numbers[start] : numbers[start] + length]


def _starts(first: int, parts: Iterable[Array | Integers]) -> list[int]:
    return list(accumulate((len(part) for part in parts), initial=first))[:-1]


def _widths(data: CalibrationData[EstimatorData], level: float) -> tuple[Array, float]:
    """Half-width (n_joints,) [rad or m] within the trained range, and how fast it grows outside."""
    if data.interval is None:
        return np.full(len(data.joints), np.inf), 0.0
    return data.interval.half_width(level), data.interval.growth
