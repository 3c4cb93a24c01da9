"""`truejoint compare`: several models on the same recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import truejoint
from truejoint.cli import complete, options
from truejoint.cli.console import out, progress, result_json, say
from truejoint.cli.data import CHECK_FAILED
from truejoint.cli.inputs import Files, takes_files
from truejoint.cli.show import is_model
from truejoint.errors import CalibrationError
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
    part: options.Part = None,
    split: options.Split = None,
    as_json: options.Json = False,
    *,
    files: Files,
) -> None:
    """Compare models on the same recordings; exit code 1 when one was trained on them."""
    paths = [name for name in names if is_model(Path(name))]
    if len(paths) < 2:
        raise CalibrationError(
            f"{len(paths)} model file{'s' if len(paths) != 1 else ''} among {', '.join(names)}; "
            "name at least two (`truejoint evaluate` judges one)"
        )
    from truejoint.calibration.sessions import source_of, trained_on  # noqa: PLC0415  # not for help
    from truejoint.evaluation.results import BASELINES  # noqa: PLC0415

    stems = [Path(path).stem for path in paths]
    # A model called as one of the table's own rows, or as another one, goes by its path.
    titles = [
        path if [*stems, *BASELINES].count(stem) > 1 else stem
        for stem, path in zip(stems, paths, strict=True)
    ]
    models = {t: truejoint.read_calibration(p) for t, p in zip(titles, paths, strict=True)}
    first = models[titles[0]]
    tested = files.find(
        [name for name in names if name not in paths], part=part, split=split, model=first
    )()
    with progress(f"Judging {len(models)} models"):
        result = truejoint.evaluate({title: [model] for title, model in models.items()}, tested)
    objections = [
        f"{title} was trained on rows of {source_of(recording)}"
        for title, model in models.items()
        for recording in tested
        if trained_on(model.metadata, recording)
    ]
    best = {
        joint: min((result.score(title, joint) for title in titles), key=lambda s: s.rmse)
        for joint in result.joints
    }
    if as_json:
        winners = {joint: score.estimator for joint, score in best.items()}
        scores = result.to_dict()["scores"]
        deploy = "" if objections else result.verdict.deploy
        result_json({"scores": scores, "best": winners, "deploy": deploy, "objections": objections})
    else:
        out.print(truejoint.evaluation.score_table(result))
        for joint, score in best.items():
            out.print(f"{joint}: {score.estimator} is best, {with_unit(score.rmse, score.unit)}")
        if result.verdict.advice and not objections:
            out.print(result.verdict.advice)
        for objection in objections:
            say(f"This test cannot be believed: {objection}")
    if objections:
        raise typer.Exit(CHECK_FAILED)
