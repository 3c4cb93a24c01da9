"""Figures as data: curves and boxes in panels, three plots of tidy rows, and still pictures."""

import io
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, cycle, product
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import ArrayLike

from truejoint.array_types import Array
from truejoint.extras import require
from truejoint.units import display_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame

# Okabe and Ito's palette, which stays distinct under every common colour blindness; the orange
# is darkened so that a thin line holds on white paper.
INK: Final = "#1f2328"
BLUE: Final = "#0072b2"
ORANGE: Final = "#d55e00"
GREEN: Final = "#009e73"
PURPLE: Final = "#aa4499"
SKY: Final = "#56b4e9"
GREY: Final = "#9aa0a6"
PALETTE: Final = (BLUE, ORANGE, GREEN, PURPLE, SKY, GREY)

_STYLE: Final = Path(__file__).with_name("figures.mplstyle")
_DPI: Final = 130
_LEGEND: Final = 5
"""Names at most in a line of a legend."""
_SHARES: Final = 201
"""Points at most of a cumulative distribution."""
_DECADES: Final = 300.0  # ends of a logarithmic axis this many times apart: powers of ten alone


@dataclass(frozen=True, eq=False)
class Curve:
    """Points (n,) in the units of the axes, in matplotlib's `style`; in the legend if labelled."""

    x: ArrayLike
    y: ArrayLike
    label: str = ""
    colour: str | None = None
    style: str = "-"
    width: float = 0.9


@dataclass(frozen=True, eq=False)
class Box:
    """Box plot of values (n,) in the unit of the vertical axis, at `x`."""

    x: float
    values: ArrayLike
    colour: str
    label: str = ""
    width: float = 0.16


@dataclass(frozen=True, eq=False)
class Panel:
    """One pair of axes, labelled `x`, `y` and `title`; those of ``"xy"`` in `log` are logarithmic.

    `rows` name the places 0, 1, ... along the vertical axis, from above, `columns` those along the
    horizontal one; `shade` greys a stretch of that.
    """

    curves: Sequence[Curve]
    x: str = ""
    y: str = ""
    title: str = ""
    log: str = ""
    rows: Sequence[str] = ()
    shade: tuple[float, float] | None = None
    legend: bool = False
    boxes: Sequence[Box] = ()
    columns: Sequence[str] = ()


@dataclass(frozen=True, eq=False)
class Figure:
    """Rows of as many panels each, with a title, a caption for the page, and a size [inch].

    With `legend`, one legend below, that of the first panel, serves all.
    """

    title: str
    panels: Sequence[Sequence[Panel]]
    caption: str = ""
    width: float = 11.0
    height: float = 5.0
    legend: bool = False


