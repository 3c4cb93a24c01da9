"""Banks of play operators (Prandtl-Ishlinskii) on displacements of cables: a weighted sum."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled, vector
from truejoint.estimators.family import (
    Family,
    Params,
    Rule,
    Shape,
    integer,
    number,
    numbers,
    only_joint,
)
from truejoint.estimators.jaw.signals import DRIVE, MECHANISM_RULES, MOTOR, RESET
from truejoint.estimators.products import weighted
from truejoint.features.kernels import play
from truejoint.layout import Layout, Memory

POWERS: Final = 4
"""Highest power of a displacement, by default."""
RESET_WIDTHS: Final = (3e-6, 6e-6, 12e-6, 25e-6, 50e-6, 100e-6, 200e-6)
"""Half-widths of the plays on ``x2`` [m]: the slider's presliding and the cable's hysteresis."""
DRIVE_WIDTHS: Final = (5e-6, 10e-6, 20e-6, 40e-6, 80e-6, 150e-6, 250e-6, 400e-6, 600e-6)
"""Half-widths of the plays on ``x1`` [m], wider by what the jaw's friction stretches the cable."""
DISPLACEMENTS: Final = {"motor": MOTOR, "drive": DRIVE, "reset": RESET}
"""What a bank can stand on, in the order of the features: ``x1`` by the motor or by an encoder on
the drive cable, and ``x2`` by an encoder on the reset cable."""

LAYOUT: Final = Layout()
N_BANKS: Final = LAYOUT.integer("n_banks", "displacements")
DEGREE: Final = LAYOUT.integer("degree", "highest power of a displacement")
N_PRODUCTS: Final = LAYOUT.integer("n_products", "of plays with the first displacement")
N_COLUMNS: Final = LAYOUT.integer("n_columns", "powers, plays and products")
CONSTANT: Final = LAYOUT.scalar("constant", "of the sum [rad]")
FACTOR: Final = LAYOUT.array("factor", "displacement of each bank per feature")
SCALE: Final = LAYOUT.array("scale", "inverse largest displacement of each bank [1/m]")
WIDTHS: Final = LAYOUT.array("widths", "half-widths of the plays [m]")
WEIGHTS: Final = LAYOUT.array("weights", "of the columns [rad]")
PLAYS: Final = LAYOUT.array("plays", "outputs of the plays [m]")
COLUMNS: Final = LAYOUT.array("columns", "of one row: powers and plays of each bank, products")
FEATURE: Final = LAYOUT.integers("feature", "that each bank stands on")
FIRST_PLAY: Final = LAYOUT.integers("first_play", "of each bank")
COUNT: Final = LAYOUT.integers("count", "plays of each bank")
FIRST_COLUMN: Final = LAYOUT.integers("first_column", "of each bank")
PAIRS: Final = LAYOUT.integers("pairs", "columns that the first is multiplied by")


@compiled
def play_row(
    numbers: Integers, memory: Array, dt: float, x: Array, out: Array, half_width: Array
) -> None:
    """Predict by banks of plays."""
    out[0] = weigh_banks(numbers, memory, dt == 0.0, x)


@compiled
def weigh_banks(numbers: Integers, memory: Array, fresh: bool, x: Array) -> float:
    """Weighted sum of powers, plays and products; `fresh`: their history starts here."""
    degree, n_columns, n_products = numbers[DEGREE], numbers[N_COLUMNS], numbers[N_PRODUCTS]
    n_banks = numbers[N_BANKS]
    factor = vector(memory, numbers[FACTOR], n_banks)
    scale = vector(memory, numbers[SCALE], n_banks)
    columns = vector(memory, numbers[COLUMNS], n_columns)
    for i in range(n_banks):
        first = numbers[numbers[FIRST_PLAY] + i]
        count = numbers[numbers[COUNT] + i]
        column = numbers[numbers[FIRST_COLUMN] + i]
        value = x[numbers[numbers[FEATURE] + i]] * factor[i]
        raise_powers(value * scale[i], vector(columns, column, degree))
        follow(
            fresh,
            value,
            vector(memory, numbers[WIDTHS] + first, count),
            vector(memory, numbers[PLAYS] + first, count),
            vector(columns, column + degree, count),
        )
    products = n_columns - n_products
    for i in range(n_products):
        columns[products + i] = columns[0] * columns[numbers[numbers[PAIRS] + i]]
    total: float = weighted(columns, vector(memory, numbers[WEIGHTS], n_columns))
    total += memory[CONSTANT]
    return total


@compiled
def raise_powers(value: float, out: Array) -> None:
    """Powers of a value from the first on."""
    power = 1.0
    for i in range(out.shape[0]):
        power *= value
        out[i] = power


