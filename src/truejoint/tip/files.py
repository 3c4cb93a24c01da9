"""Files of blocks, poses, touches, shots and registrations: read with one-line errors, written."""

from __future__ import annotations

import csv
import json
import math
import os
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from truejoint import schema
from truejoint.array_types import Array
from truejoint.errors import CalibrationError
from truejoint.files import read_small, write_atomically
from truejoint.robots import Robot
from truejoint.schema import Bounds, Key, Positive, Shape
from truejoint.tip.block import Block, BlockPose
from truejoint.tip.registration import Registration
from truejoint.tip.touch import Touches
from truejoint.toml_file import read_toml
from truejoint.units import display_unit

_MAX_BYTES: Final = 1 << 20
SHOT_SD: Final = 2.5e-4
"""Standard deviation of a marker at rest that a tracker sees, per axis [m]."""
_TRACKER: Final = 0.99  # m, a length that a tracker measures as it is
_COMMENTS: Final = {
    "calliper_mm": "Measure the print here with a calliper and enter measured_mm = ... below.",
    "rotation": "Where it stands in the robot's base.",
    "points_mm": "Where the tip rests in each dimple, in the block's frame.",
    "covariance": "Of a turn about the block's axes [rad] and a shift along the base's [m].",
}


def read_block(path: str | os.PathLike[str]) -> Block:
    """Read a block file (docs/touch.md); raises CalibrationError naming the key that is wrong.

    Examples
    --------
    >>> write_block(Block("test", "raven2", {"1": np.zeros(3)}, calliper=0.08), Path("p.toml"))
    >>> read_block(Path("p.toml")).calliper
    0.08
    """
    values = read_toml(Path(path), CalibrationError)
    return schema.read(Block, values, str(path), CalibrationError)


