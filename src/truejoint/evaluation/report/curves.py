"""Figures over time and position: tracking, worst stretches, hysteresis loops, histograms.

`plot_corrected` draws a still one for documents.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from truejoint.array_types import Mask
from truejoint.errors import CalibrationError, RecordingError
from truejoint.evaluation.report import plot
from truejoint.evaluation.report.plot import COLOURS, GRID, Figure, Spec, colour_of
from truejoint.evaluation.results import (
    OFFSET,
    RAW,
    Evaluation,
    Trace,
    as_evaluation,
    estimator_title,
)
from truejoint.extras import require
from truejoint.files import write_atomically
from truejoint.recordings.table.signals import gaps
from truejoint.tables import fixed, shown
from truejoint.units import DisplayUnit, display_unit

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
        known = np.flatnonzero(np.isfinite(bounds[0]))
        if len(known) >= 2:
            widest = plot.extreme_rows((bounds[1] - bounds[0])[known], buckets // 4)
            known = known[np.union1d(plot.extreme_rows(estimate[known], buckets), widest)]
            pieces = np.searchsorted(gaps(t), known, side="left")
            low, high, middle = bounds[0][known], bounds[1][known], estimate[known]
            around = plot.outline(t[known], low, high, pieces)
            errors = plot.outline(t[known], middle - high, middle - low, pieces)
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

    def draw(column: int, unit: DisplayUnit) -> list[Spec]:
        curves = []
        for name, colour, opacity in pairs:
            paths = [
                np.column_stack((trace.truth[:, column], trace.error(name)[:, column]))
                for trace in evaluation.traces
            ]
            path, title = unit.scale * plot.joined(paths, most), estimator_title(name)
            options = {"width": 0.7, "opacity": opacity, "hoverinfo": "skip"}
            curves.append(plot.curve(path[:, 0], path[:, 1], title, colour, **options))
        return curves

    caption = (
        "Error against true position, as the motion runs through it: before (fixed offset) and "
        "after calibration. Width of a loop is hysteresis, slope is stretch under changing load."
    )
    spec = _small_multiples(evaluation, draw, "position", "error", 300)
    return Figure("loops", "Hysteresis loops", caption, [spec])


def histograms(evaluation: Evaluation) -> Figure:
    """How errors are distributed, before and after."""

    def draw(column: int, unit: DisplayUnit) -> list[Spec]:
        errors = {
            name: evaluation.error(name, column) * unit.scale
            for name in (OFFSET, evaluation.chosen)
        }
        low = min(float(e.min()) for e in errors.values())
        high = max(float(e.max()) for e in errors.values())
        edges = np.linspace(low, high if high > low else low + 1e-9, 91)
        middle = 0.5 * (edges[1:] + edges[:-1])
        curves = []
        for name, error in errors.items():
            share = 100.0 * np.histogram(error, edges)[0] / len(error)
            colour = colour_of(name, evaluation)
            fill = {"fill": "tozeroy", "fillcolor": colour, "opacity": 0.75, "shape": "hvh"}
            curves.append(plot.curve(middle, share, estimator_title(name), colour, **fill))
        return curves

    spec = _small_multiples(evaluation, draw, "error", "share of rows [%]", 280)
    caption = "Distribution of the error over all rows of the test; 90 equal bins a joint."
    return Figure("histograms", "Distribution of errors", caption, [spec])


def _small_multiples(
    evaluation: Evaluation,
    draw: Callable[[int, DisplayUnit], list[Spec]],
    x_title: str,
    y_title: str,
    row_height: int,
) -> Spec:
    """One panel a joint, at most three side by side; `draw(column, unit)` gives its curves."""
    count = len(evaluation.joints)
    across = min(3, count) if count != 4 else 2
    down = -(-count // across)
    panels = []
    band, domains = 1.0 / down, plot.columns(across, 0.075)
    for column, joint, unit in evaluation.shown_joints():
        row, left = divmod(column, across)
        top = 1.0 - row * band
        y_unit = "" if "[" in y_title else f" [{unit.name}]"
        bottom = top - band + (0.3 * band if row < down - 1 else 0.0)
        x = {"title": f"{joint} {x_title} [{unit.name}]", "domain": domains[left]}
        y = {"title": f"{y_title}{y_unit}" if left == 0 or y_unit else "", "domain": [bottom, top]}
        panels.append((x, y, draw(column, unit)))
    spec = plot.panels(panels, row_height * down + 40)
    for curve in spec["data"]:  # the legend of the first panel serves all
        curve["showlegend"] = curve["xaxis"] == "x"
    return spec


def cartesian_errors(evaluation: Evaluation) -> list[Figure]:
    """Tool position error along each axis and as a distance; nothing without kinematics."""
    if not evaluation.cartesian:
        return []
    panels = []
    share = np.linspace(0.0, 1.0, 201)
    titles = [*(f"|{name} error| [mm]" for name in "xyz"), "distance [mm]"]
    for i, (title, domain) in enumerate(zip(titles, plot.columns(4, 0.07), strict=True)):
        x = {"title": title, "domain": domain, "rangemode": "tozero"}
        y = {"title": "" if i else "share of rows within [%]", "range": [0, 101]}
        drawn = []
        for name in dict.fromkeys((OFFSET, evaluation.chosen)):
            error = np.concatenate([t.tool[name] - t.tool["truth"] for t in evaluation.traces])
            size = np.linalg.norm(error, axis=1) if i == 3 else np.abs(error[:, i])
            within = np.quantile(1e3 * size, share), 100.0 * share
            style = {"width": 1.6, "showlegend": i == 0}
            colour = colour_of(name, evaluation)
            drawn.append(plot.curve(*within, estimator_title(name), colour, **style))
        panels.append((x, y, drawn))
    caption = (
        "Share of the test's rows in which the tool is within a given distance of its true "
        "position: along each axis of the base frame and in space [mm]."
    )
    title, spec = "Error of the tool position", plot.panels(panels, 300)
    return [Figure("cartesian", title, caption, [spec])]


def plot_corrected(
    evaluation: Evaluation,
    path: str | Path,
    *,
    recording: int = 0,
    seconds: float = 60.0,
    overwrite: bool = False,
) -> Path:
    """Draw corrected and true position, and the error, of the first seconds of a recording.

    Parameters
    ----------
    evaluation : Evaluation
    path : str or Path
        Picture to write; its suffix tells the format.
    recording : int
        Index into `Evaluation.traces`.
    seconds : float
        How much of it to show [s].
    overwrite : bool
        Whether a file at `path` may be replaced.

    Raises
    ------
    CalibrationError
        If there is no such recording.
    RecordingError
        If the file exists and may not be replaced, cannot be written, or is of another format.

    Examples
    --------
    >>> plot_corrected(evaluation, "jaw.png").name
    'jaw.png'
    """
    if recording not in range(len(as_evaluation(evaluation).traces)):
        raise CalibrationError(
            f"no recording {recording!r:.20} was judged; choose 0 to {len(evaluation.traces) - 1}"
        )
    trace = evaluation.traces[recording]
    rows = trace.t <= trace.t[0] + seconds
    t, count = trace.t[rows], len(evaluation.joints)
    drawing = require("matplotlib.figure", "plots", "a figure")
    figure = drawing.Figure(figsize=(4.2 * count, 4.4), layout="constrained")
    axes = figure.subplots(2, count, sharex="col", squeeze=False, height_ratios=[1.6, 1.0])
    for column, joint, unit in evaluation.shown_joints():
        truth = unit.scale * trace.truth[rows, column]
        upper, lower = axes[:, column]
        upper.plot(t, truth, color=COLOURS["truth"], lw=1.6, ls=":", label="True")
        for name in dict.fromkeys((OFFSET, evaluation.chosen)):
            colour = colour_of(name, evaluation)
            values = unit.scale * trace.estimates[name][rows, column]
            upper.plot(t, values, color=colour, lw=1.0, label=estimator_title(name))
            lower.plot(t, values - truth, color=colour, lw=0.9)
        upper.set_title(joint, fontsize=10, loc="left")
        lower.set_xlabel("time [s]")
        for panel, what in ((upper, "position"), (lower, "error")):
            panel.set_ylabel(f"{what} [{unit.name}]")
            panel.spines[["top", "right"]].set_visible(False)
            panel.grid(color=GRID, lw=0.7)
    legend = {"loc": "outside upper right", "ncols": 3, "frameon": False, "fontsize": 9}
    figure.legend(*axes[0, 0].get_legend_handles_labels(), **legend)
    picture, known = Path(path), figure.canvas.get_supported_filetypes()
    kind = picture.suffix.removeprefix(".").lower() or "png"
    if kind not in known:
        raise RecordingError(f"{picture}: no picture is .{kind}; choose one of {', '.join(known)}")
    draw = partial(figure.savefig, dpi=150, format=kind)
    write_atomically(picture, draw, overwrite=overwrite, error=RecordingError)
    return picture
