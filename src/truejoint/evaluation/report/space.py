"""Figures of where the joints and the tool went, in training and in the test."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
from scipy.stats import binned_statistic_2d

from truejoint.array_types import Array
from truejoint.drawing import BLUE, GREY, INK, ORANGE
from truejoint.evaluation.report import plot
from truejoint.evaluation.report.plot import Figure, Spec
from truejoint.evaluation.results import OFFSET, Evaluation, estimator_phrase, estimator_title
from truejoint.recordings.table.recording import Recording
from truejoint.recordings.table.stream import velocity

# Curves (n, k) with title and colour.
_Groups = Sequence[tuple[str, str, Sequence[Array]]]

_POINTS: Final = 3000  # points of a 3-D curve; more are not seen at this size
_CELLS: Final = (6, 24)  # of a map along each axis, at least and at most
_FEW: Final = 8  # rows below which a cell of a map is left blank


def trajectories(evaluation: Evaluation, training: Sequence[Recording]) -> Figure:
    """Measured joint positions in training and test: in 3-D, a plane, or against speed."""
    units = [unit for _, _, unit in evaluation.shown_joints()]
    scale = np.array([unit.scale for unit in units])
    train = [recording.columns("measured", evaluation.joints) for recording in training]
    test = [trace.measured for trace in evaluation.traces]
    names = [f"{joint} [{unit.name}]" for _, joint, unit in evaluation.shown_joints()]
    title, what = "Trajectories in joint space", "Measured joint positions"
    if len(names) == 1:
        # One joint has no path in space; position against speed shows what was covered.
        train = [np.hstack((x, velocity(r.t, x))) for r, x in zip(training, train, strict=True)]
        test = [np.hstack((trace.measured, trace.velocity)) for trace in evaluation.traces]
        names.append(f"speed [{units[0].name}/s]")
        title = "Position and speed covered"
        what = f"Measured position of {evaluation.joints[0]} against its speed"
    groups = [
        ("training", GREY, [scale * path for path in train]),
        ("test", BLUE, [scale * path for path in test]),
    ]
    caption = (
        f"{what} while training (grey) and in the test (blue). A calibration is to be trusted "
        "where the two overlap."
    )
    if len(names) == 2:
        return Figure("trajectories", title, caption, [_plane(groups, names)])
    if len(names) > 3:
        caption += f" The first three of {len(names)} calibrated joints are shown."
    return _space("trajectories", title, caption, groups, names[:3], "cube")


def tool_paths(evaluation: Evaluation) -> list[Figure]:
    """Tool path in the base frame, true and estimated; nothing without kinematics."""
    if not evaluation.cartesian:
        return []
    groups = [
        (title, colour, [1e3 * trace.tool[key] for trace in evaluation.traces])
        for title, colour, key in (
            ("true", INK, "truth"),
            ("fixed offset", ORANGE, OFFSET),
            (estimator_title(evaluation.chosen), BLUE, evaluation.chosen),
        )
    ]
    caption = (
        "Tool position in the base frame, through the same forward kinematics for the true, the "
        "fixed-offset and the calibrated joint positions."
    )
    names = ["x [mm]", "y [mm]", "z [mm]"]
    return [_space("tool-paths", "Tool path", caption, groups, names, "data")]


def error_maps(evaluation: Evaluation) -> Iterator[Figure]:
    """Map each joint's RMSE, and the mean half-width that it states, over the workspace."""
    points, names, where = _workspace(evaluation)
    widest = np.argsort(-np.ptp(points[:, :3], axis=0), kind="stable")[:2]
    a, b = sorted(widest.tolist())
    # A cell that an even motion would cross in three times the rows that it needs.
    count = int(np.clip(np.sqrt(len(points) / (3 * _FEW)), *_CELLS))
    plane = points[:, a], points[:, b]
    crossed = binned_statistic_2d(*plane, points[:, 0], "count", bins=count)
    edges = [crossed.x_edge, crossed.y_edge]
    visited = crossed.statistic >= _FEW
    middle = [0.5 * (edge[1:] + edge[:-1]) for edge in edges]
    x, y = (grid[visited] for grid in np.meshgrid(*middle, indexing="ij"))

    def mean(values: Array) -> Array:
        """Mean of `values` (n,) in each visited cell, 0 where none is finite."""
        rows = np.isfinite(values)
        x, y = (axis[rows] for axis in plane)
        means = binned_statistic_2d(x, y, values[rows], "mean", bins=edges).statistic
        return np.nan_to_num(np.asarray(means, dtype=np.float64)[visited])

    for column, joint, unit in evaluation.shown_joints():
        square = np.square(unit.scale * evaluation.error(evaluation.chosen, column))
        layers = [(f"RMSE [{unit.name}]", np.sqrt(mean(square)))]
        bounds = [(t.lower, t.upper) for t in evaluation.traces]
        half = [
            0.5 * (high - low)[:, column]
            for low, high in bounds
            if low is not None and high is not None
        ]
        if len(half) == len(bounds):
            layers.append((f"half-width [{unit.name}]", mean(unit.scale * np.concatenate(half))))
        panels: list[plot.Panel] = []
        for title, values in layers:
            highest = float(np.quantile(values, 0.95)) if len(values) else 1.0
            dots = plot.coloured(x, y, values, title, highest, symbol="square")
            dots["meta"] = {"cells": count}  # for the size of the squares
            across, up = (
                {"title": names[i], "range": [edge[0], edge[-1]], "zeroline": False}
                for i, edge in zip((a, b), edges, strict=True)
            )
            panels.append((across, up, [dots]))
        said = " and the mean half-width that is stated" if len(layers) > 1 else ""
        caption = (
            f"{joint}: RMSE of {estimator_phrase(evaluation.chosen)}{said} over {where}, in "
            f"cells that at least {_FEW} rows of the test crossed; scales end at the 95th "
            "percentile."
        )
        spec = plot.panels(panels, 280, gap=0.2, width=0.9)
        title, wide = f"{joint}: error over the workspace", len(layers) > 1
        yield Figure(f"map-{column}", title, caption, [spec], wide=wide)


