"""Figures of the stated interval: stated against found, and motion by motion."""

from __future__ import annotations

from typing import Final

import numpy as np

from truejoint.evaluation.report.plot import (
    BLUE,
    GREEN,
    GREY,
    INK,
    ORANGE,
    PURPLE,
    SKY,
    Figure,
    Spec,
    axis,
    curve,
    layout,
    packed,
    plain,
)
from truejoint.evaluation.results import Evaluation

_COLOURS: Final = (BLUE, ORANGE, GREEN, PURPLE, SKY, GREY)
_HEIGHT: Final = 320


def stated_interval(evaluation: Evaluation) -> list[Figure]:
    """Found against stated coverage, with several levels; coverage of each of several motions."""
    levels = {score.level for score in evaluation.intervals}
    several = len(evaluation.interval_trajectories) > 1
    found = [_calibration(evaluation)] if len(levels) > 1 else []
    return found + ([_by_trajectory(evaluation)] if levels and several else [])


def _calibration(evaluation: Evaluation) -> Figure:
    stated = sorted({score.level for score in evaluation.intervals})
    several = len(evaluation.interval_trajectories) > 1
    low, high = 100 * stated[0], 100 * stated[-1]
    margin = 0.15 * (high - low)
    ends = np.array([max(stated[0] - 0.2, 0.0), 1.0])
    data = [_line(100 * ends, 100 * ends, "equal")]
    for joint, colour, beside in _joints(evaluation):
        rows = [score for score in evaluation.intervals if score.joint == joint]
        points = {
            **_points(
                100 * np.array([row.level for row in rows]) + 0.06 * margin * beside,
                100 * np.array([row.coverage for row in rows]),
                joint,
                colour,
            ),
            "mode": "lines+markers",
            "line": {"color": colour, "width": 1.3},
        }
        if several:
            errors = 100 * np.array([row.standard_error for row in rows])
            points["error_y"] = {"array": packed(errors), "thickness": 1.3, "width": 4}
        data.append(points)
    axes = {
        "xaxis": axis(
            "stated [%]",
            range=[low - margin, min(high + margin, 100.0)],
            tickvals=[100 * level for level in stated],
        ),
        "yaxis": axis("found inside [%]", rangemode="normal"),
    }
    lowest = min(score.coverage for score in evaluation.intervals)
    axes["yaxis"]["range"] = [max(0.0, 100 * min(lowest, stated[0]) - 8.0), 101.0]
    errors_text = "; bars are its sampling error over trajectories" if several else ""
    return Figure(
        "calibration",
        "Stated and found coverage",
        "Share of the test's samples inside the interval against what it states, joint by "
        f"joint{errors_text}. On the dashed line both are equal; below it the interval is too "
        "narrow.",
        [{"data": data, "layout": layout(_HEIGHT, **axes)}],
        _HEIGHT,
        wide=False,
    )


def _by_trajectory(evaluation: Evaluation) -> Figure:
    level, names = evaluation.interval_level, evaluation.interval_trajectories
    number = np.arange(1.0, len(names) + 1.0)
    ends = np.array([0.5, len(names) + 0.5])
    data = [_line(ends, np.full(2, 100 * level), f"stated {100 * level:g} %")]
    lowest = 1.0
    for joint, colour, beside in _joints(evaluation):
        (row,) = (s for s in evaluation.intervals if s.joint == joint and s.level == level)
        lowest = min(lowest, *row.shares)
        data.append(
            {
                **_points(number + 0.12 * beside, 100 * np.array(row.shares), joint, colour),
                "mode": "markers",
                "text": [plain(name) for name in names],
                "hovertemplate": "%{text}: %{y:.1f} %",
            }
        )
    axes = {
        "xaxis": axis("trajectory of the test", range=list(ends), dtick=max(1, len(names) // 10)),
        "yaxis": axis("inside [%]", range=[max(0.0, 95 * lowest - 2), 102.0]),
    }
    return Figure(
        "coverage",
        "Coverage of each trajectory",
        f"Share of the samples of each trajectory inside the {100 * level:g} % interval, in the "
        "order of the test. The statement is about their mean: one may lie inside altogether, "
        "another half outside.",
        [{"data": data, "layout": layout(_HEIGHT, **axes)}],
        _HEIGHT,
        wide=False,
    )


def _joints(evaluation: Evaluation) -> list[tuple[str, str, float]]:
    """Joints, the colour of each, and its place beside the others: -2 to 2, 0 for a single one."""
    count = len(evaluation.joints)
    places = np.linspace(-2.0, 2.0, count) if count > 1 else np.zeros(1)
    return [
        (joint, _COLOURS[i % len(_COLOURS)], float(places[i]))
        for i, joint in enumerate(evaluation.joints)
    ]


def _points(x: np.ndarray, y: np.ndarray, name: str, colour: str) -> Spec:
    return {
        "type": "scatter",
        "x": packed(x),
        "y": packed(y),
        "name": plain(name),
        "marker": {"color": colour, "size": 7},
    }


def _line(x: np.ndarray, y: np.ndarray, name: str) -> Spec:
    return curve(x, y, name, INK, width=1.0, dash="dash", hoverinfo="skip")
