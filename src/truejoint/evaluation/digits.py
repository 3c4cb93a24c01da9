"""How many digits a number deserves where a person reads it."""

from __future__ import annotations

import math
from collections.abc import Iterable


def decimals_for(values: Iterable[float], most: int = 3) -> int:
    """Decimals that show the smallest of `values` with three digits, or two beyond `most`.

    Values beside each other share their decimals, so that a column can be compared at a glance;
    values that are zero or not finite do not count.
    """
    sizes = [abs(v) for v in values if math.isfinite(v) and v != 0.0]
    if not sizes:
        return 2
    exponent = math.floor(math.log10(min(sizes)))
    return min(max(2 - exponent, 0), max(most, 1 - exponent), 9)


def shown(values: Iterable[float], most: int = 3) -> list[str]:
    """Numbers as text with shared decimals; a dash where there is none."""
    numbers = list(values)
    decimals = decimals_for(numbers, most)
    return [fixed(v, decimals) for v in numbers]


def fixed(value: float, decimals: int) -> str:
    """`value` with `decimals` decimals, an en dash for NaN, never a negative zero."""
    if not math.isfinite(value):
        return "\N{EN DASH}"
    text = f"{value:.{decimals}f}"
    return text.removeprefix("-") if float(text) == 0.0 else text.replace("-", "\N{MINUS SIGN}")


def percent_text(value: float) -> str:
    """Percentage for a person; beyond 9999 the number says no more, and NaN is a dash."""
    if not math.isfinite(value):
        return "\N{EN DASH}"
    return "> 9999 %" if value > 9999 else f"{value:.0f} %"


def share_text(share: float) -> str:
    """Share as a percentage, with a decimal where it is near 0 or near all."""
    percent = 100.0 * share
    near = 0.0 < percent < 10.0 or 99.0 < percent < 100.0
    return f"{percent:.{1 if near else 0}f} %"


def spread_text(value: float, decimals: int) -> str:
    """Spread with the decimals of its value, or what it is smaller than; empty for NaN."""
    if not math.isfinite(value):
        return ""
    least = 10.0**-decimals
    return f"±<{least:.{decimals}f}" if 0.0 < value < 0.5 * least else f"± {fixed(value, decimals)}"