def _workspace(evaluation: Evaluation) -> tuple[Array, list[str], str]:
    """Points (n, k) that the test crossed, their axis titles, and what they are.

    These are tool positions [mm] or, without kinematics, joint positions and of one joint its
    speed.
    """
    traces = evaluation.traces
    if evaluation.cartesian:
        true = 1e3 * np.concatenate([trace.tool["truth"] for trace in traces])
        return true, ["x [mm]", "y [mm]", "z [mm]"], "the tool's position"
    joints = evaluation.shown_joints()
    points = np.concatenate([trace.truth for trace in traces])
    points = points * [unit.scale for _, _, unit in joints]
    names = [f"{joint} [{unit.name}]" for _, joint, unit in joints]
    if len(joints) > 1:
        return points, names, "two joints"
    unit = joints[0][2]
    speed = unit.scale * np.concatenate([trace.velocity for trace in traces])
    names.append(f"speed [{unit.name}/s]")
    return np.hstack((points, speed)), names, "position and speed"


def _space(
    key: str, title: str, caption: str, groups: _Groups, names: Sequence[str], aspect: str
) -> Figure:
    """Draw curves in space."""
    data = []
    for name, colour, paths in groups:
        if paths:
            points = map(plot.packed, plot.joined(paths, _POINTS).T)
            curve = {"type": "scatter3d", "mode": "lines", **dict(zip("xyz", points, strict=False))}
            line = {"color": colour, "width": 2.5}
            data.append(curve | {"name": plot.plain(name), "line": line, "opacity": 0.6})
    return Figure(key, title, caption, [_scene(data, names, aspect)])


def _scene(data: Sequence[Spec], names: Sequence[str], aspect: str) -> Spec:
    """Lay out three axes in space."""
    scene: Spec = {
        f"{letter}axis": {
            "title": {"text": plot.plain(name), "font": {"size": 12}},
            "gridcolor": plot.WALL_GRID,
            "backgroundcolor": plot.WALL,
            "showbackground": True,
            "zerolinecolor": plot.WALL_GRID,
            "tickfont": {"size": 11},
            "nticks": 6,
        }
        for letter, name in zip("xyz", names, strict=True)
    }
    scene |= {
        "aspectmode": aspect,
        "camera": {"eye": {"x": 1.62, "y": 1.46, "z": 0.85}, "center": {"x": 0, "y": 0, "z": -0.1}},
    }
    return plot.drawing(data, 520, scene=scene, margin={"l": 0, "r": 0, "t": 0, "b": 0})


def _plane(groups: _Groups, names: Sequence[str]) -> Spec:
    """Draw curves in a plane."""
    drawn = [(name, colour, plot.joined(paths, _POINTS)) for name, colour, paths in groups if paths]
    style = {"width": 1.0, "opacity": 0.7, "hoverinfo": "skip"}
    curves = [plot.curve(path[:, 0], path[:, 1], *who, **style) for *who, path in drawn]
    return plot.panels([({"title": names[0]}, {"title": names[1]}, curves)], 360)
