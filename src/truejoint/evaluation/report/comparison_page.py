"""A page of several models side by side: verdicts, table, what is better beyond chance, errors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from itertools import combinations, cycle
from pathlib import Path

import numpy as np

from truejoint import drawing
from truejoint.errors import CalibrationError
from truejoint.evaluation.paired_test import compare
from truejoint.evaluation.report.curves import distributions
from truejoint.evaluation.report.page import facts, render_figures, write_page
from truejoint.evaluation.report.plot import Figure
from truejoint.evaluation.report.residuals import POINTS, Panel, error_panels
from truejoint.evaluation.results import Evaluation
from truejoint.evaluation.score_rows import Row


def write_comparison(
    together: Evaluation,
    alone: Mapping[str, Evaluation],
    path: str | Path,
    *,
    command: str = "",
    overwrite: bool = False,
) -> Path:
    """Write a page on several models that were judged on the same recordings.

    Parameters
    ----------
    together : Evaluation
        Of all models, each as an estimator by its own name.
    alone : mapping of str to Evaluation
        Of each model by itself, by that name, for its verdict.
    path : str or Path
        Where to write; written whole or not at all.
    command : str
        Command line that makes this page again.
    overwrite : bool
        Whether a file at `path` may be replaced.

    Raises
    ------
    CalibrationError
        If there are fewer than two models, or one is not among those that were judged together.
    RecordingError
        As `write_report`.

    Examples
    --------
    >>> alone = {"offset": evaluation, "linear": evaluation}
    >>> write_comparison(evaluation, alone, "models.html").name
    'models.html'
    """
    if len(alone) < 2:
        raise CalibrationError(f"{len(alone)} model to compare; give at least two")
    for name in alone:
        if name not in together.estimators:
            raise CalibrationError(f"{name} was not judged together with the others")
    render = partial(_render, together, alone, command)
    return write_page(path, render, overwrite=overwrite)


def _render(together: Evaluation, alone: Mapping[str, Evaluation], command: str) -> str:
    verdicts = {name: evaluation.verdict for name, evaluation in alone.items()}
    objections = [v.text for v in verdicts.values() if v.objections]
    deploy = together.verdict.deploy
    level = verdicts[deploy].level if deploy in verdicts else "warn"
    picked = replace(together, chosen=deploy) if deploy else together
    colours = dict(zip(alone, cycle(drawing.PALETTE), strict=False))
    return render_figures(
        "comparison.html.j2",
        {
            "residuals": list(_residuals(together, list(alone))),
            "distribution": [distributions(together, colours)],
        },
        evaluation=picked,
        verdicts=verdicts,
        level="fail" if objections else level,
        sentence=objections[0] if objections else together.verdict.advice,
        rule=next(iter(verdicts.values())).rule,
        pairs=list(_pairs(together, list(alone))),
        origins={name: evaluation.training for name, evaluation in alone.items()},
        facts=facts(together, f"{len(alone)} models"),
        command=command,
    )


def _pairs(evaluation: Evaluation, names: list[str]) -> Iterator[Row]:
    """Which model of each two is closer to the truth in each joint."""
    for column, joint, _ in evaluation.shown_joints():
        for first, other in combinations(names, 2):
            errors = (
                [trace.error(name)[:, column] for trace in evaluation.traces]
                for name in (first, other)
            )
            difference = compare(*errors)
            yield Row(joint, [first, difference.outcome, other, str(difference.stretches)])


def _residuals(evaluation: Evaluation, names: list[str]) -> Iterator[Figure]:
    """Error of each model against position, a figure a joint, on one scale."""
    for column, joint, unit in evaluation.shown_joints():
        position = unit.scale * np.concatenate([t.truth[:, column] for t in evaluation.traces])
        moves = np.concatenate([trace.direction[:, column] for trace in evaluation.traces])
        title = f"position [{unit.name}]"
        panels = [
            Panel(f"{name}: {title}", position, unit.scale * evaluation.error(name, column))
            for name in names
        ]
        spec = error_panels(panels, moves, unit, POINTS // len(names))
        caption = (
            f"{joint}: error [{unit.name}] against position, a panel a model on one scale. Dots "
            "are rows, blue while the joint moves up and orange while it moves down; lines are "
            "medians, bands hold the middle 90 %."
        )
        yield Figure(f"residual-{column}", f"{joint} residuals", caption, [spec])
