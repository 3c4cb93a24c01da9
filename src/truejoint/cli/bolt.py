"""`truejoint touch bolt`: find where a bolted block stands; what touches say of their fit."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import truejoint
from truejoint.cli import options
from truejoint.cli.console import out, result_json, say
from truejoint.cli.recording_options import Files
from truejoint.files import check_target
from truejoint.units import with_unit

if TYPE_CHECKING:
    from truejoint.tip.fit import TipFit


@dataclass(frozen=True)
class Touching:
    """Touches, and what the arm did meanwhile, an option each."""

    touches: Path
    touch_sd_mm: float = 0.2

    def read(
        self, model: Path, recording: str | None, files: Files
    ) -> tuple[truejoint.Calibration, truejoint.Recording, truejoint.tip.Touches]:
        """Read the model, the recording beside the touches unless one is named, the touches."""
        calibration, touches = (
            truejoint.read_calibration(model),
            truejoint.tip.read_touches(self.touches),
        )
        name = recording or str(self.touches.with_suffix(".parquet"))
        return calibration, files.one(name, model=calibration), touches


@options.takes(files=Files, touching=Touching)
def bolt(
    model: Path,
    recording: str | None = None,
    *,
    block: Path,
    touching: Touching,
    output: Path,
    force: bool = False,
    as_json: bool = False,
    files: Files,
) -> None:
    """Find where a bolted block stands, on the day of the full calibration."""
    check_target(output, overwrite=force)
    shape = truejoint.tip.read_block(block)
    calibration, whole, touches = touching.read(model, recording, files)
    sd = touching.touch_sd_mm / 1e3
    pose, fit = truejoint.tip.find_block(calibration, whole, touches, shape, touch_sd=sd)
    truejoint.tip.write_pose(pose, output, overwrite=force)
    facts = {
        "turn_sd": fit.sd[:3].tolist(), "shift_sd": fit.sd[3:6].tolist(), "scale": pose.scale,
        "scale_sd": pose.scale_sd, **touch_facts(fit, touches),
    }  # fmt: skip
    if as_json:
        result_json({"pose": str(output), **facts})
        return
    turn, shift = (
        with_unit(float(fit.sd[part].max()), unit)
        for part, unit in ((slice(0, 3), "rad"), (slice(3, 6), "m"))
    )
    out.print(f"{output}: {pose.title}, within {turn} and {shift} (one standard deviation)")
    if abs(pose.scale / shape.scale - 1.0) > 3.0 * pose.scale_sd:
        off = 100.0 * (pose.scale / shape.scale - 1.0)
        say(f"the print is {off:+.2f} % of what its file says: measure it, and enter measured_mm")
    say_left_out(fit, touches)


def touch_facts(fit: TipFit, touches: truejoint.tip.Touches) -> dict[str, Any]:
    """State how well touches fit, as plain values."""
    rms = (fit.residual[~fit.left_out] ** 2).sum(axis=1).mean() ** 0.5
    outliers = [touches.dimple[i] for i in fit.left_out.nonzero()[0]]
    return {"touches": len(touches), "left_out": outliers, "residual_rms": float(rms)}


def say_left_out(fit: TipFit, touches: truejoint.tip.Touches) -> None:
    """Print how well touches fit, and which were left out as outliers."""
    facts = touch_facts(fit, touches)
    out.print(f"{len(touches)} touches, {with_unit(facts['residual_rms'], 'm')} off (RMS)")
    for i in fit.left_out.nonzero()[0]:
        off = with_unit(float((fit.residual[i] ** 2).sum() ** 0.5), "m")
        say(
            f"left out: dimple {touches.dimple[i]} at {touches.t[i]:.1f} s, {off} off: badly "
            "seated, or another number?"
        )
