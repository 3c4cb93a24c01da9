"""Figures of the pages, as plain values for Plotly: pieces, then errors over time and position."""

import base64
import html
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle, pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from pandas import DataFrame

from truejoint.array_types import Array, Integers, Mask
from truejoint.drawing import BLUE, GREEN, GREY, INK, ORANGE, PALETTE, PURPLE, SKY, ecdf
from truejoint.errors import printable
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
from truejoint.tip import TouchReport
from truejoint.toml_file import shipped_table
from truejoint.units import DisplayUnit, display_unit

Spec = dict[str, Any]
Panel = tuple[Spec, Spec, list[Spec]]  # horizontal and vertical axis, as `axis` takes them, curves

GRID: Final = "#e6e8eb"
PAPER: Final = "#ffffff"
ZERO: Final = "#c4c9cf"
BAND: Final = "rgba(0,114,178,0.17)"

DARK: Final = {
    INK: "#e6edf3", BLUE: "#58a6e0", ORANGE: "#f0883e", GREEN: "#3fbf92", PURPLE: "#d07fd0",
    SKY: "#8fd0f5", GREY: "#7d8590", GRID: "#2b3138", PAPER: "#0f1419", ZERO: "#4b535d",
    BAND: "rgba(88,166,224,0.25)",
}  # fmt: skip
"""What each colour of a figure becomes where the reader prefers dark pages."""

COLOURS: Final = {"truth": INK, RAW: GREY, OFFSET: ORANGE, "chosen": BLUE}

_LOOK: Final = shipped_table(__package__, "assets/look.toml")
FONT: Final = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif"


@dataclass(frozen=True)
class Figure:
    """One figure of the page: Plotly specifications, between which a menu switches."""

    key: str
    label: str  # For readers who cannot see it
    caption: str
    variants: Sequence[Spec]
    wide: bool = True


def colour_of(estimator: str, evaluation: Evaluation) -> str:
    """Colour of the raw position, the fixed offset or the chosen estimator."""
    return COLOURS["chosen" if estimator == evaluation.chosen else estimator]


def packed(values: Array | NDArray[np.float32]) -> Spec:
    """Numbers as base64 of 4-byte floats, a third of the size of their digits."""
    raw = np.ascontiguousarray(values, dtype="<f4").tobytes()
    return {"dtype": "f4", "bdata": base64.b64encode(raw).decode("ascii")}


def plain(text: str) -> str:
    """Text that a figure shows as it is, `printable`: plotly reads some HTML in titles."""
    return html.escape(printable(text), quote=False)


def scatter(mode: str, x: Array, y: Array, name: str, /, **options: Any) -> Spec:
    """Draw ``"lines"`` or ``"markers"`` at (n,) points, values in the units of the axes."""
    places = {"x": packed(x), "y": packed(y)}
    return {"type": "scatter", "mode": mode, **places, "name": plain(name), **options}


def curve(x: Array, y: Array, name: str, colour: str, /, **options: Any) -> Spec:
    """Draw a line, which its name in the legend shows and hides with all others of that name."""
    keys = [key for key in ("width", "dash", "shape") if key in options]
    line = {"color": colour, "width": 1.3} | {key: options.pop(key) for key in keys}
    return scatter("lines", x, y, name, **{"legendgroup": plain(name), "line": line, **options})


def axis(title: str = "", **options: Any) -> Spec:
    """Describe a plain axis with a light grid."""
    return {
        "title": {"text": plain(title), **_LOOK["axis_title"]},
        "gridcolor": GRID,
        "zerolinecolor": ZERO,
        **_LOOK["axis"],
        **options,
    }


def drawing(data: Sequence[Spec], height: int, **options: Any) -> Spec:
    """Curves, and the layout that all figures share with their own axes."""
    layout = {
        "height": height,
        "font": {"family": FONT, "size": 12, "color": INK},
        "paper_bgcolor": PAPER,
        "plot_bgcolor": PAPER,
        **_LOOK["layout"],
        **options,
    }
    return {"data": data, "layout": layout}


