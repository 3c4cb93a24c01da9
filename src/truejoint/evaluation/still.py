"""One still figure of an evaluation, for documents: corrected against true position."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from truejoint.evaluation.report.plot import COLOURS, GRID, colour_of
from truejoint.evaluation.results import OFFSET, Evaluation, estimator_title, shown_joints
from truejoint.extras import require
from truejoint.files import write_atomically


def plot_corrected(
    evaluation: Evaluation, path: str | Path, *, recording: int = 0, seconds: float = 60.0
) -> Path:
    """Draw corrected and true position, and the error, of the first seconds of a recording.

    Parameters
    ----------
    evaluation : Evaluation
    path : str or Path
        Picture to write; its suffix tells the format.
    recording : int
        Index into `Evaluation.traces`.
    seconds : float
        How much of it to show [s].

    Examples
    --------
    >>> plot_corrected(evaluation, "jaw.png").name
    'jaw.png'
    """
    trace = evaluation.traces[recording]
    rows = trace.t <= trace.t[0] + seconds
    t, count = trace.t[rows], len(evaluation.joints)
    drawing = require("matplotlib.figure", "plots", "a figure")
    figure = drawing.Figure(figsize=(4.2 * count, 4.4), layout="constrained")
    axes = figure.subplots(2, count, sharex="col", squeeze=False, height_ratios=[1.6, 1.0])
    for column, joint, unit in shown_joints(evaluation):
        truth = unit.scale * trace.truth[rows, column]
        upper, lower = axes[:, column]
        upper.plot(t, truth, color=COLOURS["truth"], lw=1.6, ls=":", label="True")
        for name in dict.fromkeys((OFFSET, evaluation.chosen)):
            colour = colour_of(name, evaluation)
            values = unit.scale * trace.estimates[name][rows, column]
            upper.plot(t, values, color=colour, lw=1.0, label=estimator_title(name))
            lower.plot(t, values - truth, color=colour, lw=0.9)
        upper.set_title(joint, fontsize=10, loc="left")
        lower.set_xlabel("time [s]")
        for panel, what in ((upper, "position"), (lower, "error")):
            panel.set_ylabel(f"{what} [{unit.name}]")
            panel.spines[["top", "right"]].set_visible(False)
            panel.grid(color=GRID, lw=0.7)
    legend = {"loc": "outside upper right", "ncols": 3, "frameon": False, "fontsize": 9}
    figure.legend(*axes[0, 0].get_legend_handles_labels(), **legend)
    picture = Path(path)
    draw = partial(figure.savefig, dpi=150, format=picture.suffix.removeprefix(".") or "png")
    write_atomically(picture, draw, overwrite=True)
    return picture