@compiled
def follow(fresh: bool, value: float, widths: Array, plays: Array, out: Array) -> None:
    """How far a value [m] stands in the dead band of each play operator (k,), from -1 to 1.

    Where the history is `fresh`, every play is in the middle of its band. `plays` (k,) change.
    """
    for i in range(widths.shape[0]):
        plays[i] = play(widths[i], fresh, value, plays[i])
        out[i] = (value - plays[i]) / widths[i]


@compiled
def bank_columns(dt: Array, values: Array, scale: float, widths: Array, out: Array) -> None:
    """Powers of displacements (n,) [m] by `scale` and plays on them, into `out` (n, degree + k)."""
    plays = np.zeros(widths.shape[0])
    degree = out.shape[1] - widths.shape[0]
    for i in range(values.shape[0]):
        raise_powers(values[i] * scale, out[i, :degree])
        follow(dt[i] == 0.0, values[i], widths, plays, out[i, degree:])


def inputs(params: Params) -> tuple[str, ...]:
    """Features of the displacements asked for."""
    return tuple(f for name, f in DISPLACEMENTS.items() if name in params["displacements"])


def bank_widths(params: Params) -> list[Array]:
    """Half-widths (k,) of each bank [m], in the order of `displacements`."""
    return [
        np.array(params["reset_widths" if name == "reset" else "drive_widths"], dtype=np.float64)
        for name in params["displacements"]
    ]


def bank_factors(params: Params) -> list[float]:
    """Displacement of each bank per feature: (2) and (3) of yan2020 for the motor's angle."""
    geared = params["wheel_radius"] / params["gear_ratio"]
    return [geared if name == "motor" else 1.0 for name in params["displacements"]]


def product_pairs(degree: int, counts: Sequence[int]) -> list[int]:
    """Columns (k,) of every other play of each bank: hysteresis that grows with tension."""
    pairs: list[int] = []
    first = 0
    for count in counts:
        first += degree
        pairs += range(first + 1, first + count, 2)
        first += count
    return pairs


def count_columns(degree: int, counts: Iterable[int]) -> int:
    """Count the columns of banks with so many plays: powers, plays, products for every other."""
    return sum(degree + count + count // 2 for count in counts)


def _shapes(params: Params, _n_features: int, n_outputs: int) -> dict[str, Shape]:
    widths = bank_widths(params)
    count = count_columns(int(params["degree"]), [len(w) for w in widths])
    shapes: dict[str, Shape] = {
        "scale": (len(widths),), "weights": (count,), "constant": (1,)
    }  # fmt: skip
    return only_joint("play", shapes, n_outputs)


def pack_banks(params: Params, arrays: Mapping[str, Array], features: Mapping[str, int]) -> Memory:
    """Memory of banks that find each displacement in one of the `features`."""
    degree, widths = int(params["degree"]), bank_widths(params)
    counts = [len(w) for w in widths]
    pairs = product_pairs(degree, counts)
    n_columns = count_columns(degree, counts)
    sizes = [degree + count for count in counts]
    return LAYOUT.pack(
        n_banks=len(widths),
        degree=degree,
        n_products=len(pairs),
        n_columns=n_columns,
        **arrays,
        factor=bank_factors(params),
        widths=np.concatenate(widths),
        plays=np.zeros(sum(counts)),
        columns=np.zeros(n_columns),
        feature=[features[name] for name in params["displacements"]],
        first_play=np.cumsum([0, *counts[:-1]]),
        count=counts,
        first_column=np.cumsum([0, *sizes[:-1]]),
        pairs=pairs,
    )


def _pack(params: Params, arrays: Mapping[str, Array], _k: int, _n: int) -> Memory:
    names = [name for name in DISPLACEMENTS if name in params["displacements"]]
    return pack_banks(params, arrays, {name: i for i, name in enumerate(names)})


def _are_displacements(value: object) -> bool:
    return (
        isinstance(value, (tuple, list))
        and 1 <= len(value) <= 2
        and len(set(value)) == len(value)
        and set(value) <= set(DISPLACEMENTS)
    )


_WIDTH_RULE: Final = numbers(64, 1e-9, 1.0, "half-widths [m]")

FAMILY: Final = Family(
    "plays.jaw_bank",
    rules={
        "displacements": Rule(_are_displacements, f"one or two of {', '.join(DISPLACEMENTS)}"),
        "degree": integer(1, 8),
        "reset_widths": _WIDTH_RULE,
        "drive_widths": _WIDTH_RULE,
        "penalty": number(0.0, 1e12),
        **{name: MECHANISM_RULES[name] for name in ("gear_ratio", "wheel_radius")},
    },
    shapes=_shapes,
    pack=_pack,
    row=play_row,
    remembers=True,
    inputs=inputs,
    targets=("position", "error"),
    bears_load=lambda params: tuple(params["displacements"]) == ("reset",),
)
