"""`truejoint plate`: a block with dimples to print and touch, sized for a robot."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

import truejoint
from truejoint.cli import complete, options
from truejoint.cli.console import out, result_json, say
from truejoint.errors import CalibrationError
from truejoint.files import write_all_atomically


def plate(
    robot: Annotated[
        str,
        typer.Argument(
            metavar="ROBOT", help="Robot model, or a robot file.", autocompletion=complete.robots
        ),
    ],
    output: Annotated[
        Path, typer.Option("--out", "-o", help="Folder for plate.stl, plate.svg and plate.toml.")
    ] = Path(),
    arm: options.Arm = "",
    force: options.Force = False,
    as_json: options.Json = False,
) -> None:
    """Design a block of stairs to print: its shape, a drawing with numbers, and its points."""
    from truejoint.tip.block_shape import block_stl, block_svg, design_block  # noqa: PLC0415
    from truejoint.tip.files import block_text  # noqa: PLC0415  # NumPy

    shape = design_block(truejoint.get_robot(robot, arm))
    made = shape.block()
    output.mkdir(parents=True, exist_ok=True)
    files = {
        output / "plate.stl": partial(Path.write_bytes, data=block_stl(shape)),
        output / "plate.svg": partial(Path.write_text, data=block_svg(shape), encoding="utf-8"),
        output / "plate.toml": partial(Path.write_text, data=block_text(made), encoding="utf-8"),
    }
    write_all_atomically(files, overwrite=force, error=CalibrationError)
    reached, cells = int(shape.reached.sum()), shape.level.size
    if as_json:
        places = {"rotation": shape.rotation.tolist(), "translation": shape.translation.tolist()}
        result_json({"files": [str(path) for path in files], "dimples": reached, **places})
        return
    size = " x ".join(f"{1e3 * v:g}" for v in shape.size)
    out.print(f"{output}: {made.name}, {size} mm, {reached} of {cells} dimples in reach")
    stands = []
    for number in (1, reached):
        place = shape.rotation @ made.points[str(number)] + shape.translation
        x, y, z = (1e3 * place).tolist()
        stands.append(f"dimple {number} is about ({x:.0f}, {y:.0f}, {z:.0f}) mm")
    out.print(
        f"Stand it so that {' and '.join(stands)} from the base's origin, the dimples looking "
        "against the tool's way in."
    )
    say("print it at 100 %, measure along x, and enter measured_mm in plate.toml")
