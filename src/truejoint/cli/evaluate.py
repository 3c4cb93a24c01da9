"""`truejoint evaluate`: judge a calibration on recordings that it never saw."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

import truejoint
from truejoint.cli import complete, options
from truejoint.cli.console import command_line, out, progress, result_json, say
from truejoint.cli.inputs import Files, check_writable, parse_tolerances, takes_files
from truejoint.errors import CalibrationError

CHECK_FAILED = 1


@takes_files
def evaluate(
    model: options.Model,
    recordings: options.Recordings,
    seeds: Annotated[
        list[Path] | None,
        typer.Option("--seed-of", help="Model file of the same estimator with another seed."),
    ] = None,
    training: Annotated[
        list[str] | None,
        options.recordings("--training", "Training recording, for the report's figures only."),
    ] = None,
    report: Annotated[Path | None, typer.Option(help="Also write the report, an .html page.")] = (
        None
    ),
    tolerance: Annotated[
        list[str] | None,
        typer.Option(
            metavar="JOINT=VALUE",
            help="Largest RMSE that you accept, in deg or mm, for instance elbow=0.2. Without "
            "one, a joint must beat the fixed offset.",
            autocompletion=complete.tolerances,
        ),
    ] = None,
    window_s: Annotated[float, typer.Option(help="Length of the worst stretches [s].")] = 10.0,
    part: options.Part = None,
    split: options.Split = None,
    force: options.Force = False,
    as_json: options.Json = False,
    *,
    files: Files,
) -> None:
    """Judge a calibration on recordings with truth; exit code 1 when it does not pass."""
    if report is not None:
        check_writable(report, force, "--report")
    models = [truejoint.read_calibration(path) for path in (model, *(seeds or []))]
    first = models[0]
    if any(other.estimator != first.estimator for other in models):
        raise CalibrationError(
            f"--seed-of: {model} is {first.estimator!r}; give models of the same estimator"
        )
    units = {joint: first.units[f"measured/{joint}"] for joint in first.joints}
    accepted = parse_tolerances(tolerance or [], units)
    read_testing = files.find(recordings, part=part, split=split, model=first)
    read_training = files.find(training or [], model=first)
    testing, shown = read_testing(), read_training()
    with progress("Judging"):
        result = truejoint.evaluate(models, testing, tolerance=accepted, window=window_s)
    if report is not None:
        report_evaluation(result, report, first, testing, shown, force=force)
    if as_json:
        result_json(result.to_dict())
    else:
        show(result)
    if not result.verdict.passed:
        raise typer.Exit(CHECK_FAILED)


def report_evaluation(
    result: truejoint.evaluation.Evaluation,
    path: Path,
    model: truejoint.Calibration,
    testing: Sequence[truejoint.Recording],
    training: Sequence[truejoint.Recording] = (),
    *,
    force: bool = False,
) -> None:
    """Check the data and write the report, showing progress."""
    with progress(f"Writing {path}"):
        check_data = truejoint.evaluation.check_data
        checks = {"test": check_data(testing, calibration=model)}
        if training:
            checks["training"] = check_data(training, joints=model.joints)
        command = command_line()
        truejoint.write_report(
            result, path, training=training, checks=checks, command=command, overwrite=force
        )


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
    out.print(result.verdict.text, style="green" if result.verdict.passed else "red")
    for line in (*result.verdict.objections, *result.verdict.remarks):
        out.print(f"  {line}")