def ecdf(
    frame: "DataFrame",
    value: str,
    by: str,
    *,
    scale: float = 1.0,
    colours: Mapping[Any, str] | None = None,
    **panel: Any,
) -> Panel:
    """Plot the share of rows [%] with at most a size of `value`, a curve for each `by`.

    The `frame` is tidy, one row per value; `value` and `by` are its columns. `scale` leads from its
    unit to that of the axis. `colours` are by the values of `by`, the palette by default; `panel`
    is more of `Panel`, such as its labels.
    """
    curves = []
    for number, (name, colour, group) in enumerate(_groups(frame, by, colours)):
        size = np.sort(scale * np.abs(group[value].to_numpy(dtype=float)))
        share = np.linspace(0.0, 1.0, min(len(size), _SHARES))
        style = ("-", "--", ":")[number // len(PALETTE) % 3]  # no two names look alike
        curves.append(Curve(np.quantile(size, share), 100.0 * share, name, colour, style))
    return Panel(curves, **{"y": "share of rows [%]", **panel})


def by_condition(frame: "DataFrame", condition: str, value: str, by: str, **panel: Any) -> Panel:
    """Plot medians of `value` against numbers of a `condition`, a curve for each `by`.

    The other parameters are those of `ecdf`.
    """
    curves = []
    for name, colour, group in _groups(frame, by, None):
        middle = group.groupby(condition)[value].median()
        curves.append(Curve(middle.index.to_numpy(), middle.to_numpy(), name, colour, "-o", 2.0))
    return Panel(curves, **panel)


def box_plot(
    frame: "DataFrame",
    condition: str,
    value: str,
    by: str,
    *,
    colours: Mapping[Any, str] | None = None,
    **panel: Any,
) -> Panel:
    """Plot boxes of `value` at each `condition`, side by side by `by`; otherwise as `ecdf`."""
    places = list(dict.fromkeys(frame[condition]))
    groups = list(_groups(frame, by, colours))
    step = 0.8 / len(groups)
    boxes = []
    for (place, at), (number, (name, colour, group)) in product(
        enumerate(places), enumerate(groups)
    ):
        values = group.loc[group[condition] == at, value].to_numpy(dtype=float)
        x, label = place + step * (number - 0.5 * (len(groups) - 1)), "" if place else name
        boxes += [Box(x, values, colour, label, 0.8 * step)] if len(values) else []
    return Panel((), boxes=boxes, columns=tuple(map(str, places)), **panel)


def _groups(
    frame: "DataFrame", by: str, colours: Mapping[Any, str] | None
) -> "Iterator[tuple[str, str, DataFrame]]":
    """Label, colour and rows for each value of a column, in the order of the frame."""
    for (key, group), colour in zip(frame.groupby(by, sort=False), cycle(PALETTE), strict=False):
        yield str(key), (colours or {}).get(key, colour), group


def png(figure: Figure) -> bytes:
    """Picture of a figure, by matplotlib; raises TruejointError if that is not installed."""
    data, small = io.BytesIO(), io.BytesIO()
    picture = _axes(figure, "matplotlib.figure", "Figure")[0, 0].figure
    picture.savefig(data, format="png", dpi=_DPI)
    image = require("PIL.Image", "plots", "pictures").open(data).convert("RGB")
    image.quantize(128, dither=0).save(small, "png", optimize=True)  # a third of the size
    return small.getvalue()


def plot(
    title: str, x: Array, curves: Mapping[str, Array], units: Mapping[str, str], of: str
) -> Any:
    """Draw curves (n, k) over `of`, `x` (n,); or curves of `of` over `x` (n, k); give axes (k,)."""
    panels = []
    for k, (name, unit) in enumerate(zip(units, map(display_unit, units.values()), strict=True)):
        over, titles = x, (of, f"{name} [{unit.name}]")
        if x.ndim > 1:
            over, titles = unit.scale * x[:, k], (titles[1], f"{of} [{unit.name}]")
        drawn = zip(curves.items(), cycle(PALETTE), strict=False)
        own = [Curve(over, unit.scale * y[:, k], text, colour) for (text, y), colour in drawn]
        panels.append([Panel(own, *titles)])
    figure = Figure(title, panels, height=1.5 + 2.5 * len(panels), legend=True)
    return _axes(figure, "matplotlib.pyplot", "figure")[:, 0]


def _axes(figure: Figure, module: str, name: str) -> Any:
    """Axes (rows, columns) of a figure, which a function or class of matplotlib makes."""
    mpl, maker = (require(each, "plots", "a figure") for each in ("matplotlib", module))
    with mpl.rc_context(fname=_STYLE):
        size = figure.width, figure.height
        picture = getattr(maker, name)(figsize=size, layout="constrained")
        axes = picture.subplots(len(figure.panels), len(figure.panels[0]), squeeze=False)
        for panel, axis in zip(chain(*figure.panels), axes.flat, strict=True):
            _draw(panel, axis)
        picture.suptitle(figure.title)
        if figure.legend:
            handles, labels = axes[0, 0].get_legend_handles_labels()
            lines = max(1, math.ceil(len(labels) / _LEGEND))
            columns = max(1, math.ceil(len(labels) / lines))  # lines of about the same length
            picture.legend(handles, labels, loc="outside lower center", ncols=columns, fontsize=8)
    return axes


def _draw(panel: Panel, axis: "Axes") -> None:
    ticker = require("matplotlib.ticker", "plots", "a figure")
    for curve in panel.curves:
        look: dict[str, Any] = {"color": curve.colour, "lw": curve.width, "ms": 4}
        axis.plot(curve.x, curve.y, curve.style, label=curve.label or None, **look)
    for box in panel.boxes:
        _draw_box(box, axis)
    axis.set(xlabel=panel.x, ylabel=panel.y, title=panel.title)
    if panel.shade:
        axis.axvspan(*panel.shade, color="0.9", zorder=0)
    for letter, one in (("x", axis.xaxis), ("y", axis.yaxis)):
        if letter in panel.log:
            axis.set(**{f"{letter}scale": "log"})
            low, high = one.get_view_interval()
            between = () if high > _DECADES * low else (2.0, 5.0)
            one.set_major_locator(ticker.LogLocator(subs=(1.0, *between)))
            one.set_major_formatter(ticker.FuncFormatter(lambda value, _place: f"{value:g}"))
            one.set_minor_formatter(ticker.NullFormatter())
    if panel.columns:
        axis.set_xticks(np.arange(len(panel.columns)), list(panel.columns))
    if panel.rows:
        axis.set_yticks(np.arange(len(panel.rows)), list(panel.rows))
        axis.invert_yaxis()
    if panel.legend:
        if not panel.rows:  # above the curves, where it hides nothing
            low, high = axis.get_ylim()
            axis.set_ylim(low, high + 0.35 * (high - low))
        axis.legend(loc="upper left", fontsize=7)


def _draw_box(box: Box, axis: "Axes") -> None:
    lines = {key: {"color": box.colour} for key in ("medianprops", "whiskerprops", "capprops")}
    look: dict[str, Any] = lines | {
        "boxprops": {"facecolor": "none", "edgecolor": box.colour},
        "flierprops": {"marker": ".", "markeredgecolor": box.colour},
    }
    where: dict[str, Any] = {"positions": [box.x], "widths": box.width, "manage_ticks": False}
    axis.boxplot([np.asarray(box.values)], patch_artist=True, **where, **look)
    if box.label:
        axis.plot([], [], color=box.colour, label=box.label)
