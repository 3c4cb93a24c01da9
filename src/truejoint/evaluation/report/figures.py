"""Figures of the pages: over time and position, what is left of the error, where it is, touches."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import cycle
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from scipy.stats import binned_statistic_2d

from truejoint.array_types import Array, Mask
from truejoint.drawing import BLUE, GREY, INK, ORANGE, PALETTE
from truejoint.evaluation.report import plot
from truejoint.evaluation.report.plot import COLOURS, Figure, Spec, colour_of
from truejoint.evaluation.results import (
    OFFSET,
    RAW,
    Evaluation,
    IntervalScore,
    Trace,
    estimator_phrase,
    estimator_title,
    known_loads,
)
from truejoint.recordings.table.recording import Recording
from truejoint.recordings.table.stream import gaps, velocity
from truejoint.tables import fixed, shown
from truejoint.units import DisplayUnit, display_unit

if TYPE_CHECKING:
    from truejoint.tip import TouchReport

MENU: Final = 36  # curves over time that the page offers, of all joints; at most 12 recordings
_BUDGET: Final = 600_000  # bytes that the time figures may take of the page
_CURVE_BYTES: Final = 22.0  # of one bucket: two points of x and y in base64
_STRETCHES: Final = 6
_STRETCH_BUCKETS: Final = 300
_LOOP_POINTS: Final = 6000  # of all joints together
_ALL: Final = slice(None)

_POINTS: Final = 3600  # of each direction in a panel of every joint together, at most 1200 of one
_BINS: Final = 24
_FEW: Final = 8  # rows below which a bin has no median, and a cell of a map is left blank
_WAYS: Final = (("moving up", BLUE, 1), ("moving down", ORANGE, -1))
_HEIGHT: Final = 280  # of the figures of the interval
_EQUAL: Final = {"width": 1.0, "dash": "dash", "hoverinfo": "skip"}

_PATH_POINTS: Final = 3000  # of a curve in space; more are not seen at this size
_CELLS: Final = (6, 24)  # of a map along each axis, at least and at most
_ARROW: Final = 0.15  # of the block's width, of the largest error
_VIEWS: Final = ((0, 1, "from above"), (0, 2, "from the side"))

# Curves (n, k) with title and colour.
_Groups = Sequence[tuple[str, str, Sequence[Array]]]


def menu_order(evaluation: Evaluation) -> list[int]:
    """Traces that the time figures show, worst first: by RMSE as a multiple of the limit."""
    limits = [joint.limit for joint in evaluation.verdict.joints]
    ratio = [
        np.max(np.sqrt(np.mean(trace.error(evaluation.chosen) ** 2, axis=0)) / limits)
        for trace in evaluation.traces
    ]
    count = min(12, max(1, MENU // len(limits)))
    return [int(i) for i in np.argsort(-np.array(ratio), kind="stable")][:count]


def over_time(evaluation: Evaluation) -> list[Figure]:
    """Return one figure a joint: corrected and true position, and the error, over time."""
    order = menu_order(evaluation)
    banded = any(trace.lower is not None for trace in evaluation.traces)
    curves = (14 if banded else 6) * len(order) * len(evaluation.joints)
    buckets = int(np.clip(_BUDGET / (_CURVE_BYTES * curves), 50, 1800))
    return [
        Figure(
            f"time-{column}",
            f"{joint} over time",
            f"{joint}: true position, estimates and their error [{unit.name}] over time [s].",
            [_tracking(evaluation, evaluation.traces[i], column, buckets) for i in order],
        )
        for column, joint, unit in evaluation.shown_joints()
    ]


def worst_stretches(evaluation: Evaluation) -> Iterator[Figure]:
    """Draw the worst windows in full, worst first."""
    for rank, stretch in enumerate(evaluation.worst[:_STRETCHES], 1):
        column, unit = evaluation.joints.index(stretch.joint), display_unit(stretch.unit)
        trace = evaluation.traces[stretch.recording]
        rows = (trace.t >= stretch.start) & (trace.t <= stretch.end)
        rmse, largest = shown([stretch.rmse * unit.scale, stretch.max_abs * unit.scale])
        caption = (
            f"{rank}. {stretch.joint}, {trace.name}, {fixed(stretch.start, 1)} to "
            f"{fixed(stretch.end, 1)} s: RMSE {rmse} {unit.name}, largest error {largest} "
            f"{unit.name}."
        )
        spec = _tracking(evaluation, trace, column, _STRETCH_BUCKETS, rows)
        key, label = f"stretch-{rank - 1}", f"Worst stretch {rank}"
        yield Figure(key, label, caption, [spec], wide=False)


def _tracking(
    evaluation: Evaluation, trace: Trace, column: int, buckets: int, rows: Mask | slice = _ALL
) -> Spec:
    """Positions above, errors below; with the raw position and a legend of all when whole."""
    whole, chosen, unit = rows is _ALL, evaluation.chosen, display_unit(evaluation.units[column])
    t, truth = trace.t[rows], trace.truth[rows, column] * unit.scale
    upper: Spec = {"xaxis": "x", "yaxis": "y"}
    lower: Spec = {"xaxis": "x", "yaxis": "y2"}
    true = plot.thinned(t, truth, buckets)
    data = [plot.curve(*true, "True", COLOURS["truth"], width=1.5, dash="dot", **upper)]
    if trace.lower is not None and trace.upper is not None:
        curves = (trace.lower, trace.upper, trace.estimates[chosen])
        low, high, middle = (unit.scale * curve[rows, column] for curve in curves)
        bounded = np.flatnonzero(np.isfinite(low))
        if len(bounded) >= 2:
            widest = plot.extreme_rows((high - low)[bounded], buckets // 4)
            bounded = bounded[np.union1d(plot.extreme_rows(middle[bounded], buckets), widest)]
            pieces = np.searchsorted(gaps(t), bounded, side="left")
            name = f"{100 * evaluation.interval_level:g} % interval"
            band: Spec = {"width": 0, "fill": "toself", "fillcolor": plot.BAND}
            band |= {"hoverinfo": "skip", "legendrank": 1001}
            low, high, middle = low[bounded], high[bounded], middle[bounded]
            around = plot.outline(t[bounded], low, high, pieces)
            errors = plot.outline(t[bounded], middle - high, middle - low, pieces)
            for edge, place, legend in ((around, upper, whole), (errors, lower, False)):
                options = {**band, **place, "showlegend": legend}
                data.append(plot.curve(*edge, name, COLOURS["chosen"], **options))
    # The chosen one last, so that it lies on top.
    for name in [n for n in (RAW, OFFSET) if n != chosen and (whole or n != RAW)] + [chosen]:
        title, colour = estimator_title(name), colour_of(name, evaluation)
        values = trace.estimates[name][rows, column] * unit.scale
        visible = "legendonly" if name == RAW != chosen else True
        for curve, place in ((values, upper), (values - truth, {"showlegend": False, **lower})):
            thin = plot.thinned(t, curve, buckets)
            data.append(plot.curve(*thin, title, colour, visible=visible, **place))
    return plot.drawing(
        data,
        380 if whole else 330,
        xaxis=plot.axis("time [s]", anchor="y2"),
        yaxis=plot.axis(f"position [{unit.name}]", domain=[0.43, 1.0]),
        yaxis2=plot.axis(f"error [{unit.name}]", domain=[0.0, 0.36], zeroline=True),
    )


def loops(evaluation: Evaluation) -> Figure:
    """Error against position, before and after; cable hysteresis shows as loops."""
    most = _LOOP_POINTS // len(evaluation.joints)
    pairs = ((OFFSET, COLOURS[OFFSET], 0.45), (evaluation.chosen, COLOURS["chosen"], 0.8))
    panels = []
    for column, joint, unit in evaluation.shown_joints():
        curves = []
        for name, colour, opacity in pairs:
            paths = [
                unit.scale * np.column_stack((trace.truth[:, column], trace.error(name)[:, column]))
                for trace in evaluation.traces
            ]
            options = {"width": 0.7, "opacity": opacity, "showlegend": column == 0}
            curves.append(plot.path(paths, most, estimator_title(name), colour, **options))
        x = {"title": f"{joint} position [{unit.name}]"}
        panels.append((x, {"title": f"error [{unit.name}]"}, curves))
    caption = (
        "Error against true position, as the motion runs through it: before (fixed offset) and "
        "after calibration. Width of a loop is hysteresis, slope is stretch under changing load."
    )
    return Figure("loops", "Hysteresis loops", caption, [plot.panels(panels, 300)])


def distributions(evaluation: Evaluation, colours: Mapping[str, str]) -> Figure:
    """Draw the share of the test's rows within an error, a curve for each estimator of `colours`.

    A panel each for the joints, and for the tool where its paths are known.
    """
    shown = [
        (joint, unit, {name: unit.scale * evaluation.error(name, column) for name in colours})
        for column, joint, unit in evaluation.shown_joints()
    ]
    if colours.keys() <= evaluation.traces[0].tool.keys():
        unit = display_unit("m")
        distances = {
            name: unit.scale * np.linalg.norm(evaluation.tool_error(name), axis=1)
            for name in colours
        }
        shown.append(("tool", unit, distances))
    share = np.linspace(0.0, 1.0, 201)
    panels = []
    for i, (name, unit, errors) in enumerate(shown):
        curves = [
            plot.curve(
                np.quantile(np.abs(error), share), 100.0 * share, estimator_title(key),
                colours[key], width=1.6, showlegend=i == 0,
            )
            for key, error in errors.items()
        ]  # fmt: skip
        x = {"title": f"|error| of {name} [{unit.name}]", "rangemode": "tozero"}
        panels.append((x, {"title": "share of rows within [%]", "range": [0, 101]}, curves))
    caption = (
        "Share of the test's rows within a given error: absolute error of each joint, and distance "
        "of the tool from its true position where its kinematics are known."
    )
    return Figure("distribution", "Distribution of errors", caption, [plot.panels(panels, 280)])


class Panel(NamedTuple):
    """Errors (n,) over one cause: axis title, its values (n,), and which it has if they are few."""

    title: str
    values: Array
    error: Array
    steps: tuple[float, ...] = ()


def residuals(evaluation: Evaluation, models: Sequence[str] = ()) -> Iterator[Figure]:
    """Draw one figure a joint: the chosen model's error against position, velocity and so on.

    Of several `models` it is the error of each against position, on one scale.
    """
    for column, joint, unit in evaluation.shown_joints():
        moves = np.concatenate([trace.direction[:, column] for trace in evaluation.traces])
        panels = list(_panels(evaluation, column, unit, models))
        most = min(1200, _POINTS // len(evaluation.joints))
        causes = [panel.title.partition(" [")[0] for panel in panels]
        end_to_end = " (recordings end to end)" if len(evaluation.traces) > 1 else ""
        of = (
            f"error left by {estimator_phrase(evaluation.chosen)} [{unit.name}] against "
            f"{', '.join(causes[:-1])} and {causes[-1]}{end_to_end}"
        )
        if models:
            most = _POINTS // len(models)
            of = f"error [{unit.name}] against position, a panel a model"
        caption = (
            f"{joint}: {of}. Dots are rows, blue while the joint moves up and orange while it "
            "moves down; lines are medians, bands hold the middle 90 %."
        )
        spec = error_panels(panels, moves, unit, most)
        yield Figure(f"residual-{column}", f"{joint} residuals", caption, [spec])


def _panels(
    evaluation: Evaluation, column: int, unit: DisplayUnit, models: Sequence[str]
) -> Iterator[Panel]:
    joint, traces = evaluation.joints[column], evaluation.traces
    position = unit.scale * np.concatenate([trace.truth[:, column] for trace in traces])
    for name in models:
        error = unit.scale * evaluation.error(name, column)
        yield Panel(f"{name}: position [{unit.name}]", position, error)
    if models:
        return
    error = unit.scale * evaluation.error(evaluation.chosen, column)
    speed = unit.scale * np.concatenate([trace.velocity[:, column] for trace in traces])
    yield Panel(f"position [{unit.name}]", position, error)
    yield Panel(f"velocity [{unit.name}/s]", speed, error)
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


def stated_interval(evaluation: Evaluation) -> Iterator[Figure]:
    """Found against stated coverage, with several levels; coverage of each of several motions."""
    level, names = evaluation.interval_level, evaluation.interval_trajectories
    scores: dict[str, list[IntervalScore]] = {joint: [] for joint in evaluation.joints}
    for score in evaluation.intervals:
        scores[score.joint].append(score)
    stated = 100 * np.array(sorted({score.level for score in evaluation.intervals}))
    several = len(names) > 1
    if len(stated) > 1:
        margin = 0.15 * (stated[-1] - stated[0])
        ends = np.array([max(stated[0] - 20, 0.0), 100.0])
        data = [plot.curve(ends, ends, "equal", INK, **_EQUAL)]
        for joint, colour, beside in _joints(evaluation):
            rows = np.array([(s.level, s.coverage, s.standard_error) for s in scores[joint]])
            x, y, errors = 100 * rows.T
            style = _dots(colour) | {"line": {"color": colour, "width": 1.3}}
            if several:
                style["error_y"] = {"array": plot.packed(errors), "thickness": 1.3, "width": 4}
            x = x + 0.06 * margin * beside
            data.append(plot.scatter("lines+markers", x, y, joint, **style))
        lowest = min(stated[0], *(100 * score.coverage for score in evaluation.intervals))
        range_ = [stated[0] - margin, min(stated[-1] + margin, 100.0)]
        across = {"title": "stated [%]", "range": range_, "tickvals": stated.tolist()}
        up = {"title": "found inside [%]", "range": [max(0.0, lowest - 8.0), 101.0]}
        errors_text = "; bars are its sampling error over trajectories" if several else ""
        caption = (
            "Share of the test's samples inside the interval against what it states, joint by "
            f"joint{errors_text}. On the dashed line both are equal; below it the interval is too "
            "narrow."
        )
        spec, title = plot.panels([(across, up, data)], _HEIGHT), "Stated and found coverage"
        yield Figure("calibration", title, caption, [spec], wide=False)
    if len(stated) and several:
        number, ends = np.arange(1.0, len(names) + 1.0), np.array([0.5, len(names) + 0.5])
        title = f"stated {100 * level:g} %"
        data = [plot.curve(ends, np.full(2, 100 * level), title, INK, **_EQUAL)]
        text = {"text": [plot.plain(n) for n in names], "hovertemplate": "%{text}: %{y:.1f} %"}
        lowest = 100.0
        for joint, colour, beside in _joints(evaluation):
            (shares,) = (100 * np.array(s.shares) for s in scores[joint] if s.level == level)
            lowest, place = min(lowest, shares.min()), number + 0.12 * beside
            data.append(plot.scatter("markers", place, shares, joint, **_dots(colour), **text))
        ticks = -(-len(names) // 10)
        across = {"title": "trajectory of the test", "range": list(ends), "dtick": ticks}
        up = {"title": "inside [%]", "range": [max(0.0, 0.95 * lowest - 2), 102.0]}
        caption = (
            f"Share of the samples of each trajectory inside the {100 * level:g} % interval, in "
            "the order of the test. The statement is about their mean: one may lie inside "
            "altogether, another half outside."
        )
        spec, title = plot.panels([(across, up, data)], _HEIGHT), "Coverage of each trajectory"
        yield Figure("coverage", title, caption, [spec], wide=False)


def _dots(colour: str) -> Spec:
    return {"marker": {"color": colour, "size": 7}}


def _joints(evaluation: Evaluation) -> list[tuple[str, str, float]]:
    """Joints, the colour of each, and its place beside the others: -2 to 2, 0 for a single one."""
    count = len(evaluation.joints)
    places = np.linspace(-2.0, 2.0, count) if count > 1 else np.zeros(1)
    return list(zip(evaluation.joints, cycle(PALETTE), places.tolist(), strict=False))


def trajectories(evaluation: Evaluation, training: Sequence[Recording]) -> Figure:
    """Measured joint positions in training and test: in 3-D, a plane, or against speed."""
    names, scale = _joint_axes(evaluation)
    taught = [(r.t, r.columns("measured", evaluation.joints)) for r in training]
    paths = {
        "training": [np.hstack((x, velocity(t, x))) for t, x in taught],
        "test": [np.hstack((trace.measured, trace.velocity)) for trace in evaluation.traces],
    }
    title, what = "Trajectories in joint space", "Measured joint positions"
    if len(evaluation.joints) == 1:
        title = "Position and speed covered"
        what = f"Measured position of {evaluation.joints[0]} against its speed"
    groups = [
        (name, colour, [scale * path[:, : len(names)] for path in paths[name]])
        for name, colour in (("training", GREY), ("test", BLUE))
    ]
    caption = (
        f"{what} while training (grey) and in the test (blue). A calibration is to be trusted "
        "where the two overlap."
    )
    if len(names) == 2:
        style = {"width": 1.0, "opacity": 0.7}
        curves = [
            plot.path(parts, _PATH_POINTS, name, colour, **style)
            for name, colour, parts in groups
            if parts
        ]
        spec = plot.panels([({"title": names[0]}, {"title": names[1]}, curves)], 360)
        return Figure("trajectories", title, caption, [spec])
    if len(names) > 3:
        caption += f" The first three of {len(names)} calibrated joints are shown."
    return _space("trajectories", title, caption, groups, names[:3], "cube")


def tool_paths(evaluation: Evaluation) -> list[Figure]:
    """Tool path in the base frame, true and estimated; nothing without kinematics."""
    if not evaluation.cartesian:
        return []
    groups = [
        (title, colour, [1e3 * trace.tool[key] for trace in evaluation.traces])
        for title, colour, key in (
            ("true", INK, "truth"),
            ("fixed offset", ORANGE, OFFSET),
            (estimator_title(evaluation.chosen), BLUE, evaluation.chosen),
        )
    ]
    caption = (
        "Tool position in the base frame, through the same forward kinematics for the true, the "
        "fixed-offset and the calibrated joint positions."
    )
    names = ["x [mm]", "y [mm]", "z [mm]"]
    return [_space("tool-paths", "Tool path", caption, groups, names, "data")]


def error_maps(evaluation: Evaluation) -> Iterator[Figure]:
    """Map each joint's RMSE, and the mean half-width that it states, over the workspace."""
    points, names, where = _workspace(evaluation)
    widest = np.argsort(-np.ptp(points[:, :3], axis=0), kind="stable")[:2]
    a, b = sorted(widest.tolist())
    # A cell that an even motion would cross in three times the rows that it needs.
    count = int(np.clip(np.sqrt(len(points) / (3 * _FEW)), *_CELLS))
    plane = points[:, a], points[:, b]
    crossed = binned_statistic_2d(*plane, points[:, 0], "count", bins=count)
    edges = [crossed.x_edge, crossed.y_edge]
    visited = crossed.statistic >= _FEW
    middle = [0.5 * (edge[1:] + edge[:-1]) for edge in edges]
    x, y = (grid[visited] for grid in np.meshgrid(*middle, indexing="ij"))

    def mean(values: Array) -> Array:
        """Mean of `values` (n,) in each visited cell, 0 where none is finite."""
        rows = np.isfinite(values)
        x, y = (axis[rows] for axis in plane)
        means = binned_statistic_2d(x, y, values[rows], "mean", bins=edges).statistic
        return np.nan_to_num(np.asarray(means, dtype=np.float64)[visited])

    for column, joint, unit in evaluation.shown_joints():
        square = np.square(unit.scale * evaluation.error(evaluation.chosen, column))
        layers = [(f"RMSE [{unit.name}]", np.sqrt(mean(square)))]
        half = [
            0.5 * (trace.upper - trace.lower)[:, column]
            for trace in evaluation.traces
            if trace.lower is not None and trace.upper is not None
        ]
        if len(half) == len(evaluation.traces):
            layers.append((f"half-width [{unit.name}]", mean(unit.scale * np.concatenate(half))))
        panels: list[plot.Panel] = []
        for title, values in layers:
            highest = float(np.quantile(values, 0.95)) if len(values) else 1.0
            dots = plot.coloured(x, y, values, title, highest, symbol="square")
            dots["meta"] = {"cells": count}  # for the size of the squares
            across, up = (
                {"title": names[i], "range": [edge[0], edge[-1]], "zeroline": False}
                for i, edge in zip((a, b), edges, strict=True)
            )
            panels.append((across, up, [dots]))
        said = " and the mean half-width that is stated" if len(layers) > 1 else ""
        caption = (
            f"{joint}: RMSE of {estimator_phrase(evaluation.chosen)}{said} over {where}, in "
            f"cells that at least {_FEW} rows of the test crossed; scales end at the 95th "
            "percentile."
        )
        spec = plot.panels(panels, 280, gap=0.2, width=0.9)
        title, wide = f"{joint}: error over the workspace", len(layers) > 1
        yield Figure(f"map-{column}", title, caption, [spec], wide=wide)