def write_block(block: Block, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
    """Write a block file; raises CalibrationError if that fails.

    Examples
    --------
    >>> write_block(Block("test", "raven2", {"1": np.zeros(3)}, calliper=0.08), Path("p.toml"))
    """
    _write(Path(path), block_text(block), overwrite)


def block_text(block: Block) -> str:
    """Text of a block file, which `read_block` reads; lengths are rounded to 0.1 um."""
    return _toml(schema.plain(block), digits=4)


def read_pose(path: str | os.PathLike[str]) -> BlockPose:
    """Read the pose of a bolted block; raises CalibrationError naming the key that is wrong.

    Examples
    --------
    >>> block = Block("test", "raven2", {"1": np.zeros(3)}, calliper=0.08)
    >>> pose = BlockPose(block, "raven2", "left", np.eye(3), np.zeros(3), np.eye(6), 1.0, 0.001)
    >>> write_pose(pose, Path("pose.toml"))
    >>> read_pose(Path("pose.toml")).title
    'test in the base of raven2 left'
    """
    values = read_toml(Path(path), CalibrationError)
    return schema.read(BlockPose, values, str(path), CalibrationError)


def write_pose(pose: BlockPose, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
    """Write the pose of a bolted block as TOML; raises CalibrationError if that fails.

    Examples
    --------
    >>> block = Block("test", "raven2", {"1": np.zeros(3)}, calliper=0.08)
    >>> where = np.eye(3), np.zeros(3), np.eye(6)
    >>> write_pose(BlockPose(block, "raven2", "left", *where, 1.0, 0.001), Path("pose.toml"))
    """
    _write(Path(path), _toml(schema.plain(pose)), overwrite)


def _write(path: Path, text: str, overwrite: bool) -> None:
    write = partial(Path.write_text, data=text, encoding="utf-8")
    write_atomically(path, write, overwrite=overwrite, error=CalibrationError)


def _toml(values: Mapping[str, Any], name: str = "", digits: int | None = None) -> str:
    """Plain values as TOML, tables last; numbers of keys in mm are rounded to `digits`."""
    text, tables = "", ""
    in_mm = name.endswith("_mm")
    for key, value in values.items():
        comment = f"# {_COMMENTS[key]}\n" if key in _COMMENTS else ""
        if isinstance(value, Mapping):
            path = f"{name}.{key}" if name else key
            tables += f"\n{comment}[{path}]\n{_toml(value, path, digits)}"
            continue
        if digits is not None and (in_mm or key.endswith("_mm")):
            written = json.dumps(np.round(value, digits).tolist())
        else:
            written = json.dumps(value)
        text += f"{comment}{json.dumps(key) if in_mm else key} = {written}\n"
    return text + tables


def read_touches(path: str | os.PathLike[str]) -> Touches:
    r"""Touches of a CSV file with a header: ``t`` [s], ``dimple`` and whatever else.

    Raises CalibrationError naming line and value.

    Examples
    --------
    >>> _ = Path("touches.csv").write_text("t,dimple\n4.0,3\n9.5,17\n")
    >>> read_touches(Path("touches.csv")).dimple
    ('3', '17')
    """
    rows = _read_rows(Path(path), ("t", "dimple"), "touches", "a time [s] and a dimple", 1)
    return Touches(tuple(float(t) for t, _ in rows), tuple(name for _, name in rows), str(path))


def read_shots(path: str | os.PathLike[str]) -> tuple[Touches, Block]:
    r"""Single shots of a tracker at rest: a CSV file with ``t`` [s], ``x_mm``, ``y_mm``, ``z_mm``.

    They are touches of a block of those points, each numbered by its place in the file. Raises
    CalibrationError naming line and value.

    Examples
    --------
    >>> _ = Path("shots.csv").write_text("t,x_mm,y_mm,z_mm\n4.0,1,2,800\n9.5,1,3,800\n")
    >>> read_shots(Path("shots.csv"))[1].points["2"]
    array([0.001, 0.003, 0.8  ])
    """
    columns = ("t", "x_mm", "y_mm", "z_mm")
    rows = _read_rows(Path(path), columns, "shots", "a time [s] and three numbers", 4)
    table = np.array([[float(text) for text in row] for row in rows]).reshape(-1, 4)
    points = {str(k): point / 1e3 for k, point in enumerate(table[:, 1:], 1)}
    touches = Touches(tuple(table[:, 0].tolist()), tuple(points), str(path))
    return touches, Block(str(path)[-200:], "", points, _TRACKER, _TRACKER)


def _read_rows(
    path: Path, names: tuple[str, ...], content: str, want: str, numbers: int
) -> list[tuple[str, ...]]:
    """Columns of a CSV file by name, a row each; the first `numbers` of them are numbers.

    `content` is what the file holds, and `want` what a line is to give, for the errors. Raises
    CalibrationError naming line and value.
    """
    text = read_small(path, CalibrationError, _MAX_BYTES, content).decode("utf-8", "replace")
    try:
        lines = list(csv.reader(text.splitlines()))
    except csv.Error as error:  # a file of something else: a field of 100 kB
        raise CalibrationError(f"{path}: is not a CSV file of {content} ({error})") from None
    header = [name.strip() for name in lines[0]] if lines else []
    if not set(names) <= set(header):
        listed = ",".join(names)
        raise CalibrationError(f"{path}: its first line names {header!r:.60}; want {listed}")
    rows = []
    for number, line in enumerate(lines[1:], 2):
        fields = dict(zip(header, line, strict=False))
        try:
            values = tuple(fields[name].strip() for name in names) if line else ()
            [float(value) for value in values[:numbers]]
        except (KeyError, ValueError):
            raise CalibrationError(
                f"{path}, line {number}: {','.join(line)!r:.60}; want {want}"
            ) from None
        rows += [values] if line else []
    return rows


_Point = Annotated[Array, Shape((3,))]


class _Base(NamedTuple):
    position: Annotated[_Point, Key("position_mm", 1e-3)]
    quaternion: Annotated[Array, Shape((4,))]
    sd: Annotated[float, Bounds(0.0, above=True), Key("sd_mm", 1e-3)]
    turn_sd: Annotated[float, Bounds(0.0, above=True), Key("sd_deg", math.pi / 180.0)]


class _Marker(NamedTuple):
    link: str = ""
    position: Annotated[Array | None, Shape((3,)), Key("position_mm", 1e-3)] = None
    sd: Annotated[float | None, Bounds(0.0, above=True), Key("sd_mm", 1e-3)] = None


class _Touched(NamedTuple):
    base: Annotated[_Point, Key("base_mm", 1e-3)]
    tracker: Annotated[_Point, Key("tracker_mm", 1e-3)]


class _Stop(NamedTuple):
    joint: str
    measured: float
    true: float
    sd: Positive


class _Stated(NamedTuple):
    """File of a registration."""

    base: _Base | None = None
    marker: _Marker = _Marker()
    touched: tuple[_Touched, ...] = ()
    touched_sd: Annotated[float | None, Bounds(0.0, above=True), Key("touched_sd_mm", 1e-3)] = None
    stops: tuple[_Stop, ...] = ()


def read_registration(path: str | os.PathLike[str], robot: Robot) -> Registration:
    r"""Registration of a TOML file (docs/tracker.md), whose numbers are in mm and deg.

    Raises CalibrationError naming the key and the rule that it breaks, RobotError for a joint that
    `robot` does not have.

    Examples
    --------
    >>> text = '[marker]\nlink = "roll"\nposition_mm = [0, 0, 8]\nsd_mm = 0.2'
    >>> _ = Path("tracker.toml").write_text(text)
    >>> read_registration(Path("tracker.toml"), get_robot("raven2")).marker
    array([0.   , 0.   , 0.008])
    """
    values = read_toml(Path(path), CalibrationError)
    file = schema.read(_Stated, values, str(path), CalibrationError)
    stated: dict[str, Any] = {"link": file.marker.link}
    if file.marker.link:
        robot.joint(file.marker.link)
    if file.base is not None:
        stated["base"] = _pose(path, file.base)
        stated["base_sd"] = np.repeat([file.base.turn_sd, file.base.sd], 3)
    if file.marker.position is not None:
        if file.marker.sd is None:
            raise CalibrationError(f"{path}: marker.sd_mm is missing; state its deviation")
        stated |= {"marker": file.marker.position, "marker_sd": np.full(3, file.marker.sd)}
    if (file.touched_sd is None) != (not file.touched):
        raise CalibrationError(
            f"{path}: touched_sd_mm and touched points belong together; give both, [[touched]] "
            "for each point, or neither"
        )
    if file.touched:
        stated["touched"] = np.array([[row.base, row.tracker] for row in file.touched])
        stated["touched_sd"] = file.touched_sd
    stops: dict[str, tuple[float, float, float]] = {}
    for stop in file.stops:
        joint = robot.joint(stop.joint)
        if joint.name in stops:
            raise CalibrationError(f"{path}: two stops of {joint.name}; state one of each joint")
        scale = display_unit(joint.unit).scale
        stops[joint.name] = stop.measured / scale, stop.true / scale, stop.sd / scale
    return Registration(**stated, stops=stops)


def _pose(path: str | os.PathLike[str], base: _Base) -> Array:
    """Pose (4, 4) [m] of a base as it is stated."""
    length = np.linalg.norm(base.quaternion)
    if not abs(length - 1.0) < 1e-2:
        raise CalibrationError(
            f"{path}: base.quaternion is of length {length:.3g}; give x, y, z, w of a unit "
            "quaternion"
        )
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat(base.quaternion).as_matrix()
    pose[:3, 3] = base.position
    return pose
