"""Tables and figures of RMSE by condition, joint and method, beside what peng2024 prints."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Final

import numpy as np

from truejoint.array_types import Array
from truejoint.drawing import Curve, Figure, Panel
from truejoint.evaluation.metrics import percent_of
from truejoint.studies.raven2.sessions import JOINTS, MODELS, TITLES, Errors, shown
from truejoint.studies.table import reported
from truejoint.tables import Table, fixed

Found = Mapping[str, Sequence[Errors]]
"""Errors of each session by condition."""
Paper = Callable[[str, int, str], float | None]
"""RMSE that the paper prints for a condition, a joint's index and a method; None: none."""


def unprinted(_condition: str, _joint: int, _method: str) -> None:
    """Nothing: the paper prints no number of these."""


COLOURS: Final = {
    "dnn": "tab:blue", "poly2": "tab:orange", "linear": "tab:green", "offset": "tab:gray",
    "raw": "k", "wide": "tab:red",
}  # fmt: skip


def printed(table: str, condition: str, joint: int, method: str) -> float | None:
    """RMSE in a table of peng2024 [deg, deg, mm]; None where it has none."""
    return reported("peng2024", table, condition, method, f"joint{joint + 1}").get("rmse")


def by_session(sessions: Sequence[Errors], method: str) -> Array:
    """RMSE (k, 3) of a method in each session, mean over its models [deg, deg, mm]."""
    return np.array([shown(errors, method) for errors in sessions])


def _mean(sessions: Sequence[Errors], method: str, joint: int) -> float:
    """RMSE over sessions [deg, deg, mm]; NaN where the method has none."""
    if method not in sessions[0]:
        return float("nan")
    return float(by_session(sessions, method)[:, joint].mean())


def accuracy_table(
    title: str, found: Found, methods: Sequence[str], paper: Paper, notes: Sequence[str] = ()
) -> Table:
    """RMSE [deg, deg, mm] of each condition and joint, with the paper's in brackets."""
    rows = []
    for condition, sessions in found.items():
        for joint, name in enumerate(TITLES):
            cells = [_cell(sessions, condition, method, joint, paper) for method in methods]
            rows.append((f"{condition}, {name}", *cells))
    header = ("condition, joint", *_titles(methods, rows))
    count = max((len(sessions) for sessions in found.values()), default=0)
    over = f"{count} sessions" if count > 1 else "the models of one session"
    has_spread = any("±" in cell for row in rows for cell in row)
    what = f"RMSE; ± standard deviation over {over}." if has_spread else "RMSE, of one session."
    return Table(title, header, tuple(rows), (what, *notes))


def _cell(sessions: Sequence[Errors], condition: str, method: str, joint: int, paper: Paper) -> str:
    if method not in sessions[0]:
        return fixed(np.nan, 3)
    values = by_session(sessions, method)[:, joint]
    if len(values) == 1:
        values = np.array([shown({"": [one]}, "")[joint] for one in sessions[0][method]])
    spread = f" ± {fixed(float(values.std(ddof=1)), 3)}" if len(values) > 1 else ""
    there = paper(condition, joint, method)
    return fixed(float(values.mean()), 3) + spread + ("" if there is None else f" ({there:.3f})")


def percent_table(title: str, found: Found, paper: Paper) -> Table:
    """Share [%] of the fixed offset's error that each model leaves, the paper's in brackets."""
    rows = []
    for condition, sessions in found.items():
        for joint, name in enumerate(TITLES):
            cells = []
            for method in MODELS:
                here = percent(sessions, method)[:, joint].mean()
                there = [paper(condition, joint, one) for one in (method, "offset")]
                after = f" ({percent_of(*there):.1f})" if None not in there else ""  # type: ignore[arg-type]
                cells.append(fixed(float(here), 1) + after)
            rows.append((f"{condition}, {name}", *cells))
    header = ("condition, joint", *_titles([f"{method} %" for method in MODELS], rows))
    return Table(title, header, tuple(rows))


def _titles(names: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Titles of the columns behind the first; those in which the paper has a number say so."""
    for column, name in enumerate(names, 1):
        yield name + " (paper)" * any("(" in row[column] for row in rows)


def percent(sessions: Sequence[Errors], method: str) -> Array:
    """Share (k, 3) [%] of the fixed offset's error that a model leaves, by session."""
    return percent_of(by_session(sessions, method), by_session(sessions, "offset"))


def ratio_table(
    title: str, groups: Mapping[str, Found], methods: Sequence[str], paper: Paper
) -> Table:
    """Geometric mean of RMSE over the paper's, by group of conditions."""
    rows = []
    for name, found in groups.items():
        cells = []
        for method in methods:
            logs = [
                np.log(by_session(sessions, method)[:, joint].mean() / there)
                for condition, sessions in found.items()
                for joint in range(len(JOINTS))
                if (there := paper(condition, joint, method)) is not None
            ]
            cells.append(fixed(float(np.exp(np.mean(logs))) if logs else np.nan, 2))
        rows.append((name, *cells))
    return Table(title, ("conditions", *methods), tuple(rows), ("1: as in the paper.",))


def accuracy_figure(
    title: str, found: Found, methods: Sequence[str], paper: Paper, caption: str
) -> Figure:
    """Points by condition, a panel a joint; the paper's are crosses."""
    names, panels = list(found), []
    place = np.arange(len(names))
    for joint, label in enumerate(TITLES):
        curves = []
        for method in methods:
            here = [_mean(found[name], method, joint) for name in names]
            there = [paper(name, joint, method) for name in names]
            curves.append(Curve(here, place, method, COLOURS.get(method), "o"))
            known = [(v, p) for v, p in zip(there, place, strict=True) if v is not None]
            if known:
                x, y = zip(*known, strict=True)
                curves.append(Curve(x, y, "", COLOURS.get(method), "x"))
        panels.append(Panel(curves, f"RMSE, {label}", log="x", rows=names))
    if paper is not unprinted:
        caption += " Dots: here; crosses: the paper's robot."
    return Figure(
        title, (panels,), caption, width=12.0, height=1.8 + 0.32 * len(names), legend=True
    )
