"""Tables of studies, for a terminal and as Markdown, and what papers report, as they print it.

The page draws its own; the numbers of all papers stand in one table, `paper_tables.csv`.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Final

import numpy as np
from rich import box
from rich import table as rich_table
from rich.text import Text

from truejoint.array_types import Array
from truejoint.evaluation.digits import fixed

_CELL: Final = 24
"""Cells up to this wide are kept in one piece."""
_KEY: Final = ("source", "table", "condition", "method", "quantity")


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


def degrees_text(value: float | None, decimals: int = 3) -> str:
    """Degrees of an angle [rad]; a dash for None or NaN."""
    return fixed(math.nan if value is None else math.degrees(value), decimals)


def median_text(values: Array, decimals: int) -> str:
    """Median of values (n,), in brackets the largest."""
    middle, largest = (fixed(float(f(values)), decimals) for f in (np.median, np.max))
    return f"{middle} ({largest})"


def reported_text(value: float | None, decimals: int = 2) -> str:
    """Text of a number as a paper prints it; a dash for None."""
    return fixed(math.nan if value is None else value, decimals)


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def reported(
    source: str, table: str, condition: str, method: str, quantity: str = "jaw"
) -> Mapping[str, float]:
    """Numbers that a paper prints, by metric, in the unit that it prints; empty where it has none.

    >>> reported("yan2020", "2", "trajectory 28", "ukf_compensated")["rms"]
    0.12
    """
    return _rows().get((source, table, condition, method, quantity), {})


@cache
def _rows() -> dict[tuple[str, ...], dict[str, float]]:
    text = files("truejoint.studies").joinpath("paper_tables.csv").read_text(encoding="utf-8")
    found: dict[tuple[str, ...], dict[str, float]] = {}
    for row in csv.DictReader(text.splitlines()):
        *key, metric = (row[c] for c in (*_KEY, "metric"))
        found.setdefault(tuple(key), {})[metric] = float(row["value"])
    return found
