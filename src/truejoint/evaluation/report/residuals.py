"""Figures of what is left of the error: against what might explain it, and what was stated."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import cycle
from typing import Final, NamedTuple

import numpy as np

from truejoint import drawing
from truejoint.array_types import Array
from truejoint.drawing import BLUE, ORANGE
from truejoint.evaluation.report import plot
from truejoint.evaluation.report.plot import Figure, Spec
from truejoint.evaluation.results import Evaluation, estimator_phrase, known_loads
from truejoint.units import DisplayUnit, display_unit

POINTS: Final = 3600  # of each direction in a panel of every joint together, at most 1200 of one
_BINS: Final = 24
_FEW: Final = 8  # rows below which a bin has no median

_WAYS: Final = (("moving up", BLUE, 1), ("moving down", ORANGE, -1))
_HEIGHT: Final = 280  # of the figures of the interval
_EQUAL: Final = {"width": 1.0, "dash": "dash", "hoverinfo": "skip"}


class Panel(NamedTuple):
    """Errors (n,) over one cause: axis title, its values (n,), and which it has if they are few."""

    title: str
    values: Array
    error: Array
    steps: tuple[float, ...] = ()


def residuals(evaluation: Evaluation) -> Iterator[Figure]:
    """Draw one figure a joint: error against position, velocity, effort, hung mass and time."""
    for column, joint, unit in evaluation.shown_joints():
        error = unit.scale * evaluation.error(evaluation.chosen, column)
        moves = np.concatenate([trace.direction[:, column] for trace in evaluation.traces])
        panels = list(_panels(evaluation, column, unit, error))
        causes = [panel.title.partition(" [")[0] for panel in panels]
        against = f"{', '.join(causes[:-1])} and {causes[-1]}"
        several = " (recordings end to end)" if len(evaluation.traces) > 1 else ""
        caption = (
            f"{joint}: error left by {estimator_phrase(evaluation.chosen)} [{unit.name}] against "
            f"{against}{several}. Dots are rows, blue while the joint moves up and orange while it "
            "moves down; lines are medians, bands hold the middle 90 %."
        )
        most = min(1200, POINTS // len(evaluation.joints))
        spec = error_panels(panels, moves, unit, most)
        yield Figure(f"residual-{column}", f"{joint} residuals", caption, [spec])


def _panels(
    evaluation: Evaluation, column: int, unit: DisplayUnit, error: Array
) -> Iterator[Panel]:
    joint, traces = evaluation.joints[column], evaluation.traces
    position = np.concatenate([trace.truth[:, column] for trace in traces])
    velocity = np.concatenate([trace.velocity[:, column] for trace in traces])
    yield Panel(f"position [{unit.name}]", unit.scale * position, error)
    yield Panel(f"velocity [{unit.name}/s]", unit.scale * velocity, error)
    if all(joint in trace.effort for trace in traces):
        effort = display_unit(traces[0].effort_unit[joint])
        values = np.concatenate([trace.effort[joint] for trace in traces])
        label = f" [{effort.name}]" if effort.name != "1" else " [no unit]"
        yield Panel(f"effort{label}", effort.scale * values, error)
    masses = known_loads(traces)
    if len(masses) > 1:
        loads = [trace.provenance.get("load") for trace in traces]
        values = np.repeat(
            [math.nan if load is None else 1e3 * load for load in loads],
            [len(trace.t) for trace in traces],
        )
        yield Panel("hung mass [g]", values, error, tuple(1e3 * mass for mass in masses))
    times, start = [], 0.0
    for trace in traces:
        times.append(trace.t - trace.t[0] + start)
        start = float(times[-1][-1])
    yield Panel("time [s]", np.concatenate(times), error)


def error_panels(panels: Sequence[Panel], moves: Array, unit: DisplayUnit, most: int) -> Spec:
    """Panels side by side on one scale, with at most so many dots of each direction in one.

    `moves` (n,) is the direction of motion: 1, -1 or 0.
    """
    drawn = []
    every = np.concatenate([panel.error for panel in panels])
    low, high = float(every.min()), float(every.max())
    margin = 0.05 * (high - low) or 1e-9
    for i, panel in enumerate(panels):
        across: Spec = {"title": panel.title, "nticks": 6}
        up: Spec = {"title": "" if i else f"error [{unit.name}]", "zeroline": True}
        up |= {"range": [low - margin, high + margin], "showticklabels": i == 0}
        curves: list[Spec] = []
        for name, colour, side in _WAYS:
            x, y = panel.values[moves == side], panel.error[moves == side]
            if len(x) and panel.steps:
                extent = panel.steps[-1] - panel.steps[0]
                ends = [panel.steps[0] - 0.2 * extent, panel.steps[-1] + 0.2 * extent]
                across |= {"tickvals": list(panel.steps), "range": ends}
                curves.append(_bars(x, y, panel.steps, 0.04 * side * extent, name, colour))
            elif len(x):
                curves += _cloud(x, y, name, colour, most, legend=i == 0)
        drawn.append((across, up, curves))
    return plot.panels(drawn, 230, len(panels), 0.035)


def _cloud(
    x: Array, y: Array, name: str, colour: str, most: int, *, legend: bool
) -> Iterable[Spec]:
    """At most `most` dots, and the median and the middle 90 % of `y` (n,) along `x` (n,)."""
    keep, hidden = plot.every(len(x), most), {"legendgroup": name, "showlegend": False}
    style = {"marker": {"color": colour, "size": 2.5, "opacity": 0.22}, "hoverinfo": "skip"}
    dots = plot.scatter("markers", x[keep], y[keep], name, **style, **hidden)
    centre, low, middle, high = binned(x, y)
    around = np.concatenate((centre, centre[::-1])), np.concatenate((high, low[::-1]))
    fill = {"fill": "toself", "fillcolor": colour, "opacity": 0.14, "hoverinfo": "skip"}
    band = plot.curve(*around, name, colour, width=0, **fill, **hidden)
    median = plot.curve(centre, middle, name, colour, width=1.8, **hidden | {"showlegend": legend})
    return dots, band, median


def _bars(
    x: Array, y: Array, steps: tuple[float, ...], shift: float, name: str, colour: str
) -> Spec:
    """Median and middle 90 % of `y` (n,) at each of a few values, beside the other direction's."""
    place, low, middle, high = _quantiles((step + shift, y[x == step]) for step in steps)
    ends = {"array": plot.packed(high - middle), "arrayminus": plot.packed(middle - low)}
    bars = {**ends, "thickness": 1.5, "width": 4, "color": colour}
    style = {**_dots(colour), "error_y": bars, "legendgroup": name, "showlegend": False}
    return plot.scatter("markers", place, middle, name, **style)


