"""Figures of where the joints and the tool went, in training and in the test."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from truejoint.evaluation.report.plot import (
    BLUE,
    GREY,
    INK,
    ORANGE,
    Figure,
    Spec,
    axis,
    columns,
    curve,
    every,
    layout,
    packed,
    plain,
)
from truejoint.evaluation.results import OFFSET, Evaluation, estimator_title
from truejoint.evaluation.signals import velocity
from truejoint.recordings.recording import Recording
from truejoint.units import display_unit

Array = NDArray[np.float64]

_POINTS: Final = 5000  # points of a 3-D curve; more are not seen at this size
_HEIGHT_3D: Final = 560


def trajectories(evaluation: Evaluation, training: Sequence[Recording]) -> Figure:
    """Measured joint positions in training and test: in 3-D, a plane, or against speed."""
    units = [display_unit(unit) for unit in evaluation.units]
    scale = np.array([unit.scale for unit in units])
    train = [r.columns("measured", evaluation.joints) * scale for r in training]
    test = [trace.measured * scale for trace in evaluation.traces]
    names = [f"{j} [{u.name}]" for j, u in zip(evaluation.joints, units, strict=True)]
    if len(names) == 1:
        return _phase_plane(evaluation, training, names[0])
    groups = [("training", GREY, _joined(train)), ("test", BLUE, _joined(test))]
    caption = (
        "Measured joint positions while training (grey) and in the test (blue). A calibration is "
        "to be trusted where the two overlap."
    )
    if len(names) == 2:
        spec = _planes(groups, names, [(0, 1)], 420)
        return Figure("trajectories", "Trajectories in joint space", caption, [spec], 420)
    if len(names) > 3:
        caption += f" The first three of {len(names)} calibrated joints are shown."
    return Figure(
        "trajectories",
        "Trajectories in joint space",
        caption,
        [_space(groups, names[:3], aspect="cube")],
        _HEIGHT_3D,
        flat=_planes(groups, names[:3], [(0, 1), (0, 2), (1, 2)], 340),
    )


def tool_paths(evaluation: Evaluation) -> Figure | None:
    """Tool path in the base frame, true and estimated; None without kinematics."""
    if not evaluation.cartesian:
        return None
    chosen = estimator_title(evaluation.chosen)
    groups = [
        (title, colour, 1e3 * _joined([trace.tool[key] for trace in evaluation.traces]))
        for title, colour, key in (
            ("true", INK, "truth"),
            ("fixed offset", ORANGE, OFFSET),
            (chosen, BLUE, evaluation.chosen),
        )
    ]
    names = ["x [mm]", "y [mm]", "z [mm]"]
    return Figure(
        "tool-paths",
        "Tool path",
        "Tool position in the base frame, through the same forward kinematics for the true, the "
        "fixed-offset and the calibrated joint positions. Click a name in the legend to hide it.",
        [_space(groups, names, aspect="data")],
        _HEIGHT_3D,
        flat=_planes(groups, names, [(0, 1), (0, 2), (1, 2)], 340),
    )


def _phase_plane(evaluation: Evaluation, training: Sequence[Recording], name: str) -> Figure:
    """One joint has no path in space; position against speed shows what was covered."""
    joint, unit = evaluation.joints[0], display_unit(evaluation.units[0])
    train = [
        np.column_stack((x, velocity(r.t, x)))
        for r, x in ((r, r.column(f"measured/{joint}")) for r in training)
    ]
    test = [np.column_stack((t.measured[:, 0], t.velocity[:, 0])) for t in evaluation.traces]
    groups = [
        ("training", GREY, unit.scale * _joined(train)),
        ("test", BLUE, unit.scale * _joined(test)),
    ]
    spec = _planes(groups, [name, f"speed [{unit.name}/s]"], [(0, 1)], 400)
    return Figure(
        "trajectories",
        "Position and speed covered",
        f"Measured position of {joint} against its speed while training (grey) and in the test "
        "(blue). A calibration is to be trusted where the two overlap.",
        [spec],
        400,
    )


def _joined(parts: Sequence[Array]) -> Array:
    """Curves one after another, thinned, with a NaN row between; (0, 3) when there is none."""
    if not parts:
        return np.empty((0, 3))
    most = max(2, _POINTS // len(parts))
    pieces = []
    for part in parts:
        pieces += [part[every(len(part), most)], np.full((1, part.shape[1]), np.nan)]
    return np.concatenate(pieces)


def _space(groups: Sequence[tuple[str, str, Array]], names: Sequence[str], aspect: str) -> Spec:
    data = [
        {
            "type": "scatter3d",
            "mode": "lines",
            "x": packed(points[:, 0]),
            "y": packed(points[:, 1]),
            "z": packed(points[:, 2]),
            "name": plain(title),
            "line": {"color": colour, "width": 2.5},
            "opacity": 0.6,
        }
        for title, colour, points in groups
        if len(points)
    ]
    scene: Spec = {
        f"{letter}axis": {
            "title": {"text": plain(name), "font": {"size": 12}},
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
    options = {"scene": scene, "margin": {"l": 0, "r": 0, "t": 28, "b": 0}}
    return {"data": data, "layout": layout(_HEIGHT_3D, **options)}


def _planes(
    groups: Sequence[tuple[str, str, Array]],
    names: Sequence[str],
    pairs: Sequence[tuple[int, int]],
    height: int,
) -> Spec:
    data, axes = [], {}
    for panel, ((a, b), domain) in enumerate(zip(pairs, columns(len(pairs), 0.09), strict=True)):
        suffix = str(panel + 1) if panel else ""
        axes[f"xaxis{suffix}"] = axis(names[a], domain=domain, anchor=f"y{suffix}")
        axes[f"yaxis{suffix}"] = axis(names[b], anchor=f"x{suffix}")
        data += [
            curve(
                points[:, a],
                points[:, b],
                title,
                colour,
                width=1.0,
                opacity=0.7,
                xaxis=f"x{suffix}",
                yaxis=f"y{suffix}",
                showlegend=not panel,
                hoverinfo="skip",
            )
            for title, colour, points in groups
            if len(points)
        ]
    return {"data": data, "layout": layout(height, **axes)}
