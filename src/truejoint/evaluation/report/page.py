"""One self-contained HTML page that a reader can believe a calibration by."""

from __future__ import annotations

import importlib.metadata
import json
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

import jinja2
from plotly.offline import get_plotlyjs

from truejoint.errors import CalibrationError, RecordingError
from truejoint.evaluation.checks import DataCheck
from truejoint.evaluation.report import curves, residuals, space, uncertainty, view
from truejoint.evaluation.report.plot import Figure
from truejoint.evaluation.results import OFFSET, Evaluation, estimator_phrase, estimator_title
from truejoint.files import check_target, write_atomically
from truejoint.recordings.recording import Recording
from truejoint.units import display_unit

_PACKAGES: Final = ("truejoint", "numpy", "scipy", "numba", "scikit-learn", "pandas", "plotly")


@dataclass(frozen=True)
class Section:
    """A numbered part of the page with figures."""

    key: str
    title: str
    lead: str
    figures: Sequence[Figure]


def write_report(
    evaluation: Evaluation,
    path: str | Path,
    *,
    training: Sequence[Recording] = (),
    checks: Mapping[str, DataCheck] | None = None,
    command: str = "",
    overwrite: bool = False,
) -> Path:
    """Write the report of an evaluation as one HTML file that needs nothing else.

    The page loads nothing from anywhere, and a content security policy in it forbids to.

    Parameters
    ----------
    evaluation : Evaluation
    path : str or Path
        Where to write; written whole or not at all.
    training : sequence of Recording
        What the model was fitted on, for the figures of trajectories; may be empty.
    checks : mapping of str to DataCheck, optional
        Data checks by name, such as ``"training"`` and ``"test"``.
    command : str
        Command line that makes this report again.
    overwrite : bool
        Whether a file at `path` may be replaced.

    Returns
    -------
    Path
        Where it was written.

    Raises
    ------
    CalibrationError
        If `evaluation` is something else.
    RecordingError
        If a file is there and may not be replaced, or the folder does not exist.

    Examples
    --------
    >>> write_report(evaluation, "report.html", training=training).name
    'report.html'
    """
    if not isinstance(evaluation, Evaluation):
        raise CalibrationError(
            f"a {type(evaluation).__name__} is no Evaluation; give what `evaluate` gives"
        )
    target = Path(path)
    check_target(target, overwrite=overwrite, error=RecordingError)
    page = render_report(evaluation, training=training, checks=checks, command=command)
    write_atomically(
        target,
        lambda part: part.write_text(page, encoding="utf-8"),
        overwrite=overwrite,
        error=RecordingError,
    )
    return target


def render_report(
    evaluation: Evaluation,
    *,
    training: Sequence[Recording] = (),
    checks: Mapping[str, DataCheck] | None = None,
    command: str = "",
) -> str:
    """Return the page that `write_report` writes.

    Examples
    --------
    >>> render_report(evaluation).startswith("<!doctype html>")
    True
    """
    sections = _sections(evaluation, training)
    interval_figures = uncertainty.stated_interval(evaluation)
    figures = [figure for section in sections.values() for figure in section.figures]
    figures += interval_figures
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    template = environment.from_string(_asset("report.html.j2"))
    return template.render(
        evaluation=evaluation,
        title_of=estimator_title,
        joint_units=[
            (joint, display_unit(unit).name)
            for joint, unit in zip(evaluation.joints, evaluation.units, strict=True)
        ],
        spread_shown=any(score.seeds > 1 for score in evaluation.scores),
        any_session=any(trace.provenance.get("session") for trace in evaluation.traces),
        any_homing=any(trace.provenance.get("homing_id") for trace in evaluation.traces),
        any_load=any(trace.provenance.get("load") is not None for trace in evaluation.traces),
        chosen_title=estimator_title(evaluation.chosen),
        chosen_phrase=estimator_phrase(evaluation.chosen),
        baseline_is_chosen=evaluation.chosen == OFFSET,
        sections=sections,
        menu=[evaluation.traces[i].name for i in curves.menu_order(evaluation)],
        main_rows=view.main_rows(evaluation),
        headlines=view.headlines(evaluation),
        all_scores=view.bias_rows(evaluation),
        recording_rows=view.recording_rows(evaluation),
        interval_rows=view.interval_rows(evaluation),
        interval_figures=interval_figures,
        load_rows=view.load_rows(evaluation),
        direction_rows=view.direction_rows(evaluation),
        cartesian_rows=view.cartesian_rows(evaluation),
        checks={
            name: (check.findings, view.coverage_rows(check.coverage))
            for name, check in (checks or {}).items()
        },
        facts=_facts(evaluation),
        training_facts=view.flattened(evaluation.training),
        sources=_sources(evaluation, training),
        versions=_versions(),
        command=command,
        style=_asset("report.css"),
        script=_asset("report.js"),
        plotly=get_plotlyjs(),
        figures=script_json([_figure_values(f) for f in figures]),
    )


