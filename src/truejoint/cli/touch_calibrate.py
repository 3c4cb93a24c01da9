"""`truejoint touch calibrate`: by touches of a block, or single shots of a tracker at rest."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import truejoint
from truejoint.cli import options
from truejoint.cli.bolt import say_left_out
from truejoint.cli.console import command_line, out, progress, result_json, say
from truejoint.cli.recording_options import Files, check_model_target, check_page_target
from truejoint.cli.show import is_model
from truejoint.errors import CalibrationError
from truejoint.units import with_unit


@dataclass(frozen=True)
class Sightings:
    """What was touched or shot, an option each."""

    touches: Path | None = None
    block: Path | None = None
    points: Path | None = None
    touch_sd_mm: float | None = None

    def __post_init__(self) -> None:
        if (self.touches is None) == (self.points is None):
            raise CalibrationError("give --touches with --block, or --points; one of the two")
        if (self.touches is None) != (self.block is None):
            raise CalibrationError("--touches and --block belong together: give both, or neither")


@options.takes(sightings=Sightings, files=Files)
def calibrate(
    recording: str,
    output: Path,
    *,
    sightings: Sightings,
    prior: Path | None = None,
    report: Path | None = None,
    files: Files,
    force: bool = False,
    as_json: bool = False,
) -> None:
    """Calibrate an arm without joint sensors, and say what the touches could not determine."""
    from truejoint.evaluation.report.touch_page import write_touch_report

    check_model_target(output, force)
    check_page_target(report, force)
    fit = _fitting(sightings, [] if prior is None else prior_calibrations(prior))
    whole = files.one(recording)
    with progress("Fitting joints and frame"):
        fitted, touch_report = fit(whole)
    command = command_line()
    fitted = fitted.with_metadata(command=command)
    truejoint.write_calibration(fitted, output, overwrite=force)
    if report is not None:
        write_touch_report(fitted, touch_report, report, command=command, overwrite=force)
    if as_json:
        result_json({"model": str(output), "metadata": fitted.metadata})
        return
    say_left_out(touch_report.fit, touch_report.touches)
    near = with_unit(touch_report.left_out_error, "m")
    sd = with_unit(touch_report.left_out_sd, "m")
    out.print(
        f"{output}: the tip is within {near} ± {sd} (RMS) in the block's frame, by touches "
        "left out in turn",
        soft_wrap=True,
    )
    for text in touch_report.not_seen:
        out.print(f"  {text}", soft_wrap=True)


def prior_calibrations(prior: Path) -> list[truejoint.Calibration]:
    """Read the model file, or all those in a folder; raises CalibrationError if there are none."""
    if not prior.is_dir():
        return [truejoint.read_calibration(prior)]
    paths = [path for path in sorted(prior.iterdir()) if is_model(path)]
    if not paths:
        raise CalibrationError(f"{prior}: no model file is in this folder; `calibrate` writes them")
    for path in paths:
        say(f"  prior: {path.name}")
    return [truejoint.read_calibration(path) for path in paths]


def _fitting(
    sightings: Sightings, priors: Sequence[truejoint.Calibration]
) -> Callable[[truejoint.Recording], tuple[truejoint.Calibration, truejoint.tip.TouchReport]]:
    """Read what was touched or shot, and give what fits a recording to it."""
    from truejoint.tip.block import TOUCH_SD
    from truejoint.tip.files import SHOT_SD

    tip = truejoint.tip
    if sightings.touches is not None and sightings.block is not None:
        touches, block = tip.read_touches(sightings.touches), tip.read_block(sightings.block)
        default = TOUCH_SD
    else:
        (touches, block), default = tip.read_shots(sightings.points or Path()), SHOT_SD
    sd = default if sightings.touch_sd_mm is None else sightings.touch_sd_mm / 1e3
    return lambda whole: tip.calibrate_by_touch(whole, touches, block, touch_sd=sd, priors=priors)