def binned(x: Array, y: Array) -> Array:
    """Centres of equal bins of `x` (n,), and 5th, 50th, 95th percentile of `y` there, (4, m)."""
    edges = np.linspace(x.min(), x.max(), _BINS + 1)
    which = np.searchsorted(edges[1:-1], x, side="right")
    return _quantiles((0.5 * (edges[k] + edges[k + 1]), y[which == k]) for k in range(_BINS))


def _quantiles(groups: Iterable[tuple[float, Array]]) -> Array:
    rows = [(x, *np.quantile(y, [0.05, 0.5, 0.95])) for x, y in groups if len(y) >= _FEW]
    return np.array(rows, dtype=float).reshape(-1, 4).T


def stated_interval(evaluation: Evaluation) -> list[Figure]:
    """Found against stated coverage, with several levels; coverage of each of several motions."""
    figures = []
    stated = np.array(sorted({score.level for score in evaluation.intervals}))
    several = len(evaluation.interval_trajectories) > 1
    if len(stated) > 1:
        margin = 15 * (stated[-1] - stated[0])
        ends = 100 * np.array([max(stated[0] - 0.2, 0.0), 1.0])
        data = [plot.curve(ends, ends, "equal", drawing.INK, **_EQUAL)]
        for joint, colour, beside in _joints(evaluation):
            rows = [score for score in evaluation.intervals if score.joint == joint]
            level = 100 * np.array([row.level for row in rows]) + 0.06 * margin * beside
            coverage = 100 * np.array([row.coverage for row in rows])
            style = _dots(colour) | {"line": {"color": colour, "width": 1.3}}
            if several:
                errors = 100 * np.array([row.standard_error for row in rows])
                style["error_y"] = {"array": plot.packed(errors), "thickness": 1.3, "width": 4}
            data.append(plot.scatter("lines+markers", level, coverage, joint, **style))
        lowest = min(stated[0], *(score.coverage for score in evaluation.intervals))
        across = [100 * stated[0] - margin, min(100 * stated[-1] + margin, 100.0)]
        x = {"title": "stated [%]", "range": across, "tickvals": (100 * stated).tolist()}
        y = {"title": "found inside [%]", "range": [max(0.0, 100 * lowest - 8.0), 101.0]}
        errors_text = "; bars are its sampling error over trajectories" if several else ""
        caption = (
            "Share of the test's samples inside the interval against what it states, joint by "
            f"joint{errors_text}. On the dashed line both are equal; below it the interval is too "
            "narrow."
        )
        spec = plot.panels([(x, y, data)], _HEIGHT)
        title = "Stated and found coverage"
        figures.append(Figure("calibration", title, caption, [spec], wide=False))
    if len(stated) and several:
        level, names = evaluation.interval_level, evaluation.interval_trajectories
        number, ends = np.arange(1.0, len(names) + 1.0), np.array([0.5, len(names) + 0.5])
        title = f"stated {100 * level:g} %"
        data = [plot.curve(ends, np.full(2, 100 * level), title, drawing.INK, **_EQUAL)]
        text = {"text": [plot.plain(n) for n in names], "hovertemplate": "%{text}: %{y:.1f} %"}
        shares = {
            s.joint: 100 * np.array(s.shares) for s in evaluation.intervals if s.level == level
        }
        for joint, colour, beside in _joints(evaluation):
            place = number + 0.12 * beside
            data.append(
                plot.scatter("markers", place, shares[joint], joint, **_dots(colour), **text)
            )
        x = {"title": "trajectory of the test", "range": list(ends), "dtick": -(-len(names) // 10)}
        lowest = min(values.min() for values in shares.values())
        y = {"title": "inside [%]", "range": [max(0.0, 0.95 * lowest - 2), 102.0]}
        caption = (
            f"Share of the samples of each trajectory inside the {100 * level:g} % interval, in "
            "the order of the test. The statement is about their mean: one may lie inside "
            "altogether, another half outside."
        )
        spec, title = plot.panels([(x, y, data)], _HEIGHT), "Coverage of each trajectory"
        figures.append(Figure("coverage", title, caption, [spec], wide=False))
    return figures


def _dots(colour: str) -> Spec:
    return {"marker": {"color": colour, "size": 7}}


def _joints(evaluation: Evaluation) -> list[tuple[str, str, float]]:
    """Joints, the colour of each, and its place beside the others: -2 to 2, 0 for a single one."""
    count = len(evaluation.joints)
    places = np.linspace(-2.0, 2.0, count) if count > 1 else np.zeros(1)
    return list(zip(evaluation.joints, cycle(drawing.PALETTE), places.tolist(), strict=False))
