"""`truejoint compare`: several models on the same recordings."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import truejoint
from truejoint.cli.console import command_line, out, plural, progress
from truejoint.cli.evaluate import show_verdict
from truejoint.cli.options import Result
from truejoint.cli.recording_options import Files, check_page_target, parse_tolerances
from truejoint.cli.show import is_model
from truejoint.errors import CalibrationError
from truejoint.units import with_unit


def compare(
    names: list[str],
    files: Files,
    tolerance: list[str] | None = None,
    rezero_s: float = 0.0,
    report: Path | None = None,
    part: str | None = None,
    split: str | None = None,
    force: bool = False,
) -> Result:
    """Compare models on the same recordings; exit code 1 when a test cannot be believed."""
    paths = [name for name in names if is_model(Path(name))]
    if len(paths) < 2:
        raise CalibrationError(
            f"{plural(len(paths), 'model file')} among {', '.join(names)}; "
            "name at least two (`truejoint evaluate` judges one)"
        )
    check_page_target(report, force)
    models = _by_title(paths)
    first = next(iter(models.values()))
    how: dict[str, Any] = {
        "tolerance": parse_tolerances(tolerance, first), "rezero": rezero_s,
    }  # fmt: skip
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
    best = {
        joint: min((together.score(title, joint) for title in alone), key=lambda s: s.rmse)
        for joint in together.joints
    }
    out.print(truejoint.evaluation.score_table(together))
    for joint, score in best.items():
        out.print(f"{joint}: {score.estimator} is best, {with_unit(score.rmse, score.unit)}")
    for title, evaluation in alone.items():
        show_verdict(evaluation.verdict, f"{title}: ")
    if together.verdict.advice and not objections:
        out.print(together.verdict.advice)
    values = {
        "scores": together.to_dict()["scores"],
        "best": {joint: score.estimator for joint, score in best.items()},
        "deploy": "" if objections else together.verdict.deploy,
        "verdicts": {title: one.to_dict()["verdict"] for title, one in alone.items()},
        "objections": objections,
    }
    return Result(values, passed=not objections)


def _by_title(paths: Sequence[str]) -> dict[str, truejoint.Calibration]:
    """Read models; one called as another, or as one of the table's own rows, goes by its path."""
    from truejoint.evaluation.results import BASELINES

    stems = [Path(path).stem for path in paths]
    return {
        path if [*stems, *BASELINES].count(stem) > 1 else stem: truejoint.read_calibration(path)
        for path, stem in zip(paths, stems, strict=True)
    }
