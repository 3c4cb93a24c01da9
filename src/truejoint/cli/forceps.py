"""`truejoint forceps`: what only a cable-driven jaw needs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import truejoint
from truejoint.cli import options
from truejoint.cli.console import out, progress, result_json
from truejoint.cli.inputs import Files, check_model_target, takes_files
from truejoint.units import with_unit

app = typer.Typer(help="Weights on a cable-driven jaw, and its encoders' zeros.")

_Output = Annotated[Path, typer.Option("--out", "-o", help="Model file to write.")]


@app.command(
    "stiffness",
    epilog="Example: `truejoint forceps stiffness jaw.safetensors 200g_*.parquet --arm-mm 13.5 "
    "-o jaw_loads.safetensors`",
)
@takes_files
def stiffness(
    model: options.Model,
    recordings: options.Recordings,
    output: _Output,
    arm_mm: Annotated[float, typer.Option(help="Lever of the weights at the jaw [mm].")],
    last_seconds: Annotated[
        float, typer.Option(help="For how long each weight hangs freely, at the end [s].")
    ] = 5.0,
    part: options.Part = None,
    force: options.Force = False,
    as_json: options.Json = False,
    *,
    files: Files,
) -> None:
    """Find the drive cable's stiffness by weights hung on the jaw, one or more each way.

    The model, of `ukf_friction`, then tells loads that are right in size.
    """
    check_model_target(output, force)
    calibration = truejoint.read_calibration(model)
    loaded = files.find(recordings, part=part, model=calibration)()
    with progress("Weighing"):
        known, found = truejoint.calibration.weighed(
            calibration, loaded, arm_mm / 1e3, last_seconds
        )
    truejoint.write_calibration(known, output, overwrite=force)
    if as_json:
        result_json({"out": str(output), **vars(found)})
        return
    out.print(
        f"K_d = {found.drive_stiffness / 1e3:.2f} ± {found.deviation / 1e3:.2f} kN/m, growing by "
        f"{found.growth:.0f} N/m per N of tension"
    )
    friction = 2e3 * known.model.jaw_friction
    out.print(f"Up to {friction:.1f} mNm against the last motion may stay hidden in friction")
    out.print(f"{output}: the model with this stiffness")


@app.command(
    "zero",
    epilog="Example: `truejoint forceps zero jaw.safetensors cycle.parquet -o today.safetensors`",
)
@takes_files
def zero(
    model: options.Model,
    recording: Annotated[
        str,
        typer.Argument(
            metavar="RECORDING", help="Unloaded whole cycles about zero, after today's homing."
        ),
    ],
    output: _Output,
    by: Annotated[
        Path | None,
        typer.Option(help="Model of ukf_friction, made of the same motion, where MODEL is none."),
    ] = None,
    part: options.Part = None,
    force: options.Force = False,
    as_json: options.Json = False,
    *,
    files: Files,
) -> None:
    """Find the reset encoder's zero after a homing, with no sensor at the jaw.

    A shift that is within what it may be off by is left alone.
    """
    check_model_target(output, force)
    calibration = truejoint.read_calibration(model)
    other = None if by is None else truejoint.read_calibration(by)
    cycles = files.one(recording, part=part, model=calibration)
    with progress("Comparing both sides of the cable"):
        today, found = truejoint.calibration.encoder_rezeroed(calibration, cycles, other)
    truejoint.write_calibration(today, output, overwrite=force)
    if as_json:
        result_json({"out": str(output), **vars(found), "correction": found.correction})
        return
    sizes = (with_unit(value, "m") for value in (found.shift, found.deviation))
    out.print(f"x2 reads too much by {' ± '.join(sizes)}")
    done = "taken off" if found.correction else "left alone: it is within what it may be off by"
    out.print(f"{output}: {done}")
