"""`truejoint evaluate` and `compare`: judge calibrations on recordings that they never saw."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

import truejoint
from truejoint.cli.console import command_line, out, plural, progress, say
from truejoint.cli.options import Result
from truejoint.cli.recording_options import (
    DataCheck,
    Files,
    check_page_target,
    parse_tolerances,
    say_failed,
)
from truejoint.cli.show import is_model
from truejoint.errors import CalibrationError, RecordingError
from truejoint.files import check_folder
from truejoint.units import with_unit

_STYLES: Final = {"pass": "green", "warn": "yellow", "fail": "red"}


@dataclass(frozen=True)
class Judging:
    """How models are judged, and the page that says so, an option each."""

    tolerance: list[str] | None = None
    rezero_s: float = 0.0
    part: str | None = None
    split: str | None = None
    report: Path | None = None
    force: bool = False

    def __post_init__(self) -> None:
        check_page_target(self.report, self.force)


def evaluate(
    model: Path,
    recordings: list[str],
    how: Judging,
    data_check: DataCheck,
    files: Files,
    seeds: list[Path] | None = None,
    training: list[str] | None = None,
    tables: Path | None = None,
    window_s: float = 10.0,
) -> Result:
    """Judge a calibration on recordings with truth; exit code 1 when it does not pass."""
    report, force = how.report, how.force
    if tables is not None:
        if tables.exists() and not force:
            raise RecordingError(f"{tables}: exists already; name a new folder, or --force")
        check_folder(tables)
    models = [truejoint.read_calibration(path) for path in (model, *(seeds or []))]
    first = models[0]
    if any(other.estimator != first.estimator for other in models):
        raise CalibrationError(
            f"--seed-of: {model} is {first.estimator!r}; give models of the same estimator"
        )
    accepted = parse_tolerances(how.tolerance, first)
    read_testing = files.find(
        recordings, part=how.part, split=how.split, model=first, inputs=first.feature_set
    )
    read_training = files.find(training or [], model=first)
    testing, shown = read_testing(), read_training()
    checks = {"test": data_check.run(testing, model=first)}
    if shown:
        checks["training"] = data_check.run(shown, joints=first.joints)
    with progress("Judging"):
        result = truejoint.evaluate(
            models, testing, tolerance=accepted, window=window_s, rezero=how.rezero_s,
            check=checks["test"],
        )  # fmt: skip
    if report is not None:
        with progress(f"Writing {report}"):
            truejoint.write_report(
                result, report, training=shown, checks=checks, command=command_line(),
                overwrite=force,
            )  # fmt: skip
    if tables is not None:
        truejoint.evaluation.write_tables(result, tables, overwrite=force)
    show(result)
    say_failed(checks["test"])
    values = {"checks": {name: each.to_dict() for name, each in checks.items()}}
    passed = result.verdict.passed and not checks["test"].failed
    return Result(result.to_dict() | values, passed)


def show(result: truejoint.evaluation.Evaluation) -> None:
    """Print the tables and the verdict."""
    out.print(truejoint.evaluation.score_table(result))
    for name, note in result.baseline_notes.items():
        say(f"{name}: {note}")
    if result.intervals:
        out.print(truejoint.evaluation.interval_table(result))
    if result.intervals or result.interval_objections:
        for line in (result.interval_note, *result.interval_objections):
            say(line)
    if result.domain.inside < 1.0:
        out.print(truejoint.evaluation.domain_table(result))
    say(truejoint.evaluation.score_rows.domain_line(result))
    verdict = result.verdict
    show_verdict(verdict)
    if verdict.advice and verdict.advice not in verdict.doubts:
        out.print(verdict.advice)


def show_verdict(verdict: truejoint.evaluation.Verdict, title: str = "") -> None:
    """Print a verdict with its reasons, after a `title`."""
    out.print(f"{title}{verdict.text}", style=_STYLES[verdict.level])
    for line in (*verdict.objections[1:], *verdict.doubts, *verdict.remarks):
        out.print(f"  {line}")


def compare(names: list[str], how: Judging, data_check: DataCheck, files: Files) -> Result:
    """Compare models on the same recordings; exit code 1 when a test cannot be believed."""
    paths = [name for name in names if is_model(Path(name))]
    if len(paths) < 2:
        raise CalibrationError(
            f"{plural(len(paths), 'model file')} among {', '.join(names)}; "
            "name at least two (`truejoint evaluate` judges one)"
        )
    models, recordings = _by_title(paths), [name for name in names if name not in paths]
    first = next(iter(models.values()))
    accepted, rezero = parse_tolerances(how.tolerance, first), how.rezero_s
    tested = files.find(recordings, part=how.part, split=how.split, model=first)()
    check = data_check.run(tested, model=first)
    judge = partial(
        truejoint.evaluate, recordings=tested, tolerance=accepted, rezero=rezero, check=check
    )
    with progress(f"Judging {len(models)} models"):
        together = judge({title: [model] for title, model in models.items()})
        alone = {title: judge(model) for title, model in models.items()}
    if how.report is not None:
        with progress(f"Writing {how.report}"):
            truejoint.evaluation.write_comparison(
                together, alone, how.report, command=command_line(), overwrite=how.force
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
    say_failed(check)
    values = {
        "check": check.to_dict(),
        "scores": together.to_dict()["scores"],
        "best": {joint: score.estimator for joint, score in best.items()},
        "deploy": "" if objections else together.verdict.deploy,
        "advice": "" if objections else together.verdict.advice,
        "verdicts": {title: judged.to_dict()["verdict"] for title, judged in alone.items()},
        "objections": objections,
    }
    return Result(values, passed=not objections and not check.failed)


def _by_title(paths: Sequence[str]) -> dict[str, truejoint.Calibration]:
    """Read models by file and estimator; those whose files are called alike go by their paths."""
    stems = [Path(path).stem for path in paths]
    models = {}
    for path, stem in zip(paths, stems, strict=True):
        model = truejoint.read_calibration(path)
        estimator = "auto" if "choice" in model.metadata else model.estimator
        models[f"{path if stems.count(stem) > 1 else stem} ({estimator})"] = model
    return models
