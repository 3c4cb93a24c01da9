"""Figures over time and position: tracking, worst stretches, hysteresis loops, histograms."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from truejoint.evaluation.digits import fixed, shown
from truejoint.evaluation.report.plot import (
    COLOURS,
    Figure,
    Spec,
    axis,
    columns,
    curve,
    every,
    extreme_rows,
    layout,
    outline,
    packed,
    plain,
    thinned,
)
from truejoint.evaluation.results import OFFSET, RAW, Evaluation, Stretch, Trace, estimator_title
from truejoint.evaluation.signals import gaps
from truejoint.units import DisplayUnit, display_unit

Array = NDArray[np.float64]

MENU: Final = 12  # recordings that the time figures offer; the table lists all
_BUDGET: Final = 4_000_000  # bytes that the time figures may take of the page
_CURVE_BYTES: Final = 22.0  # of one bucket: two points of x and y in base64
_STRETCHES: Final = 6
_LOOP_POINTS: Final = 6000


def menu_order(evaluation: Evaluation) -> list[int]:
    """Traces that the time figures show, worst first: by RMSE as a multiple of the limit."""
    limits = [joint.limit for joint in evaluation.verdict.joints]
    ratio = [
        float(np.max(np.sqrt(np.mean(_error(trace, evaluation.chosen) ** 2, axis=0)) / limits))
        for trace in evaluation.traces
    ]
    return [int(i) for i in np.argsort(-np.array(ratio), kind="stable")][:MENU]


def over_time(evaluation: Evaluation) -> list[Figure]:
    """Return one figure a joint: corrected and true position, and the error, over time."""
    order = menu_order(evaluation)
    banded = any(trace.lower is not None for trace in evaluation.traces)
    curves = (14 if banded else 6) * len(order) * len(evaluation.joints)
    buckets = int(np.clip(_BUDGET / (_CURVE_BYTES * curves), 150, 1800))
    figures = []
    for column, joint in enumerate(evaluation.joints):
        unit = display_unit(evaluation.units[column])
        variants = [
            _tracking(evaluation, evaluation.traces[i], column, unit, buckets) for i in order
        ]
        figures.append(
            Figure(
                f"time-{column}",
                f"{joint} over time",
                f"{joint}: true position, estimates and their error [{unit.name}] over time [s].",
                variants,
                380,
            )
        )
    return figures


def worst_stretches(evaluation: Evaluation) -> list[Figure]:
    """Return the worst windows in full, worst first."""
    shown_stretches = evaluation.worst[:_STRETCHES]
    return [_stretch(evaluation, s, i) for i, s in enumerate(shown_stretches)]


def _stretch(evaluation: Evaluation, stretch: Stretch, rank: int) -> Figure:
    column = evaluation.joints.index(stretch.joint)
    unit = display_unit(stretch.unit)
    trace = evaluation.traces[stretch.recording]
    rows = (trace.t >= stretch.start) & (trace.t <= stretch.end)
    part = _part(trace, rows)
    rmse, largest = shown([stretch.rmse * unit.scale, stretch.max_abs * unit.scale])
    spec = _tracking(evaluation, part, column, unit, 1500, raw=False)
    return Figure(
        f"stretch-{rank}",
        f"Worst stretch {rank + 1}",
        f"{rank + 1}. {stretch.joint}, {trace.name}, {fixed(stretch.start, 1)} to "
        f"{fixed(stretch.end, 1)} s: RMSE {rmse} {unit.name}, largest error {largest} {unit.name}.",
        [spec],
        330,
        wide=False,
    )


def _part(trace: Trace, rows: NDArray[np.bool_]) -> Trace:
    """Rows of a trace that a tracking figure needs."""
    return Trace(
        name=trace.name,
        provenance=trace.provenance,
        rows_total=trace.rows_total,
        t=trace.t[rows],
        truth=trace.truth[rows],
        measured=trace.measured[rows],
        velocity=trace.velocity[rows],
        direction=trace.direction[rows],
        effort={},
        effort_unit={},
        estimates={name: values[rows] for name, values in trace.estimates.items()},
        tool={},
        lower=None if trace.lower is None else trace.lower[rows],
        upper=None if trace.upper is None else trace.upper[rows],
    )


def _tracking(
    evaluation: Evaluation,
    trace: Trace,
    column: int,
    unit: DisplayUnit,
    buckets: int,
    *,
    raw: bool = True,
) -> Spec:
    truth = trace.truth[:, column] * unit.scale
    data = []
    for name, colour, hidden in _shown_estimators(evaluation, raw=raw):
        values = trace.estimates[name][:, column] * unit.scale
        visible: Any = "legendonly" if hidden else True
        title = estimator_title(name)
        upper = thinned(trace.t, values, buckets)
        lower = thinned(trace.t, values - truth, buckets)
        data += [
            curve(*upper, title, colour, xaxis="x", yaxis="y", visible=visible),
            curve(*lower, title, colour, xaxis="x", yaxis="y2", visible=visible, showlegend=False),
        ]
    data = _bands(evaluation, trace, column, unit, buckets, legend=raw) + data
    true = curve(*thinned(trace.t, truth, buckets), "True", COLOURS["truth"], width=1.5, dash="dot")
    data.insert(0, {**true, "xaxis": "x", "yaxis": "y"})
    axes = {
        "xaxis": axis("time [s]", anchor="y2"),
        "yaxis": axis(f"position [{unit.name}]", domain=[0.43, 1.0]),
        "yaxis2": axis(f"error [{unit.name}]", domain=[0.0, 0.36], zeroline=True),
    }
    return {"data": data, "layout": layout(380 if raw else 330, **axes)}


def _bands(
    evaluation: Evaluation,
    trace: Trace,
    column: int,
    unit: DisplayUnit,
    buckets: int,
    *,
    legend: bool,
) -> list[Spec]:
    """Where the interval says that the truth is, and the errors that it allows."""
    if trace.lower is None or trace.upper is None:
        return []
    lower, upper = (unit.scale * bound[:, column] for bound in (trace.lower, trace.upper))
    estimate = unit.scale * trace.estimates[evaluation.chosen][:, column]
    rows = np.flatnonzero(np.isfinite(lower))
    if len(rows) < 2:
        return []
    widest = extreme_rows(upper[rows] - lower[rows], buckets // 4)
    rows = rows[np.union1d(extreme_rows(estimate[rows], buckets), widest)]
    pieces = np.searchsorted(gaps(trace.t), rows, side="left")
    t, low, high, middle = trace.t[rows], lower[rows], upper[rows], estimate[rows]
    name = f"{100 * evaluation.interval_level:g} % interval"
    options: Spec = {
        "width": 0,
        "fill": "toself",
        "fillcolor": "rgba(0,114,178,0.17)",
        "hoverinfo": "skip",
        "legendrank": 1001,
        "xaxis": "x",
    }
    around, errors = outline(t, low, high, pieces), outline(t, middle - high, middle - low, pieces)
    return [
        curve(*around, name, COLOURS["chosen"], yaxis="y", showlegend=legend, **options),
        curve(*errors, name, COLOURS["chosen"], yaxis="y2", showlegend=False, **options),
    ]


def _shown_estimators(evaluation: Evaluation, *, raw: bool) -> list[tuple[str, str, bool]]:
    """Names, colours and whether hidden at first; the chosen one last, so that it lies on top."""
    found = [(RAW, COLOURS[RAW], True)] if raw and evaluation.chosen != RAW else []
    if evaluation.chosen != OFFSET:
        found.append((OFFSET, COLOURS[OFFSET], False))
    return [*found, (evaluation.chosen, COLOURS["chosen"], False)]


def loops(evaluation: Evaluation) -> Figure:
    """Error against position, before and after; cable hysteresis shows as loops."""
    most = max(2, _LOOP_POINTS // len(evaluation.traces))
    pairs = [(OFFSET, COLOURS[OFFSET], 0.45), (evaluation.chosen, COLOURS["chosen"], 0.8)]

    def draw(column: int, unit: DisplayUnit, place: Spec) -> list[Spec]:
        traces = []
        for name, colour, opacity in dict.fromkeys(pairs):
            x, y = [], []
            for trace in evaluation.traces:
                rows = every(len(trace.t), most)
                x += [trace.truth[rows, column] * unit.scale, np.array([np.nan])]
                y += [_error(trace, name)[rows, column] * unit.scale, np.array([np.nan])]
            line = curve(
                np.concatenate(x),
                np.concatenate(y),
                estimator_title(name),
                colour,
                width=0.7,
                opacity=opacity,
                hoverinfo="skip",
                **place,
            )
            traces.append(line)
        return traces

    spec, height = small_multiples(evaluation, draw, "position", "error", 300)
    caption = (
        "Error against true position, as the motion runs through it: before (fixed offset) and "
        "after calibration. Width of a loop is hysteresis, slope is stretch under changing load."
    )
    return Figure("loops", "Hysteresis loops", caption, [spec], height)


def histograms(evaluation: Evaluation) -> Figure:
    """How errors are distributed, before and after."""

    def draw(column: int, unit: DisplayUnit, place: Spec) -> list[Spec]:
        names = dict.fromkeys((OFFSET, evaluation.chosen))
        errors = {
            name: np.concatenate([_error(t, name)[:, column] for t in evaluation.traces])
            * unit.scale
            for name in names
        }
        low = min(float(e.min()) for e in errors.values())
        high = max(float(e.max()) for e in errors.values())
        edges = np.linspace(low, high if high > low else low + 1e-9, 91)
        bars = []
        for name, error in errors.items():
            share = 100.0 * np.histogram(error, edges)[0] / len(error)
            colour = COLOURS["chosen"] if name == evaluation.chosen else COLOURS[OFFSET]
            bars.append(
                {
                    "type": "bar",
                    "x": packed(0.5 * (edges[1:] + edges[:-1])),
                    "y": packed(share),
                    "width": float(edges[1] - edges[0]),
                    "name": plain(estimator_title(name)),
                    "legendgroup": plain(estimator_title(name)),
                    "marker": {"color": colour, "line": {"width": 0}},
                    "opacity": 0.7,
                    **place,
                }
            )
        return bars

    spec, height = small_multiples(evaluation, draw, "error", "share of rows [%]", 280)
    spec["layout"] |= {"barmode": "overlay", "bargap": 0}
    caption = "Distribution of the error over all rows of the test; 90 equal bins a joint."
    return Figure("histograms", "Distribution of errors", caption, [spec], height)


def small_multiples(
    evaluation: Evaluation, draw: Any, x_title: str, y_title: str, row_height: int
) -> tuple[Spec, int]:
    """One panel a joint, at most three side by side.

    `draw(column, unit, place)` gives the curves of one joint, `place` being the axes to use.
    """
    joints = evaluation.joints
    across = min(3, len(joints)) if len(joints) != 4 else 2
    down = -(-len(joints) // across)
    height = row_height * down + 40
    data: list[Spec] = []
    axes: Spec = {}
    band = 1.0 / down
    for column, joint in enumerate(joints):
        unit = display_unit(evaluation.units[column])
        row, place = divmod(column, across)
        suffix = str(column + 1) if column else ""
        top = 1.0 - row * band
        y_unit = "" if "[" in y_title else f" [{unit.name}]"
        axes[f"xaxis{suffix}"] = axis(
            f"{joint} {x_title} [{unit.name}]",
            domain=columns(across, 0.075)[place],
            anchor=f"y{suffix}",
        )
        axes[f"yaxis{suffix}"] = axis(
            f"{y_title}{y_unit}" if place == 0 or y_unit else "",
            domain=[top - band + (0.3 * band if row < down - 1 else 0.0), top],
            anchor=f"x{suffix}",
        )
        panel = draw(column, unit, {"xaxis": f"x{suffix}", "yaxis": f"y{suffix}"})
        data += [{**trace, "showlegend": column == 0} for trace in panel]
    return {"data": data, "layout": layout(height, **axes)}, height


def _error(trace: Trace, estimator: str) -> Array:
    return trace.estimates[estimator] - trace.truth


def cartesian_errors(evaluation: Evaluation) -> Figure | None:
    """Tool position error along each axis and as a distance; None without kinematics."""
    if not evaluation.cartesian:
        return None
    data: list[Spec] = []
    axes: Spec = {}
    names = dict.fromkeys((OFFSET, evaluation.chosen))
    for panel, (what, domain) in enumerate(
        zip(("x", "y", "z", "distance"), columns(4, 0.07), strict=True)
    ):
        suffix = str(panel + 1) if panel else ""
        for name in names:
            error = 1e3 * _tool_error(evaluation.traces, name, panel)
            data.append(
                {
                    **_ranked(error, estimator_title(name)),
                    "line": {
                        "color": COLOURS["chosen" if name == evaluation.chosen else OFFSET],
                        "width": 1.6,
                    },
                    "xaxis": f"x{suffix}",
                    "yaxis": f"y{suffix}",
                    "showlegend": panel == 0,
                }
            )
        axes[f"xaxis{suffix}"] = axis(
            f"|{what} error| [mm]" if panel < 3 else "distance [mm]",
            domain=domain,
            anchor=f"y{suffix}",
            rangemode="tozero",
        )
        axes[f"yaxis{suffix}"] = axis(
            "share of rows within [%]" if panel == 0 else "",
            anchor=f"x{suffix}",
            range=[0, 101],
        )
    caption = (
        "Share of the test's rows in which the tool is within a given distance of its true "
        "position: along each axis of the base frame and in space [mm]."
    )
    spec = {"data": data, "layout": layout(300, **axes)}
    return Figure("cartesian", "Error of the tool position", caption, [spec], 300)


def _tool_error(traces: Sequence[Trace], name: str, panel: int) -> Array:
    error = np.concatenate([trace.tool[name] - trace.tool["truth"] for trace in traces])
    return np.asarray(np.linalg.norm(error, axis=1) if panel == 3 else np.abs(error[:, panel]))


def _ranked(error: Array, title: str) -> Spec:
    """Cumulative distribution, drawn from 201 of its quantiles."""
    share = np.linspace(0.0, 1.0, 201)
    return {
        "type": "scatter",
        "mode": "lines",
        "x": packed(np.quantile(error, share)),
        "y": packed(100.0 * share),
        "name": plain(title),
        "legendgroup": plain(title),
    }
