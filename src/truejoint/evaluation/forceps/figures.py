"""Figures 6, 7 and 9 of yan2020 and the population, as PNG pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from numpy.typing import NDArray

from truejoint.evaluation.forceps.loaded import Loaded
from truejoint.evaluation.forceps.methods import BEST, METHODS, PAPERS_BEST, SETTLED
from truejoint.evaluation.forceps.population import PopulationStudy
from truejoint.evaluation.forceps.strategies import Strategies
from truejoint.evaluation.forceps.unloaded import Unloaded
from truejoint.simulation.forceps.twin import ForcepsRun

Array = NDArray[np.float64]

_STYLE: Final[dict[Any, Any]] = {
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "legend.frameon": False,
    "font.size": 9,
}
_COLOURS: Final = {
    "lsm": "tab:red",
    "lsm_compensated": "tab:orange",
    PAPERS_BEST: "tab:blue",
    BEST: "tab:green",
    "ukf_friction": "tab:purple",
    "play_reset": "tab:olive",
}
_PAPERS: Final = ("lsm", "lsm_compensated", PAPERS_BEST)
_OURS: Final = (PAPERS_BEST, "ukf_friction", BEST)
_AVERAGE: Final = 0.25  # [s]
_DPI: Final = 130


def plot_unloaded(result: Unloaded, path: Path) -> None:
    """Figures 6 and 7: angles and errors on (27) and (28), the paper's methods and ours."""
    figure, axes = _figure(
        3, 2, (11.0, 8.0), f"yan2020 figures 6 and 7, specimen {result.specimen}"
    )
    runs = (result.calibration, result.verification)
    for column, (run, title) in enumerate(zip(runs, ("(27)", "(28)"), strict=True)):
        rows = run.t > SETTLED
        axes[0][column].plot(run.t, np.degrees(run.reference), "k", lw=1.0, label="encoder")
        if PAPERS_BEST in result.estimates:
            estimate = np.degrees(result.estimates[PAPERS_BEST][column])
            axes[0][column].plot(run.t, estimate, "--", lw=1.0, label=METHODS[PAPERS_BEST].title)
        axes[0][column].set(ylabel=f"jaw on {title} [deg]")
        _legend(axes[0][column])
        for row, keys in ((1, _PAPERS), (2, _OURS)):
            for key in (k for k in keys if k in result.estimates):
                error = result.estimates[key][column] - run.reference
                _line(axes[row][column], run, error, rows, key)
            axes[row][column].set(ylabel="error [deg]")
            _legend(axes[row][column])
        axes[2][column].set_xlabel("time [s]")
    figure.savefig(path, dpi=_DPI)


def plot_loaded(result: Loaded, path: Path) -> None:
    """Figure 9: errors while weights are hung on the jaw, one panel a method and direction."""
    methods = [key for key in _COLOURS if key in result.cases[0].errors]
    directions = list(dict.fromkeys(case.direction for case in result.cases))
    figure, axes = _figure(
        len(methods),
        len(directions),
        (11.0, 2.3 * len(methods) + 1.0),
        f"yan2020 figure 9, specimen {result.specimen}",
    )
    for row, method in enumerate(methods):
        for column, direction in enumerate(directions):
            axis = axes[row][column]
            for case in result.cases:
                if case.direction != direction:
                    continue
                # The encoder's steps of 0.088 deg would hide everything else.
                error = _averaged(np.degrees(case.estimates[method] - case.run.reference), case.run)
                axis.plot(case.run.t, error, lw=0.9, label=f"{1e3 * case.mass:.0f} g")
            test = result.cases[0].run.load
            if test is not None:
                axis.axvspan(*test.phases["III"], color="0.9", zorder=0)
            axis.set(title=f"{METHODS[method].title}, load {direction}", ylabel="error [deg]")
            span = 1.5 if METHODS[method].origin == "yan2020" else 0.3
            axis.set_ylim(-span, span)
            if row == len(methods) - 1:
                axis.set_xlabel(f"time [s]; grey: the hand lets go; means over {_AVERAGE:g} s")
    axes[0][0].legend(loc="lower left", ncols=3, fontsize=8)
    figure.savefig(path, dpi=_DPI)


