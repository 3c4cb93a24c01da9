"""`truejoint check`: whether a calibration still holds, by a brief truth or another calibration."""

from __future__ import annotations

from pathlib import Path

import typer

import truejoint
from truejoint.cli import options
from truejoint.cli.check_options import CHECK_FAILED
from truejoint.cli.console import out, print_table, progress, result_json, say
from truejoint.cli.recording_options import Files, takes_files
from truejoint.units import with_unit

_ADVICE = {
    "shift": "efforts no longer fit the positions: was a load hung on, or a cable changed?",
    "friction": "friction has changed",
    "range": "many samples lie far outside what was trained",
    "innovation": "the filter's innovations are larger than it states",
    "work": "the arm has worked for long since it was last compared with the truth",
}


_COLOURS = {True: "green", False: "red", None: "yellow"}


@takes_files
def check(
    model: Path,
    recording: str,
    against: Path | None = None,
    level_percent: float | None = None,
    part: str | None = None,
    as_json: bool = False,
    *,
    files: Files,
) -> None:
    """Say how far off a calibration is now; exit code 1 when its interval no longer holds."""
    from truejoint.calibration.interval import LEVEL

    level = options.share(level_percent)
    calibration = truejoint.read_calibration(model)
    other = None if against is None else truejoint.read_calibration(against)
    if level is not None or calibration.interval is not None:
        calibration.required_interval().index(LEVEL if level is None else level)
    loaded = files.one(recording, part=part, model=calibration)
    if other is not None:
        with progress("Comparing the two calibrations"):
            agreement = truejoint.calibration.compare_calibrations(
                calibration, other, loaded, LEVEL if level is None else level
            )
        _report_agreement(calibration, agreement, as_json)
        holds: bool | None = bool(agreement.consistent.all())
    else:
        with progress("Comparing with the truth"):
            result = truejoint.runtime.check_calibration(calibration, loaded, level)
        _report_check(calibration, result, as_json)
        holds = result.holds
    if holds is False:
        raise typer.Exit(CHECK_FAILED)


def _report_check(
    calibration: truejoint.Calibration,
    result: truejoint.runtime.CalibrationCheck,
    as_json: bool,
) -> None:
    if as_json:
        result_json(result.to_dict())
        return
    rows = []
    for joint in result.joints:
        values = (joint.rmse, joint.offset, joint.offset_sd, joint.rezeroed_rmse, joint.half_width)
        rmse, offset, offset_sd, residual, half_width = (with_unit(v, joint.unit) for v in values)
        inside = "-" if joint.holds is None else f"{100 * joint.inside:.0f} %"
        rows.append(
            (joint.joint, rmse, f"{offset} ± {offset_sd}", residual, f"± {half_width}", inside)
        )
    header = ("joint", "error RMS", "offset", "left after re-zeroing", "interval", "inside")
    print_table(header, rows, title=f"{calibration.estimator} of {calibration.title}, now")
    out.print(f"{result.rows} readings of the truth over {result.duration:.1f} s")
    if calibration.interval is not None:
        out.print(f"The interval is {calibration.interval.meaning}")
    out.print(_verdict(result), style=_COLOURS[result.holds])
    for name in result.to_dict()["reasons"]:
        say(f"monitor: {_ADVICE[name]}")


def _verdict(result: truejoint.runtime.CalibrationCheck) -> str:
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
        f"The {stated} no longer holds in {worst}: most readings lie outside it. Re-zero it "
        "(`truejoint rezero`), or calibrate anew where much is left after re-zeroing."
    )


def _report_agreement(
    calibration: truejoint.Calibration, agreement: truejoint.calibration.Agreement, as_json: bool
) -> None:
    names = ("difference", "allowed", "inside", "consistent")
    units = [calibration.units[f"measured/{joint}"] for joint in calibration.joints]
    values = [getattr(agreement, name).tolist() for name in names]
    rows = list(zip(calibration.joints, units, *values, strict=True))
    if as_json:
        joints = [dict(zip(("joint", "unit", *names), row, strict=True)) for row in rows]
        result_json({"level": agreement.level, "joints": joints})
        return
    lines = [
        (joint, with_unit(off, unit), f"± {with_unit(allowed, unit)}", f"{100 * inside:.0f} %")
        for joint, unit, off, allowed, inside, _ in rows
    ]
    header = ("joint", "RMS", "both intervals, RMS", "inside")
    print_table(header, lines, title="Difference of the two calibrations")
    good, more = bool(agreement.consistent.all()), "at least one interval is too narrow here"
    verdicts = {True: "no more than both state.", False: f"more than both state: {more}."}
    out.print(f"They differ by {verdicts[good]}", style=_COLOURS[good])
