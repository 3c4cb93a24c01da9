"""Numbers and tables as people read them: digits, one cell rule, a table for terminal and page."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from rich import box
from rich import table as rich_table
from rich.text import Text

from truejoint.array_types import Array
from truejoint.errors import printable

if TYPE_CHECKING:
    from pandas import DataFrame

DASH: Final = "\N{EN DASH}"
_FORMULA: Final = ("=", "+", "-", "@", "\t", "\r")
_CELL: Final = 24
"""Cells up to this wide are kept in one piece."""


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
        return DASH
    text = f"{value:.{decimals}f}"
    return text.removeprefix("-") if float(text) == 0.0 else text.replace("-", "\N{MINUS SIGN}")


def percent_text(value: float) -> str:
    """Percentage for a person; beyond 9999 the number says no more, and NaN is a dash."""
    if not math.isfinite(value):
        return DASH
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


def median_text(values: Array, decimals: int = 2) -> str:
    """Median of values (n,) and, in brackets, the largest; a dash where there is none."""
    if not len(values):
        return DASH
    middle, largest = (fixed(float(f(values)), decimals) for f in (np.median, np.max))
    return f"{middle} ({largest})"


def csv_text(frame: "DataFrame") -> str:
    r"""CSV of a table in which no text is a formula to a spreadsheet.

    A text that begins like one gets an apostrophe before it; all are `printable`.
    """

    def quoted(cell: Any) -> Any:
        if not isinstance(cell, str):
            return cell
        return f"'{printable(cell)}" if cell.startswith(_FORMULA) else printable(cell)

    texts = frame.select_dtypes(exclude=["number", "bool"])
    plain = frame.assign(**{str(name): column.map(quoted) for name, column in texts.items()})
    header = [quoted(name) for name in frame.columns]
    return plain.to_csv(index=False, header=header, lineterminator="\n")


@dataclass(frozen=True)
class Table:
    """A table of texts in a person's units; the first cell of a row names it, `notes` go below."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()

    def rich(self) -> rich_table.Table:
        """For a terminal."""
        table = rich_table.Table(title=Text(self.title), box=box.SIMPLE_HEAD)
        table.caption, table.caption_justify = Text("\n".join(self.notes)), "left"
        for i, name in enumerate(self.header):
            least = min(_CELL, max((len(row[i]) for row in self.rows), default=0))
            table.add_column(
                Text(name), justify="right" if i else "left", min_width=least, overflow="fold"
            )
        for row in self.rows:
            table.add_row(*(Text(cell) for cell in row))
        return table

    def markdown(self) -> str:
        """As Markdown, ending with a line break."""
        rule = [":---", *["---:"] * (len(self.header) - 1)]
        lines = [_line(cells) for cells in (self.header, rule, *self.rows)]
        return "\n".join([f"**{self.title}**", "", *lines, *(f"\n{n}" for n in self.notes), ""])


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"
