"""Tables of studies, for a terminal and as Markdown; the page draws its own."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

from rich import box
from rich import table as rich_table
from rich.text import Text

from truejoint.evaluation.digits import fixed

_CELL: Final = 24
"""Cells up to this wide are kept in one piece."""


@dataclass(frozen=True)
class Table:
    """A table of texts, in the units of a person.

    Attributes
    ----------
    title : str
    header : tuple of str
    rows : tuple of tuple of str
        The first cell of each row names it.
    notes : tuple of str
        Lines below the table.
    """

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()

    def rich(self) -> rich_table.Table:
        """For a terminal."""
        notes = Text("\n".join(self.notes))
        table = rich_table.Table(
            title=Text(self.title), box=box.SIMPLE_HEAD, caption=notes, caption_justify="left"
        )
        for i, name in enumerate(self.header):
            justify: Literal["left", "right"] = "left" if i == 0 else "right"
            widest = max((len(row[i]) for row in self.rows), default=0)
            table.add_column(
                Text(name), justify=justify, min_width=min(widest, _CELL), overflow="fold"
            )
        for row in self.rows:
            table.add_row(*(Text(cell) for cell in row))
        return table

    def markdown(self) -> str:
        """As Markdown, ending with a line break."""
        lines = [f"**{self.title}**", "", _line(self.header)]
        lines.append(_line([":---", *["---:"] * (len(self.header) - 1)]))
        lines += [_line(row) for row in self.rows]
        lines += [f"\n{note}" for note in self.notes]
        return "\n".join(lines) + "\n"


def degrees_text(value: float | None, decimals: int = 3) -> str:
    """Degrees of an angle [rad]; a dash for None or NaN."""
    return fixed(math.nan if value is None else math.degrees(value), decimals)


def reported_text(value: float | None, decimals: int = 2) -> str:
    """Text of a number as a paper prints it; a dash for None."""
    return fixed(math.nan if value is None else value, decimals)


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"