def _workspace(evaluation: Evaluation) -> tuple[Array, list[str], str]:
    """Points (n, k) that the test crossed, their axis titles, and what they are.

    These are tool positions [mm] or, without kinematics, joint positions and of one joint its
    speed.
    """
    traces = evaluation.traces
    if evaluation.cartesian:
        true = 1e3 * np.concatenate([trace.tool["truth"] for trace in traces])
        return true, ["x [mm]", "y [mm]", "z [mm]"], "the tool's position"
    names, scale = _joint_axes(evaluation)
    points = np.concatenate([np.hstack((trace.truth, trace.velocity)) for trace in traces])
    where = "two joints" if len(evaluation.joints) > 1 else "position and speed"
    return scale * points[:, : len(names)], names, where


def _joint_axes(evaluation: Evaluation) -> tuple[list[str], Array]:
    """Titles and factors from SI of the axes of a space of joints, or of one joint and its speed.

    They are those of the first columns of positions beside velocities.
    """
    joints = evaluation.shown_joints()
    names = [f"{joint} [{unit.name}]" for _, joint, unit in joints]
    scale = [unit.scale for _, _, unit in joints]
    if len(joints) == 1:
        names.append(f"speed [{joints[0][2].name}/s]")
        scale *= 2
    return names, np.array(scale)


