"""Figures over time and position: tracking, worst stretches, hysteresis loops, distributions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np

from truejoint.array_types import Mask
from truejoint.evaluation.report import plot
from truejoint.evaluation.report.plot import COLOURS, Figure, Spec, colour_of
from truejoint.evaluation.results import (
    OFFSET,
    RAW,
    Evaluation,
    Trace,
    estimator_title,
)
from truejoint.recordings.table.stream import gaps
from truejoint.tables import fixed, shown
from truejoint.units import display_unit

MENU: Final = 36  # curves over time that the page offers, of all joints; at most 12 recordings
_BUDGET: Final = 600_000  # bytes that the time figures may take of the page
_CURVE_BYTES: Final = 22.0  # of one bucket: two points of x and y in base64
_STRETCHES: Final = 6
_STRETCH_BUCKETS: Final = 300
_LOOP_POINTS: Final = 6000  # of all joints together
_ALL: Final = slice(None)


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
    upper, lower = {"xaxis": "x", "yaxis": "y"}, {"xaxis": "x", "yaxis": "y2"}
    true = plot.thinned(t, truth, buckets)
    data = [plot.curve(*true, "True", COLOURS["truth"], width=1.5, dash="dot", **upper)]
    if trace.lower is not None and trace.upper is not None:
        bounds = [unit.scale * bound[rows, column] for bound in (trace.lower, trace.upper)]
        estimate = unit.scale * trace.estimates[chosen][rows, column]
        bounded = np.flatnonzero(np.isfinite(bounds[0]))
        if len(bounded) >= 2:
            widest = plot.extreme_rows((bounds[1] - bounds[0])[bounded], buckets // 4)
            bounded = bounded[np.union1d(plot.extreme_rows(estimate[bounded], buckets), widest)]
            pieces = np.searchsorted(gaps(t), bounded, side="left")
            low, high, middle = bounds[0][bounded], bounds[1][bounded], estimate[bounded]
            around = plot.outline(t[bounded], low, high, pieces)
            errors = plot.outline(t[bounded], middle - high, middle - low, pieces)
            name = f"{100 * evaluation.interval_level:g} % interval"
            band: Spec = {"width": 0, "fill": "toself", "fillcolor": plot.BAND}
            band |= {"hoverinfo": "skip", "legendrank": 1001}
            for edge, place, legend in ((around, upper, whole), (errors, lower, False)):
                options = {**band, **place, "showlegend": legend}
                data.append(plot.curve(*edge, name, COLOURS["chosen"], **options))
    # The chosen one last, so that it lies on top.
    for name in [n for n in (RAW, OFFSET) if n != chosen and (whole or n != RAW)] + [chosen]:
        title, colour = estimator_title(name), colour_of(name, evaluation)
        values = trace.estimates[name][rows, column] * unit.scale
        visible = "legendonly" if name == RAW != chosen else True
        error = plot.thinned(t, values - truth, buckets)
        data += [
            plot.curve(*plot.thinned(t, values, buckets), title, colour, visible=visible, **upper),
            plot.curve(*error, title, colour, visible=visible, showlegend=False, **lower),
        ]
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
                np.column_stack((trace.truth[:, column], trace.error(name)[:, column]))
                for trace in evaluation.traces
            ]
            path, title = unit.scale * plot.joined(paths, most), estimator_title(name)
            options = {"width": 0.7, "opacity": opacity, "hoverinfo": "skip"}
            options["showlegend"] = column == 0
            curves.append(plot.curve(path[:, 0], path[:, 1], title, colour, **options))
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
