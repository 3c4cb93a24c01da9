"""Pieces of interactive figures as plain values: packed arrays, curves, axes, thinning."""

from __future__ import annotations

import base64
import html
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from truejoint.evaluation.results import OFFSET, RAW
from truejoint.evaluation.signals import gaps

Array = NDArray[np.float64]
Spec = dict[str, Any]

# Okabe and Ito's palette, which stays distinct under every common colour blindness; the orange
# is darkened so that a thin line holds on white paper.
INK: Final = "#1f2328"
BLUE: Final = "#0072b2"
ORANGE: Final = "#d55e00"
GREEN: Final = "#009e73"
PURPLE: Final = "#aa4499"
SKY: Final = "#56b4e9"
GREY: Final = "#9aa0a6"
GRID: Final = "#e6e8eb"

COLOURS: Final = {"truth": INK, RAW: GREY, OFFSET: ORANGE, "chosen": BLUE}

FONT: Final = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif"


@dataclass(frozen=True)
class Figure:
    """One figure of the page.

    Attributes
    ----------
    key : str
        Identifier in the page.
    label : str
        Short name for readers who cannot see the figure.
    caption : str
        What it shows, with units.
    variants : sequence of dict
        Plotly specifications (``data`` and ``layout``); a menu switches between several.
    height : int
        Height [px].
    wide : bool
        Whether it takes the whole width of the page.
    flat : dict or None
        Two-dimensional figure that stands in where a browser has no WebGL.
    """

    key: str
    label: str
    caption: str
    variants: Sequence[Spec]
    height: int = 320
    wide: bool = True
    flat: Spec | None = field(default=None, repr=False)


def packed(values: Array | NDArray[np.float32]) -> Spec:
    """Numbers as base64 of 4-byte floats, a third of the size of their digits."""
    raw = np.ascontiguousarray(values, dtype="<f4").tobytes()
    return {"dtype": "f4", "bdata": base64.b64encode(raw).decode("ascii")}


def plain(text: str) -> str:
    """Text that a figure shows as it is: plotly reads some HTML in titles and labels."""
    return html.escape(text, quote=False)


def curve(x: Array, y: Array, name: str, colour: str, **options: Any) -> Spec:
    """Draw a line through (n,) points, values in the units of the axes."""
    line = {"color": colour, "width": options.pop("width", 1.3)}
    if "dash" in options:
        line["dash"] = options.pop("dash")
    if "shape" in options:
        line["shape"] = options.pop("shape")
    return {
        "type": "scatter",
        "mode": "lines",
        "x": packed(x),
        "y": packed(y),
        "name": plain(name),
        "legendgroup": plain(name),
        "line": line,
        **options,
    }


def axis(title: str = "", **options: Any) -> Spec:
    """Describe a plain axis with a light grid."""
    return {
        "title": {"text": plain(title), "standoff": 6, "font": {"size": 12}},
        "gridcolor": GRID,
        "zerolinecolor": "#c4c9cf",
        "linecolor": "#8b9198",
        "tickfont": {"size": 11},
        "ticks": "outside",
        "ticklen": 3,
        "tickcolor": "#8b9198",
        "showline": True,
        "automargin": True,
        **options,
    }


def layout(height: int, **options: Any) -> Spec:
    """Layout shared by all figures."""
    return {
        "height": height,
        "margin": {"l": 56, "r": 12, "t": 36, "b": 44},
        "font": {"family": FONT, "size": 12, "color": INK},
        "paper_bgcolor": "#ffffff",
        "plot_bgcolor": "#ffffff",
        "hovermode": "closest",
        "legend": {
            "orientation": "h",
            "x": 0,
            "xanchor": "left",
            "y": 1.0,
            "yanchor": "top",
            "yref": "container",
            "font": {"size": 12},
            "traceorder": "normal",
        },
        **options,
    }


def columns(count: int, gap: float) -> list[list[float]]:
    """Domains of `count` panels side by side, as shares of the width."""
    width = (1.0 - gap * (count - 1)) / count
    return [[i * (width + gap), i * (width + gap) + width] for i in range(count)]


def thinned(t: Array, values: Array, buckets: int) -> tuple[Array, Array]:
    """Curve with at most two points a bucket, which keeps every peak; broken at gaps.

    Parameters
    ----------
    t, values : ndarray, shape (n,)
        Stamps [s] and values in any unit.
    buckets : int
        Parts of the rows in which the smallest and the largest value are kept.

    Returns
    -------
    t, values : ndarray, shape (m,)
        m is at most ``2 * buckets`` and a NaN for each gap.
    """
    keep = extreme_rows(values, buckets)
    piece = np.searchsorted(gaps(t), keep, side="left") if len(t) > 1 else np.zeros(len(keep))
    breaks = np.flatnonzero(np.diff(piece)) + 1
    return np.insert(t[keep], breaks, t[keep][breaks]), np.insert(values[keep], breaks, np.nan)


def outline(t: Array, low: Array, high: Array, pieces: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return the closed outline of a band between two curves, one for each piece, NaN between them.

    Parameters
    ----------
    t, low, high : ndarray, shape (n,)
        Stamps [s], and the edges of the band in any unit.
    pieces : ndarray of int, shape (n,)
        Rows of one piece share a number; numbers ascend.

    Returns
    -------
    t, edge : ndarray, shape (m,)
    """
    x: list[Array] = []
    y: list[Array] = []
    end = np.array([np.nan])
    for rows in np.split(np.arange(len(t)), np.flatnonzero(np.diff(pieces)) + 1):
        x += [t[rows], t[rows][::-1], end]
        y += [high[rows], low[rows][::-1], end]
    return np.concatenate(x), np.concatenate(y)


def extreme_rows(values: Array, buckets: int) -> NDArray[np.int64]:
    """Rows of the smallest and largest value of each bucket, in order, and both ends."""
    n = len(values)
    if n <= 2 * buckets:
        return np.arange(n)
    edges = np.linspace(0, n, buckets + 1).astype(np.int64)
    lowest = [a + int(np.argmin(values[a:b])) for a, b in pairwise(edges)]
    highest = [a + int(np.argmax(values[a:b])) for a, b in pairwise(edges)]
    return np.unique(np.array([0, *lowest, *highest, n - 1]))


def every(n: int, most: int) -> NDArray[np.int64]:
    """Evenly spaced rows, at most `most` of `n`."""
    return np.unique(np.linspace(0, n - 1, min(n, most)).round().astype(np.int64))
