"""Tables of an evaluation and of data checks for a terminal, in deg and mm."""

from __future__ import annotations

from itertools import groupby

from rich import box
from rich.table import Table
from rich.text import Text

from truejoint.evaluation.data_check import DataCheck
from truejoint.evaluation.results import Evaluation, estimator_title
from truejoint.evaluation.view import interval_rows, main_rows

_LEVEL_STYLE = {"fail": "bold red", "warn": "yellow", "info": "dim"}


def score_table(evaluation: Evaluation) -> Table:
    """Joints (and the tool) by estimator: RMSE, spread over seeds, percent of the fixed offset.

    The smallest of a row is bold.

    Examples
    --------
    >>> score_table(evaluation).row_count
    1
    """
    title = f"{evaluation.title}: RMSE on the test, percent of the fixed offset"
    table = Table(title=title, box=box.SIMPLE_HEAD)
    table.add_column("joint")
    for name in evaluation.estimators:
        style = "cyan" if name == evaluation.chosen else ""
        table.add_column(estimator_title(name), justify="right", style=style)
    for row in main_rows(evaluation):
        if row.name == "tool position":
            table.add_section()
        cells = []
        for cell in row.cells:
            text = Text(cell["rmse"], style="bold" if cell["best"] else "")
            for small in filter(None, (cell["spread"], f"{cell['percent']:>6}")):
                text.append(f" {small}", style="not bold dim")
            cells.append(text)
        table.add_row(Text(f"{row.name.removesuffix(' position')} [{row.unit}]"), *cells)
    return table


def interval_table(evaluation: Evaluation) -> Table:
    """Stated levels by joint: share of the test inside, and half-widths beside the offset's.

    Examples
    --------
    >>> interval_table(evaluation).row_count
    2
    """
    count = len(evaluation.interval_trajectories)
    title = f"Stated interval, on {count} test {'trajectories' if count != 1 else 'trajectory'}"
    table = Table(title=title, box=box.SIMPLE_HEAD)
    table.add_column("joint")
    for name in ("stated", "found inside", "half-width", "fixed offset's"):
        table.add_column(name, justify="right")
    table.add_column("")
    for joint, rows in groupby(interval_rows(evaluation), key=lambda row: row["joint"]):
        for place, row in enumerate(rows):
            table.add_row(
                Text("" if place else f"{joint} [{row['unit']}]"),
                row["level"],
                row["coverage"],
                *row["widths"],
                Text(row["agreement"], style="yellow" if row["agreement"] != "agrees" else "dim"),
            )
        table.add_section()
    return table


def findings_table(check: DataCheck, title: str = "Data checks") -> Table:
    """List the findings of a data check, worst first.

    Examples
    --------
    >>> [column.header for column in findings_table(check_data(training)).columns]
    ['level', 'found', 'where', 'what to do']
    """
    table = Table(title=title)
    for name in ("level", "found", "where", "what to do"):
        table.add_column(name, overflow="fold")
    for found in check.findings:
        texts = map(Text, (found.what, found.where, found.advice))
        table.add_row(Text(found.level, style=_LEVEL_STYLE[found.level]), *texts)
    return table
