"""`truejoint compare`: several models on the same recordings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import typer

import truejoint
from truejoint.cli.check_options import CHECK_FAILED
from truejoint.cli.console import command_line, out, progress, result_json
from truejoint.cli.evaluate import show_verdict
from truejoint.cli.recording_options import Files, check_page_target, parse_tolerances, takes_files
from truejoint.cli.show import is_model
from truejoint.errors import CalibrationError
from truejoint.units import with_unit

Evaluation: TypeAlias = "truejoint.evaluation.Evaluation"


@takes_files
def compare(
    names: list[str],
    tolerance: list[str] | None = None,
    rezero_s: float = 0.0,
    report: Path | None = None,
    part: str | None = None,
    split: str | None = None,
    force: bool = False,
    as_json: bool = False,
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
    check_page_target(report, force)
    models = _by_title(paths)
    first = next(iter(models.values()))
    how: dict[str, Any] = {"tolerance": parse_tolerances(tolerance or [], first)}
    how["rezero"] = rezero_s
    tested = files.find(
        [name for name in names if name not in paths], part=part, split=split, model=first
    )()
    with progress(f"Judging {len(models)} models"):
        together = truejoint.evaluate({title: [m] for title, m in models.items()}, tested, **how)
        alone = {title: truejoint.evaluate(m, tested, **how) for title, m in models.items()}
    if report is not None:
        with progress(f"Writing {report}"):
            truejoint.evaluation.write_comparison(
                together, alone, report, command=command_line(), overwrite=force
            )
    objections = [
        f"{title}: {objection}"
        for title, evaluation in alone.items()
        for objection in evaluation.verdict.objections
    ]
    _tell(together, alone, objections, as_json=as_json)
    if objections:
        raise typer.Exit(CHECK_FAILED)


def _by_title(paths: Sequence[str]) -> dict[str, truejoint.Calibration]:
    """Read models; one called as another, or as one of the table's own rows, goes by its path."""
    from truejoint.evaluation.results import BASELINES

    stems = [Path(path).stem for path in paths]
    return {
        path if [*stems, *BASELINES].count(stem) > 1 else stem: truejoint.read_calibration(path)
        for path, stem in zip(paths, stems, strict=True)
    }


def _tell(
    together: Evaluation,
    alone: Mapping[str, Evaluation],
    objections: Sequence[str],
    *,
    as_json: bool,
) -> None:
    """Print the table of all models, the best in each joint, and what is said of each."""
    best = {
        joint: min((together.score(title, joint) for title in alone), key=lambda s: s.rmse)
        for joint in together.joints
    }
    if as_json:
        result_json(
            {
                "scores": together.to_dict()["scores"],
                "best": {joint: score.estimator for joint, score in best.items()},
                "deploy": "" if objections else together.verdict.deploy,
                "verdicts": {
                    title: evaluation.to_dict()["verdict"] for title, evaluation in alone.items()
                },
                "objections": objections,
            }
        )
        return
    out.print(truejoint.evaluation.score_table(together))
    for joint, score in best.items():
        out.print(f"{joint}: {score.estimator} is best, {with_unit(score.rmse, score.unit)}")
    for title, evaluation in alone.items():
        show_verdict(evaluation.verdict, f"{title}: ")
    if together.verdict.advice and not objections:
        out.print(together.verdict.advice)
