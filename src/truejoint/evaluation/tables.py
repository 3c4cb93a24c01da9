"""Tables of an evaluation and of data checks for a terminal, in deg and mm."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rich import box
from rich.table import Table
from rich.text import Text

from truejoint.evaluation.checks import DataCheck
from truejoint.evaluation.digits import decimals_for, fixed, percent_text, spread_text
from truejoint.evaluation.results import (
    CartesianScore,
    Evaluation,
    IntervalScore,
    Score,
    estimator_title,
)
from truejoint.units import display_unit

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
        table.add_column(
            estimator_title(name),
            justify="right",
            style="cyan" if name == evaluation.chosen else "",
        )
    for joint, unit in zip(evaluation.joints, evaluation.units, strict=True):
        scores = [evaluation.score(name, joint) for name in evaluation.estimators]
        shown_unit = display_unit(unit)
        label = Text(f"{joint} [{shown_unit.name}]")
        table.add_row(label, *_cells(scores, shown_unit.scale))
    if evaluation.cartesian:
        table.add_section()
        table.add_row(Text("tool [mm]"), *_cells(evaluation.cartesian, 1e3))
    return table


def _cells(scores: Sequence[Score] | Sequence[CartesianScore], scale: float) -> list[Text]:
    rows = [(score.rmse, score.spread, score.percent_of_offset) for score in scores]
    values = [scale * row[0] for row in rows]
    decimals = decimals_for(values)
    cells = []
    for value, (_, spread, percent) in zip(values, rows, strict=True):
        text = Text(fixed(value, decimals), style="bold" if value == min(values) else "")
        if math.isfinite(spread):
            text.append(f" {spread_text(scale * spread, decimals)}", style="not bold dim")
        text.append(f" {percent_text(percent):>6}", style="not bold dim")
        cells.append(text)
    return cells


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
    for joint in evaluation.joints:
        rows = [score for score in evaluation.intervals if score.joint == joint]
        unit = display_unit(rows[0].unit)
        for score, widths in zip(rows, half_width_texts(rows), strict=True):
            table.add_row(
                Text(f"{joint} [{unit.name}]" if score is rows[0] else ""),
                f"{100 * score.level:g} %",
                coverage_text(score),
                *widths,
                Text(score.agreement, style="yellow" if score.agreement != "agrees" else "dim"),
                end_section=score is rows[-1],
            )
    return table


def half_width_texts(scores: Sequence[IntervalScore]) -> list[list[str]]:
    """Half-widths of a joint's levels, the model's and the fixed offset's, with like decimals."""
    scale = display_unit(scores[0].unit).scale
    pairs = [(scale * score.half_width, scale * score.offset_half_width) for score in scores]
    decimals = decimals_for(value for pair in pairs for value in pair)
    return [[fixed(value, decimals) for value in pair] for pair in pairs]


def coverage_text(score: IntervalScore) -> str:
    """Coverage with its sampling error, such as ``"91.3 ± 1.2 %"``."""
    error = f" ± {100 * score.standard_error:.1f}" if len(score.shares) > 1 else ""
    return f"{100 * score.coverage:.1f}{error} %"


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
    for finding in check.findings:
        style = _LEVEL_STYLE[finding.level]
        table.add_row(
            Text(finding.level, style=style),
            Text(finding.what),
            Text(finding.where),
            Text(finding.advice),
        )
    return table
