"""`truejoint evaluate`: judge a calibration on recordings that it never saw."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from truejoint import evaluation
from truejoint.calibration import Calibration, read_calibration
from truejoint.cli.console import command_line, out, progress, result_json, say
from truejoint.cli.inputs import load_recordings, parse_tolerances
from truejoint.cli.options import Arm, Columns, Force, Format, Json, Part, Recordings, Split
from truejoint.errors import CalibrationError, RecordingError
from truejoint.evaluation import Evaluation, check_data, interval_table, score_table, write_report
from truejoint.recordings import Recording

CHECK_FAILED = 1


def evaluate(
    model: Annotated[Path, typer.Argument(help="Model file, from `truejoint calibrate`.")],
    recordings: Recordings,
    seeds: Annotated[
        list[Path] | None,
        typer.Option("--seed-of", help="Model file of the same estimator with another seed."),
    ] = None,
    training: Annotated[
        list[str] | None,
        typer.Option("--training", help="Training recording, for the report's figures only."),
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
        ),
    ] = None,
    window_s: Annotated[float, typer.Option(help="Length of the worst stretches [s].")] = 10.0,
    reader: Format = None,
    columns: Columns = None,
    robot: Annotated[str | None, typer.Option("--robot", help="For plain CSV files.")] = None,
    arm: Arm = "",
    part: Part = None,
    split: Split = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Judge a calibration on recordings with truth; exit code 1 when it does not pass."""
    if report is not None and report.exists() and not force:
        raise RecordingError(f"{report}: is there already; choose another --report, or --force")
    models = [read_calibration(path) for path in (model, *(seeds or []))]
    first = models[0]
    if any(other.estimator != first.estimator for other in models):
        raise CalibrationError(
            f"--seed-of: {model} is {first.estimator!r}; give models of the same estimator"
        )
    context = {"reader": reader, "columns": columns, "robot": robot, "arm": arm}
    testing = load_recordings(recordings, part=part, split=split, **context)  # type: ignore[arg-type]
    shown = load_recordings(training, **context) if training else []  # type: ignore[arg-type]
    units = {joint: testing[0].robot.joint(joint).unit for joint in first.joints}
    with progress(f"Judging on {len(testing)} recordings"):
        result = evaluation.evaluate(
            {first.estimator: models},
            testing,
            tolerance=parse_tolerances(tolerance or [], units),
            window=window_s,
        )
    if report is not None:
        report_evaluation(result, report, models[0], testing, shown, force=force)
    if as_json:
        result_json(result.to_dict())
    else:
        show(result)
    if not result.verdict.passed:
        raise typer.Exit(CHECK_FAILED)


def report_evaluation(
    result: Evaluation,
    path: Path,
    model: Calibration,
    testing: Sequence[Recording],
    training: Sequence[Recording] = (),
    *,
    force: bool = False,
) -> None:
    """Check the data and write the report, showing progress."""
    with progress(f"Writing {path}"):
        checks = {"test": check_data(testing, calibration=model)}
        if training:
            checks["training"] = check_data(training, joints=model.joints)
        write_report(
            result,
            path,
            training=training,
            checks=checks,
            command=command_line(),
            overwrite=force,
        )


def show(result: Evaluation) -> None:
    """Print the tables and the verdict."""
    out.print(score_table(result))
    for name, note in result.baseline_notes.items():
        say(f"{name}: {note}")
    if result.intervals or result.interval_objections:
        if result.intervals:
            out.print(interval_table(result))
        for line in (result.interval_note, *result.interval_objections):
            say(line)
    colour = "green" if result.verdict.passed else "red"
    out.print(result.verdict.text, style=colour, highlight=False)
    for line in (*result.verdict.objections, *result.verdict.remarks):
        out.print(f"  {line}", highlight=False)
