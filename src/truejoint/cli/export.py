"""`truejoint export`: C99, ONNX or a ROS package of a calibration, a bag of a recording."""

import re
from functools import partial
from pathlib import Path
from typing import Any, Final, Literal

import truejoint
from truejoint.cli.console import out, progress
from truejoint.cli.options import Result, share
from truejoint.cli.recording_options import Files
from truejoint.errors import ExportError
from truejoint.files import check_folder, check_target
from truejoint.units import with_unit


def export(
    name: str,
    kind: Literal["c", "onnx", "ros", "bag", "simulator", "urdf", "scaled-urdf"],
    output: Path,
    precision: Literal["double", "float"] = "double",
    prefix: str | None = None,
    level_percent: float | None = None,
    on_fault: Literal["hold", "raw", "silent"] = "hold",
    compensate: bool = False,
    profile: str = "",
    urdf: Path | None = None,
    force: bool = False,
) -> Result:
    """Write a calibration as C99 (c), a ROS package (ros) or an ONNX graph (onnx).

    The C source does all that `Corrector` does, with test vectors and a main that checks it; the
    package, for catkin and ament, is a node around it. The ONNX graph holds the regressor alone.
    With --to bag, write a recording as a ROS bag of CRTK's topics; with --to simulator, learn from
    a recording with truth what the robot reports of true positions, and write that as C99. With
    --to urdf, write your URDF (--urdf) with the calibration's fixed offsets in its joints; with
    --to scaled-urdf, with each joint's scale as well, as a joint behind it that mimics it.
    """
    stated = {"level": share(level_percent), "on_fault": on_fault}
    how: dict[str, Any] = {k: v for k, v in stated.items() if v not in (None, "hold")}
    values = {"profile": profile or None, "prefix": prefix, "urdf": urdf}
    if kind in _OF_ONE_OPTION:
        option, write_one = _OF_ONE_OPTION[kind]
        value = values.pop(option)
        if how or compensate or {*values.values()} != {None} or precision != "double":
            raise ExportError(f"--to {kind} takes --{option}; leave other options out")
        written: Result = write_one(name, output, value, force=force)
        return written
    for option, (word, _) in _OF_ONE_OPTION.items():
        if word != "prefix" and values[word] is not None:
            raise ExportError(f"--{word} is for --to {option}; leave it out")
    if compensate and kind != "c":
        raise ExportError("--compensate works only with --to c")
    if kind == "onnx" and how:
        raise ExportError("--level and --on-fault work only with --to c and --to ros")
    check_folder(output, error=ExportError)
    calibration = truejoint.read_calibration(name)
    if compensate:
        corrector = truejoint.runtime.Corrector(calibration.without_redundant())
        how["compensator"] = truejoint.runtime.Compensator(corrector, calibration.machine)
    write: Any = {
        "c": truejoint.export.export_c, "ros": truejoint.export.export_ros, "onnx": _write_graph,
    }[kind]  # fmt: skip
    paths = write(calibration, output, prefix=prefix, precision=precision, overwrite=force, **how)
    for path in paths:
        out.print(str(path), soft_wrap=True)
    if kind != "onnx":
        headers = "".join(path.read_text() for path in paths if path.suffix == ".h")
        covered = sum(map(int, re.findall(r"_DIGEST \w+ /\* of (\d+) numbers", headers)))
        out.print(
            f"its check covers {covered} numbers: their values by a digest, their use by samples"
        )
        out.print(f"check it:  {truejoint.export.check_command(paths)}", soft_wrap=True)
    return Result({"files": [str(path) for path in paths]})


def _export_bag(name: str, output: Path, profile: str | None, *, force: bool) -> Result:
    check_target(output, overwrite=force)
    recording = Files().one(name)
    with progress(f"Writing {output}"):
        truejoint.recordings.write_bag(recording, output, profile=profile or "", overwrite=force)
    topics = ", ".join(truejoint.recordings.bag_topics(output))
    out.print(f"{output}: {len(recording)} rows as {topics}")
    return Result({"files": [str(output)]})


def _export_urdf(
    name: str, output: Path, urdf: Path | None, *, scale: bool = False, force: bool
) -> Result:
    if urdf is None:
        raise ExportError("--to urdf needs --urdf, the URDF that is to have the offsets")
    calibration = truejoint.read_calibration(name)
    how = {"scale": scale, "overwrite": force}
    offsets, left_out = truejoint.export.export_urdf(calibration, urdf, output, **how)
    for joint, offset in offsets.items():
        out.print(f"{joint}: {with_unit(offset, calibration.units[f'measured/{joint}'])} added")
    out.print(f"{output}: left out: {left_out}", soft_wrap=True)
    return Result({"files": [str(output)], "offsets": offsets, "left_out": left_out})


def _export_error_model(name: str, output: Path, prefix: str | None, *, force: bool) -> Result:
    check_folder(output, error=ExportError)
    recording = Files().one(name)
    robot = recording.robot
    prefix = prefix or "_".join(filter(None, (f"{robot.name}_true", robot.arm)))
    file = output / f"{prefix}.safetensors"
    check_target(file, overwrite=force, makes_folder=True)
    with progress("Learning what the robot reports"):
        model = truejoint.calibration.learn_error_model(recording)
    paths = truejoint.export.export_c(model, output, prefix=prefix, overwrite=force)
    truejoint.write_calibration(model, file, overwrite=force)
    files = [str(path) for path in (*paths, file)]
    out.print("\n".join(files), soft_wrap=True)
    for joint, (size, time) in model.metadata["noise"].items():
        noise = with_unit(size, model.units[f"measured/{joint}"])
        out.print(f"{joint}: noise {noise}, correlated over {time:.2g} s")
    return Result({"files": files, "noise": model.metadata["noise"]})


def _write_graph(
    calibration: "truejoint.Calibration", folder: Path, *, prefix: str | None, **how: Any
) -> tuple[Path, ...]:
    """Write an ONNX graph, named as the C source would be."""
    from truejoint.export.export_c import check_prefix

    stem = truejoint.export.default_prefix(calibration) if prefix is None else prefix
    path = folder / f"{check_prefix(stem)}.onnx"
    return (truejoint.export.export_onnx(calibration, path, **how),)


_OF_ONE_OPTION: Final[Any] = {
    "bag": ("profile", _export_bag), "simulator": ("prefix", _export_error_model),
    "urdf": ("urdf", _export_urdf), "scaled-urdf": ("urdf", partial(_export_urdf, scale=True)),
}  # fmt: skip  # what else is written: the one option that it takes, and what writes it
