"""`truejoint compare`: several models on the same recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

import truejoint
from truejoint.cli import complete, options
from truejoint.cli.console import command_line, out, progress, result_json
from truejoint.cli.data import CHECK_FAILED
from truejoint.cli.evaluate import show_verdict
from truejoint.cli.inputs import Files, parse_tolerances, takes_files
from truejoint.cli.show import is_model
from truejoint.errors import CalibrationError
from truejoint.files import check_target
from truejoint.units import with_unit


@takes_files
def compare(
    names: Annotated[
        list[str],
        typer.Argument(
            metavar="MODEL... RECORDING...",
            help="Two or more model files, and the recordings with truth to judge them on.",
            autocompletion=complete.recordings,
        ),
    ],
    tolerance: options.Tolerance = None,
    rezero_s: options.JudgedAfter = 0.0,
    report: Annotated[
        Path | None, typer.Option(help="Also write a page of all models, an .html page.")
    ] = None,
    part: options.Part = None,
    split: options.Split = None,
    force: options.Force = False,
    as_json: options.Json = False,
    *,
    files: Files,
) -> None:
    """Compare models on the same recordings; exit code 1 when a test cannot be believed."""
    paths = [name for name in names if is_model(Path(name))]
    if len(paths) < 2:
        raise CalibrationError(
            f"{len(paths)} model file{'s' if len(paths) != 1 else ''} among {', '.join(names)}; "
            "name at least two (`truejoint evaluate` judges one)"
        )
    if report is not None:
        from truejoint.evaluation.report.page import check_name  # noqa: PLC0415  # needs NumPy

        check_target(check_name(report), overwrite=force)
    from truejoint.evaluation.results import BASELINES  # noqa: PLC0415  # not for help

    stems = [Path(path).stem for path in paths]
    # A model called as one of the table's own rows, or as another one, goes by its path.
    titles = [
        path if [*stems, *BASELINES].count(stem) > 1 else stem
        for stem, path in zip(stems, paths, strict=True)
    ]
    models = {t: truejoint.read_calibration(p) for t, p in zip(titles, paths, strict=True)}
    first = models[titles[0]]
    how: dict[str, Any] = {"tolerance": parse_tolerances(tolerance or [], first)}
    how["rezero"] = rezero_s
    tested = files.find(
        [name for name in names if name not in paths], part=part, split=split, model=first
    )()
    with progress(f"Judging {len(models)} models"):
        result = truejoint.evaluate({title: [m] for title, m in models.items()}, tested, **how)
        alone = {title: truejoint.evaluate(m, tested, **how) for title, m in models.items()}
    objections = [
        f"{title}: {objection}"
        for title, evaluation in alone.items()
        for objection in evaluation.verdict.objections
    ]
    best = {
        joint: min((result.score(title, joint) for title in titles), key=lambda s: s.rmse)
        for joint in result.joints
    }
    if report is not None:
        with progress(f"Writing {report}"):
            truejoint.evaluation.write_comparison(
                result, alone, report, command=command_line(), overwrite=force
            )
    if as_json:
        deploy = "" if objections else result.verdict.deploy
        result_json(
            {
                "scores": result.to_dict()["scores"],
                "best": {joint: score.estimator for joint, score in best.items()},
                "deploy": deploy,
                "verdicts": {title: one.to_dict()["verdict"] for title, one in alone.items()},
                "objections": objections,
            }
        )
    else:
        out.print(truejoint.evaluation.score_table(result))
        for joint, score in best.items():
            out.print(f"{joint}: {score.estimator} is best, {with_unit(score.rmse, score.unit)}")
        for title, one in alone.items():
            show_verdict(one.verdict, f"{title}: ")
        if result.verdict.advice and not objections:
            out.print(result.verdict.advice)
    if objections:
        raise typer.Exit(CHECK_FAILED)