def script_json(value: Any) -> str:
    """JSON that may stand inside a script element: nothing in it can end the element."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return text


def _sections(evaluation: Evaluation, training: Sequence[Recording]) -> dict[str, Section]:
    chosen = estimator_phrase(evaluation.chosen)
    paths = [space.trajectories(evaluation, training), space.tool_paths(evaluation)]
    tool = curves.cartesian_errors(evaluation)
    parts = [
        Section(
            "worst",
            "Worst stretches",
            f"The windows of at most {evaluation.window:g} s in which {chosen} is furthest from "
            "the truth, worst first." + _band_text(evaluation),
            curves.worst_stretches(evaluation),
        ),
        Section("paths", "Trajectories", "", [figure for figure in paths if figure]),
        Section(
            "time",
            "Corrected against true position",
            "Click a name in a legend to show or hide it; the raw position is hidden at first. "
            "Long curves are thinned in a way that keeps every peak." + _band_text(evaluation),
            curves.over_time(evaluation),
        ),
        Section("residuals", "Residuals", "", residuals.residuals(evaluation)),
        Section("loops", "Hysteresis", "", [curves.loops(evaluation)]),
        Section("histograms", "Distribution", "", [curves.histograms(evaluation)]),
        Section("tool", "Tool position", "", [tool] if tool else []),
    ]
    return {section.key: section for section in parts}


def _band_text(evaluation: Evaluation) -> str:
    if all(trace.lower is None for trace in evaluation.traces):
        return ""
    return (
        f" The band is the stated {100 * evaluation.interval_level:g} % interval: above, where the "
        "true position should be; below, errors that it allows."
    )


def _figure_values(figure: Figure) -> dict[str, Any]:
    return {"key": figure.key, "variants": list(figure.variants), "flat": figure.flat}


def _facts(evaluation: Evaluation) -> list[str]:
    """Provenance in a line: what was trained, on what it was tested, and when."""
    rows = sum(len(trace.t) for trace in evaluation.traces)
    seconds = sum(float(trace.t[-1] - trace.t[0]) for trace in evaluation.traces)
    seeds = evaluation.score(evaluation.chosen, evaluation.joints[0]).seeds
    count = len(evaluation.traces)
    return [
        estimator_title(evaluation.chosen) + (f", {seeds} seeds" if seeds > 1 else ""),
        f"tested on {rows:,} rows, {view.duration(seconds)}, "
        f"{count} recording{'s' if count > 1 else ''} held out",
        f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC",
        f"truejoint {_version('truejoint')}",
    ]


def _sources(evaluation: Evaluation, training: Sequence[Recording]) -> list[tuple[str, str, str]]:
    """(part, file, hash) of everything that went in."""
    used = [("training", r.provenance.source, r.provenance.sha256) for r in training]
    tested = [
        ("test", str(t.provenance.get("source", "")), str(t.provenance.get("sha256", "")))
        for t in evaluation.traces
    ]
    return used + tested


def _versions() -> list[tuple[str, str]]:
    found = [(name, _version(name)) for name in _PACKAGES]
    return [("Python", platform.python_version()), *found]


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def _asset(name: str) -> str:
    return files("truejoint.evaluation.report").joinpath("assets", name).read_text("utf-8")
