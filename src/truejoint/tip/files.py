"""Files of blocks, poses, touches, shots and registrations: read with one-line errors, written."""

from __future__ import annotations

import csv
import json
import math
import os
from collections.abc import Mapping, Sequence
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
from truejoint.tip.touch import Touches
from truejoint.tip.track_fit import Registration
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
    >>> text = block_text(Block("test", "raven2", {"1": np.zeros(3)}, calliper=0.08))
    >>> _ = Path("p.toml").write_text(text)
    >>> read_block(Path("p.toml")).calliper
    0.08
    """
    values = read_toml(Path(path), CalibrationError)
    return schema.read(Block, values, str(path), CalibrationError)


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
    write = partial(Path.write_text, data=_toml(schema.plain(pose)), encoding="utf-8")
    write_atomically(Path(path), write, overwrite=overwrite, error=CalibrationError)


def _toml(values: Mapping[str, Any], name: str = "", digits: int | None = None) -> str:
    """Plain values as TOML, tables last; numbers of keys in mm are rounded to `digits`."""
    text, tables = "", ""
    for key, value in values.items():
        comment = f"# {_COMMENTS[key]}\n" if key in _COMMENTS else ""
        if isinstance(value, Mapping):
            path = f"{name}.{key}".lstrip(".")
            tables += f"\n{comment}[{path}]\n{_toml(value, path, digits)}"
            continue
        is_rounded = digits is not None and (name + key).endswith("_mm")
        written = json.dumps(np.round(value, digits).tolist() if is_rounded else value)
        text += f"{comment}{json.dumps(key) if name.endswith('_mm') else key} = {written}\n"
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
    rows = _read_rows(Path(path), ("t", "dimple"), "touches", "a time [s] and a dimple")
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
    rows = _read_rows(Path(path), columns, "shots", "a time [s] and three numbers")
    table = np.array(rows, dtype=np.float64).reshape(-1, 4)
    points = {str(k): point / 1e3 for k, point in enumerate(table[:, 1:], 1)}
    touches = Touches(tuple(table[:, 0].tolist()), tuple(points), str(path))
    return touches, Block(str(path)[-200:], "", points, _TRACKER, _TRACKER)


def _read_rows(path: Path, names: Sequence[str], content: str, want: str) -> list[list[str]]:
    """Columns of a CSV file by name, a row each; all but ``dimple`` are numbers.

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
        try:
            if line:
                rows.append([line[header.index(name)].strip() for name in names])
                [float(value) for value in rows[-1][: len(names) - ("dimple" in names)]]
        except (IndexError, ValueError):
            raise CalibrationError(
                f"{path}, line {number}: {','.join(line)!r:.60}; want {want}"
            ) from None
    return rows


_Point = Annotated[Array, Shape((3,))]
_Above = Bounds(0.0, above=True)


class _Base(NamedTuple):
    position: Annotated[_Point, Key("position_mm", 1e-3)]
    quaternion: Annotated[Array, Shape((4,))]
    sd: Annotated[float, _Above, Key("sd_mm", 1e-3)]
    turn_sd: Annotated[float, _Above, Key("sd_deg", math.pi / 180.0)]


class _Marker(NamedTuple):
    link: str = ""
    position: Annotated[Array | None, Shape((3,)), Key("position_mm", 1e-3)] = None
    sd: Annotated[float | None, _Above, Key("sd_mm", 1e-3)] = None


class _Touched(NamedTuple):
    base: Annotated[_Point, Key("base_mm", 1e-3)]
    tracker: Annotated[_Point, Key("tracker_mm", 1e-3)]


class _Stop(NamedTuple):
    joint: str
    measured: float
    true: float
    sd: Positive


class _File(NamedTuple):
    base: _Base | None = None
    marker: _Marker = _Marker()
    touched: tuple[_Touched, ...] = ()
    touched_sd: Annotated[float | None, _Above, Key("touched_sd_mm", 1e-3)] = None
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
    file = schema.read(_File, values, str(path), CalibrationError)
    stated: dict[str, Any] = {"link": file.marker.link}
    if file.marker.link:
        robot.joint(file.marker.link)
    if file.base is not None:
        length = np.linalg.norm(file.base.quaternion)
        if not abs(length - 1.0) < 1e-2:
            raise CalibrationError(
                f"{path}: base.quaternion is of length {length:.3g}; give x, y, z, w of a unit "
                "quaternion"
            )
        stated["base"] = np.eye(4)
        stated["base"][:3, :3] = Rotation.from_quat(file.base.quaternion).as_matrix()
        stated["base"][:3, 3] = file.base.position
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
