"""Banks of play operators on the forceps' displacements: their columns and default widths."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from truejoint.models import jaw_kernels as kernels

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

POWERS: Final = 4
"""Highest power of a displacement, by default."""
RESET_WIDTHS: Final = (3e-6, 6e-6, 12e-6, 25e-6, 50e-6, 100e-6, 200e-6)
"""Half-widths of the plays on ``x2`` [m]: the slider's presliding and the cable's hysteresis."""
MOTOR_WIDTHS: Final = (5e-6, 10e-6, 20e-6, 40e-6, 80e-6, 150e-6, 250e-6, 400e-6, 600e-6)
"""Half-widths of the plays on ``x1`` [m], wider by what the jaw's friction stretches the cable."""

BANK_WIDTHS: Final[Mapping[str, tuple[str, ...]]] = {
    "play_reset": ("reset_widths",),
    "play_motor": ("motor_widths",),
    "play_both": ("reset_widths", "motor_widths"),
    "play_cables": ("reset_widths", "drive_widths"),
}
"""Parameters that hold the half-widths of each bank, by family."""


@dataclass(frozen=True, eq=False)
class Bank:
    """Powers of one displacement and plays on it.

    Attributes
    ----------
    scale : float
        Inverse of the largest displacement [1/m].
    degree : int
        Highest power.
    widths : ndarray, shape (k,)
        Half-widths [m].
    """

    scale: float
    degree: int
    widths: Array

    @property
    def size(self) -> int:
        """Number of columns."""
        return self.degree + len(self.widths)

    def compute(self, values: Array, steps: Array) -> Array:
        """Columns (n, size) for displacements (n,) [m] with `steps` (n,) [s] between them."""
        out = np.empty((len(values), self.size))
        kernels.bank_rows(
            steps, np.ascontiguousarray(values), self.scale, self.degree, self.widths, out
        )
        return out


def default_widths(family: str) -> dict[str, Any]:
    """Degree and half-widths of a family that nobody chose others for."""
    known = {"reset_widths": RESET_WIDTHS, "motor_widths": MOTOR_WIDTHS}
    known["drive_widths"] = MOTOR_WIDTHS
    return {"degree": POWERS, **{name: known[name] for name in BANK_WIDTHS[family]}}


def count_columns(degree: int, counts: Iterable[int]) -> int:
    """Count the columns of banks with so many plays: powers, plays, products for every other."""
    return sum(degree + count + count // 2 for count in counts)


def product_pairs(degree: int, counts: Sequence[int]) -> Integers:
    """Columns (k,) of every other play of each bank: hysteresis that grows with tension."""
    pairs: list[int] = []
    first = 0
    for count in counts:
        first += degree
        pairs += range(first + 1, first + count, 2)
        first += count
    return np.array(pairs, dtype=np.int64)
