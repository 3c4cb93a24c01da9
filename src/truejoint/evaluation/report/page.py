"""Self-contained HTML pages: what a calibration is worth, several side by side, and touches."""

import re
from base64 import b64encode
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from datetime import UTC, datetime
from functools import cache, partial
from hashlib import sha256
from importlib.resources import files
from itertools import chain, combinations, cycle
from pathlib import Path
from typing import Any, Final

import jinja2
import numpy as np
from jinja2.utils import htmlsafe_json_dumps
from pandas import DataFrame

from truejoint import drawing
from truejoint._version import __version__, versions
from truejoint.calibration import Calibration
from truejoint.errors import CalibrationError, RecordingError, shown_text
from truejoint.evaluation import score_tables as view
from truejoint.evaluation.evaluate import compare_models
from truejoint.evaluation.report import figures
from truejoint.evaluation.results import (
    OFFSET,
    Evaluation,
    all_scores,
    as_evaluation,
    estimator_phrase,
    estimator_title,
)
from truejoint.evaluation.scoring import WINDOW
from truejoint.files import check_target, write_atomically
from truejoint.tip import TouchReport
from truejoint.units import with_unit

_POLICY: Final = "script-src 'self'"  # as the template has it
_SCRIPT: Final = re.compile(r"<script>(.*?)</script>", re.DOTALL)


def write_report(
    evaluation: Evaluation, path: str | Path, *, command: str = "", overwrite: bool = False
) -> Path:
    """Write the report of an evaluation as one HTML file that needs nothing else.

    The page loads nothing from anywhere, and a content security policy in it forbids to.

    Parameters
    ----------
    evaluation : Evaluation
    path : str or Path
        File to write, whole or not at all.
    command : str
        Command line that makes this report again.
    overwrite : bool
        Whether a file at `path` may be replaced.

    Raises
    ------
    CalibrationError
        If `evaluation` is something else.
    RecordingError
        If the name does not end in .html or .htm, a file is there and may not be replaced, or the
        folder does not exist.

    Examples
    --------
    >>> write_report(evaluation, "report.html").name
    'report.html'
    """
    as_evaluation(evaluation)
    render = partial(render_report, evaluation, command=command)
    return write_page(path, render, overwrite=overwrite)


def write_page(path: str | Path, render: Callable[[], str], *, overwrite: bool) -> Path:
    """Write the page that `render` gives, whole or not at all; checks the path before it does."""
    target = check_name(path)
    check_target(target, overwrite=overwrite, error=RecordingError)
    # Half a character, of somebody's name, becomes its number.
    data = render().encode(errors="backslashreplace")
    write_atomically(target, data, overwrite=overwrite, error=RecordingError)
    return target


def check_name(path: str | Path) -> Path:
    """Path of a report to write; raises RecordingError when its ending is not that of a page."""
    path = Path(path)
    if path.suffix.lower() not in {".html", ".htm"}:
        raise RecordingError(f"{path}: a report is an HTML page; call it {path.stem}.html")
    return path


def render_report(evaluation: Evaluation, *, command: str = "") -> str:
    """Return the page that `write_report` writes.

    Examples
    --------
    >>> render_report(evaluation).startswith("<!doctype html>")
    True
    """
    pair = {n: figures.colour_of(n, evaluation) for n in (OFFSET, as_evaluation(evaluation).chosen)}
    drawn = {
        "worst": list(figures.worst_stretches(evaluation)),
        "time": figures.over_time(evaluation),
        "residuals": list(figures.residuals(evaluation)),
        "loops": [figures.loops(evaluation)],
        "distribution": [figures.distributions(evaluation, pair)],
        "intervals": list(figures.stated_interval(evaluation)),
    }
    seeds = evaluation.score(evaluation.chosen, evaluation.joints[0]).seeds
    several = f", {seeds} seeds" if seeds > 1 else ""
    return render_figures(
        "report.html.j2",
        drawn,
        evaluation=evaluation,
        chosen_phrase=estimator_phrase(evaluation.chosen),
        menu=figures.menu_order(evaluation),
        window=WINDOW,
        facts=facts(evaluation, estimator_title(evaluation.chosen) + several),
        origin=view.origin(evaluation.training),
        tables=dict(all_scores(evaluation)),
        command=command,
    )


def write_comparison(
    together: Evaluation,
    alone: Mapping[str, Evaluation],
    path: str | Path,
    *,
    command: str = "",
    overwrite: bool = False,
) -> Path:
    """Write a page on several models that were judged on the same recordings.

    Parameters
    ----------
    together : Evaluation
        Evaluation of all models, each as an estimator by its name.
    alone : mapping of str to Evaluation
        Evaluation of each model by itself, by that name, for its verdict.
    path, command, overwrite
        As `write_report` takes them.

    Raises
    ------
    CalibrationError
        If there are fewer than two models, or one is not among those that were judged together.
    RecordingError
        As `write_report`.

    Examples
    --------
    >>> alone = {"offset": evaluation, "linear": evaluation}
    >>> write_comparison(evaluation, alone, "models.html").name
    'models.html'
    """
    if len(alone) < 2:
        raise CalibrationError(f"{len(alone)} model to compare; give at least two")
    for name in alone:
        if name not in together.estimators:
            raise CalibrationError(f"{name} was not judged together with the others")
    render = partial(_render_comparison, together, alone, command)
    return write_page(path, render, overwrite=overwrite)


