"""Tables and figures of RMSE by condition, joint and method, beside what peng2024 prints."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import wraps
from itertools import product
from typing import Any, Final

import numpy as np
from pandas import DataFrame

from truejoint.drawing import Figure, Panel, box_plot
from truejoint.studies.claim_tests import Verdict, by_session, matches
from truejoint.studies.raven2.sessions import JOINTS, MODELS, SCALES, TITLES
from truejoint.studies.rows import frame_table, mean_text, reported, select, unique
from truejoint.studies.study import Results, Summary
from truejoint.tables import DASH, Table, fixed

Paper = Callable[[str, str, str], float | None]
"""RMSE that the paper prints for a condition, a joint and a method; None: none."""

COLOURS: Final = {
    "dnn": "tab:blue", "poly2": "tab:orange", "linear": "tab:green", "offset": "tab:gray",
    "raw": "k", "wide": "tab:red",
}  # fmt: skip
ZIGZAGS: Final = "4+5+6: zig-zags of sparsity 1/4, 1/5 and 1/6."
_CELL: Final = ["condition", "joint"]


def printed(table: str, form: str) -> Paper:
    """RMSE in a table of peng2024 [deg, deg, mm], of the condition that `form` makes of ours."""
    return lambda condition, joint, method: reported(
        "peng2024", table, form.format(condition), method, f"joint{JOINTS.index(joint) + 1}"
    ).get("rmse")


def as_printed(rows: DataFrame, paper: Paper, methods: Sequence[str]) -> Verdict:
    """Judge whether errors of some methods are those that the paper prints, in every cell."""
    pairs = []
    for key in product(unique(rows, "condition"), JOINTS, methods):
        there = paper(*key)
        if there is not None:
            own = by_session(rows, **dict(zip((*_CELL, "method"), key, strict=True)))
            pairs.append((", ".join(key), own, there))
    return matches(pairs)


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
            for title, rows in results.rows.groupby("specimen", sort=False)
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


def percent(rows: DataFrame) -> DataFrame:
    """Share [%] of the fixed offset's error: a row a condition, joint and session, by method."""
    by = rows.groupby([*_CELL, "session", "method"], sort=False).rmse.mean().unstack()
    return 100.0 * by.div(by.offset.where(by.offset > 0.0), axis=0)


def accuracy_table(
    title: str,
    rows: DataFrame,
    methods: Sequence[str],
    paper: Paper | None = None,
    notes: Iterable[str] = (),
) -> Table:
    """RMSE [deg, deg, mm] of each condition and joint, with the paper's in brackets."""
    count, cell = rows.session.nunique(), [*_CELL, "method"]
    by = rows.groupby([*cell, "session"], sort=False).rmse.mean()
    errors = by if count > 1 else rows.set_index(cell).rmse
    texts = errors.groupby(level=cell, sort=False).agg(mean_text, 3).unstack()
    over = f"{count} sessions" if count > 1 else "the models of one session"
    spread = count > 1 or errors.index.has_duplicates
    what = f"RMSE; ± standard deviation over {over}." if spread else "RMSE, of one session."
    return _by_joint(title, texts, methods, paper and _printed(paper, texts), (what, *notes))


def percent_table(title: str, rows: DataFrame, paper: Paper) -> Table:
    """Share [%] of the fixed offset's error that each model leaves, the paper's in brackets."""
    here = percent(rows).groupby(level=_CELL, sort=False).mean()
    there = _printed(paper, here)
    there = 100.0 * there.div(there.offset, axis=0)
    return _by_joint(title, here.map(lambda share: fixed(share, 1)), MODELS, there, (), 1, " %")


def _printed(paper: Paper, like: DataFrame) -> DataFrame:
    """Frame of the paper's numbers with the rows and columns of another, NaN without one."""
    cells = {
        name: [paper(condition, joint, str(name)) for condition, joint in like.index]
        for name in like.columns
    }
    return DataFrame(cells, like.index, dtype=float)


def _by_joint(
    title: str,
    texts: DataFrame,
    methods: Sequence[str],
    there: DataFrame | None,
    notes: Sequence[str],
    decimals: int = 3,
    unit: str = "",
) -> Table:
    """Table of conditions and joints by method; a column says where the paper has a number."""
    texts = texts.reindex(columns=[*methods]).fillna(DASH)
    heads = [name + unit for name in methods]
    if there is not None:
        there = there.reindex(columns=[*methods]).where(texts != DASH)
        beside = there.map(f" ({{:.{decimals}f}})".format).where(there.notna(), "")
        texts = texts + beside
        heads = [name + unit + (" (paper)" if any(beside[name]) else "") for name in methods]
    labels = dict(zip(JOINTS, TITLES, strict=True))
    names = [f"{condition}, {labels[joint]}" for condition, joint in texts.index]
    table = texts.set_axis(names).set_axis(heads, axis=1)
    return frame_table(title, table, notes, head="condition, joint")


def ratio_table(
    title: str,
    rows: DataFrame,
    conditions_of: Mapping[str, Collection[str]],
    methods: Sequence[str],
    paper: Paper,
) -> Table:
    """Geometric mean of RMSE over the paper's, by group of conditions."""
    here = rows.groupby([*_CELL, "session", "method"], sort=False).rmse.mean().unstack()
    here = here.groupby(level=_CELL, sort=False).mean()
    logs = (here / _printed(paper, here)).apply(np.log)
    means = {
        name: np.exp(logs[logs.index.isin(group, level=0)].mean())
        for name, group in conditions_of.items()
    }
    table = DataFrame(means).T[[*methods]]
    return frame_table(title, table, ("1: as in the paper.",), decimals=2, head="conditions")


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