def plot_population(study: PopulationStudy, path: Path) -> None:
    """Distribution of each method's RMS error over the specimens, and each against the UKF's."""
    figure, axes = _figure(
        1, 2, (12.0, 5.6), f"{len(study.rms)} virtual forceps, trajectory (28), against the encoder"
    )
    left, right = axes[0]
    for method in study.methods:
        error = np.sort(np.degrees(study.of(method)))
        share = (np.arange(len(error)) + 0.5) / len(error)
        left.semilogx(
            error, share, lw=1.2, color=_COLOURS.get(method), label=METHODS[method].title,
            alpha=1.0 if method in _COLOURS else 0.5,
        )  # fmt: skip
    left.set(xlabel="RMS error [deg]", ylabel="share of specimens below")
    figure.legend(loc="outside lower center", ncols=4, fontsize=8)
    _plain_ticks(left.xaxis)
    if PAPERS_BEST in study.methods:
        paper = np.degrees(study.of(PAPERS_BEST))
        for method in (m for m in _COLOURS if m in study.methods and m != PAPERS_BEST):
            right.loglog(
                paper, np.degrees(study.of(method)), ".", color=_COLOURS[method],
            )  # fmt: skip
        ends = [0.8 * paper.min(), 1.2 * paper.max()]
        right.plot(ends, ends, "k-", lw=0.8)
        right.set(xlabel=f"{METHODS[PAPERS_BEST].title} [deg]", ylabel="method [deg]")
        _plain_ticks(right.xaxis)
        _plain_ticks(right.yaxis)
    figure.savefig(path, dpi=_DPI)


def plot_strategies(result: Strategies, path: Path) -> None:
    """RMS error of each method unloaded and at its worst load, grouped by sensors."""
    keys = list(result.unloaded)
    figure, axes = _figure(1, 1, (9.0, 4.8), f"Sensor strategies, specimen {result.specimen}")
    axis = axes[0][0]
    place = np.arange(len(keys))
    unloaded = [float(np.degrees(result.unloaded[key].rms)) for key in keys]
    loaded = [float(np.degrees(result.loaded.worst(key, "IV"))) for key in keys]
    axis.barh(place - 0.2, unloaded, 0.4, label="unloaded, (28)")
    axis.barh(place + 0.2, loaded, 0.4, label="still under a load, worst")
    axis.set_yticks(place, [f"{METHODS[k].title}  [{METHODS[k].strategy}]" for k in keys])
    axis.invert_yaxis()
    axis.set(xscale="log", xlabel="RMS error [deg]; [strategy] in brackets")
    axis.legend(loc="center right", fontsize=8)
    axis.set_xlim(right=60.0)
    figure.savefig(path, dpi=_DPI)


def _figure(
    rows: int, columns: int, size: tuple[float, float], title: str
) -> tuple[Figure, list[list[Axes]]]:
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=size, layout="constrained")
        axes = figure.subplots(rows, columns, squeeze=False)
    figure.suptitle(title)
    return figure, [list(row) for row in axes]


def _plain_ticks(axis: Axis) -> None:
    """Label a logarithmic axis in plain degrees."""
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _place: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _legend(axis: Axes) -> None:
    """Put the legend above the curves, where it hides nothing."""
    low, high = axis.get_ylim()
    axis.set_ylim(low, high + 0.35 * (high - low))
    axis.legend(loc="upper left", fontsize=7)


def _averaged(values: Array, run: ForcepsRun) -> Array:
    """Centred mean (n,) over `_AVERAGE`."""
    width = max(1, round(_AVERAGE * run.log_rate))
    weights = np.ones(width)
    count = np.convolve(np.ones_like(values), weights, "same")
    return np.asarray(np.convolve(values, weights, "same") / count)


def _line(axis: Axes, run: ForcepsRun, error: Array, rows: NDArray[np.bool_], key: str) -> None:
    label = f"{METHODS[key].title}: {np.degrees(np.sqrt(np.mean(error[rows] ** 2))):.3f}"
    axis.plot(run.t[rows], np.degrees(error[rows]), lw=0.7, color=_COLOURS[key], label=label)
