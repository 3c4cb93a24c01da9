"""A trajectory in three dimensions, in degrees and millimetres."""

import os
from functools import partial
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


def plot_trajectory(
    trajectory: Trajectory, path: str | os.PathLike[str], *, overwrite: bool = False
) -> None:
    """Draw a trajectory of three joints, in deg and mm, from its start (dark) to its end (bright).

    With more than 20 000 points every n-th is drawn.

    Parameters
    ----------
    trajectory : Trajectory
    path : path-like
        ``.html``: a self-contained page that works offline and saves pictures.
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
    if Path(path).suffix != ".html":
        raise TrajectoryError(f"{path}: a plot is a page, which saves pictures; call it .html")
    units = [display_unit(unit) for unit in trajectory.units]
    labels = [f"{joint} [{unit.name}]" for joint, unit in zip(joints, units, strict=True)]
    stride = -(-len(trajectory) // _MOST_POINTS)
    rows = np.union1d(np.arange(0, len(trajectory), stride), len(trajectory) - 1)
    points = np.asarray(trajectory.positions[rows] * [unit.scale for unit in units])
    write = partial(_draw, name, points, labels)
    write_atomically(Path(path), write, overwrite=overwrite, error=TrajectoryError)


def _draw(name: str, points: Array, labels: list[str], path: Path) -> None:
    figure = require("plotly.graph_objects", "plots", "a drawing").Figure()
    shown = list(zip("xyz", labels, strict=True))
    hover = "<br>".join(f"{label} %{{{axis}:.3f}}" for axis, label in shown)
    gradient = {"color": np.linspace(0, 100, len(points)), "colorscale": "viridis", "width": 4}
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
