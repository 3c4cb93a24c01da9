"""`truejoint rezero`: re-zero a calibration by truth, by touches or by its motors."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import truejoint
from truejoint import schema
from truejoint.cli.console import out, print_table, progress
from truejoint.cli.driven_arm import BriefTruth
from truejoint.cli.options import Result
from truejoint.cli.recording_options import Files, NewModel
from truejoint.cli.touch import report_touches
from truejoint.errors import CalibrationError
from truejoint.units import with_unit


@dataclass(frozen=True)
class Source:
    """Where the zero comes from, an option each; the truth in a recording by default."""

    rezero_s: float | None = None
    touches: Path | None = None
    bolted: Path | None = None
    touch_sd_mm: float | None = None
    motor: Path | None = None
    potentiometers: bool = False


def rezero(
    model: Path,
    new: NewModel,
    source: Source,
    files: Files,
    live: BriefTruth,
    recording: str | None = None,
) -> Result:
    """Re-zero a calibration after a homing or hours of work, and write it.

    One of five sources gives the zero: truth in RECORDING, truth of the arm on ROS's topics
    (--ros, --truth), touches of a bolted block (--touches, --bolted), a jaw's motor (--motor), or
    potentiometers, if RECORDING has them and no truth, or with --potentiometers.
    """
    from truejoint.tip.block import TOUCH_SD

    calibration, tip = truejoint.read_calibration(model), truejoint.tip
    if recording is None and source.touches is None and live.ros is None:
        raise CalibrationError("name the recording to re-zero from, or give --touches or --ros")
    beside = "" if source.touches is None else str(source.touches.with_suffix(".parquet"))
    name = recording or live.truth or beside or "ROS's topics"
    if source.touches is not None and source.bolted is not None:
        pose, made = tip.read_pose(source.bolted), tip.read_touches(source.touches)
        sd = TOUCH_SD if source.touch_sd_mm is None else source.touch_sd_mm / 1e3
        loaded = files.one(name, model=calibration)
        zero, fit = tip.zero_by_touch(calibration, loaded, made, pose, touch_sd=sd)
        result = _write(calibration, zero, new, report_touches(fit, made))
        out.print(f"{new.output}: re-zeroed by {len(made)} touches of {pose.title}")
        move = with_unit(zero.details["unnoticed_move"], "m")
        out.print(
            f"The deviations hold a move of the block by {move} since its pose was found, which "
            "these touches do not show; references do (docs/tracker.md)",
            soft_wrap=True,
        )
        return result
    loaded = live.read(name, files, calibration, potentiometers=source.potentiometers)
    if source.motor is not None:
        by = None if source.motor == model else truejoint.read_calibration(source.motor)
        with progress("Comparing both sides of the cable"):
            zero, by_motor = truejoint.calibration.motor_zero(calibration, loaded, by)
        new.write(calibration.at(zero))
        shift, deviation = (with_unit(v, "m") for v in (by_motor.shift, by_motor.deviation))
        out.print(f"x2 reads too much by {shift} ± {deviation}")
        done = "taken off" if by_motor.correction else "left alone: it is within its own deviation"
        out.print(f"{new.output}: {done}")
        facts = {**vars(by_motor), "correction": by_motor.correction}
        return Result({"model": str(new.output), **facts})
    has_truth = {*calibration.joints} <= {*loaded.joints_of("truth")}
    if source.potentiometers or (loaded.joints_of("pot") and not has_truth):
        zero = truejoint.calibration.potentiometer_zero(calibration, loaded)
        result = _write(calibration, zero, new, {})
        deviations = zip(calibration.joints, zero.deviation, strict=True)
        if still := [joint for joint, sd in deviations if math.isnan(sd)]:
            out.print(f"{', '.join(still)}: no potentiometer, or hardly moved; the zero stays")
        out.print(f"{new.output}: re-zeroed by the potentiometers in {name}")
        return result
    duration = math.inf if source.rezero_s is None else source.rezero_s
    zero = truejoint.calibration.find_zero(calibration, loaded, duration)
    result = _write(calibration, zero, new, {})
    out.print(f"{new.output}: re-zeroed by the truth of {name}")
    return result


def _write(
    calibration: "truejoint.Calibration",
    zero: "truejoint.calibration.Zero",
    new: NewModel,
    facts: dict[str, Any],
) -> Result:
    new.write(calibration.at(zero))
    units = [calibration.units[f"measured/{joint}"] for joint in calibration.joints]
    offsets = zip(calibration.joints, units, zero.shift, zero.deviation, strict=True)
    rows = [
        (joint, with_unit(offset, unit), "-" if math.isnan(sd) else f"± {with_unit(sd, unit)}")
        for joint, unit, offset, sd in offsets
    ]
    print_table(("joint", "offset", "deviation"), rows, title=f"Zero of {calibration.title}, now")
    values = {"model": str(new.output), **schema.plain(zero), "sd": zero.deviation, **facts}
    return Result(values)
