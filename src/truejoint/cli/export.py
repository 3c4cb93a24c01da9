"""`truejoint export`: write a calibration as C99 source or as an ONNX graph."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, get_args

import typer

from truejoint.calibration import read_calibration
from truejoint.cli.console import out, result_json
from truejoint.cli.options import Force, Json
from truejoint.errors import ExportError
from truejoint.export.c_source import Precision, check_prefix
from truejoint.export.export_c import check_command, default_prefix, export_c
from truejoint.export.export_onnx import export_onnx
from truejoint.runtime.limits import RANGE_MARGIN


def export(
    model: Annotated[Path, typer.Argument(metavar="MODEL", help="Model file.")],
    kind: Annotated[str, typer.Option("--to", help="What to write: c or onnx.")],
    folder: Annotated[Path, typer.Option("--out", "-o", help="Folder to write into.")],
    precision: Annotated[
        str, typer.Option(help=f"Of the numbers: {' or '.join(get_args(Precision))}.")
    ] = "double",
    prefix: Annotated[
        str | None,
        typer.Option(
            help="Beginning of file names, and of the names in C; default: robot and arm."
        ),
    ] = None,
    level: Annotated[
        float | None,
        typer.Option(help="Probability of the half-width; C only. Default: 0.9."),
    ] = None,
    range_margin: Annotated[
        float | None,
        typer.Option(
            help="Share of its trained range by which a feature may lie outside, 0 to 1; C only. "
            f"Default: {RANGE_MARGIN}."
        ),
    ] = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Write a calibration as C99 source (--to c) or as an ONNX graph (--to onnx).

    The C source does all that `Corrector` does, and comes with test vectors and a main that
    checks it. The ONNX graph holds the regressor alone: it checks nothing and remembers nothing.
    """
    if kind not in ("c", "onnx"):
        raise ExportError(f"--to {kind!r:.60} is neither 'c' nor 'onnx'")
    if kind == "onnx" and (level is not None or range_margin is not None):
        raise ExportError(
            "--level and --range-margin are for --to c; an ONNX graph has no interval and no checks"
        )
    calibration = read_calibration(model)
    if kind == "c":
        paths = export_c(
            calibration,
            folder,
            prefix=prefix,
            precision=precision,  # type: ignore[arg-type]  # checked there
            level=0.9 if level is None else level,
            range_margin=RANGE_MARGIN if range_margin is None else range_margin,
            overwrite=force,
        )
    else:
        name = check_prefix(default_prefix(calibration) if prefix is None else prefix)
        path = folder / f"{name}.onnx"
        paths = (
            export_onnx(calibration, path, precision=precision, overwrite=force),  # type: ignore[arg-type]  # checked there
        )
    if as_json:
        result_json({"files": [str(path) for path in paths]})
        return
    for path in paths:
        out.print(str(path), highlight=False, soft_wrap=True)
    if kind == "c":
        out.print(f"check it:  {check_command(paths)}", highlight=False, soft_wrap=True)
