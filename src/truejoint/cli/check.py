"""`truejoint check`: whether a calibration still holds, by a brief truth or another calibration."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from truejoint.calibration import Calibration, CrossCheck, cross_check, read_calibration, rezeroed
from truejoint.cli.console import out, progress, result_json, say
from truejoint.cli.evaluate import CHECK_FAILED
from truejoint.cli.inputs import load_recordings
from truejoint.cli.options import Arm, Columns, Force, Format, Json, Part
from truejoint.errors import ModelFileError, RecordingError
from truejoint.runtime import CalibrationCheck, check_calibration
from truejoint.units import display_unit

_ADVICE = {
    "shift": "efforts no longer fit the positions: was a load hung on, or a cable changed?",
    "friction": "friction has changed",
    "range": "many samples lie far outside what was trained",
    "innovation": "the filter's innovations are larger than it states",
    "work": "the arm has worked for long since it was last compared with the truth",
}


def check(
    model: Annotated[Path, typer.Argument(help="Model file, from `truejoint calibrate`.")],
    recording: Annotated[
        str,
        typer.Argument(
            help="Recording of the arm as it is now. A few readings of the truth do: one short "
            "motion, a touched stop, a marker seen now and then."
        ),
    ],
    rezero: Annotated[
        Path | None,
        typer.Option(help="Write the model again with its offset moved to this truth."),
    ] = None,
    against: Annotated[
        Path | None,
        typer.Option(
            help="Compare with a second, independent calibration instead; the recording then "
            "needs no truth."
        ),
    ] = None,
    level_percent: Annotated[
        float, typer.Option("--level", help="Which of the stated intervals to judge by [%].")
    ] = 90.0,
    reader: Format = None,
    columns: Columns = None,
    robot: Annotated[str | None, typer.Option("--robot", help="For plain CSV files.")] = None,
    arm: Arm = "",
    part: Part = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Say how far off a calibration is now; exit code 1 when its interval no longer holds."""
    if rezero is not None and rezero.exists() and not force:
        raise ModelFileError(f"{rezero}: is there already; choose another --rezero, or --force")
    if rezero is not None and against is not None:
        raise RecordingError("--rezero needs a truth, --against has none; give one of the two")
    calibration = read_calibration(model)
    context = {"reader": reader, "columns": columns, "robot": robot, "arm": arm}
    loaded = load_recordings([recording], part=part, **context)  # type: ignore[arg-type]
    if len(loaded) != 1:
        raise RecordingError(f"{recording}: {len(loaded)} recordings; check takes one at a time")
    level = level_percent / 100.0
    if against is not None:
        other = read_calibration(against)
        with progress("Comparing the two calibrations"):
            agreement = cross_check(calibration, other, loaded[0], level)
        _report_agreement(calibration, agreement, as_json)
        failed = not agreement.consistent.all()
    else:
        with progress("Comparing with the truth"):
            result = check_calibration(calibration, loaded[0], level)
        if rezero is not None:
            rezeroed(calibration, loaded[0]).save(rezero, overwrite=force)
        _report_check(calibration, result, rezero, as_json)
        failed = result.holds is False
    if failed:
        raise typer.Exit(CHECK_FAILED)


def _report_check(
    calibration: Calibration, result: CalibrationCheck, written: Path | None, as_json: bool
) -> None:
    if as_json:
        result_json({**result.to_dict(), "rezeroed": None if written is None else str(written)})
        return
    table = Table(title=f"{calibration.estimator} of {calibration.title}, now")
    for name in ("joint", "error RMS", "offset", "left after re-zeroing", "interval", "inside"):
        table.add_column(name, justify="left" if name == "joint" else "right")
    for joint in result.joints:
        shown = display_unit(joint.unit)

        def length(value: float, scale: float = shown.scale) -> str:
            return "-" if math.isnan(value) else f"{value * scale:.3f}"

        table.add_row(
            f"{joint.joint} [{shown.name}]",
            length(joint.rmse),
            f"{joint.offset * shown.scale:+.3f} ± {length(joint.offset_sd)}",
            length(joint.left),
            f"± {length(joint.half_width)}",
            "-" if joint.holds is None else f"{100 * joint.inside:.0f} %",
        )
    out.print(table)
    out.print(f"{result.rows} readings of the truth over {result.duration:.1f} s", highlight=False)
    if calibration.interval is not None:
        out.print(f"The interval is {calibration.interval.meaning}", highlight=False)
    out.print(_verdict(result), style=_COLOURS[result.holds], highlight=False)
    if result.reasons:
        for name in result.to_dict()["reasons"]:
            say(f"monitor: {_ADVICE[name]}")
    if written is not None:
        out.print(f"{written}: re-zeroed to this truth", highlight=False)


_COLOURS = {True: "green", False: "red", None: "yellow"}


def _verdict(result: CalibrationCheck) -> str:
    stated = f"{100 * result.level:g} % interval"
    if result.holds is None:
        return (
            "No verdict: the model states no interval. Make one with "
            "`truejoint calibrate ... --interval RECORDING`."
        )
    if result.holds:
        return f"The {stated} holds: most readings lie inside it in every joint."
    worst = ", ".join(joint.joint for joint in result.joints if joint.holds is False)
    return (
        f"The {stated} no longer holds in {worst}: most readings lie outside it. Re-zero "
        "(--rezero), or calibrate anew where much is left after re-zeroing."
    )


def _report_agreement(calibration: Calibration, found: CrossCheck, as_json: bool) -> None:
    rows: list[dict[str, Any]] = [
        {
            "joint": joint,
            "unit": calibration.units[f"measured/{joint}"],
            "difference": float(found.difference[k]),
            "allowed": float(found.allowed[k]),
            "inside": float(found.inside[k]),
            "consistent": bool(found.consistent[k]),
        }
        for k, joint in enumerate(calibration.joints)
    ]
    if as_json:
        result_json({"level": found.level, "joints": rows})
        return
    table = Table(title="Difference of the two calibrations")
    for name in ("joint", "RMS", "both intervals, RMS", "inside"):
        table.add_column(name, justify="left" if name == "joint" else "right")
    for row in rows:
        shown = display_unit(row["unit"])
        table.add_row(
            f"{row['joint']} [{shown.name}]",
            f"{row['difference'] * shown.scale:.3f}",
            f"± {row['allowed'] * shown.scale:.3f}",
            f"{100 * row['inside']:.0f} %",
        )
    out.print(table)
    good = bool(found.consistent.all())
    out.print(
        "They differ by no more than both state."
        if good
        else "They differ by more than both state: at least one interval is too narrow here.",
        style=_COLOURS[good],
        highlight=False,
    )