def _space(
    key: str, title: str, caption: str, groups: _Groups, names: Sequence[str], aspect: str
) -> Figure:
    """Draw curves in space."""
    data = []
    for name, colour, paths in groups:
        if paths:
            points = map(plot.packed, plot.joined(paths, _PATH_POINTS).T)
            curve = {"type": "scatter3d", "mode": "lines", **dict(zip("xyz", points, strict=False))}
            line = {"color": colour, "width": 2.5}
            data.append(curve | {"name": plot.plain(name), "line": line, "opacity": 0.6})
    scene: Spec = {
        f"{letter}axis": {
            "title": {"text": plot.plain(name), "font": {"size": 12}},
            "gridcolor": plot.WALL_GRID,
            "backgroundcolor": plot.WALL,
            "showbackground": True,
            "zerolinecolor": plot.WALL_GRID,
            "tickfont": {"size": 11},
            "nticks": 6,
        }
        for letter, name in zip("xyz", names, strict=True)
    }
    eye, centre = {"x": 1.62, "y": 1.46, "z": 0.85}, {"x": 0, "y": 0, "z": -0.1}
    scene |= {"aspectmode": aspect, "camera": {"eye": eye, "center": centre}}
    margin = {"l": 0, "r": 0, "t": 0, "b": 0}
    spec = plot.drawing(data, 520, scene=scene, margin=margin)
    return Figure(key, title, caption, [spec])


