"""One still figure of an evaluation, for documents: corrected against true position."""

from __future__ import annotations

from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from truejoint.evaluation.report.plot import COLOURS
from truejoint.evaluation.results import OFFSET, Evaluation, estimator_title
from truejoint.units import display_unit


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

    Returns
    -------
    Path

    Examples
    --------
    >>> plot_corrected(evaluation, "jaw.png").name
    'jaw.png'
    """
    trace = evaluation.traces[recording]
    rows = trace.t <= trace.t[0] + seconds
    count = len(evaluation.joints)
    figure = Figure(figsize=(4.2 * count, 4.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(
        2, count, sharex="col", squeeze=False, gridspec_kw={"height_ratios": [1.6, 1.0]}
    )
    shown = dict.fromkeys((OFFSET, evaluation.chosen))
    for column, (joint, si) in enumerate(zip(evaluation.joints, evaluation.units, strict=True)):
        unit = display_unit(si)
        t, truth = trace.t[rows], unit.scale * trace.truth[rows, column]
        upper, lower = axes[0, column], axes[1, column]
        upper.plot(t, truth, color=COLOURS["truth"], lw=1.6, ls=":", label="True")
        for name in shown:
            colour = COLOURS["chosen" if name == evaluation.chosen else OFFSET]
            values = unit.scale * trace.estimates[name][rows, column]
            upper.plot(t, values, color=colour, lw=1.0, label=estimator_title(name))
            lower.plot(t, values - truth, color=colour, lw=0.9)
        upper.set_title(joint, fontsize=10, loc="left")
        upper.set_ylabel(f"position [{unit.name}]")
        lower.set_ylabel(f"error [{unit.name}]")
        lower.set_xlabel("time [s]")
        for panel in (upper, lower):
            panel.spines[["top", "right"]].set_visible(False)
            panel.grid(color="#e6e8eb", lw=0.7)
    figure.legend(
        *axes[0, 0].get_legend_handles_labels(),
        loc="outside upper right",
        ncols=3,
        frameon=False,
        fontsize=9,
    )
    figure.savefig(path, dpi=150)
    return Path(path)
