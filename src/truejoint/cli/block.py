"""`truejoint touch block`: a block with dimples to print and touch, sized for a robot."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import truejoint
from truejoint.cli import options
from truejoint.cli.console import out, result_json, say
from truejoint.errors import CalibrationError
from truejoint.files import write_all_atomically


def block(
    robot: str,
    output: Path = Path(),
    force: bool = False,
    as_json: bool = False,
) -> None:
    """Design a block of stairs to print: its shape, a drawing with numbers, and its points."""
    from truejoint.tip.files import block_text

    shape = truejoint.tip.design_block(options.get_robot(robot))
    made = shape.block()
    output.mkdir(parents=True, exist_ok=True)
    files = {
        output / "block.stl": partial(Path.write_bytes, data=truejoint.tip.block_stl(shape)),
        output / "block.svg": partial(
            Path.write_text, data=truejoint.tip.block_svg(shape), encoding="utf-8"
        ),
        output / "block.toml": partial(Path.write_text, data=block_text(made), encoding="utf-8"),
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
    say("print it at 100 %, measure along x, and enter measured_mm in block.toml")