def touch_maps(report: TouchReport) -> Iterator[Figure]:
    """Errors over the block before and after, on the scale of each."""
    errors = (("before", report.before), ("after, by fits without it", report.left_out))
    rejected = " Crosses were rejected." if report.fit.left_out.any() else ""
    for a, b, where in _VIEWS:
        panels: list[plot.Panel] = []
        for title, error in errors:
            x = {"title": f"{'xyz'[a]} of the block [mm], {title}"}
            y = {"title": f"{'xyz'[b]} [mm]", "scaleanchor": "x" if not panels else "x2"}
            panels.append((x, y, _arrows(report.point, error, (a, b), report.fit.left_out)))
        caption = (
            f"Each dot is a dimple, seen {where}; its colour is how far off the tip "
            "was [mm], the line from it in which direction, drawn out for each panel. Before: as "
            f"measured, the block laid over all as well as it can be. After: by fits that did "
            "not see it, its own error included." + rejected
        )
        key = f"map-{'xyz'[a]}{'xyz'[b]}"
        yield Figure(
            key, f"Errors of the tip, {where}", caption, [plot.panels(panels, 340, gap=0.2)]
        )


def _arrows(point: Array, error: Array, axes: tuple[int, int], left_out: Mask) -> list[plot.Spec]:
    """Dots at points (m, 3) [m], and lines along errors (m, 3), in a plane."""
    place, size = 1e3 * point[:, axes], 1e3 * np.linalg.norm(error, axis=1)
    good = ~left_out
    longest = np.linalg.norm(error[good][:, axes], axis=1).max()
    tip = place + _ARROW * np.ptp(place, axis=0).max() / longest * error[:, axes]
    lines = np.full((3 * good.sum(), 2), np.nan)
    lines[0::3], lines[1::3] = place[good], tip[good]
    highest = float(size[good].max())
    x, y = place[good].T
    dots = plot.coloured(x, y, size[good], "error [mm]", highest, size=9)
    style = {"width": 1.5, "hoverinfo": "skip"}
    drawn = [plot.curve(lines[:, 0], lines[:, 1], "direction", GREY, **style), dots]
    if left_out.any():
        cross = {"marker": {"symbol": "x", "size": 9, "color": ORANGE}}
        drawn.append(
            plot.scatter("markers", place[left_out, 0], place[left_out, 1], "rejected", **cross)
        )
    return drawn
