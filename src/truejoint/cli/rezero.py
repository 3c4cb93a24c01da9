"""`truejoint bolt` and `truejoint rezero`: re-zero a calibration by touching a bolted block."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import truejoint
from truejoint.cli import options
from truejoint.cli.console import (
    command_line,
    out,
    print_table,
    progress,
    result_json,
    say,
)
from truejoint.cli.inputs import Files, check_model_target, takes_files
from truejoint.errors import CalibrationError
from truejoint.files import check_target
from truejoint.units import with_unit

if TYPE_CHECKING:
    from truejoint.calibration.tip_rows import TipFit
    from truejoint.calibration.touches import Touches

TouchesFile = Annotated[
    Path,
    typer.Option(
        "--touches", metavar="FILE", help="CSV file of touches, t,dimple, as `touch` writes it."
    ),
]
RecordingFile = Annotated[
    Path | None,
    typer.Option(
        "--recording",
        help="What the arm did meanwhile; default: the .parquet file beside the touches.",
    ),
]
TouchSd = Annotated[
    float,
    typer.Option("--touch-sd-mm", min=1e-3, help="How far off its dimple a tip rests [mm]."),
]


@takes_files
def bolt(
    model: options.Model,
    touches: TouchesFile,
    plate: Annotated[
        Path, typer.Option("--plate", help="Plate file of the block, as `plate` writes it.")
    ],
    output: Annotated[Path, typer.Option("--out", "-o", help="Pose file to write (.toml).")],
    recording: RecordingFile = None,
    touch_sd_mm: TouchSd = 0.2,
    force: options.Force = False,
    as_json: options.Json = False,
    *,
    files: Files,
) -> None:
    """Find where a bolted block stands, on the day of the full calibration."""
    from truejoint.calibration.plate import read_plate, write_pose  # noqa: PLC0415  # NumPy
    from truejoint.calibration.touches import find_block  # noqa: PLC0415

    check_target(output, overwrite=force)
    block = read_plate(plate)
    calibration, whole, made = _read(model, touches, recording, files)
    pose, found = find_block(calibration, whole, made, block, touch_sd=touch_sd_mm / 1e3)
    write_pose(pose, output, overwrite=force)
    sd = found.sd
    facts = {
        "turn_sd": sd[:3].tolist(), "shift_sd": sd[3:6].tolist(), "scale": pose.scale,
        "scale_sd": pose.scale_sd, **_facts(found, made),
    }  # fmt: skip
    if as_json:
        result_json({"pose": str(output), **facts})
        return
    turn, shift = with_unit(float(sd[:3].max()), "rad"), with_unit(float(sd[3:6].max()), "m")
    out.print(f"{output}: {pose.title}, within {turn} and {shift} (one deviation)")
    if abs(pose.scale / block.scale - 1.0) > 3.0 * pose.scale_sd:
        off = 100.0 * (pose.scale / block.scale - 1.0)
        say(f"the print is {off:+.2f} % of what its file says: measure it, and enter measured_mm")
    _say_left_out(found, made)


@takes_files
def rezero(
    model: options.Model,
    touches: TouchesFile,
    bolted: Annotated[
        Path, typer.Option("--bolted", help="Pose of the block, as `bolt` writes it.")
    ],
    output: Annotated[Path, typer.Option("--out", "-o", help="Model file to write.")],
    recording: RecordingFile = None,
    touch_sd_mm: TouchSd = 0.2,
    force: options.Force = False,
    as_json: options.Json = False,
    *,
    files: Files,
) -> None:
    """Re-zero a calibration by touching a bolted block: after a homing, or hours of work."""
    from truejoint.calibration.plate import read_pose  # noqa: PLC0415  # NumPy
    from truejoint.calibration.touches import rezeroed_by_touch  # noqa: PLC0415

    check_model_target(output, force)
    pose = read_pose(bolted)
    calibration, whole, made = _read(model, touches, recording, files)
    again, found = rezeroed_by_touch(calibration, whole, made, pose, touch_sd=touch_sd_mm / 1e3)
    truejoint.write_calibration(again, output, overwrite=force)
    facts = again.metadata["rezeroed"]
    if as_json:
        result_json({"model": str(output), **facts, **_facts(found, made)})
        return
    units = [calibration.units[f"measured/{joint}"] for joint in calibration.joints]
    rows = [
        (joint, with_unit(offset, unit), f"± {with_unit(sd, unit)}")
        for joint, unit, offset, sd in zip(
            calibration.joints, units, facts["offset"], facts["sd"], strict=True
        )
    ]
    print_table(("joint", "offset", "deviation"), rows, title=f"Zero of {calibration.title}, now")
    _say_left_out(found, made)
    out.print(f"{output}: re-zeroed by {len(made)} touches of {pose.title}")


def calibrate_touched(
    recordings: Sequence[str],
    touches: Path | None,
    plate: Path | None,
    output: Path,
    files: Files,
    is_chosen: bool,
    force: bool,
    as_json: bool,
) -> None:
    """Calibrate by touches alone, and say what they did not see.

    Refused where anything `is_chosen` that they decide themselves: estimator, features, truth.
    """
    from truejoint.calibration.plate import read_plate  # noqa: PLC0415  # NumPy
    from truejoint.calibration.touches import read_touches  # noqa: PLC0415

    if is_chosen:
        raise CalibrationError("--touches says what is fitted and how; leave out other options")
    if touches is None or plate is None or len(recordings) != 1:
        raise CalibrationError("give --touches, --plate and the one recording of these touches")
    block, made = read_plate(plate), read_touches(touches)
    whole = files.one(recordings[0])
    with progress("Fitting joints and block"):
        fitted, report = truejoint.calibration.calibrate_by_touch(whole, made, block)
    fitted = fitted.with_metadata(command=command_line())
    truejoint.write_calibration(fitted, output, overwrite=force)
    if as_json:
        result_json({"model": str(output), "metadata": fitted.metadata})
        return
    _say_left_out(report.fit, made)
    scale = report.fit.state.scale
    if abs(scale / block.scale - 1.0) > 3.0 * report.fit.sd[-1]:
        say(f"the print is {100 * (scale / block.scale - 1):+.2f} % of what its file says")
    out.print(
        f"{output}: the tip is within {with_unit(report.left_out_error, 'm')} (RMS) in the block's "
        "frame, by touches left out in turn"
    )
    for text in report.not_seen:
        out.print(f"  {text}")


def _read(
    model: Path, touches: Path, recording: Path | None, files: Files
) -> tuple[truejoint.Calibration, truejoint.Recording, Touches]:
    from truejoint.calibration.touches import read_touches  # noqa: PLC0415  # NumPy

    calibration, made = truejoint.read_calibration(model), read_touches(touches)
    name = str(recording or touches.with_suffix(".parquet"))
    return calibration, files.one(name, model=calibration), made


def _facts(found: TipFit, made: Touches) -> dict[str, Any]:
    """Say what a fit to touches says of itself, as plain values."""
    rms = (found.residual[~found.left_out] ** 2).sum(axis=1).mean() ** 0.5
    left = [made.dimple[i] for i in found.left_out.nonzero()[0]]
    return {"touches": len(made), "left_out": left, "residual_rms": float(rms)}


def _say_left_out(found: TipFit, made: Touches) -> None:
    facts = _facts(found, made)
    out.print(f"{len(made)} touches, {with_unit(facts['residual_rms'], 'm')} off (RMS)")
    for i in found.left_out.nonzero()[0]:
        off = with_unit(float((found.residual[i] ** 2).sum() ** 0.5), "m")
        say(f"left out: dimple {made.dimple[i]} at {made.t[i]:.1f} s, {off} off: badly seated, or "
            "another number?")  # fmt: skip
