"""`truejoint bolt` and `truejoint rezero`: re-zero a calibration by touching a bolted block."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import truejoint
from truejoint.cli import options
from truejoint.cli.console import out, print_table, result_json, say
from truejoint.cli.inputs import Files, check_model_target, takes
from truejoint.files import check_target
from truejoint.units import with_unit

if TYPE_CHECKING:
    from truejoint.tip.fit import TipFit
    from truejoint.tip.rests import Touches


@dataclass(frozen=True)
class Touching:
    """What was touched, and what the arm did meanwhile."""

    touches: Annotated[
        Path,
        typer.Option(metavar="FILE", help="CSV file of touches, t,dimple, as `touch` writes it."),
    ]
    recording: Annotated[
        Path | None,
        typer.Option(
            help="What the arm did meanwhile; default: the .parquet file beside the touches."
        ),
    ] = None
    touch_sd_mm: options.TouchSd = 0.2

    def read(
        self, model: Path, files: Files
    ) -> tuple[truejoint.Calibration, truejoint.Recording, Touches]:
        """Read the model, the recording and the touches."""
        from truejoint.tip.files import read_touches  # noqa: PLC0415  # NumPy

        calibration, made = truejoint.read_calibration(model), read_touches(self.touches)
        name = str(self.recording or self.touches.with_suffix(".parquet"))
        return calibration, files.one(name, model=calibration), made

    @property
    def touch_sd(self) -> float:
        """How far off its dimple a tip rests [m]."""
        return self.touch_sd_mm / 1e3


@takes(files=Files, touching=Touching)
def bolt(
    model: options.Model,
    plate: Annotated[
        Path, typer.Option("--plate", help="Plate file of the block, as `plate` writes it.")
    ],
    output: Annotated[Path, typer.Option("--out", "-o", help="Pose file to write (.toml).")],
    force: options.Force = False,
    as_json: options.Json = False,
    *,
    files: Files,
    touching: Touching,
) -> None:
    """Find where a bolted block stands, on the day of the full calibration."""
    from truejoint.tip.files import read_block, write_pose  # noqa: PLC0415  # NumPy
    from truejoint.tip.touch import find_block  # noqa: PLC0415

    check_target(output, overwrite=force)
    block = read_block(plate)
    calibration, whole, made = touching.read(model, files)
    pose, found = find_block(calibration, whole, made, block, touch_sd=touching.touch_sd)
    write_pose(pose, output, overwrite=force)
    sd = found.sd
    facts = {
        "turn_sd": sd[:3].tolist(), "shift_sd": sd[3:6].tolist(), "scale": pose.scale,
        "scale_sd": pose.scale_sd, **touch_facts(found, made),
    }  # fmt: skip
    if as_json:
        result_json({"pose": str(output), **facts})
        return
    turn, shift = with_unit(float(sd[:3].max()), "rad"), with_unit(float(sd[3:6].max()), "m")
    out.print(f"{output}: {pose.title}, within {turn} and {shift} (one deviation)")
    if abs(pose.scale / block.scale - 1.0) > 3.0 * pose.scale_sd:
        off = 100.0 * (pose.scale / block.scale - 1.0)
        say(f"the print is {off:+.2f} % of what its file says: measure it, and enter measured_mm")
    say_left_out(found, made)


@takes(files=Files, touching=Touching)
def rezero(
    model: options.Model,
    bolted: Annotated[
        Path, typer.Option("--bolted", help="Pose of the block, as `bolt` writes it.")
    ],
    output: Annotated[Path, typer.Option("--out", "-o", help="Model file to write.")],
    force: options.Force = False,
    as_json: options.Json = False,
    *,
    files: Files,
    touching: Touching,
) -> None:
    """Re-zero a calibration by touching a bolted block: after a homing, or hours of work."""
    from truejoint.tip.files import read_pose  # noqa: PLC0415  # NumPy
    from truejoint.tip.touch import rezeroed_by_touch  # noqa: PLC0415

    check_model_target(output, force)
    pose = read_pose(bolted)
    calibration, whole, made = touching.read(model, files)
    again, found = rezeroed_by_touch(calibration, whole, made, pose, touch_sd=touching.touch_sd)
    truejoint.write_calibration(again, output, overwrite=force)
    facts = again.metadata["rezeroed"]
    if as_json:
        result_json({"model": str(output), **facts, **touch_facts(found, made)})
        return
    units = [calibration.units[f"measured/{joint}"] for joint in calibration.joints]
    rows = [
        (joint, with_unit(offset, unit), f"± {with_unit(sd, unit)}")
        for joint, unit, offset, sd in zip(
            calibration.joints, units, facts["offset"], facts["sd"], strict=True
        )
    ]
    print_table(("joint", "offset", "deviation"), rows, title=f"Zero of {calibration.title}, now")
    say_left_out(found, made)
    out.print(f"{output}: re-zeroed by {len(made)} touches of {pose.title}")


def touch_facts(found: TipFit, made: Touches) -> dict[str, Any]:
    """Say what a fit to touches says of itself, as plain values."""
    rms = (found.residual[~found.left_out] ** 2).sum(axis=1).mean() ** 0.5
    left = [made.dimple[i] for i in found.left_out.nonzero()[0]]
    return {"touches": len(made), "left_out": left, "residual_rms": float(rms)}


def say_left_out(found: TipFit, made: Touches, what: str = "touches") -> None:
    """Print how well touches, or `what` they are, fit, and say which were left out."""
    facts = touch_facts(found, made)
    out.print(f"{len(made)} {what}, {with_unit(facts['residual_rms'], 'm')} off (RMS)")
    for i in found.left_out.nonzero()[0]:
        off = with_unit(float((found.residual[i] ** 2).sum() ** 0.5), "m")
        say(f"left out: {made.kind} {made.dimple[i]} at {made.t[i]:.1f} s, {off} off: {made.doubt}")
