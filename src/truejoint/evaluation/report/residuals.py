"""Figures of what is left of the error, against what might explain it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np

from truejoint.evaluation.report import plot
from truejoint.evaluation.report.plot import BLUE, ORANGE, Figure, Spec
from truejoint.evaluation.results import (
    Evaluation,
    estimator_phrase,
    hung_masses,
    pooled_error,
    shown_joints,
)
from truejoint.recordings.recording import Array
from truejoint.units import DisplayUnit, display_unit

_POINTS: Final = 1200  # of each direction in each panel
_BINS: Final = 24
_FEW: Final = 8  # rows below which a bin has no median


@dataclass(frozen=True)
class _Panel:
    """One cause: axis title, values (n,) in its unit, and those that it has where they are few."""

    title: str
    values: Array
    steps: tuple[float, ...] = ()


def residuals(evaluation: Evaluation) -> list[Figure]:
    """Return one figure a joint: error against position, velocity, effort, hung mass and time."""
    figures = []
    for column, joint, unit in shown_joints(evaluation):
        error = unit.scale * pooled_error(evaluation.traces, evaluation.chosen, column)
        moves = np.concatenate([trace.direction[:, column] for trace in evaluation.traces])
        panels = _panels(evaluation, column, unit)
        causes = [panel.title.partition(" [")[0] for panel in panels]
        against = f"{', '.join(causes[:-1])} and {causes[-1]}"
        several = " (recordings end to end)" if len(evaluation.traces) > 1 else ""
        caption = (
            f"{joint}: error left by {estimator_phrase(evaluation.chosen)} [{unit.name}] against "
            f"{against}{several}. Dots are rows, blue while the joint moves up and orange while it "
            "moves down; lines are medians, bands hold the middle 90 %."
        )
        spec = _spec(panels, error, moves, f"error [{unit.name}]")
        figures.append(Figure(f"residual-{column}", f"{joint} residuals", caption, [spec]))
    return figures


def _panels(evaluation: Evaluation, column: int, unit: DisplayUnit) -> list[_Panel]:
    joint, traces = evaluation.joints[column], evaluation.traces
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
    if masses := hung_masses(traces):
        loads = [trace.provenance.get("load") for trace in traces]
        values = np.repeat(
            [math.nan if load is None else 1e3 * load for load in loads],
            [len(trace.t) for trace in traces],
        )
        panels.append(_Panel("hung mass [g]", values, tuple(1e3 * mass for mass in masses)))
    times, start = [], 0.0
    for trace in traces:
        times.append(trace.t - trace.t[0] + start)
        start = float(times[-1][-1])
    return [*panels, _Panel("time [s]", np.concatenate(times))]


def _spec(panels: list[_Panel], error: Array, moves: Array, title: str) -> Spec:
    data: list[Spec] = []
    axes: Spec = {}
    low, high = float(error.min()), float(error.max())
    margin = 0.05 * (high - low) or 1e-9
    domains = plot.columns(len(panels), 0.035)
    for i, (panel, domain) in enumerate(zip(panels, domains, strict=True)):
        ticks: Spec = {"nticks": 6}
        apart = panel.steps[-1] - panel.steps[0] if panel.steps else 0.0
        if panel.steps:
            around = [panel.steps[0] - 0.2 * apart, panel.steps[-1] + 0.2 * apart]
            ticks = {"tickvals": list(panel.steps), "range": around}
        errors: Spec = {"title": "" if i else title, "range": [low - margin, high + margin]}
        errors |= {"showticklabels": i == 0, "zeroline": True}
        causes = {"title": panel.title, "domain": domain, **ticks}
        own, place = plot.panel(i, causes, errors)
        axes |= own
        for name, colour, side in (("moving up", BLUE, 1), ("moving down", ORANGE, -1)):
            rows = moves == side
            x, y = panel.values[rows], error[rows]
            hidden = {"legendgroup": name, "showlegend": False, **place}
            if rows.any() and panel.steps:
                data.append(_bars(x, y, panel.steps, 0.04 * side * apart, name, colour, hidden))
            elif rows.any():
                data += _cloud(x, y, name, colour, hidden, legend=i == 0)
    return plot.drawing(data, 270, **axes)


def _cloud(
    x: Array, y: Array, name: str, colour: str, hidden: Spec, *, legend: bool
) -> Iterable[Spec]:
    """Dots, and the median and the middle 90 % of `y` (n,) along `x` (n,)."""
    keep = plot.every(len(x), _POINTS)
    style = {"marker": {"color": colour, "size": 2.5, "opacity": 0.22}, "hoverinfo": "skip"}
    dots = plot.scatter("markers", x[keep], y[keep], name, **style, **hidden)
    centre, low, middle, high = binned(x, y)
    around = np.concatenate((centre, centre[::-1])), np.concatenate((high, low[::-1]))
    fill = {"fill": "toself", "fillcolor": colour, "opacity": 0.14, "hoverinfo": "skip"}
    band = plot.curve(*around, name, colour, width=0, **fill, **hidden)
    median = plot.curve(centre, middle, name, colour, width=1.8, **hidden | {"showlegend": legend})
    return dots, band, median


def _bars(
    x: Array, y: Array, steps: tuple[float, ...], apart: float, name: str, colour: str, hidden: Spec
) -> Spec:
    """Median and middle 90 % of `y` (n,) at each of a few values, beside the other direction's."""
    place, low, middle, high = _quantiles((step + apart, y[x == step]) for step in steps)
    ends = {"array": plot.packed(high - middle), "arrayminus": plot.packed(middle - low)}
    bars = {**ends, "thickness": 1.5, "width": 4, "color": colour}
    style = {"marker": {"color": colour, "size": 7}, "error_y": bars}
    return plot.scatter("markers", place, middle, name, **style, **hidden)


def binned(x: Array, y: Array) -> Array:
    """Centres of the equal bins of `x` (n,) that hold 8 rows, and quantiles of `y` there, (4, m).

    The quantiles are the 5th, 50th and 95th percentile.
    """
    edges = np.linspace(x.min(), x.max(), _BINS + 1)
    which = np.searchsorted(edges[1:-1], x, side="right")
    return _quantiles((0.5 * (edges[k] + edges[k + 1]), y[which == k]) for k in range(_BINS))


def _quantiles(groups: Iterable[tuple[float, Array]]) -> Array:
    rows = [(x, *np.quantile(y, [0.05, 0.5, 0.95])) for x, y in groups if len(y) >= _FEW]
    return np.array(rows, dtype=float).reshape(-1, 4).T