def side_by_side(parts: Sequence[Panel], height: int, across: int = 0, gap: float = 0.075) -> Spec:
    """Draw panels on their own axes, in rows of a `height` [px]: so many `across`, or up to 3."""
    across = across or (min(3, len(parts)) if len(parts) != 4 else 2)
    down = -(-len(parts) // across)
    wide, band = (1.0 - gap * (across - 1)) / across, 1.0 / down
    data: list[Spec] = []
    axes: Spec = {}
    for index, (x, y, curves) in enumerate(parts):
        number = str(index + 1) if index else ""
        names = {"xaxis": f"x{number}", "yaxis": f"y{number}"}
        row, column = divmod(index, across)
        left, top = column * (wide + gap), 1.0 - row * band
        bottom = top - band + (0.3 * band if row < down - 1 else 0.0)
        axes[f"xaxis{number}"] = axis(**x, anchor=names["yaxis"], domain=[left, left + wide])
        axes[f"yaxis{number}"] = axis(**y, anchor=names["xaxis"], domain=[bottom, top])
        data += [{**curve, **names} for curve in curves]
    return drawing(data, height * down + 40, **axes)


def thinned(t: Array, values: Array, buckets: int) -> tuple[Array, Array]:
    """Stamps and values (m,) of a curve (n,) that keeps every peak; NaN breaks it at gaps."""
    keep = extreme_rows(values, buckets)
    piece = np.searchsorted(gaps(t), keep, side="left") if len(t) > 1 else np.zeros(len(keep))
    breaks = np.flatnonzero(np.diff(piece)) + 1
    return np.insert(t[keep], breaks, t[keep][breaks]), np.insert(values[keep], breaks, np.nan)


def outline(t: Array, low: Array, high: Array, pieces: Integers) -> tuple[Array, Array]:
    """Draw the closed outline (m,), (m,) of a band between curves (n,), NaN after each piece.

    Rows of one piece share a number in `pieces` (n,), which ascends.
    """
    rows = np.split(np.arange(len(t)), np.flatnonzero(np.diff(pieces)) + 1)
    x = broken(np.concatenate((t[piece], t[piece][::-1])) for piece in rows)
    return x, broken(np.concatenate((high[piece], low[piece][::-1])) for piece in rows)


def broken(parts: Iterable[Array]) -> Array:
    """Curves (n,) or (n, k) one after another, with a NaN row after each."""
    return np.concatenate([p for part in parts for p in (part, np.full_like(part[:1], np.nan))])


def extreme_rows(values: Array, buckets: int) -> Integers:
    """Rows of the smallest and largest value of each bucket, in order, and both ends."""
    n = len(values)
    if n <= 2 * buckets:
        return np.arange(n)
    edges = np.linspace(0, n, buckets + 1).astype(np.int64)
    lowest = [a + int(np.argmin(values[a:b])) for a, b in pairwise(edges)]
    highest = [a + int(np.argmax(values[a:b])) for a, b in pairwise(edges)]
    return np.unique(np.array([0, *lowest, *highest, n - 1]))


def every(n: int, most: int) -> Integers:
    """Evenly spaced rows, at most `most` of `n`."""
    return np.unique(np.linspace(0, n - 1, min(n, most)).round().astype(np.int64))


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
    true = thinned(t, truth, buckets)
    data = [curve(*true, "True", COLOURS["truth"], width=1.5, dash="dot", **upper)]
    errors = {
        name: evaluation.error(name, joint)[rows, 0] * unit.scale
        for name in (RAW, OFFSET, chosen)
        if whole or name != RAW or name == chosen
    }
    if "lower" in evaluation.rows:
        low, high = (unit.scale * evaluation.known(key)[rows, column] for key in ("lower", "upper"))
        name = f"{100 * evaluation.interval_level:g} % interval"
        options = {"width": 0, "fill": "toself", "fillcolor": BAND, "hoverinfo": "skip"}
        options |= {"legendrank": 1001}
        edges = _band(t, truth + errors[chosen], low, high, buckets)
        for edge, place in zip(edges, (upper | {"showlegend": whole}, lower), strict=False):
            data.append(curve(*edge, name, COLOURS["chosen"], **options, **place))
    # The chosen one last, so that it lies on top.
    for name in sorted(errors, key=lambda name: name == chosen):
        visible = "legendonly" if name == RAW != chosen else True
        for values, place in ((truth + errors[name], upper), (errors[name], lower)):
            thin, colour = thinned(t, values, buckets), colour_of(name, evaluation)
            data.append(curve(*thin, estimator_title(name), colour, visible=visible, **place))
    return drawing(
        data,
        380 if whole else 330,
        xaxis=axis("time [s]", anchor="y2"),
        yaxis=axis(f"position [{unit.name}]", domain=[0.43, 1.0]),
        yaxis2=axis(f"error [{unit.name}]", domain=[0.0, 0.36], zeroline=True),
    )


def _band(
    t: Array, middle: Array, low: Array, high: Array, buckets: int
) -> list[tuple[Array, Array]]:
    """Outlines of an interval (n,) about a curve, and of errors that it allows; none if unknown."""
    bounded = np.flatnonzero(np.isfinite(low))
    if len(bounded) < 2:
        return []
    widest = extreme_rows((high - low)[bounded], buckets // 4)
    bounded = bounded[np.union1d(extreme_rows(middle[bounded], buckets), widest)]
    pieces = np.searchsorted(gaps(t), bounded, side="left")
    t, low, high, middle = (values[bounded] for values in (t, low, high, middle))
    return [outline(t, low, high, pieces), outline(t, middle - high, middle - low, pieces)]


def loops(evaluation: Evaluation) -> Figure:
    """Error against position, before and after; cable hysteresis shows as loops."""
    parts = by_recording(evaluation.rows.index)
    most = max(2, _LOOP_POINTS // len(evaluation.joints) // len(parts))  # of each recording
    pairs = ((OFFSET, COLOURS[OFFSET], 0.45), (evaluation.chosen, COLOURS["chosen"], 0.8))
    panels = []
    for column, joint, unit in evaluation.shown_joints():
        curves = []
        truth = evaluation.known("truth")[:, column]
        for name, colour, opacity in pairs:
            path = unit.scale * np.column_stack((truth, evaluation.error(name, joint)))
            options = {"width": 0.7, "opacity": opacity, "showlegend": column == 0}
            paths = (path[part] for part in parts)
            x, y = broken(rows[every(len(rows), most)] for rows in paths).T
            curves.append(curve(x, y, estimator_title(name), colour, hoverinfo="skip", **options))
        across = {"title": f"{joint} position [{unit.name}]"}
        panels.append((across, {"title": f"error [{unit.name}]"}, curves))
    caption = (
        "Error against true position, as the motion runs through it: before (fixed offset) and "
        "after calibration. Width of a loop is hysteresis, slope is stretch under changing load."
    )
    return Figure("loops", "Hysteresis loops", caption, [side_by_side(panels, 300)])


def distributions(evaluation: Evaluation, colours: Mapping[str, str]) -> Figure:
    """Draw the share of the test's rows within an error, a curve for each estimator of `colours`.

    A panel each for the joints, and for the tool where its place is known.
    """
    titles = {estimator_title(name): colour for name, colour in colours.items()}
    panels: list[Panel] = []
    for name, unit, _ in evaluation.shown_scores():
        errors = {estimator_title(key): evaluation.error(key, name)[:, 0] for key in colours}
        frame = DataFrame(errors).melt(var_name="model", value_name="error")
        what = f"|error| of {'tool' if name == TOOL else name} [{unit.name}]"
        drawn = ecdf(frame, "error", "model", scale=unit.scale, colours=titles)
        curves = [
            curve(
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
    return Figure("distribution", "Distribution of errors", caption, [side_by_side(panels, 280)])


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
            of = f"error [{unit.name}] against position, one panel for each model"
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
    """Panels on one scale, each with at most `most` dots of the ways 1 and -1 of `moves` (n,)."""
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
    return side_by_side(drawn, 230, len(panels), 0.035)


def _cloud(
    x: Array, y: Array, name: str, colour: str, most: int, *, legend: bool
) -> Iterable[Spec]:
    """At most `most` dots, and the median and the middle 90 % of `y` (n,) along `x` (n,)."""
    keep, hidden = every(len(x), most), {"legendgroup": name, "showlegend": False}
    style = {"marker": {"color": colour, "size": 2.5, "opacity": 0.22}, "hoverinfo": "skip"}
    dots = scatter("markers", x[keep], y[keep], name, **style, **hidden)
    centre, low, middle, high = binned(x, y)
    around = np.concatenate((centre, centre[::-1])), np.concatenate((high, low[::-1]))
    fill = {"fill": "toself", "fillcolor": colour, "opacity": 0.14, "hoverinfo": "skip"}
    band = curve(*around, name, colour, width=0, **fill, **hidden)
    median = curve(centre, middle, name, colour, width=1.8, **hidden | {"showlegend": legend})
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
    data = [curve(ends, ends, "equal", INK, **_EQUAL)]
    for joint, colour, beside in _joints(evaluation):
        rows = percent.loc[[joint]]
        style = _dots(colour) | {"line": {"color": colour, "width": 1.3}}
        if several:
            bars = packed(rows["standard_error"].to_numpy())
            style["error_y"] = {"array": bars, "thickness": 1.3, "width": 4}
        x = rows["level"].to_numpy() + 0.06 * margin * beside
        data.append(scatter("lines+markers", x, rows["coverage"].to_numpy(), joint, **style))
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
    spec, title = side_by_side([(across, up, data)], _HEIGHT), "Stated and found coverage"
    return Figure("calibration", title, caption, [spec], wide=False)


def _each_trajectory(evaluation: Evaluation, percent: DataFrame) -> Figure:
    level, names = 100.0 * evaluation.interval_level, evaluation.interval_trajectories
    number, ends = np.arange(1.0, len(names) + 1.0), np.array([0.5, len(names) + 0.5])
    data = [curve(ends, np.full(2, level), f"stated {level:g} %", INK, **_EQUAL)]
    text = {"text": [plain(n) for n in names], "hovertemplate": "%{text}: %{y:.1f} %"}
    shares = percent[percent["level"] == level]["shares"].map(np.array) * 100.0
    for joint, colour, beside in _joints(evaluation):
        place, style = number + 0.12 * beside, _dots(colour) | text
        data.append(scatter("markers", place, shares[joint], joint, **style))
    lowest = min(100.0, *map(np.min, shares))
    across = {"title": "trajectory of the test", "range": list(ends), "dtick": -(-len(names) // 10)}
    up = {"title": "inside [%]", "range": [max(0.0, 0.95 * lowest - 2), 102.0]}
    caption = (
        f"Share of the samples of each trajectory inside the {level:g} % interval, in "
        "the order of the test. The statement is about their mean: one may lie inside "
        "altogether, another half outside."
    )
    spec, title = side_by_side([(across, up, data)], _HEIGHT), "Coverage of each trajectory"
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
        panels: list[Panel] = []
        for title, error in errors:
            x = {"title": f"{'xyz'[a]} of the block [mm], {title}"}
            y = {"title": f"{'xyz'[b]} [mm]", "scaleanchor": "x" if not panels else "x2"}
            panels.append((x, y, _arrows(point, error, (a, b), left_out)))
        caption = (
            f"Each dot is a dimple, seen {where}; its colour is how far off the tip "
            "was [mm], the line from it in which direction, drawn out for each panel. Before: as "
            "measured, the block laid over all as well as it can be. After: by fits that did "
            f"not see it, its own error included.{rejected}"
        )
        key, label = f"map-{'xyz'[a]}{'xyz'[b]}", f"Errors of the tip, {where}"
        yield Figure(key, label, caption, [side_by_side(panels, 340, gap=0.2)])


def _arrows(point: Array, error: Array, axes: tuple[int, int], left_out: Mask) -> list[Spec]:
    """Dots at points (m, 3) [m], and lines along errors (m, 3), in a plane."""
    place, size = 1e3 * point[:, axes], 1e3 * np.linalg.norm(error, axis=1)
    good = ~left_out
    longest = np.linalg.norm(error[good][:, axes], axis=1).max()
    tip = place + _ARROW * np.ptp(place, axis=0).max() / longest * error[:, axes]
    ways = broken(np.stack([place[good], tip[good]], axis=1)).T
    bar = _LOOK["colour_bar"] | {"title": {"text": "error [mm]", "side": "top"}}
    marker = _LOOK["coloured_dots"] | {"color": packed(size[good]), "size": 9, "colorbar": bar}
    marker["cmax"] = float(size[good].max())
    (x, y), (a, b) = place[good].T, place[left_out].T
    dots = scatter("markers", x, y, "error [mm]", marker=marker, showlegend=False)
    drawn = [curve(ways[0], ways[1], "direction", GREY, width=1.5, hoverinfo="skip"), dots]
    if left_out.any():
        cross = {"symbol": "x", "size": 9, "color": ORANGE}
        drawn.append(scatter("markers", a, b, "rejected", marker=cross))
    return drawn
