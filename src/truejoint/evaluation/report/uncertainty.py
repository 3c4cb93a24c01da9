"""Figures of the stated interval: stated against found, and motion by motion."""

from __future__ import annotations

from itertools import cycle
from typing import Final

import numpy as np

from truejoint.evaluation.report import plot
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
)
from truejoint.evaluation.results import Evaluation

_COLOURS: Final = (BLUE, ORANGE, GREEN, PURPLE, SKY, GREY)
_HEIGHT: Final = 320
_EQUAL: Final = {"width": 1.0, "dash": "dash", "hoverinfo": "skip"}


def stated_interval(evaluation: Evaluation) -> list[Figure]:
    """Found against stated coverage, with several levels; coverage of each of several motions."""
    levels = {score.level for score in evaluation.intervals}
    several = len(evaluation.interval_trajectories) > 1
    found = [_calibration(evaluation, sorted(levels), several=several)] if len(levels) > 1 else []
    return found + ([_by_trajectory(evaluation)] if levels and several else [])


def _calibration(evaluation: Evaluation, stated: list[float], *, several: bool) -> Figure:
    low, high = 100 * stated[0], 100 * stated[-1]
    margin = 0.15 * (high - low)
    ends = 100 * np.array([max(stated[0] - 0.2, 0.0), 1.0])
    data = [plot.curve(ends, ends, "equal", INK, **_EQUAL)]
    for joint, colour, beside in _joints(evaluation):
        rows = [score for score in evaluation.intervals if score.joint == joint]
        level = 100 * np.array([row.level for row in rows]) + 0.06 * margin * beside
        found = 100 * np.array([row.coverage for row in rows])
        style = _dots(colour) | {"line": {"color": colour, "width": 1.3}}
        if several:
            errors = 100 * np.array([row.standard_error for row in rows])
            style["error_y"] = {"array": plot.packed(errors), "thickness": 1.3, "width": 4}
        data.append(plot.scatter("lines+markers", level, found, joint, **style))
    lowest = min(stated[0], *(score.coverage for score in evaluation.intervals))
    across = [low - margin, min(high + margin, 100.0)]
    x = plot.axis("stated [%]", range=across, tickvals=[100 * level for level in stated])
    bottom = max(0.0, 100 * lowest - 8.0)
    y = plot.axis("found inside [%]", rangemode="normal", range=[bottom, 101.0])
    errors_text = "; bars are its sampling error over trajectories" if several else ""
    caption = (
        "Share of the test's samples inside the interval against what it states, joint by "
        f"joint{errors_text}. On the dashed line both are equal; below it the interval is too "
        "narrow."
    )
    spec = plot.drawing(data, _HEIGHT, xaxis=x, yaxis=y)
    return Figure("calibration", "Stated and found coverage", caption, [spec], wide=False)


def _by_trajectory(evaluation: Evaluation) -> Figure:
    level, names = evaluation.interval_level, evaluation.interval_trajectories
    number = np.arange(1.0, len(names) + 1.0)
    ends = np.array([0.5, len(names) + 0.5])
    stated = np.full(2, 100 * level), f"stated {100 * level:g} %"
    data = [plot.curve(ends, *stated, INK, **_EQUAL)]
    lowest = 1.0
    text = {"text": [plot.plain(n) for n in names], "hovertemplate": "%{text}: %{y:.1f} %"}
    for joint, colour, beside in _joints(evaluation):
        (row,) = (s for s in evaluation.intervals if s.joint == joint and s.level == level)
        lowest = min(lowest, *row.shares)
        inside = 100 * np.array(row.shares)
        style = _dots(colour) | text
        data.append(plot.scatter("markers", number + 0.12 * beside, inside, joint, **style))
    x = plot.axis("trajectory of the test", range=list(ends), dtick=max(1, len(names) // 10))
    y = plot.axis("inside [%]", range=[max(0.0, 95 * lowest - 2), 102.0])
    caption = (
        f"Share of the samples of each trajectory inside the {100 * level:g} % interval, in the "
        "order of the test. The statement is about their mean: one may lie inside altogether, "
        "another half outside."
    )
    spec = plot.drawing(data, _HEIGHT, xaxis=x, yaxis=y)
    return Figure("coverage", "Coverage of each trajectory", caption, [spec], wide=False)


def _dots(colour: str) -> Spec:
    return {"marker": {"color": colour, "size": 7}}


def _joints(evaluation: Evaluation) -> list[tuple[str, str, float]]:
    """Joints, the colour of each, and its place beside the others: -2 to 2, 0 for a single one."""
    count = len(evaluation.joints)
    places = np.linspace(-2.0, 2.0, count) if count > 1 else np.zeros(1)
    return list(zip(evaluation.joints, cycle(_COLOURS), places.tolist(), strict=False))
