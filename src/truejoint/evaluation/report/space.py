"""Figures of where the joints and the tool went, in training and in the test."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from truejoint.array_types import Array
from truejoint.evaluation.report import plot
from truejoint.evaluation.report.plot import BLUE, GREY, INK, ORANGE, Figure, Spec
from truejoint.evaluation.results import OFFSET, Evaluation, estimator_title
from truejoint.recordings.recording import Recording
from truejoint.recordings.signals import velocity

# Curves (n, k) with title and colour.
_Groups = Sequence[tuple[str, str, Sequence[Array]]]

_POINTS: Final = 5000  # points of a 3-D curve; more are not seen at this size


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
        spec = _planes(groups, names, 400 if len(units) == 1 else 420)
        return Figure("trajectories", title, caption, [spec])
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
        "fixed-offset and the calibrated joint positions. Click a name in the legend to hide it."
    )
    names = ["x [mm]", "y [mm]", "z [mm]"]
    return [_space("tool-paths", "Tool path", caption, groups, names, "data")]


def _space(
    key: str, title: str, caption: str, groups: _Groups, names: Sequence[str], aspect: str
) -> Figure:
    """Curves in 3-D, and their projections where a browser cannot draw that."""
    data = []
    for name, colour, paths in groups:
        if paths:
            points = map(plot.packed, plot.joined(paths, _POINTS).T)
            curve = {"type": "scatter3d", "mode": "lines", **dict(zip("xyz", points, strict=False))}
            line = {"color": colour, "width": 2.5}
            data.append(curve | {"name": plot.plain(name), "line": line, "opacity": 0.6})
    scene: Spec = {
        f"{letter}axis": {
            "title": {"text": plot.plain(name), "font": {"size": 12}},
            "gridcolor": "#d5d8dc",
            "backgroundcolor": "#fafbfc",
            "showbackground": True,
            "zerolinecolor": "#d5d8dc",
            "tickfont": {"size": 11},
            "nticks": 6,
        }
        for letter, name in zip("xyz", names, strict=True)
    }
    scene |= {
        "aspectmode": aspect,
        "camera": {"eye": {"x": 1.62, "y": 1.46, "z": 0.85}, "center": {"x": 0, "y": 0, "z": -0.1}},
    }
    spec = plot.drawing(data, 560, scene=scene, margin={"l": 0, "r": 0, "t": 28, "b": 0})
    return Figure(key, title, caption, [spec], flat=_planes(groups, names, 340))


def _planes(groups: _Groups, names: Sequence[str], height: int) -> Spec:
    """Curves projected on the plane of each pair of axes."""
    pairs = [(0, 1), (0, 2), (1, 2)][: 1 if len(names) == 2 else 3]
    drawn = [(name, colour, plot.joined(paths, _POINTS)) for name, colour, paths in groups if paths]
    panels: list[plot.Panel] = []
    for (a, b), domain in zip(pairs, plot.columns(len(pairs), 0.09), strict=True):
        style = {"width": 1.0, "opacity": 0.7, "showlegend": not panels, "hoverinfo": "skip"}
        curves = [plot.curve(path[:, a], path[:, b], *who, **style) for *who, path in drawn]
        panels.append(({"title": names[a], "domain": domain}, {"title": names[b]}, curves))
    return plot.panels(panels, height)
