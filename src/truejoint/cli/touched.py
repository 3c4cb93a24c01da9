"""`truejoint calibrate` without joint sensors: by touches of a block, or shots of a tracker."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import truejoint
from truejoint.cli.console import command_line, out, progress, result_json, say
from truejoint.cli.inputs import Files, check_page_target
from truejoint.cli.rezero import say_left_out
from truejoint.cli.show import is_model
from truejoint.errors import CalibrationError
from truejoint.units import with_unit

if TYPE_CHECKING:
    from truejoint.tip import TouchReport


def _option(help: str, **more: Any) -> Any:  # noqa: A002  # as typer calls it
    return typer.Option(help=help, rich_help_panel="Without joint sensors", **more)


@dataclass(frozen=True)
class Seen:
    """What was touched or shot in place of truth in the recording, an option each."""

    touches: Annotated[
        Path | None,
        _option("Touches of a block (docs/touch.md), in place of truth.", metavar="FILE"),
    ] = None
    plate: Annotated[Path | None, _option("With --touches: plate file of the block.")] = None
    points: Annotated[
        Path | None,
        _option(
            "Single shots of a tracker at rest, t,x_mm,y_mm,z_mm, in place of truth.",
            metavar="FILE",
        ),
    ] = None
    registration: Annotated[
        Path | None,
        _option("With --points: what is known of the tracker (docs/tracker.md)."),
    ] = None
    touch_sd_mm: Annotated[
        float | None,
        _option(
            "How far off a touch rests or a shot is, per axis [mm]; default: 0.2 and 0.25.",
            min=1e-3,
        ),
    ] = None
    touch_report: Annotated[
        Path | None,
        _option("Page to write: errors before and after, and what was not seen.", metavar="HTML"),
    ] = None

    @property
    def is_given(self) -> bool:
        """Whether any of it was said."""
        return any(value is not None for value in vars(self).values())

    def check(self, recordings: Sequence[str], *, force: bool) -> None:
        """Refuse what does not go together or is there already, before anything is read."""
        if (self.touches is None) == (self.points is None) or len(recordings) != 1:
            raise CalibrationError(
                "give --touches and --plate, or --points, and the one recording of these rests"
            )
        if (self.touches is None) != (self.plate is None):
            raise CalibrationError("--touches and --plate belong together: give both, or neither")
        if self.points is None and self.registration is not None:
            raise CalibrationError("--registration is of a tracker: give it with --points")
        check_page_target(self.touch_report, force)


def calibrate_touched(
    recordings: Sequence[str],
    seen: Seen,
    prior: Path | None,
    output: Path,
    files: Files,
    *,
    force: bool,
    as_json: bool,
) -> None:
    """Calibrate by what was touched or shot, and say what that did not tell."""
    from truejoint.evaluation.report.touches import write_touch_report  # noqa: PLC0415  # NumPy

    seen.check(recordings, force=force)
    priors = [] if prior is None else prior_calibrations(prior)
    fit = _fitting(seen, priors)
    whole = files.one(recordings[0])
    with progress("Fitting joints and frame"):
        fitted, report = fit(whole)
    command = command_line()
    fitted = fitted.with_metadata(command=command)
    truejoint.write_calibration(fitted, output, overwrite=force)
    if seen.touch_report is not None:
        write_touch_report(fitted, report, seen.touch_report, command=command, overwrite=force)
    if as_json:
        result_json({"model": str(output), "metadata": fitted.metadata})
        return
    facts = fitted.metadata["touch"]
    say_left_out(report.fit, report.rests, facts["what"])
    near, sd = with_unit(report.left_out_error, "m"), with_unit(report.left_out_sd, "m")
    out.print(
        f"{output}: the tip is within {near} ± {sd} (RMS) in the {facts['frame']}'s frame, by "
        f"{facts['what']} left out in turn",
        soft_wrap=True,
    )
    for text in report.not_seen:
        out.print(f"  {text}", soft_wrap=True)


def prior_calibrations(prior: Path) -> list[truejoint.Calibration]:
    """Read the model file, or all those in a folder; raises CalibrationError if there are none."""
    if not prior.is_dir():
        return [truejoint.read_calibration(prior)]
    found = [path for path in sorted(prior.iterdir()) if is_model(path)]
    if not found:
        raise CalibrationError(f"{prior}: no model file is in this folder; `calibrate` writes them")
    for path in found:
        say(f"  prior: {path.name}")
    return [truejoint.read_calibration(path) for path in found]


def _fitting(
    seen: Seen, priors: Sequence[truejoint.Calibration]
) -> Callable[[truejoint.Recording], tuple[truejoint.Calibration, TouchReport]]:
    """Read what was touched or shot; gives what fits a recording to it."""
    from truejoint.tip.block import TOUCH_SD  # noqa: PLC0415  # NumPy
    from truejoint.tip.rests import SHOT_SD  # noqa: PLC0415

    tip = truejoint.tip
    sd = None if seen.touch_sd_mm is None else seen.touch_sd_mm / 1e3
    if seen.touches is not None and seen.plate is not None:
        made, block = tip.read_touches(seen.touches), tip.read_block(seen.plate)
        return lambda whole: tip.calibrate_by_touch(
            whole, made, block, touch_sd=sd or TOUCH_SD, priors=priors
        )
    shots = tip.read_shots(seen.points or Path())

    def fit(whole: truejoint.Recording) -> tuple[truejoint.Calibration, TouchReport]:
        stands = None
        if seen.registration is not None:
            stands = tip.read_registration(seen.registration, whole.robot)
        return tip.calibrate_by_points(whole, shots, stands, shot_sd=sd or SHOT_SD, priors=priors)

    return fit
