"""Trajectories in three dimensions, in degrees and millimetres."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import plotly.graph_objects as go
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import (  # type: ignore[import-untyped]  # it has no types
    Line3DCollection,
)

from truejoint.crtk.messages import Array
from truejoint.errors import TrajectoryError
from truejoint.motion.trajectory import Trajectory
from truejoint.units import display_unit

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


def plot_3d(trajectories: Sequence[Trajectory], path: Path) -> None:
    """Draw trajectories of the same three joints into one figure.

    A single one is coloured from its start (dark) to its end (bright), several by trajectory.
    Of more than 20 000 points every n-th is drawn.

    Parameters
    ----------
    trajectories : sequence of Trajectory
    path : Path
        ``.png`` for a picture, ``.html`` for a self-contained page that works offline.

    Raises
    ------
    TrajectoryError
        If the joints are not the same three, or for another file type.
    """
    joints, units = trajectories[0].joints, trajectories[0].units
    for trajectory in trajectories:
        if len(joints) != 3 or trajectory.joints != joints or trajectory.units != units:
            raise TrajectoryError(
                f"{trajectory.name}: a 3-D plot needs the same three joints in all trajectories; "
                f"got {', '.join(trajectory.joints)}"
            )
    shown = [display_unit(unit) for unit in units]
    labels = [f"{joint} [{unit.name}]" for joint, unit in zip(joints, shown, strict=True)]
    points = [_points(trajectory) for trajectory in trajectories]
    names = [trajectory.name for trajectory in trajectories]
    if path.suffix == ".png":
        _draw_png(points, names, labels, path)
    elif path.suffix == ".html":
        _draw_html(points, names, labels, path)
    else:
        raise TrajectoryError(f"{path}: plots are .png or .html; choose one of them")


def _points(trajectory: Trajectory) -> Array:
    """Positions (n, 3) [deg or mm], thinned out."""
    scale = [display_unit(unit).scale for unit in trajectory.units]
    stride = -(-len(trajectory) // _MOST_POINTS)
    rows = np.arange(0, len(trajectory), stride)
    if rows[-1] != len(trajectory) - 1:
        rows = np.append(rows, len(trajectory) - 1)
    return np.asarray(trajectory.positions[rows] * scale)


def _draw_png(points: list[Array], names: list[str], labels: list[str], path: Path) -> None:
    figure = Figure(figsize=(8.0, 7.2), dpi=150)
    FigureCanvasAgg(figure)
    axes: Any = figure.add_axes((0.0, 0.02, 0.94, 0.94), projection="3d")
    low, high = _bounds(points)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect((1, 1, 1), zoom=0.9)
    for k, line in enumerate(points):
        _draw_line(axes, line, low, high, None if len(points) == 1 else _COLOURS[k % 6])
        axes.plot([], [], [], color=_COLOURS[k % 6], label=names[k])
        axes.scatter(*line[0], color=_START, s=42, depthshade=False, zorder=5)
        axes.scatter(*line[-1], color=_END, s=42, marker="s", depthshade=False, zorder=5)
    axes.set(xlabel=labels[0], ylabel=labels[1], zlabel=labels[2])
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_pane_color((0.97, 0.975, 0.98, 1.0))
        axis.labelpad = 9
        # Matplotlib has no public setting for the grid of 3-D axes.
        axis._axinfo["grid"]["color"] = _GRID
    axes.view_init(elev=22, azim=-56)
    key = "from the circle to the square"
    if len(points) == 1:
        figure.text(0.5, 0.955, names[0], ha="center", fontsize=14)
        key += ", dark to bright"
    else:
        axes.legend(loc="upper left", fontsize=9, frameon=False)
    figure.text(0.5, 0.925, key, ha="center", fontsize=9)
    figure.savefig(path)


def _draw_line(axes: Any, line: Array, low: Array, high: Array, colour: str | None) -> None:
    """One trajectory and its shadows on the three walls behind it."""
    for axis, wall in ((0, low[0]), (1, high[1]), (2, low[2])):
        shadow = line.copy()
        shadow[:, axis] = wall
        axes.plot(*shadow.T, color=_SHADOW, linewidth=0.5, zorder=0)
    segments = np.stack([line[:-1], line[1:]], axis=1)
    colours = colormaps[_MAP](np.linspace(0.0, 0.92, len(segments))) if colour is None else [colour]
    axes.add_collection3d(
        Line3DCollection(list(segments), colors=colours, linewidths=1.3, capstyle="round")
    )


def _draw_html(points: list[Array], names: list[str], labels: list[str], path: Path) -> None:
    figure = go.Figure()
    hover = "<br>".join(
        f"{label.split(' ')[0]} %{{{axis}:.3f}} {label.split('[')[1][:-1]}"
        for label, axis in zip(labels, "xyz", strict=True)
    )
    for k, line in enumerate(points):
        gradient = {"color": np.linspace(0, 100, len(line)), "colorscale": _MAP, "width": 4}
        solid = {"color": _COLOURS[k % 6], "width": 4}
        figure.add_scatter3d(
            x=line[:, 0],
            y=line[:, 1],
            z=line[:, 2],
            mode="lines",
            name=names[k],
            showlegend=len(points) > 1,
            line=gradient if len(points) == 1 else solid,
            hovertemplate=hover + "<extra>%{fullData.name}</extra>",
        )
        for row, marker, what in ((0, "circle", "start"), (-1, "square", "end")):
            figure.add_scatter3d(
                x=line[[row], 0],
                y=line[[row], 1],
                z=line[[row], 2],
                mode="markers",
                name=what,
                marker={
                    "size": 5,
                    "symbol": marker,
                    "color": _START if what == "start" else _END,
                },
                showlegend=k == 0,
                legendgroup=what,
                hovertemplate=hover + "<extra>%{fullData.name}</extra>",
            )
    figure.update_layout(
        title=names[0] if len(names) == 1 else "trajectories",
        template="plotly_white",
        margin={"l": 0, "r": 0, "t": 48, "b": 0},
        scene={
            "aspectmode": "cube",
            **{f"{axis}axis_title": label for axis, label in zip("xyz", labels, strict=True)},
            "camera_eye": {"x": 1.4, "y": -1.75, "z": 0.85},
        },
    )
    figure.write_html(path, include_plotlyjs=True, config=_PAGE, default_height="94vh")


def _bounds(points: list[Array]) -> tuple[Array, Array]:
    """Lower and upper corner (3,) of a box around all points with a margin of 6 %."""
    everything = np.vstack(points)
    low, high = everything.min(axis=0), everything.max(axis=0)
    margin = 0.06 * np.where(high > low, high - low, 1.0)
    return low - margin, high + margin
