"""Figures of the pages: over time and position, what is left of the error, touches."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import cycle
from typing import TYPE_CHECKING, Final

import numpy as np
from pandas import DataFrame

from truejoint.array_types import Array, Integers, Mask
from truejoint.drawing import BLUE, GREY, INK, ORANGE, PALETTE, ecdf
from truejoint.evaluation.report import plot
from truejoint.evaluation.report.plot import COLOURS, Figure, Spec, colour_of
from truejoint.evaluation.results import (
    OFFSET,
    RAW,
    TOOL,
    Evaluation,
    by_recording,
    each,
    estimator_phrase,
    estimator_title,
)
from truejoint.evaluation.score_tables import worst_first
from truejoint.recordings.table.stream import gaps
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

_POINTS: Final = 3600  # of each direction in a panel of every joint together, at most 1200 of one
_BINS: Final = 24
_FEW: Final = 8  # rows below which a bin has no median
_WAYS: Final = (("moving up", BLUE, 1), ("moving down", ORANGE, -1))
_HEIGHT: Final = 280  # of the figures of the interval
_EQUAL: Final = {"width": 1.0, "dash": "dash", "hoverinfo": "skip"}

_ARROW: Final = 0.15  # of the block's width, of the largest error
_VIEWS: Final = ((0, 1, "from above"), (0, 2, "from the side"))

_Errors = tuple[str, Array, Array]  # over one cause: axis title, its values (n,), errors (n,)


def menu_order(evaluation: Evaluation) -> list[str]:
    """Name the recordings that the time figures show, worst first."""
    return worst_first(evaluation)[: min(12, max(1, MENU // len(evaluation.joints)))]


def over_time(evaluation: Evaluation) -> list[Figure]:
    """Return one figure a joint: corrected and true position, and the error, over time."""
    names, recordings = menu_order(evaluation), evaluation.rows.index
    curves = (14 if "lower" in evaluation.rows else 6) * len(names) * len(evaluation.joints)
    buckets = int(np.clip(_BUDGET / (_CURVE_BYTES * curves), 50, 1800))
    parts = {recordings[part][0]: part for part in by_recording(recordings)}
    return [
        Figure(
            f"time-{column}",
            f"{joint} over time",
            f"{joint}: true position, estimates and their error [{unit.name}] over time [s].",
            [_tracking(evaluation, parts[name], column, buckets, whole=True) for name in names],
        )
        for column, joint, unit in evaluation.shown_joints()
    ]


def worst_stretches(evaluation: Evaluation) -> Iterator[Figure]:
    """Draw the worst windows in full, worst first."""
    t = evaluation.rows["t"]
    for rank, stretch in enumerate(each(evaluation.worst[:_STRETCHES]), 1):
        column, unit = evaluation.joints.index(stretch.joint), display_unit(stretch.unit)
        rows = t.between(stretch.start, stretch.end) & (t.index == stretch.recording)
        rmse, largest = shown([stretch.rmse * unit.scale, stretch.max_abs * unit.scale])
        caption = (
            f"{rank}. {stretch.joint}, {stretch.recording}, {fixed(stretch.start, 1)} to "
            f"{fixed(stretch.end, 1)} s: RMSE {rmse} {unit.name}, largest error {largest} "
            f"{unit.name}."
        )
        spec = _tracking(evaluation, np.flatnonzero(rows), column, _STRETCH_BUCKETS, whole=False)
        key, label = f"stretch-{rank - 1}", f"Worst stretch {rank}"
        yield Figure(key, label, caption, [spec], wide=False)


def _tracking(
    evaluation: Evaluation, rows: slice | Integers, column: int, buckets: int, *, whole: bool
) -> Spec:
    """Positions above, errors below; with the raw position and a legend of all when `whole`."""
    chosen, joint = evaluation.chosen, evaluation.joints[column]
    unit, t = display_unit(evaluation.units[column]), evaluation.known("t")[rows]
    truth = evaluation.known("truth")[rows, column] * unit.scale
    upper: Spec = {"xaxis": "x", "yaxis": "y"}
    lower: Spec = {"xaxis": "x", "yaxis": "y2", "showlegend": False}
    true = plot.thinned(t, truth, buckets)
    data = [plot.curve(*true, "True", COLOURS["truth"], width=1.5, dash="dot", **upper)]
    errors = {
        name: evaluation.error(name, joint)[rows, 0] * unit.scale
        for name in (RAW, OFFSET, chosen)
        if whole or name != RAW or name == chosen
    }
    if "lower" in evaluation.rows:
        low, high = (unit.scale * evaluation.known(key)[rows, column] for key in ("lower", "upper"))
        name = f"{100 * evaluation.interval_level:g} % interval"
        options = {"width": 0, "fill": "toself", "fillcolor": plot.BAND, "hoverinfo": "skip"}
        options |= {"legendrank": 1001}
        edges = _band(t, truth + errors[chosen], low, high, buckets)
        for edge, place in zip(edges, (upper | {"showlegend": whole}, lower), strict=False):
            data.append(plot.curve(*edge, name, COLOURS["chosen"], **options, **place))
    # The chosen one last, so that it lies on top.
    for name in sorted(errors, key=lambda name: name == chosen):
        visible = "legendonly" if name == RAW != chosen else True
        for values, place in ((truth + errors[name], upper), (errors[name], lower)):
            thin, colour = plot.thinned(t, values, buckets), colour_of(name, evaluation)
            data.append(plot.curve(*thin, estimator_title(name), colour, visible=visible, **place))
    return plot.drawing(
        data,
        380 if whole else 330,
        xaxis=plot.axis("time [s]", anchor="y2"),
        yaxis=plot.axis(f"position [{unit.name}]", domain=[0.43, 1.0]),
        yaxis2=plot.axis(f"error [{unit.name}]", domain=[0.0, 0.36], zeroline=True),
    )


def _band(
    t: Array, middle: Array, low: Array, high: Array, buckets: int
) -> list[tuple[Array, Array]]:
    """Outlines of an interval (n,) about a curve, and of errors that it allows; none if unknown."""
    bounded = np.flatnonzero(np.isfinite(low))
    if len(bounded) < 2:
        return []
    widest = plot.extreme_rows((high - low)[bounded], buckets // 4)
    bounded = bounded[np.union1d(plot.extreme_rows(middle[bounded], buckets), widest)]
    pieces = np.searchsorted(gaps(t), bounded, side="left")
    t, low, high, middle = (values[bounded] for values in (t, low, high, middle))
    return [
        plot.outline(t, low, high, pieces),
        plot.outline(t, middle - high, middle - low, pieces),
    ]


def loops(evaluation: Evaluation) -> Figure:
    """Error against position, before and after; cable hysteresis shows as loops."""
    most, parts = _LOOP_POINTS // len(evaluation.joints), by_recording(evaluation.rows.index)
    pairs = ((OFFSET, COLOURS[OFFSET], 0.45), (evaluation.chosen, COLOURS["chosen"], 0.8))
    panels = []
    for column, joint, unit in evaluation.shown_joints():
        curves = []
        truth = evaluation.known("truth")[:, column]
        for name, colour, opacity in pairs:
            path = unit.scale * np.column_stack((truth, evaluation.error(name, joint)))
            options = {"width": 0.7, "opacity": opacity, "showlegend": column == 0}
            paths = [path[part] for part in parts]
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

    A panel each for the joints, and for the tool where its place is known.
    """
    titles = {estimator_title(name): colour for name, colour in colours.items()}
    panels: list[plot.Panel] = []
    for name, unit, _ in evaluation.shown_scores():
        errors = {estimator_title(key): evaluation.error(key, name)[:, 0] for key in colours}
        frame = DataFrame(errors).melt(var_name="model", value_name="error")
        what = f"|error| of {'tool' if name == TOOL else name} [{unit.name}]"
        drawn = ecdf(frame, "error", "model", scale=unit.scale, colours=titles)
        curves = [
            plot.curve(
                np.asarray(c.x), np.asarray(c.y), c.label, titles[c.label], width=1.6,
                showlegend=not panels,
            )
            for c in drawn.curves
        ]  # fmt: skip
        up = {"title": "share of rows within [%]", "range": [0, 101]}
        panels.append(({"title": what, "rangemode": "tozero"}, up, curves))
    caption = (
        "Share of the test's rows within a given error: absolute error of each joint, and distance "
        "of the tool from its true position where its kinematics are known."
    )
    return Figure("distribution", "Distribution of errors", caption, [plot.panels(panels, 280)])


