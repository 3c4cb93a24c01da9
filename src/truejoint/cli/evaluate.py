"""`truejoint evaluate`: judge a calibration on recordings that it never saw."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import truejoint
from truejoint.cli.check_options import DataCheck, say_failed
from truejoint.cli.console import command_line, out, progress, say
from truejoint.cli.options import Result
from truejoint.cli.recording_options import Files, check_page_target, parse_tolerances
from truejoint.errors import CalibrationError, RecordingError
from truejoint.files import check_folder

_STYLES: Final = {"pass": "green", "warn": "yellow", "fail": "red"}


def evaluate(
    model: Path,
    recordings: list[str],
    data_check: DataCheck,
    files: Files,
    seeds: list[Path] | None = None,
    training: list[str] | None = None,
    report: Path | None = None,
    tables: Path | None = None,
    tolerance: list[str] | None = None,
    rezero_s: float = 0.0,
    window_s: float = 10.0,
    part: str | None = None,
    split: str | None = None,
    force: bool = False,
) -> Result:
    """Judge a calibration on recordings with truth; exit code 1 when it does not pass."""
    check_page_target(report, force)
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
    accepted = parse_tolerances(tolerance, first)
    inputs = first.feature_set
    read_testing = files.find(recordings, part=part, split=split, model=first, inputs=inputs)
    read_training = files.find(training or [], model=first)
    testing, shown = read_testing(), read_training()
    checks = {"test": data_check.run(testing, model=first)}
    if shown:
        checks["training"] = data_check.run(shown, joints=first.joints)
    with progress("Judging"):
        result = truejoint.evaluate(
            models, testing, tolerance=accepted, window=window_s, rezero=rezero_s,
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
