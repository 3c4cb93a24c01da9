"""A page of a calibration by touch: errors before and after, what was rejected and not seen."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from truejoint import drawing
from truejoint.array_types import Array, Mask
from truejoint.calibration import Calibration
from truejoint.errors import CalibrationError
from truejoint.evaluation.report import plot
from truejoint.evaluation.report.page import render_figures, write_page
from truejoint.evaluation.report.plot import Figure, Panel
from truejoint.evaluation.score_rows import Row
from truejoint.tip import TouchReport
from truejoint.units import with_unit

_ARROW: Final = 0.15  # of the block's width, of the largest error
_VIEWS: Final = ((0, 1, "from above"), (0, 2, "from the side"))


def write_touch_report(
    calibration: Calibration,
    report: TouchReport,
    path: str | Path,
    *,
    command: str = "",
    overwrite: bool = False,
) -> Path:
    """Write what a calibration by touch is worth as one HTML file that needs nothing else.

    Parameters
    ----------
    calibration : Calibration
        As `calibrate_by_touch` gives it.
    report : TouchReport
        That it gives with it.
    path : str or Path
        Where to write; written whole or not at all.
    command : str
        Command line that makes this page again.
    overwrite : bool
        Whether a file at `path` may be replaced.

    Raises
    ------
    CalibrationError
        If the calibration was made in another way.
    RecordingError
        As `write_report`.

    Examples
    --------
    >>> write_touch_report(model, None, "touches.html")
    Traceback (most recent call last):
    truejoint.errors.CalibrationError: ...
    """
    if "touch" not in calibration.metadata:
        raise CalibrationError(
            f"the calibration of {calibration.title} was not made by touches; `evaluate` it"
        )
    return write_page(path, partial(_render, calibration, report, command), overwrite=overwrite)


def _render(calibration: Calibration, report: TouchReport, command: str) -> str:
    about, left_out = calibration.metadata["touch"], report.fit.left_out
    before, after = (
        with_unit(float(np.sqrt((errors[~left_out] ** 2).sum(axis=1).mean())), "m")
        for errors in (report.before, report.left_out)
    )
    sentence = (
        f"The tip is within {with_unit(report.left_out_error, 'm')} ± "
        f"{with_unit(report.left_out_sd, 'm')} (RMS) in the block's frame, by touches left out in "
        "turn, less what they err themselves."
    )
    facts = [
        f"{len(report.touches)} touches, {int(left_out.sum())} of them rejected",
        f"before {before}, after {after} off (RMS)",
        f"prior: {', '.join(about['prior']) or 'none'}",
        f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC",
    ]
    return render_figures(
        "touches.html.j2",
        {"map": list(_maps(report))},
        title=calibration.title,
        sentence=sentence,
        level="warn" if report.not_seen or left_out.any() else "pass",
        facts=facts,
        not_seen=report.not_seen,
        rows=list(_rows(report)),
        source=report.touches.source,
        command=command,
    )


def _rows(report: TouchReport) -> Iterator[Row]:
    """Tell of each touch, the rejected and the worst first."""
    size = np.linalg.norm(report.left_out, axis=1)
    for i in np.lexsort((-size, ~report.fit.left_out)):
        said = "rejected: badly seated, or another number?" if report.fit.left_out[i] else ""
        cells = [f"{1e3 * np.linalg.norm(report.before[i]):.2f}", f"{1e3 * size[i]:.2f}"]
        stamp = f"{report.touches.t[i]:.1f}"
        yield Row(report.touches.dimple[i], [said, stamp, *cells])


def _maps(report: TouchReport) -> Iterator[Figure]:
    """Errors over the block before and after, on the scale of each."""
    errors = (("before", report.before), ("after, by fits without it", report.left_out))
    rejected = " Crosses were rejected." if report.fit.left_out.any() else ""
    for a, b, where in _VIEWS:
        panels: list[Panel] = []
        for title, error in errors:
            x = {"title": f"{'xyz'[a]} of the block [mm], {title}"}
            y = {"title": f"{'xyz'[b]} [mm]", "scaleanchor": "x" if not panels else "x2"}
            panels.append((x, y, _arrows(report.point, error, (a, b), report.fit.left_out)))
        caption = (
            f"Each dot is a dimple, seen {where}; its colour is how far off the tip "
            "was [mm], the line from it in which direction, drawn out for each panel. Before: as "
            f"measured, the block laid over all as well as it can be. After: by fits that did "
            "not see it, its own error included." + rejected
        )
        key = f"map-{'xyz'[a]}{'xyz'[b]}"
        yield Figure(
            key, f"Errors of the tip, {where}", caption, [plot.panels(panels, 340, gap=0.2)]
        )


def _arrows(point: Array, error: Array, axes: tuple[int, int], left_out: Mask) -> list[plot.Spec]:
    """Dots at points (m, 3) [m], and lines along errors (m, 3), in a plane."""
    place, size = 1e3 * point[:, axes], 1e3 * np.linalg.norm(error, axis=1)
    good = ~left_out
    longest = np.linalg.norm(error[good][:, axes], axis=1).max()
    tip = place + _ARROW * np.ptp(place, axis=0).max() / longest * error[:, axes]
    lines = np.full((3 * good.sum(), 2), np.nan)
    lines[0::3], lines[1::3] = place[good], tip[good]
    highest = float(size[good].max())
    x, y = place[good].T
    dots = plot.coloured(x, y, size[good], "error [mm]", highest, size=9)
    style = {"width": 1.5, "hoverinfo": "skip"}
    drawn = [plot.curve(lines[:, 0], lines[:, 1], "direction", drawing.GREY, **style), dots]
    if left_out.any():
        cross = {"marker": {"symbol": "x", "size": 9, "color": drawing.ORANGE}}
        drawn.append(
            plot.scatter("markers", place[left_out, 0], place[left_out, 1], "rejected", **cross)
        )
    return drawn
