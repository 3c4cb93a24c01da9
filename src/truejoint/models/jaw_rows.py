"""The jaw's regressions in the loop: least squares (29) and (30) of yan2020, and plays."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from truejoint.compiled import compiled
from truejoint.filters.memory import vector
from truejoint.models import jaw_kernels as kernels
from truejoint.models.families import EstimatorData
from truejoint.models.play_banks import BANK_WIDTHS, default_widths, product_pairs
from truejoint.models.row_model import Array, Integers, RowModel
from truejoint.robots.forceps_mechanism import TABLE_1

_OBSERVED: Final = kernels.OBSERVED
_COEFFICIENTS: Final = kernels.COEFFICIENTS

# `numbers` of least squares: columns of drive and reset cable, and of the motor or -1. `memory`:
# coefficients and constant, the row before, this row, and the error model.
_CONSTANT: Final = _OBSERVED
_LAST: Final = _CONSTANT + 1
_ROW: Final = _LAST + 4
_SCALE: Final = _ROW + _OBSERVED
_ERROR: Final = _SCALE + 2

# `numbers` of plays: where each regression starts in `numbers` and in `memory`, or -1; the gate is
# the first number of `memory`. A regression's own numbers: its banks, their degree, its products,
# then for each bank its column and its plays, then the products' columns. Its memory: constant;
# for each bank factor, scale, half-widths, plays; then the row, and the weights.
_FIRST: Final = 4
_HEADER: Final = 3


@compiled
def least_squares_row(
    numbers: Integers,
    memory: Array,
    interval: float,
    features: Array,
    out: Array,
    half_width: Array,  # noqa: ARG001  # every row function takes the same arguments
) -> None:
    """Predict one row: (29) or (30); arguments as in `row_models.offset_row`."""
    drive, reset, motor = features[numbers[0]], features[numbers[1]], numbers[2]
    row = vector(memory, _ROW, _OBSERVED)
    kernels.observation_row(interval, drive, reset, vector(memory, _LAST, 4), row)
    error = 0.0
    if motor >= 0:
        error = kernels.rational_row(
            features[motor],
            reset,
            vector(memory, _SCALE, 2),
            vector(memory, _ERROR, _COEFFICIENTS),
        )
    out[0] = kernels.weighted(row, vector(memory, 0, _OBSERVED)) + memory[_CONSTANT] - error


@compiled
def sum_on_banks(
    numbers: Integers, memory: Array, at: int, place: int, fresh: bool, features: Array
) -> float:
    """Give the weighted sum of one regression on banks of plays.

    Parameters
    ----------
    numbers, memory : ndarray, 1-D
    at, place : int
        Where the regression starts in `numbers` and in `memory`.
    fresh : bool
        Whether the history starts here.
    features : ndarray, shape (k,)
    """
    n_banks, degree, n_products = numbers[at], numbers[at + 1], numbers[at + 2]
    pairs = at + _HEADER + 2 * n_banks
    n_columns = n_banks * degree + n_products
    first = place + 1
    for i in range(n_banks):
        n_plays = numbers[at + _HEADER + 2 * i + 1]
        n_columns += n_plays
        first += 2 + 2 * n_plays
    row = vector(memory, first, n_columns)
    bank, column = place + 1, 0
    for i in range(n_banks):
        n_plays = numbers[at + _HEADER + 2 * i + 1]
        kernels.bank_row(
            fresh,
            features[numbers[at + _HEADER + 2 * i]] * memory[bank],
            memory[bank + 1],
            degree,
            vector(memory, bank + 2, n_plays),
            vector(memory, bank + 2 + n_plays, n_plays),
            vector(memory, first + column, degree + n_plays),
        )
        bank += 2 + 2 * n_plays
        column += degree + n_plays
    kernels.product_row(
        row, vector(numbers, pairs, n_products), vector(memory, first + column, n_products)
    )
    total: float = memory[place]
    return kernels.weighted(row, vector(memory, first + n_columns, n_columns)) + total


@compiled
def play_row(
    numbers: Integers,
    memory: Array,
    interval: float,
    features: Array,
    out: Array,
    half_width: Array,  # noqa: ARG001
) -> None:
    """Predict one row: plays, gated or not; arguments as in `row_models.offset_row`."""
    fresh = interval == 0.0
    out[0] = sum_on_banks(numbers, memory, numbers[0], numbers[1], fresh, features)
    if numbers[2] >= 0:
        both = sum_on_banks(numbers, memory, numbers[2], numbers[3], fresh, features)
        out[0] += kernels.redescending(both - out[0], memory[0])


def _least_squares(data: EstimatorData, n_features: int, _n_outputs: int) -> RowModel:
    arrays = data.arrays
    with_motor = n_features == 3
    parts = [arrays["coef"], arrays["constant"], np.zeros(4 + _OBSERVED)]
    if with_motor:
        parts += [arrays["scale"], arrays["error_coef"]]
    columns = [1, 2, 0] if with_motor else [0, 1, -1]
    return RowModel(least_squares_row, np.array(columns), np.concatenate(parts))


def _regression(
    family: str, params: Mapping[str, Any], arrays: Mapping[str, Array], columns: Sequence[int]
) -> tuple[list[int], Array]:
    """Numbers and memory of one regression, whose banks see these columns of the features."""
    widths = [np.array(params[name], dtype=np.float64) for name in BANK_WIDTHS[family]]
    degree = int(params["degree"])
    counts = [len(w) for w in widths]
    pairs = product_pairs(degree, counts)
    numbers = [len(widths), degree, len(pairs)]
    parts = [arrays["constant"]]
    for name, column, width, scale in zip(
        BANK_WIDTHS[family], columns, widths, arrays["scale"], strict=True
    ):
        geared = name == "motor_widths"
        factor = params["wheel_radius"] / params["gear_ratio"] if geared else 1.0
        numbers += [column, len(width)]
        parts += [np.array([factor, scale]), width, np.zeros(len(width))]
    parts += [np.zeros(len(arrays["weights"])), arrays["weights"]]
    return [*numbers, *pairs.tolist()], np.concatenate(parts)


def _plays(gate: float, regressions: Sequence[tuple[list[int], Array]]) -> RowModel:
    starts, parts, place = [-1] * _FIRST, [np.array([gate])], 1
    numbers: list[int] = []
    for i, (own, memory) in enumerate(regressions):
        starts[2 * i : 2 * i + 2] = _FIRST + len(numbers), place
        numbers += own
        parts.append(memory)
        place += len(memory)
    return RowModel(play_row, np.array([*starts, *numbers], dtype=np.int64), np.concatenate(parts))


# Columns of the features, in the order of each family's banks: the reset cable's first.
_COLUMNS: Final = {
    "play_reset": (0,), "play_motor": (0,), "play_both": (1, 0), "play_cables": (1, 0),
}  # fmt: skip


def _play(data: EstimatorData, _n_features: int, _n_outputs: int) -> RowModel:
    part = _regression(data.family, data.params, data.arrays, _COLUMNS[data.family])
    return _plays(0.0, [part])


def _gated(data: EstimatorData, _n_features: int, _n_outputs: int) -> RowModel:
    def part(family: str, prefix: str, columns: Sequence[int]) -> tuple[list[int], Array]:
        gear = {"gear_ratio": TABLE_1.gear_ratio, "wheel_radius": TABLE_1.wheel_radius}
        own = {k.removeprefix(prefix): a for k, a in data.arrays.items() if k.startswith(prefix)}
        return _regression(family, default_widths(family) | gear, own, columns)

    regressions = [part("play_reset", "reset_", (1,)), part("play_both", "both_", (1, 0))]
    return _plays(float(data.arrays["gate_angle"][0]), regressions)


REGRESSIONS: Final[Mapping[str, Callable[[EstimatorData, int, int], RowModel]]] = {
    "lsm": _least_squares,
    "lsm_intercept": _least_squares,
    "lsm_compensated": _least_squares,
    **dict.fromkeys(BANK_WIDTHS, _play),
    "play_gated": _gated,
}
"""Builders for `row_models.BUILDERS`."""
