"""Tidy rows of a study, tables and a figure of them, and the numbers that papers print."""

import csv
import math
from collections.abc import Collection, Iterable, Mapping
from functools import cache
from importlib.resources import files
from typing import Any, Final

import numpy as np
from pandas import DataFrame, Series

from truejoint.drawing import Figure, ecdf
from truejoint.tables import Table, fixed, median_text
from truejoint.toml_file import shipped_table

_KEY: Final = ("source", "table", "condition", "method", "quantity")


def select(rows: DataFrame, **where: Any) -> DataFrame:
    """Rows whose columns have a value, or one of several."""
    keep = np.ones(len(rows), dtype=bool)
    for column, value in where.items():
        several = isinstance(value, Collection) and not isinstance(value, str)
        keep &= (rows[column].isin(list(value)) if several else rows[column] == value).to_numpy()
    return rows[keep]


def unique(rows: DataFrame, column: str) -> list[Any]:
    """Values of a column, each once, in the order of the rows."""
    return list(dict.fromkeys(rows[column]))


def quantiles(rows: DataFrame, by: str, column: str, shares: Mapping[str, float]) -> DataFrame:
    """Quantiles of a column for each value of `by`, in the order of the rows, by title."""
    cut = rows.groupby(by, sort=False)[column].quantile(np.array(list(shares.values())))
    return cut.unstack(sort=False).set_axis(list(shares), axis=1)


def median_texts(
    rows: DataFrame, keys: list[str], column: str, decimals: int, scale: float = 1.0
) -> DataFrame:
    """Texts of the median of a column and, in brackets, the largest, by the first of the keys."""
    by = rows.groupby(keys, sort=False)[column]
    texts = by.agg(lambda own: median_text(scale * own.to_numpy(), decimals))
    return texts.unstack(keys[1:])


def mean_text(errors: Series, decimals: int) -> str:
    """Text of a mean, with the standard deviation where there are several."""
    spread = f" ± {fixed(float(errors.std(ddof=1)), decimals)}" if len(errors) > 1 else ""
    return fixed(float(errors.mean()), decimals) + spread


def frame_table(
    title: str, frame: DataFrame, notes: Iterable[str] = (), *, decimals: int = 3, head: str = ""
) -> Table:
    """Table of a frame whose index names the rows: texts as they are, numbers with `decimals`.

    Blanks around the name of a column do not show.
    """
    body = [
        (str(name), *(v if isinstance(v, str) else fixed(float(v), decimals) for v in row))
        for name, *row in frame.itertuples()
    ]
    header = (head, *(str(name).strip() for name in frame.columns))
    return Table(title, header, tuple(body), tuple(notes))


def notes_on(table: str, **values: Any) -> list[str]:
    """Give the notes under a table, of ``notes.toml``, with these values in them."""
    return [text.format(**values) for text in shipped_table(__package__, "notes.toml")[table]]


def ecdf_figure(
    title: str,
    rows: DataFrame,
    by: str,
    panels: str,
    caption: str,
    *,
    colours: Mapping[Any, str] | None = None,
) -> Figure:
    """Figure of the share of rows whose ``rms`` [rad] is at most so large.

    A curve for each value of the column `by`, a panel for each of the column `panels`.
    """
    drawn = [
        ecdf(
            group, "rms", by, scale=math.degrees(1.0), colours=colours, x="RMS error [deg]",
            y="share of cases [%]", title=str(name), log="x",
        )
        for name, group in rows.dropna(subset="rms").groupby(panels, sort=False)
    ]  # fmt: skip
    return Figure(title, (drawn,), caption, height=4.6, legend=True)


def reported(
    source: str, table: str, condition: str, method: str, quantity: str = "jaw"
) -> Mapping[str, float]:
    """Numbers that a paper prints, by metric, in the unit that it prints; empty where it has none.

    All stand in one table, ``paper_tables.csv``.
    """
    return paper_numbers().get((source, table, condition, method, quantity), {})


@cache
def paper_numbers() -> dict[tuple[str, ...], dict[str, float]]:
    """Every number of the table by metric, by source, table, condition, method and quantity."""
    text = files(__package__).joinpath("paper_tables.csv").read_text(encoding="utf-8")
    numbers: dict[tuple[str, ...], dict[str, float]] = {}
    for row in csv.DictReader(text.splitlines()):
        *key, metric = (row[column] for column in (*_KEY, "metric"))
        numbers.setdefault(tuple(key), {})[metric] = float(row["value"])
    return numbers


def reported_text(value: float | None, decimals: int = 2) -> str:
    """Text of a number as a paper prints it; a dash for None."""
    return fixed(math.nan if value is None else value, decimals)
