"""`truejoint check`: whether a calibration still holds, by a brief truth or another calibration."""

from __future__ import annotations

from pathlib import Path

import truejoint
from truejoint.cli import options
from truejoint.cli.console import out, print_table, progress, say
from truejoint.cli.options import Result
from truejoint.cli.recording_options import Files
from truejoint.units import with_unit

_ADVICE = {
    "shift": "efforts no longer fit the positions: was a load hung on, or a cable changed?",
    "friction": "friction has changed",
    "range": "many samples lie far outside what was trained",
    "innovation": "the filter's innovations are larger than it states",
    "work": "the arm has worked for long since it was last compared with the truth",
}
_COLOURS = {True: "green", False: "red", None: "yellow"}


def check(
    model: Path,
    recording: str,
    files: Files,
    against: Path | None = None,
    level_percent: float | None = None,
    part: str | None = None,
) -> Result:
    """Say how far off a calibration is now; exit code 1 when its interval no longer holds."""
    from truejoint.calibration.interval import LEVEL

    stated = options.share(level_percent)
    level = LEVEL if stated is None else stated
    calibration = truejoint.read_calibration(model)
    other = None if against is None else truejoint.read_calibration(against)
    if stated is not None or calibration.interval is not None:
        calibration.required_interval().index(level)
    loaded = files.one(recording, part=part, model=calibration)
    if other is None:
        with progress("Comparing with the truth"):
            result = truejoint.runtime.check_calibration(calibration, loaded, stated)
        return _report_check(calibration, result)
    with progress("Comparing the two calibrations"):
        agreement = truejoint.calibration.compare_calibrations(calibration, other, loaded, level)
    return _report_agreement(calibration, agreement)


def _report_check(
    calibration: truejoint.Calibration, result: truejoint.runtime.CalibrationCheck
) -> Result:
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
    facts = result.to_dict()
    for name in facts["reasons"]:
        say(f"monitor: {_ADVICE[name]}")
    return Result(facts, passed=result.holds is not False)


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
    calibration: truejoint.Calibration, agreement: truejoint.calibration.Agreement
) -> Result:
    names = ("difference", "allowed", "inside", "consistent")
    units = [calibration.units[f"measured/{joint}"] for joint in calibration.joints]
    columns = [getattr(agreement, name).tolist() for name in names]
    rows = list(zip(calibration.joints, units, *columns, strict=True))
    lines = [
        (joint, with_unit(off, unit), f"± {with_unit(allowed, unit)}", f"{100 * inside:.0f} %")
        for joint, unit, off, allowed, inside, _ in rows
    ]
    header = ("joint", "RMS", "both intervals, RMS", "inside")
    print_table(header, lines, title="Difference of the two calibrations")
    good, more = bool(agreement.consistent.all()), "at least one interval is too narrow here"
    verdict = "no more than both state." if good else f"more than both state: {more}."
    out.print(f"They differ by {verdict}", style=_COLOURS[good])
    joints = [dict(zip(("joint", "unit", *names), row, strict=True)) for row in rows]
    return Result({"level": agreement.level, "joints": joints}, passed=good)
