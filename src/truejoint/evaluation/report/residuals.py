"""Figures of what is left of the error, against what might explain it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from truejoint.evaluation.report.plot import (
    BLUE,
    ORANGE,
    Figure,
    Spec,
    axis,
    columns,
    curve,
    every,
    layout,
    packed,
)
from truejoint.evaluation.results import Evaluation, estimator_phrase, hung_masses
from truejoint.units import display_unit

Array = NDArray[np.float64]

_POINTS: Final = 1200  # of each direction in each panel
_BINS: Final = 24
_FEW: Final = 8  # rows below which a bin has no median


@dataclass(frozen=True)
class _Panel:
    """One cause: its values (n,) over all rows in display units, and the axis title."""

    title: str
    values: Array
    steps: tuple[float, ...] = ()
    """Values that it has, where it takes only a few."""


def residuals(evaluation: Evaluation) -> list[Figure]:
    """Return one figure a joint: error against position, velocity, effort, hung mass and time."""
    figures = []
    for column, joint in enumerate(evaluation.joints):
        unit = display_unit(evaluation.units[column])
        error = unit.scale * np.concatenate(
            [
                t.estimates[evaluation.chosen][:, column] - t.truth[:, column]
                for t in evaluation.traces
            ]
        )
        moves = np.concatenate([trace.direction[:, column] for trace in evaluation.traces])
        panels = _panels(evaluation, column)
        causes = [panel.title.partition(" [")[0] for panel in panels]
        against = f"{', '.join(causes[:-1])} and {causes[-1]}"
        several = " (recordings end to end)" if len(evaluation.traces) > 1 else ""
        figures.append(
            Figure(
                f"residual-{column}",
                f"{joint} residuals",
                f"{joint}: error left by {estimator_phrase(evaluation.chosen)} [{unit.name}] "
                f"against {against}{several}. Dots are rows, blue while the joint moves up and "
                "orange while it moves down; lines are medians, bands hold the middle 90 %.",
                [_spec(panels, error, moves, f"error [{unit.name}]")],
                270,
            )
        )
    return figures


def _panels(evaluation: Evaluation, column: int) -> list[_Panel]:
    joint, traces = evaluation.joints[column], evaluation.traces
    unit = display_unit(evaluation.units[column])
    position = np.concatenate([trace.truth[:, column] for trace in traces])
    velocity = np.concatenate([trace.velocity[:, column] for trace in traces])
    panels = [
        _Panel(f"position [{unit.name}]", unit.scale * position),
        _Panel(f"velocity [{unit.name}/s]", unit.scale * velocity),
    ]
    if all(joint in trace.effort for trace in traces):
        effort = display_unit(traces[0].effort_unit[joint])
        values = np.concatenate([trace.effort[joint] for trace in traces])
        label = f" [{effort.name}]" if effort.name != "1" else " [no unit]"
        panels.append(_Panel(f"effort{label}", effort.scale * values))
    masses = hung_masses(traces)
    if masses:
        loads = [trace.provenance.get("load") for trace in traces]
        values = np.repeat(
            [math.nan if load is None else 1e3 * load for load in loads],
            [len(trace.t) for trace in traces],
        )
        panels.append(_Panel("hung mass [g]", values, tuple(1e3 * mass for mass in masses)))
    panels.append(_Panel("time [s]", _end_to_end([trace.t for trace in traces])))
    return panels


def _end_to_end(times: Sequence[Array]) -> Array:
    parts, start = [], 0.0
    for t in times:
        parts.append(t - t[0] + start)
        start = float(parts[-1][-1])
    return np.concatenate(parts)


def _spec(panels: Sequence[_Panel], error: Array, moves: Array, title: str) -> Spec:
    data: list[Spec] = []
    axes: Spec = {}
    low, high = np.quantile(error, [0.0, 1.0])
    margin = 0.05 * (high - low) or 1e-9
    for i, (panel, domain) in enumerate(zip(panels, columns(len(panels), 0.035), strict=True)):
        suffix = str(i + 1) if i else ""
        axes[f"xaxis{suffix}"] = axis(
            panel.title, domain=domain, anchor=f"y{suffix}", **_ticks(panel)
        )
        axes[f"yaxis{suffix}"] = axis(
            title if i == 0 else "",
            anchor=f"x{suffix}",
            range=[float(low - margin), float(high + margin)],
            showticklabels=i == 0,
            zeroline=True,
        )
        place = {"xaxis": f"x{suffix}", "yaxis": f"y{suffix}"}
        for name, colour, rows in (
            ("moving up", BLUE, moves > 0),
            ("moving down", ORANGE, moves < 0),
        ):
            if rows.any() and panel.steps:
                side = 1 if name == "moving up" else -1
                data += _bars(panel, rows, error, name, colour, side, place)
            elif rows.any():
                data += _cloud(panel.values[rows], error[rows], name, colour, place, first=i == 0)
    return {"data": data, "layout": layout(270, **axes)}


def _ticks(panel: _Panel) -> Spec:
    if not panel.steps:
        return {"nticks": 6}
    margin = 0.2 * (panel.steps[-1] - panel.steps[0])
    return {
        "tickvals": list(panel.steps),
        "range": [panel.steps[0] - margin, panel.steps[-1] + margin],
    }


def _cloud(x: Array, y: Array, name: str, colour: str, place: Spec, *, first: bool) -> list[Spec]:
    keep = every(len(x), _POINTS)
    dots = {
        "type": "scatter",
        "mode": "markers",
        "x": packed(x[keep]),
        "y": packed(y[keep]),
        "name": name,
        "legendgroup": name,
        "showlegend": False,
        "marker": {"color": colour, "size": 2.5, "opacity": 0.22},
        "hoverinfo": "skip",
        **place,
    }
    centre, low, middle, high = binned(x, y)
    band = curve(
        np.concatenate((centre, centre[::-1])),
        np.concatenate((high, low[::-1])),
        name,
        colour,
        width=0,
        fill="toself",
        fillcolor=colour,
        opacity=0.14,
        showlegend=False,
        hoverinfo="skip",
        **place,
    )
    median = curve(centre, middle, name, colour, width=1.8, showlegend=first, **place)
    return [dots, band, median]


def _bars(
    panel: _Panel,
    rows: NDArray[np.bool_],
    error: Array,
    name: str,
    colour: str,
    side: int,
    place: Spec,
) -> list[Spec]:
    """Median and middle 90 % of the error at each of a few values, beside the other direction's."""
    apart = 0.04 * (panel.steps[-1] - panel.steps[0])
    found = [
        (step + side * apart, *np.quantile(error[rows & (panel.values == step)], [0.05, 0.5, 0.95]))
        for step in panel.steps
        if (rows & (panel.values == step)).sum() >= _FEW
    ]
    x, low, middle, high = np.array(found, dtype=float).reshape(-1, 4).T
    return [
        {
            "type": "scatter",
            "mode": "markers",
            "x": packed(x),
            "y": packed(middle),
            "error_y": {
                "array": packed(high - middle),
                "arrayminus": packed(middle - low),
                "thickness": 1.5,
                "width": 4,
                "color": colour,
            },
            "marker": {"color": colour, "size": 7},
            "name": name,
            "legendgroup": name,
            "showlegend": False,
            **place,
        }
    ]


def binned(x: Array, y: Array) -> tuple[Array, Array, Array, Array]:
    """Quantiles of `y` in equal bins of `x`.

    Parameters
    ----------
    x, y : ndarray, shape (n,)

    Returns
    -------
    centre, low, middle, high : ndarray, shape (m,)
        Centres of the bins that hold at least 8 rows, and the 5th, 50th and 95th percentile of
        `y` there.
    """
    edges = np.linspace(x.min(), x.max(), _BINS + 1)
    which = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, _BINS - 1)
    order = np.argsort(which, kind="stable")
    cuts = np.searchsorted(which[order], np.arange(_BINS + 1))
    rows = [
        (0.5 * (edges[b] + edges[b + 1]), *np.quantile(y[order[first:end]], [0.05, 0.5, 0.95]))
        for b, (first, end) in enumerate(pairwise(cuts))
        if end - first >= _FEW
    ]
    table = np.array(rows, dtype=float).reshape(-1, 4)
    return table[:, 0], table[:, 1], table[:, 2], table[:, 3]
