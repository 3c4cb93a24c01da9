"""SI inside, people's units at the edge: those that files may be in, and those that are shown."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

GRAVITY: Final = 9.81
"""Acceleration of a hanging mass [m/s2]."""

FACTORS: Final[Mapping[str, Mapping[str, float]]] = {
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "rad": {"rad": 1.0, "deg": math.pi / 180.0},
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6},
    "rad/s": {"rad/s": 1.0, "deg/s": math.pi / 180.0, "rpm": math.pi / 30.0},
    "m/s": {"m/s": 1.0, "mm/s": 1e-3},
    "Nm": {"Nm": 1.0, "mNm": 1e-3},
    "N": {"N": 1.0, "mN": 1e-3},
    "A": {"A": 1.0, "mA": 1e-3},
    "V": {"V": 1.0},
    "1": {"1": 1.0},
}
"""By SI unit, the units that a file may be in, and the factor from each."""

SI_UNITS: Final[Mapping[str, tuple[str, float]]] = {
    unit: (si, factor) for si, factors in FACTORS.items() for unit, factor in factors.items()
}
"""Unit in a file: SI unit and the factor to it."""


@dataclass(frozen=True)
class DisplayUnit:
    """How an SI unit is shown: multiply an SI value by `scale` to get it in `name`."""

    name: str
    scale: float


_DISPLAY: Final[dict[str, DisplayUnit]] = {
    "rad": DisplayUnit("deg", 180.0 / math.pi),
    "rad/s": DisplayUnit("deg/s", 180.0 / math.pi),
    "m": DisplayUnit("mm", 1e3),
    "m/s": DisplayUnit("mm/s", 1e3),
}


def display_unit(unit: str) -> DisplayUnit:
    """Find the unit in which a quantity in `unit` (SI, such as ``"rad/s"``) is shown to a person.

    These are degrees for radians and millimetres for metres; any other unit is shown as it is.
    """
    return _DISPLAY.get(unit, DisplayUnit(unit, 1.0))


def plural(count: int, word: str) -> str:
    """Write a number and its noun."""
    return f"{count} {word}{'s' if count != 1 else ''}"


def with_unit(value: float, unit: str) -> str:
    """Write an SI value for a person: three decimals in the unit of `display_unit`, "-" for NaN."""
    if math.isnan(value):
        return "-"
    display = display_unit(unit)
    return f"{value * display.scale:.3f} {display.name}"


def shown(value: float, unit: str) -> str:
    """Quantity in `unit` (SI) as a person reads it."""
    display = display_unit(unit)
    return f"{value * display.scale:.4g} {display.name}"


def shown_range(low: float, high: float, unit: str) -> str:
    """Range in `unit` (SI) as a person reads it."""
    display = display_unit(unit)
    return f"[{low * display.scale:.4g}, {high * display.scale:.4g}] {display.name}"
