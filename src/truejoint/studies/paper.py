"""What papers report, as they print it: one table for all studies, `paper_tables.csv`."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from functools import cache
from importlib.resources import files


def reported(source: str, table: str, condition: str, method: str) -> Mapping[str, float]:
    """Numbers that a paper prints, by metric, in the unit that it prints; empty where it has none.

    >>> reported("yan2020", "2", "trajectory 28", "ukf_compensated")["rms"]
    0.12
    """
    return _rows().get((source, table, condition, method), {})


@cache
def _rows() -> dict[tuple[str, ...], dict[str, float]]:
    text = files("truejoint.studies").joinpath("paper_tables.csv").read_text(encoding="utf-8")
    found: dict[tuple[str, ...], dict[str, float]] = {}
    for row in csv.DictReader(text.splitlines()):
        *key, metric = (row[c] for c in ("source", "table", "condition", "method", "metric"))
        found.setdefault(tuple(key), {})[metric] = float(row["value"])
    return found
