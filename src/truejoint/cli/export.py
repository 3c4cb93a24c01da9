"""`truejoint export`: write a calibration as C99 source or as an ONNX graph."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

import truejoint
from truejoint.cli import options
from truejoint.cli.console import out, result_json
from truejoint.errors import ExportError
from truejoint.files import check_folder

if TYPE_CHECKING:
    from truejoint.calibration import Calibration
    from truejoint.runtime import Compensator


def export(
    model: options.Model,
    kind: Annotated[Literal["c", "onnx", "ros"], typer.Option("--to", help="What to write.")],
    folder: Annotated[Path, typer.Option("--out", "-o", help="Folder to write into.")],
    precision: Annotated[
        Literal["double", "float"], typer.Option(help="Of the numbers.")
    ] = "double",
    prefix: Annotated[
        str | None,
        typer.Option(
            help="Beginning of file names, and of the names in C; default: robot and arm."
        ),
    ] = None,
    level_percent: options.Level = None,
    range_margin: Annotated[
        float | None,
        typer.Option(
            help="Share of its trained range by which a feature may lie outside, 0 to 1; not ONNX. "
            "Default: that of `Corrector`."
        ),
    ] = None,
    compensate: Annotated[
        bool,
        typer.Option(
            "--compensate",
            help="Also write the compensator, which puts the joints where they are wanted; C only.",
        ),
    ] = False,
    force: options.Force = False,
    as_json: options.Json = False,
) -> None:
    """Write a calibration as C99 (--to c), a ROS package (--to ros) or an ONNX graph (--to onnx).

    The C source does all that `Corrector` does, and comes with test vectors and a main that
    checks it; the package, of catkin and ament, is a node around it. The ONNX graph holds the
    regressor alone: it checks nothing and remembers nothing.
    """
    stated = {"level": options.share(level_percent), "range_margin": range_margin}
    given: dict[str, Any] = {name: value for name, value in stated.items() if value is not None}
    if compensate and kind != "c":
        raise ExportError("--compensate is for --to c; ROS packages and ONNX graphs have no loop")
    if kind == "onnx" and given:
        raise ExportError(
            "--level and --range-margin are for --to c and ros; an ONNX graph has no interval and "
            "no checks"
        )
    check_folder(folder, error=ExportError)
    calibration = truejoint.read_calibration(model)
    if compensate:
        given["compensator"] = _compensator(calibration)
    paths = _written(calibration, kind, folder, prefix, precision, given, overwrite=force)
    if as_json:
        result_json({"files": [str(path) for path in paths]})
        return
    for path in paths:
        out.print(str(path), soft_wrap=True)
    if kind != "onnx":
        from truejoint.export import check_command  # noqa: PLC0415  # compiles

        out.print(f"check it:  {check_command(paths)}", soft_wrap=True)


def _compensator(calibration: Calibration) -> Compensator:
    robot = truejoint.get_robot(calibration.robot, calibration.arm)
    corrector = truejoint.runtime.Corrector(calibration.without_redundant())
    return truejoint.runtime.Compensator(corrector, robot)


def _written(
    calibration: Calibration,
    kind: Literal["c", "onnx", "ros"],
    folder: Path,
    prefix: str | None,
    precision: Literal["double", "float"],
    given: dict[str, Any],
    *,
    overwrite: bool,
) -> Sequence[Path]:
    """Files that were written; `given` is what `export_c` and `export_ros` take besides."""
    from truejoint import export  # noqa: PLC0415  # compiles
    from truejoint.export.c_source import check_prefix  # noqa: PLC0415

    if kind == "onnx":
        name = check_prefix(export.default_prefix(calibration) if prefix is None else prefix)
        path = folder / f"{name}.onnx"
        return (export.export_onnx(calibration, path, precision=precision, overwrite=overwrite),)
    write = export.export_c if kind == "c" else export.export_ros
    return write(
        calibration, folder, prefix=prefix, precision=precision, overwrite=overwrite, **given
    )
