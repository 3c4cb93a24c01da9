"""A trajectory in three dimensions, in degrees and millimetres."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, Final

import numpy as np

from truejoint.array_types import Array
from truejoint.errors import TrajectoryError
from truejoint.extras import require
from truejoint.files import write_atomically
from truejoint.motion.trajectory import Trajectory, as_trajectory
from truejoint.units import display_unit

_MOST_POINTS: Final = 20_000
_START: Final = "#1b7837"
_END: Final = "#b2182b"
_SHADOW: Final = "#b9c0cb"
_MAP: Final = "viridis"


def plot_trajectory(
    trajectory: Trajectory, path: str | os.PathLike[str], *, overwrite: bool = False
) -> None:
    """Draw a trajectory of three joints, in deg and mm, from its start (dark) to its end (bright).

    Of more than 20 000 points every n-th is drawn.

    Parameters
    ----------
    trajectory : Trajectory
    path : path-like
        ``.png`` for a picture, ``.html`` for a self-contained page that works offline.
    overwrite : bool
        Whether a file that is there may be replaced.

    Raises
    ------
    TrajectoryError
        If it has not three joints, for another file type, or if the file exists or cannot be
        written.
    TruejointError
        If the extra ``plots`` is not installed.

    Examples
    --------
    >>> path = zigzag(truejoint.get_robot("raven2"), "J2-J3")
    >>> plot_trajectory(path, "zigzag.html")  # doctest: +SKIP
    """
    name, joints = as_trajectory(trajectory).name, trajectory.joints
    if len(joints) != 3:
        raise TrajectoryError(f"{name}: a 3-D plot needs three joints; got {', '.join(joints)}")
    draw = {".png": _draw_png, ".html": _draw_html}.get(Path(path).suffix)
    if draw is None:
        raise TrajectoryError(f"{path}: plots are .png or .html; choose one of them")
    units = [display_unit(unit) for unit in trajectory.units]
    labels = [f"{joint} [{unit.name}]" for joint, unit in zip(joints, units, strict=True)]
    stride = -(-len(trajectory) // _MOST_POINTS)
    rows = np.union1d(np.arange(0, len(trajectory), stride), len(trajectory) - 1)
    points = np.asarray(trajectory.positions[rows] * [unit.scale for unit in units])

    def write(part: Path) -> None:
        draw(name, points, labels, part)

    write_atomically(Path(path), write, overwrite=overwrite, error=TrajectoryError)


def _draw_png(name: str, points: Array, labels: list[str], path: Path) -> None:
    art = require("mpl_toolkits.mplot3d.art3d", "plots", "a drawing")
    figure = require("matplotlib.figure", "plots", "a drawing").Figure(figsize=(8.0, 7.2), dpi=150)
    colormap = require("matplotlib", "plots", "a drawing").colormaps[_MAP]
    axes = figure.add_axes((0.0, 0.02, 0.94, 0.94), projection="3d")
    # A margin of 6 %, and behind it walls that the shadows fall on.
    margin = 0.06 * np.where(np.ptp(points, axis=0) > 0.0, np.ptp(points, axis=0), 1.0)
    low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
    for axis, wall in enumerate((low[0], high[1], low[2])):
        shadow = points.copy()
        shadow[:, axis] = wall
        axes.plot(*shadow.T, color=_SHADOW, linewidth=0.5, zorder=0)
    lines = list(np.stack([points[:-1], points[1:]], axis=1))
    colours = colormap(np.linspace(0.0, 0.92, len(lines)))
    axes.add_collection3d(art.Line3DCollection(lines, colors=colours, linewidths=1.3))
    for point, colour, marker in ((points[0], _START, "o"), (points[-1], _END, "s")):
        axes.scatter(*point, color=colour, s=42, marker=marker, depthshade=False, zorder=5)
    limits = zip(("xlim", "ylim", "zlim"), zip(low, high, strict=True), strict=True)
    axes.set(**dict(limits), **dict(zip(("xlabel", "ylabel", "zlabel"), labels, strict=True)))
    axes.set_box_aspect((1, 1, 1), zoom=0.9)
    axes.view_init(elev=22, azim=-56)
    figure.text(0.5, 0.955, name, ha="center", fontsize=14)
    key = "from the circle to the square, dark to bright"
    figure.text(0.5, 0.925, key, ha="center", fontsize=9)
    figure.savefig(path, format="png")


def _draw_html(name: str, points: Array, labels: list[str], path: Path) -> None:
    figure = require("plotly.graph_objects", "plots", "a drawing").Figure()
    shown = list(zip("xyz", labels, strict=True))
    hover = "<br>".join(f"{label} %{{{axis}:.3f}}" for axis, label in shown)
    gradient = {"color": np.linspace(0, 100, len(points)), "colorscale": _MAP, "width": 4}
    start = {"size": 5, "symbol": "circle", "color": _START}
    end = {"size": 5, "symbol": "square", "color": _END}
    drawn: tuple[tuple[str, Array, dict[str, Any]], ...] = (
        (name, points, {"mode": "lines", "line": gradient, "showlegend": False}),
        ("start", points[:1], {"mode": "markers", "marker": start}),
        ("end", points[-1:], {"mode": "markers", "marker": end}),
    )
    for title, rows, style in drawn:
        place = dict(zip("xyz", rows.T, strict=True))
        template = f"{hover}<extra>{title}</extra>"
        figure.add_scatter3d(**place, **style, name=title, hovertemplate=template)
    figure.update_layout(
        title=name,
        template="plotly_white",
        margin={"l": 0, "r": 0, "t": 48, "b": 0},
        scene={
            "aspectmode": "cube",
            **{f"{axis}axis_title": label for axis, label in shown},
            "camera_eye": {"x": 1.4, "y": -1.75, "z": 0.85},
        },
    )
    # A page that is meant to work offline offers no button that sends its data away.
    buttons = {"modeBarButtonsToRemove": ["sendChartToCloud", "sendDataToCloud"]}
    config = {"displaylogo": False, **buttons}
    figure.write_html(path, include_plotlyjs=True, config=config, default_height="94vh")