def residuals(evaluation: Evaluation, models: Sequence[str] = ()) -> Iterator[Figure]:
    """Draw one figure a joint: the chosen model's error against position, velocity and so on.

    Of several `models` it is the error of each against position, on one scale.
    """
    for column, joint, unit in evaluation.shown_joints():
        panels = list(_panels(evaluation, column, unit, models))
        most = min(1200, _POINTS // len(evaluation.joints))
        causes = [title.partition(" [")[0] for title, _, _ in panels]
        end_to_end = " (recordings end to end)" if len(evaluation.test) > 1 else ""
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
        spec = _error_panels(panels, evaluation.known("direction")[:, column], unit, most)
        yield Figure(f"residual-{column}", f"{joint} residuals", caption, [spec])


def _panels(
    evaluation: Evaluation, column: int, unit: DisplayUnit, models: Sequence[str]
) -> Iterator[_Errors]:
    joint = evaluation.joints[column]
    position = unit.scale * evaluation.known("truth")[:, column]
    for name in models:
        error = unit.scale * evaluation.error(name, joint)[:, 0]
        yield f"{name}: position [{unit.name}]", position, error
    if models:
        return
    error = unit.scale * evaluation.error(evaluation.chosen, joint)[:, 0]
    yield f"position [{unit.name}]", position, error
    speed = unit.scale * evaluation.known("velocity")[:, column]
    yield f"velocity [{unit.name}/s]", speed, error
    if joint in evaluation.effort_units:
        effort = display_unit(evaluation.effort_units[joint])
        values = effort.scale * evaluation.rows["effort", joint].to_numpy()
        yield f"effort [{'no unit' if effort.name == '1' else effort.name}]", values, error
    t = evaluation.known("t")
    steps = np.diff(t, prepend=t[0])
    steps[[part.start for part in by_recording(evaluation.rows.index)]] = 0.0
    yield "time [s]", np.cumsum(steps), error


def _error_panels(panels: Sequence[_Errors], moves: Array, unit: DisplayUnit, most: int) -> Spec:
    """Panels side by side on one scale, with at most so many dots of each direction in one.

    `moves` (n,) is the direction of motion: 1, -1 or 0.
    """
    drawn = []
    every = np.concatenate([error for _, _, error in panels])
    low, high = float(every.min()), float(every.max())
    margin = 0.05 * (high - low) or 1e-9
    for i, (title, values, error) in enumerate(panels):
        up: Spec = {"title": "" if i else f"error [{unit.name}]", "zeroline": True}
        up |= {"range": [low - margin, high + margin], "showticklabels": i == 0}
        curves: list[Spec] = []
        for name, colour, side in _WAYS:
            x, y = values[moves == side], error[moves == side]
            if len(x):
                curves += _cloud(x, y, name, colour, most, legend=i == 0)
        drawn.append(({"title": title, "nticks": 6}, up, curves))
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


def binned(x: Array, y: Array) -> Array:
    """Centres of equal bins of `x` (n,), and 5th, 50th, 95th percentile of `y` there, (4, m)."""
    edges = np.linspace(x.min(), x.max(), _BINS + 1)
    which = np.searchsorted(edges[1:-1], x, side="right")
    groups = [(0.5 * (edges[k] + edges[k + 1]), y[which == k]) for k in range(_BINS)]
    rows = [(x, *np.quantile(y, [0.05, 0.5, 0.95])) for x, y in groups if len(y) >= _FEW]
    return np.array(rows, dtype=float).reshape(-1, 4).T


def stated_interval(evaluation: Evaluation) -> Iterator[Figure]:
    """Found against stated coverage, with several levels; coverage of each of several motions."""
    if evaluation.intervals.empty:
        return
    several = len(evaluation.interval_trajectories) > 1
    percent = evaluation.intervals.set_index("joint")
    percent[["level", "coverage", "standard_error"]] *= 100.0
    if percent["level"].nunique() > 1:
        yield _found_and_stated(evaluation, percent, several=several)
    if several:
        yield _each_trajectory(evaluation, percent)


def _found_and_stated(evaluation: Evaluation, percent: DataFrame, *, several: bool) -> Figure:
    stated = np.unique(percent["level"])
    margin = 0.15 * (stated[-1] - stated[0])
    ends = np.array([max(stated[0] - 20, 0.0), 100.0])
    data = [plot.curve(ends, ends, "equal", INK, **_EQUAL)]
    for joint, colour, beside in _joints(evaluation):
        rows = percent.loc[[joint]]
        style = _dots(colour) | {"line": {"color": colour, "width": 1.3}}
        if several:
            bars = plot.packed(rows["standard_error"].to_numpy())
            style["error_y"] = {"array": bars, "thickness": 1.3, "width": 4}
        x = rows["level"].to_numpy() + 0.06 * margin * beside
        data.append(plot.scatter("lines+markers", x, rows["coverage"].to_numpy(), joint, **style))
    lowest = min(stated[0], percent["coverage"].min())
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
    return Figure("calibration", title, caption, [spec], wide=False)


def _each_trajectory(evaluation: Evaluation, percent: DataFrame) -> Figure:
    level, names = 100.0 * evaluation.interval_level, evaluation.interval_trajectories
    number, ends = np.arange(1.0, len(names) + 1.0), np.array([0.5, len(names) + 0.5])
    data = [plot.curve(ends, np.full(2, level), f"stated {level:g} %", INK, **_EQUAL)]
    text = {"text": [plot.plain(n) for n in names], "hovertemplate": "%{text}: %{y:.1f} %"}
    shares = percent[percent["level"] == level]["shares"].map(np.array) * 100.0
    for joint, colour, beside in _joints(evaluation):
        place, style = number + 0.12 * beside, _dots(colour) | text
        data.append(plot.scatter("markers", place, shares[joint], joint, **style))
    lowest = min(100.0, *map(np.min, shares))
    across = {"title": "trajectory of the test", "range": list(ends), "dtick": -(-len(names) // 10)}
    up = {"title": "inside [%]", "range": [max(0.0, 0.95 * lowest - 2), 102.0]}
    caption = (
        f"Share of the samples of each trajectory inside the {level:g} % interval, in "
        "the order of the test. The statement is about their mean: one may lie inside "
        "altogether, another half outside."
    )
    spec, title = plot.panels([(across, up, data)], _HEIGHT), "Coverage of each trajectory"
    return Figure("coverage", title, caption, [spec], wide=False)


def _dots(colour: str) -> Spec:
    return {"marker": {"color": colour, "size": 7}}


def _joints(evaluation: Evaluation) -> list[tuple[str, str, float]]:
    """Joints, the colour of each, and its place beside the others: -2 to 2, 0 for a single one."""
    count = len(evaluation.joints)
    places = np.linspace(-2.0, 2.0, count) if count > 1 else np.zeros(1)
    return list(zip(evaluation.joints, cycle(PALETTE), places.tolist(), strict=False))


def touch_maps(report: TouchReport) -> Iterator[Figure]:
    """Errors over the block before and after, on the scale of each."""
    errors = (("before", report.before), ("after, by fits without it", report.left_out))
    point, left_out = report.fit.rows.point, report.fit.left_out
    rejected = " Crosses were rejected." if left_out.any() else ""
    for a, b, where in _VIEWS:
        panels: list[plot.Panel] = []
        for title, error in errors:
            x = {"title": f"{'xyz'[a]} of the block [mm], {title}"}
            y = {"title": f"{'xyz'[b]} [mm]", "scaleanchor": "x" if not panels else "x2"}
            panels.append((x, y, _arrows(point, error, (a, b), left_out)))
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