def _render_comparison(together: Evaluation, alone: Mapping[str, Evaluation], command: str) -> str:
    both = list(combinations(alone, 2))
    pairs = compare_models(together.errors, together.rows, together.joints, both)
    pairs = pairs.rename(columns={"estimator": "against", "outcome": "result"}).astype(str)
    verdicts = {name: evaluation.verdict for name, evaluation in alone.items()}
    objections = [v.text for v in verdicts.values() if v.objections]
    deploy = together.verdict.deploy
    level = verdicts[deploy].level if deploy in verdicts else "warn"
    picked = replace(together, chosen=deploy) if deploy else together
    colours = dict(zip(alone, cycle(drawing.PALETTE), strict=False))
    return render_figures(
        "comparison.html.j2",
        {
            "residuals": list(figures.residuals(together, list(alone))),
            "distribution": [figures.distributions(together, colours)],
        },
        evaluation=picked,
        verdicts=verdicts,
        level="fail" if objections else level,
        sentence=objections[0] if objections else together.verdict.advice,
        rule=next(iter(verdicts.values())).rule,
        pairs=pairs[["joint", "model", "against", "result", "stretches"]],
        origins={name: evaluation.training for name, evaluation in alone.items()},
        facts=facts(together, f"{len(alone)} models"),
        command=command,
    )


def write_touch_report(
    calibration: Calibration,
    report: TouchReport,
    path: str | Path,
    *,
    command: str = "",
    overwrite: bool = False,
) -> Path:
    """Write what a calibration by touch is worth as one HTML file that needs nothing else.

    `calibration` and `report` are as `calibrate_by_touch` gives them; the other arguments, and
    RecordingError, are those of `write_report`. Raises CalibrationError if the calibration was made
    in another way.
    """
    if "touch" not in calibration.metadata:
        raise CalibrationError(
            f"the calibration of {calibration.title} was not made by touches; `evaluate` it"
        )
    render = partial(_render_touches, calibration, report, command)
    return write_page(path, render, overwrite=overwrite)


def _render_touches(calibration: Calibration, report: TouchReport, command: str) -> str:
    touches, rejected = report.touches, report.fit.left_out
    before, after = (np.linalg.norm(off, axis=1) for off in (report.before, report.left_out))
    rows = []
    for i in np.lexsort((-after, ~rejected)):
        why = "rejected: badly seated, or another number?" if rejected[i] else ""
        lengths = [f"{1e3 * length:.2f}" for length in (before[i], after[i])]
        rows.append([touches.dimple[i], why, f"{touches.t[i]:.1f}", *lengths])
    was, now = (with_unit(float(np.sqrt((e[~rejected] ** 2).mean())), "m") for e in (before, after))
    raw, near, far = report.statement
    return render_figures(
        "touches.html.j2",
        {"map": list(figures.touch_maps(report))},
        title=calibration.title,
        sentence=f"{near[0].upper()}{near[1:]} in the block's frame.",
        level="warn" if report.not_seen or rejected.any() else "pass",
        facts=[
            f"{len(touches)} touches, {int(rejected.sum())} of them rejected",
            *(raw, far),
            f"before {was}, after {now} off (RMS)",
            f"prior: {', '.join(calibration.metadata['touch']['prior']) or 'none'}",
            now_text(),
        ],
        not_seen=report.not_seen,
        rows=DataFrame(rows, columns=["point", "", "at [s]", "before [mm]", "left out [mm]"]),
        source=touches.source,
        command=command,
    )


def render_figures(
    template: str, drawn: Mapping[str, Iterable[figures.Figure]], **values: Any
) -> str:
    """Fill a template that extends ``figures.html.j2`` with what is drawn, by section."""
    shown = [{"key": each.key, "variants": each.variants} for each in chain(*drawn.values())]
    return render_page(
        template,
        drawn=drawn,
        view=view,
        title_of=estimator_title,
        plotly=(files(__package__) / "assets/plotly-gl3d.min.js").read_text(encoding="utf-8"),
        figures=script_json({"figures": shown, "dark": figures.DARK}),
        **values,
    )


def render_page(template: str, *, package: str = __package__, **values: Any) -> str:
    """Fill a template of the ``assets`` of `package`, which extends our ``base.html.j2``."""
    page = _environment(package).get_template(template).render(**values, versions=versions())
    # The page's own scripts run, no other does: a policy in it names each by its hash.
    digests = (sha256(script.encode()).digest() for script in _SCRIPT.findall(page))
    allowed = [f"'sha256-{b64encode(digest).decode()}'" for digest in digests]
    return page.replace(_POLICY, " ".join(["script-src", *(allowed or ["'none'"])]), 1)


@cache
def _environment(package: str) -> jinja2.Environment:
    """Templates of the ``assets`` of `package` and of ours, each compiled once."""
    loaders = [jinja2.PackageLoader(name, "assets") for name in (package, __package__)]
    return jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True,
        loader=jinja2.ChoiceLoader(loaders), finalize=shown_text,
    )  # fmt: skip


def script_json(value: Any) -> str:
    """JSON that may stand inside a script element: nothing in it can end the element."""
    return htmlsafe_json_dumps(value, separators=(",", ":"), allow_nan=False)


def facts(evaluation: Evaluation, what: str) -> list[str]:
    """Provenance in a line: `what` was trained, on what it was tested, and when."""
    seconds, count = evaluation.rows["t"].groupby(level=0).agg(np.ptp).sum(), len(evaluation.test)
    return [
        what,
        f"tested on {len(evaluation.rows):,} rows, {view.duration(seconds)}, "
        f"{count} recording{'s' if count > 1 else ''} held out",
        now_text(),
        f"truejoint {__version__}",
    ]


def now_text() -> str:
    """Time of a page that is made now, to the minute."""
    return f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC"
