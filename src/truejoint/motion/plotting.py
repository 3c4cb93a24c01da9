"""Trajectories in three dimensions, in degrees and millimetres."""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from truejoint.array_types import Array
from truejoint.errors import TrajectoryError
from truejoint.extras import require
from truejoint.files import write_atomically
from truejoint.motion.trajectory import Trajectory, as_trajectory
from truejoint.units import display_unit

Lines = list[tuple[str, Array]]

_MOST_POINTS: Final = 20_000
_COLOURS: Final = ("#1f6fb4", "#d1495b", "#2e8b57", "#8f5bb5", "#c77f1a", "#4a5561")
_START: Final = "#1b7837"
_END: Final = "#b2182b"
_SHADOW: Final = "#b9c0cb"
_GRID: Final = "#e3e6ea"
_MAP: Final = "viridis"
# A page that is meant to work offline offers no button that sends its data away.
_PAGE: Final = {
    "displaylogo": False,
    "modeBarButtonsToRemove": ["sendChartToCloud", "sendDataToCloud"],
}


def plot_trajectories(
    trajectories: Trajectory | Sequence[Trajectory],
    path: str | os.PathLike[str],
    *,
    overwrite: bool = False,
) -> None:
    """Draw trajectories of the same three joints into one figure, in deg and mm.

    A single one is coloured from its start (dark) to its end (bright), several by trajectory.
    Of more than 20 000 points every n-th is drawn.

    Parameters
    ----------
    trajectories : Trajectory or sequence of Trajectory
    path : path-like
        ``.png`` for a picture, ``.html`` for a self-contained page that works offline.
    overwrite : bool
        Whether a file that is there may be replaced.

    Raises
    ------
    TrajectoryError
        If there is none, the joints are not the same three, for another file type, or if the file
        exists or cannot be written.
    TruejointError
        If the extra ``plots`` is not installed.

    Examples
    --------
    >>> path = zigzag(truejoint.get_robot("raven2"), "J2-J3")
    >>> plot_trajectories([path], "zigzag.html")  # doctest: +SKIP
    """
    listed = [trajectories] if isinstance(trajectories, Trajectory) else trajectories
    trajectories = [as_trajectory(trajectory) for trajectory in listed]
    if not trajectories:
        raise TrajectoryError("there is no trajectory to draw; give at least one")
    joints, units = trajectories[0].joints, trajectories[0].units
    for trajectory in trajectories:
        if len(joints) != 3 or trajectory.joints != joints or trajectory.units != units:
            raise TrajectoryError(
                f"{trajectory.name}: a 3-D plot needs the same three joints in all trajectories; "
                f"got {', '.join(trajectory.joints)}"
            )
    draw = {".png": _draw_png, ".html": _draw_html}.get(Path(path).suffix)
    if draw is None:
        raise TrajectoryError(f"{path}: plots are .png or .html; choose one of them")
    lines = [(trajectory.name, _points(trajectory)) for trajectory in trajectories]
    shown = [display_unit(unit).name for unit in units]
    write = partial(draw, lines, joints, shown)
    write_atomically(Path(path), write, overwrite=overwrite, error=TrajectoryError)


