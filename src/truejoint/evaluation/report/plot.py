"""Pieces of interactive figures as plain values: packed arrays, curves, axes, thinning."""

import base64
import html
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from truejoint.array_types import Array, Integers
from truejoint.drawing import BLUE, GREEN, GREY, INK, ORANGE, PURPLE, SKY
from truejoint.evaluation.results import OFFSET, RAW, Evaluation
from truejoint.recordings.table.stream import gaps
from truejoint.toml_file import shipped_table

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
    """One figure of the page: Plotly specifications, between which a menu switches.

    `label` is for readers who cannot see it.
    """

    key: str
    label: str
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
    """Text that a figure shows as it is: plotly reads some HTML in titles and labels."""
    return html.escape(text, quote=False)


def coloured(x: Array, y: Array, colour: Array, title: str, highest: float, **style: Any) -> Spec:
    """Draw dots in a plane by `colour` (n,) from 0 on; the legend leaves them out."""
    bar = _LOOK["colour_bar"] | {"title": {"text": plain(title), "side": "top"}}
    marker = _LOOK["coloured_dots"] | {
        "color": packed(colour), "cmax": highest, "colorbar": bar, **style,
    }  # fmt: skip
    return scatter("markers", x, y, title, marker=marker, showlegend=False)


def scatter(mode: str, x: Array, y: Array, name: str, /, **options: Any) -> Spec:
    """Draw ``"lines"`` or ``"markers"`` at (n,) points, values in the units of the axes."""
    places = {"x": packed(x), "y": packed(y)}
    return {"type": "scatter", "mode": mode, **places, "name": plain(name), **options}


def curve(x: Array, y: Array, name: str, colour: str, /, **options: Any) -> Spec:
    """Draw a line, which its name in the legend shows and hides with all others of that name."""
    keys = [key for key in ("width", "dash", "shape") if key in options]
    line = {"color": colour, "width": 1.3} | {key: options.pop(key) for key in keys}
    return scatter("lines", x, y, name, **{"legendgroup": plain(name), "line": line, **options})


def path(parts: Sequence[Array], most: int, name: str, colour: str, **options: Any) -> Spec:
    """Draw curves (n, 2) as one line, broken between them, thinned to about `most` rows."""
    most = max(2, most // len(parts))
    x, y = broken(part[every(len(part), most)] for part in parts).T
    return curve(x, y, name, colour, hoverinfo="skip", **options)


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


def panels(parts: Sequence[Panel], height: int, across: int = 0, gap: float = 0.075) -> Spec:
    """Draw panels, each with its curves on axes of its own, in rows of a `height` [px].

    So many stand side by side, at most three if that is not said.
    """
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
