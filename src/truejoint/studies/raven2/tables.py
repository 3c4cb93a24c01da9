"""Tables and figures of RMSE by condition, joint and method, beside what peng2024 prints."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from functools import wraps
from typing import Any, Final

import numpy as np
from pandas import DataFrame

from truejoint.array_types import Array
from truejoint.drawing import Figure, Panel, box_plot
from truejoint.evaluation.judge import percent_of
from truejoint.studies.paper_tables import reported
from truejoint.studies.raven2.sessions import JOINTS, MODELS, SCALES, TITLES
from truejoint.studies.rows import groups, select, unique
from truejoint.studies.study import Results, Summary
from truejoint.tables import Table, fixed

Paper = Callable[[str, int, str], float | None]
"""RMSE that the paper prints for a condition, a joint's index and a method; None: none."""

COLOURS: Final = {
    "dnn": "tab:blue", "poly2": "tab:orange", "linear": "tab:green", "offset": "tab:gray",
    "raw": "k", "wide": "tab:red",
}  # fmt: skip
ZIGZAGS: Final = "4+5+6: zig-zags of sparsity 1/4, 1/5 and 1/6."


def printed(table: str, form: str) -> Paper:
    """RMSE in a table of peng2024 [deg, deg, mm], of the condition that `form` makes of ours."""
    return lambda condition, joint, method: reported(
        "peng2024", table, form.format(condition), method, f"joint{joint + 1}"
    ).get("rmse")


def readable(rows: DataFrame) -> DataFrame:
    """Rows with their RMSE in the units of `TITLES` [deg or mm]."""
    scale = rows.joint.map(dict(zip(JOINTS, SCALES, strict=True)))
    return rows.assign(rmse=scale * rows.rmse)


def by_specimen(
    summarise: Callable[[Results, str, DataFrame], Summary],
) -> Callable[[Results], Summary]:
    """Put together what is made of the rows of every specimen, in the units of `TITLES`."""

    @wraps(summarise)
    def every(results: Results) -> Summary:
        made = [
            summarise(results, str(title), readable(rows))
            for title, rows in groups(results.rows, "specimen")
        ]
        return Summary(
            [table for one in made for table in one.tables],
            {name: figure for one in made for name, figure in one.figures.items()},
            [claim for one in made for claim in one.claims],
        )

    return every


def in_order(rows: DataFrame, column: str, names: Sequence[str]) -> DataFrame:
    """Rows in the order that a column's names have in `names`."""
    return rows.sort_values(column, key=lambda own: own.map(names.index), kind="stable")


def by_session(rows: DataFrame, **where: Any) -> Array:
    """RMSE (k,) of every session: the mean over the rows that `select` gives of it."""
    return np.asarray(select(rows, **where).groupby("session", sort=False).rmse.mean().to_numpy())


def percent(rows: DataFrame, **where: Any) -> Array:
    """Share (k, 3) [%] of the fixed offset's error that a method leaves, by session and joint."""
    method = where.pop("method")
    left, offset = (
        np.column_stack([by_session(rows, joint=j, method=name, **where) for j in JOINTS])
        for name in (method, "offset")
    )
    return np.asarray(percent_of(left, offset))


def accuracy_table(
    title: str,
    rows: DataFrame,
    methods: Sequence[str],
    paper: Paper | None = None,
    notes: Sequence[str] = (),
) -> Table:
    """RMSE [deg, deg, mm] of each condition and joint, with the paper's in brackets."""
    count = rows.groupby("condition").session.nunique().max()
    over = f"{count} sessions" if count > 1 else "the models of one session"

    def cell(rows: DataFrame, condition: str, joint: int, method: str) -> str:
        errors = by_session(rows, joint=JOINTS[joint], method=method)
        if len(errors) == 1:
            errors = select(rows, joint=JOINTS[joint], method=method).rmse.to_numpy(dtype=float)
        spread = f" ± {fixed(float(errors.std(ddof=1)), 3)}" if len(errors) > 1 else ""
        there = paper(condition, joint, method) if paper and len(errors) else None
        mean = float(errors.mean()) if len(errors) else np.nan
        return fixed(mean, 3) + spread + ("" if there is None else f" ({there:.3f})")

    table = _by_joint(title, rows, methods, cell)
    has_spread = any("±" in text for row in table.rows for text in row)
    what = f"RMSE; ± standard deviation over {over}." if has_spread else "RMSE, of one session."
    return Table(table.title, table.header, table.rows, (what, *notes))


def percent_table(title: str, rows: DataFrame, paper: Paper) -> Table:
    """Share [%] of the fixed offset's error that each model leaves, the paper's in brackets."""

    def cell(rows: DataFrame, name: str, joint: int, method: str) -> str:
        text = fixed(float(percent(rows, method=method)[:, joint].mean()), 1)
        here, offset = paper(name, joint, method), paper(name, joint, "offset")
        if here is None or offset is None:
            return text
        return f"{text} ({percent_of(here, offset):.1f})"

    return _by_joint(title, rows, MODELS, cell, " %")


def _by_joint(
    title: str,
    rows: DataFrame,
    methods: Sequence[str],
    cell: Callable[[DataFrame, str, int, str], str],
    unit: str = "",
) -> Table:
    """Table of conditions and joints by method; a column says where the paper has a number."""
    body = [
        (f"{name}, {label}", *(cell(rows_of, name, k, method) for method in methods))
        for name, rows_of in groups(rows, "condition")
        for k, label in enumerate(TITLES)
    ]
    heads = (
        method + unit + " (paper)" * any("(" in row[column] for row in body)
        for column, method in enumerate(methods, 1)
    )
    return Table(title, ("condition, joint", *heads), tuple(body))


def ratio_table(
    title: str,
    rows: DataFrame,
    conditions_of: Mapping[str, Collection[str]],
    methods: Sequence[str],
    paper: Paper,
) -> Table:
    """Geometric mean of RMSE over the paper's, by group of conditions."""

    def cell(conditions: Collection[str], method: str) -> str:
        logs = [
            np.log(by_session(rows, joint=name, condition=condition, method=method).mean() / there)
            for condition in conditions
            for joint, name in enumerate(JOINTS)
            if (there := paper(condition, joint, method)) is not None
        ]
        return fixed(float(np.exp(np.mean(logs))) if logs else np.nan, 2)

    body = [
        (name, *(cell(own, method) for method in methods)) for name, own in conditions_of.items()
    ]
    return Table(title, ("conditions", *methods), tuple(body), ("1: as in the paper.",))


def joint_figure(
    title: str,
    rows: DataFrame,
    caption: str,
    plot: Callable[..., Panel],
    columns: str = "specimen",
    **look: Any,
) -> Figure:
    """Plot RMSE, a line of panels for each joint, a panel for each value of a column.

    `plot` is one of `truejoint.drawing`, and `look` is as it takes it.
    """
    panels = [
        [
            plot(
                select(rows, joint=joint, **{columns: name}), value="rmse", y=f"RMSE, {label}",
                title="" if n else name, **look,
            )
            for name in unique(rows, columns)
        ]
        for n, (joint, label) in enumerate(zip(JOINTS, TITLES, strict=True))
    ]  # fmt: skip
    return Figure(title, panels, caption, height=9.5, legend=True)


def joint_boxes(title: str, rows: DataFrame, caption: str, condition: str) -> Figure:
    """Plot RMSE as boxes at each value of a column `condition`, side by side for each method."""
    look: dict[str, Any] = {"condition": condition, "by": "method", "log": "y"}
    return joint_figure(title, rows, caption, box_plot, colours=COLOURS, **look)
