"""Tables of an evaluation and of data checks for a terminal, in deg and mm."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rich import box
from rich.table import Table
from rich.text import Text

from truejoint.evaluation.checks import DataCheck
from truejoint.evaluation.digits import decimals_for, fixed, percent_text
from truejoint.evaluation.results import CartesianScore, Evaluation, Score, estimator_title
from truejoint.units import display_unit

_LEVEL_STYLE = {"fail": "bold red", "warn": "yellow", "info": "dim"}


def score_table(evaluation: Evaluation) -> Table:
    """Joints (and the tool) by estimator: RMSE, spread over seeds, percent of the fixed offset.

    The smallest of a row is bold.
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
        name = Text(f"{joint} [{shown_unit.name}]")
        table.add_row(name, *_cells(scores, shown_unit.scale))
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
            text.append(f" ± {fixed(scale * spread, decimals)}", style="not bold dim")
        text.append(f" {percent_text(percent):>6}", style="not bold dim")
        cells.append(text)
    return cells


def findings_table(check: DataCheck, title: str = "Data checks") -> Table:
    """List the findings of a data check, worst first."""
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
