"""Numbers that papers report, as they print them: all stand in one table, `paper_tables.csv`."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import Final

from truejoint.tables import fixed

_KEY: Final = ("source", "table", "condition", "method", "quantity")


def reported_text(value: float | None, decimals: int = 2) -> str:
    """Text of a number as a paper prints it; a dash for None."""
    return fixed(math.nan if value is None else value, decimals)


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