def _points(trajectory: Trajectory) -> Array:
    """Positions (n, 3) [deg or mm], thinned out."""
    scale = [display_unit(unit).scale for unit in trajectory.units]
    stride = -(-len(trajectory) // _MOST_POINTS)
    rows = np.union1d(np.arange(0, len(trajectory), stride), len(trajectory) - 1)
    return np.asarray(trajectory.positions[rows] * scale)


def _draw_png(lines: Lines, joints: Sequence[str], units: Sequence[str], path: Path) -> None:
    art = require("mpl_toolkits.mplot3d.art3d", "plots", "a drawing")
    figure = require("matplotlib.figure", "plots", "a drawing").Figure(figsize=(8.0, 7.2), dpi=150)
    colormap = require("matplotlib", "plots", "a drawing").colormaps[_MAP]
    axes = figure.add_axes((0.0, 0.02, 0.94, 0.94), projection="3d")
    # A margin of 6 %, and behind it walls that the shadows fall on.
    everything = np.vstack([points for _, points in lines])
    low, high = everything.min(axis=0), everything.max(axis=0)
    margin = 0.06 * np.where(high > low, high - low, 1.0)
    low, high = low - margin, high + margin
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect((1, 1, 1), zoom=0.9)
    single = len(lines) == 1
    for k, (name, points) in enumerate(lines):
        for axis, wall in ((0, low[0]), (1, high[1]), (2, low[2])):
            shadow = points.copy()
            shadow[:, axis] = wall
            axes.plot(*shadow.T, color=_SHADOW, linewidth=0.5, zorder=0)
        parts = np.stack([points[:-1], points[1:]], axis=1)
        colour = _COLOURS[k % len(_COLOURS)]
        colours = colormap(np.linspace(0.0, 0.92, len(parts))) if single else [colour]
        axes.add_collection3d(
            art.Line3DCollection(list(parts), colors=colours, linewidths=1.3, capstyle="round")
        )
        axes.plot([], [], [], color=colour, label=name)
        axes.scatter(*points[0], color=_START, s=42, depthshade=False, zorder=5)
        axes.scatter(*points[-1], color=_END, s=42, marker="s", depthshade=False, zorder=5)
    for axis, joint, unit in zip((axes.xaxis, axes.yaxis, axes.zaxis), joints, units, strict=True):
        axis.set_label_text(f"{joint} [{unit}]")
        axis.set_pane_color((0.97, 0.975, 0.98, 1.0))
        axis.labelpad = 9
        # Matplotlib has no public setting for the grid of 3-D axes.
        axis._axinfo["grid"]["color"] = _GRID
    axes.view_init(elev=22, azim=-56)
    if single:
        figure.text(0.5, 0.955, lines[0][0], ha="center", fontsize=14)
    else:
        axes.legend(loc="upper left", fontsize=9, frameon=False)
    key = "from the circle to the square" + (", dark to bright" if single else "")
    figure.text(0.5, 0.925, key, ha="center", fontsize=9)
    figure.savefig(path, format="png")


def _draw_html(lines: Lines, joints: Sequence[str], units: Sequence[str], path: Path) -> None:
    figure = require("plotly.graph_objects", "plots", "a drawing").Figure()
    shown = list(zip("xyz", joints, units, strict=True))
    hover = "<br>".join(f"{joint} %{{{axis}:.3f}} {unit}" for axis, joint, unit in shown)
    single = len(lines) == 1
    for k, (name, points) in enumerate(lines):
        gradient = {"color": np.linspace(0, 100, len(points)), "colorscale": _MAP, "width": 4}
        line = gradient if single else {"color": _COLOURS[k % len(_COLOURS)], "width": 4}
        start = {"size": 5, "symbol": "circle", "color": _START}
        end = {"size": 5, "symbol": "square", "color": _END}
        for rows, title, key, style in (
            (points, name, not single, {"mode": "lines", "line": line}),
            (points[:1], "start", k == 0, {"mode": "markers", "marker": start}),
            (points[-1:], "end", k == 0, {"mode": "markers", "marker": end}),
        ):
            figure.add_scatter3d(
                **dict(zip("xyz", rows.T, strict=True)),
                **style,
                name=title,
                showlegend=key,
                legendgroup=title,
                hovertemplate=hover + "<extra>%{fullData.name}</extra>",
            )
    figure.update_layout(
        title=lines[0][0] if single else "trajectories",
        template="plotly_white",
        margin={"l": 0, "r": 0, "t": 48, "b": 0},
        scene={
            "aspectmode": "cube",
            **{f"{axis}axis_title": f"{joint} [{unit}]" for axis, joint, unit in shown},
            "camera_eye": {"x": 1.4, "y": -1.75, "z": 0.85},
        },
    )
    figure.write_html(path, include_plotlyjs=True, config=_PAGE, default_height="94vh")
