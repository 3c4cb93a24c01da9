"""Figures as data, and their pictures."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib import figure as mpl_figure
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from numpy.typing import ArrayLike

_STYLE: Final[dict[Any, Any]] = {
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "legend.frameon": False,
    "font.size": 9,
}
_DPI: Final = 130
_LEGEND: Final = 5
"""Names at most in a line of a legend."""
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


def png(figure: Figure) -> bytes:
    """Picture of a figure."""
    with mpl.rc_context(_STYLE):
        picture = mpl_figure.Figure(figsize=(figure.width, figure.height), layout="constrained")
        axes = picture.subplots(len(figure.panels), len(figure.panels[0]), squeeze=False)
        for panel, axis in zip(chain(*figure.panels), axes.flat, strict=True):
            _draw(panel, axis)
        picture.suptitle(figure.title)
        if figure.legend:
            handles, labels = axes[0, 0].get_legend_handles_labels()
            lines = max(1, math.ceil(len(labels) / _LEGEND))
            columns = max(1, math.ceil(len(labels) / lines))  # lines of about the same length
            picture.legend(handles, labels, loc="outside lower center", ncols=columns, fontsize=8)
    data = io.BytesIO()
    picture.savefig(data, format="png", dpi=_DPI)
    return data.getvalue()


def _draw(panel: Panel, axis: Axes) -> None:
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
            one.set_major_locator(LogLocator(subs=(1.0, *between)))
            one.set_major_formatter(FuncFormatter(lambda value, _place: f"{value:g}"))
            one.set_minor_formatter(NullFormatter())
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


def _draw_box(box: Box, axis: Axes) -> None:
    line, face = {"color": box.colour}, {"facecolor": "none", "edgecolor": box.colour}
    axis.boxplot(
        [np.asarray(box.values)],
        positions=[box.x],
        widths=box.width,
        manage_ticks=False,
        patch_artist=True,
        boxprops=face,
        medianprops=line,
        whiskerprops=line,
        capprops=line,
        flierprops={"marker": ".", "markeredgecolor": box.colour},
    )
    if box.label:
        axis.plot([], [], color=box.colour, label=box.label)
