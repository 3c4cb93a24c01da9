"""A robot as plain data: what a robot file, the header of a model file or of a recording holds."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from truejoint.errors import RobotError
from truejoint.robots.robot import Joint, Kinematics, Robot, Transmission
from truejoint.robots.workspace import Workspace
from truejoint.toml_file import read_toml

if TYPE_CHECKING:  # the compiler behind it takes longer to import than the rest
    from truejoint.robots.chain import SerialChain

Array = NDArray[np.float64]

MAX_JOINTS: Final = 64
_LARGEST: Final = 1e9
_NAME: Final = re.compile(r"\w{1,60}", re.ASCII)
_UNITS: Final[Mapping[str, Mapping[str, float]]] = {
    "revolute": {"rad": 1.0, "deg": math.pi / 180.0},
    "prismatic": {"m": 1.0, "mm": 1e-3},
}
_ANGLES: Final = _UNITS["revolute"]
_LIMIT_KEYS: Final = ("lower", "upper", "home", "max_speed")
_AXIS_KEYS: Final = ("alpha", "a", "d", "theta", "kind")
_MATRIX_KEYS: Final = ("axis_from_joint", "crtk_from_base", "tool_rotation")
_CHAIN_KEYS: Final = ("axes", "unit", *_MATRIX_KEYS)
_URDF_KEYS: Final = ("urdf", "base", "tip")
_KEYS: Final = ("name", "arm", "joints", "channels", "positioning", "effort", "transmission",
                "kinematics", "workspace")  # fmt: skip
_WORKSPACE_KEYS: Final = ("lower", "upper", "speed", "margin", "slowest", "fastest")


def read_robot(path: Path, arm: str = "", source: str = "") -> Robot:
    """Robot of a TOML file, which may also name its ``arms`` and a URDF for its kinematics.

    Of the arms `arm`, in any case, is wanted; empty where they are alike or there is one. Errors
    name `source`, the path by default.
    """
    values = read_toml(path, RobotError)
    source = source or str(path)
    arms = _names(values.pop("arms", []), f"{source}: arms")
    wanted = arm.strip().lower()
    if wanted and wanted not in arms:
        known = ", ".join(arms) or "none: leave the arm empty"
        raise RobotError(f"{source}: has no arm called {arm!r}; its arms: {known}")
    return robot_from_dict({**values, "arm": wanted}, source, folder=path.parent)


def robot_from_dict(
    values: Mapping[str, Any], source: str = "robot", *, folder: Path | None = None
) -> Robot:
    """Robot of plain data, of `robot_to_dict` or a robot file: docs/robots.md lists the keys.

    Errors name `source`. A URDF that the kinematics name is searched in `folder`; none may be
    named without it.
    """
    _check_keys(values, _KEYS, ("name", "joints"), source)
    joints = _tables(values["joints"], f"{source}: joints")
    try:
        made = tuple(_joint(joint, f"joint {n}") for n, joint in enumerate(joints, 1))
        names = tuple(joint.name for joint in made)
        matrix = values.get("transmission")
        kinematics, workspace = values.get("kinematics"), values.get("workspace")
        return Robot(
            _name(values["name"], "name"),
            made,
            _name(values.get("arm", ""), "arm") if values.get("arm") else "",
            _names(values.get("channels", names), "channels"),
            _names(values.get("positioning", names), "positioning"),
            None if matrix is None else Transmission(_matrix(matrix, "transmission")),
            None if kinematics is None else _kinematics(kinematics, made, folder),
            values.get("effort", "joint"),
            None if workspace is None else _workspace(workspace, joints),
        )
    except RobotError as error:
        raise RobotError(f"{source}: {error}") from None


def robot_to_dict(robot: Robot) -> dict[str, Any]:
    """Plain values for JSON, SI, of which `robot_from_dict` makes the robot again.

    Kinematics other than a `SerialChain`, which are code, are left out; of a subclass the chain
    is kept.
    """
    joints, limitless = [asdict(joint) for joint in robot.joints], (math.inf, -math.inf)
    values: dict[str, Any] = {
        "name": robot.name,
        "arm": robot.arm,
        "joints": [{k: v for k, v in joint.items() if v not in limitless} for joint in joints],
        "channels": list(robot.channels),
        "positioning": list(robot.positioning),
        "effort": robot.effort,
    }
    if robot.transmission is not None:
        values["transmission"] = robot.transmission.matrix.tolist()
    space = robot.workspace
    if space is not None:
        rows = {key: getattr(space, key) for key in _WORKSPACE_KEYS}
        values["workspace"] = {
            joint: {key: float(row[k]) for key, row in rows.items() if row is not None}
            for k, joint in enumerate(space.joints)
        }
    chain: Any = robot.kinematics
    if hasattr(chain, "axes"):
        values["kinematics"] = {
            "axes": [asdict(axis) for axis in chain.axes],
            **{key: np.asarray(getattr(chain, key)).tolist() for key in _MATRIX_KEYS},
        }
    return values


def _joint(values: Mapping[str, Any], where: str) -> Joint:
    _check_keys(values, ("name", "kind", "unit", *_LIMIT_KEYS), ("name",), where)
    name = _name(values["name"], f"{where}: name")
    kind, factor = _kind(values, f"joint {name!r}")
    limits = {key: values[key] for key in _LIMIT_KEYS if key in values}
    numbers = {k: _number(v, f"joint {name!r}: {k}") * factor for k, v in limits.items()}
    return Joint(name, kind, **numbers)


def _workspace(values: Any, joints: Sequence[Mapping[str, Any]]) -> Workspace:
    """Workspace of one table a joint, ``jaw = {lower = -50, ...}`` in that joint's unit."""
    if not isinstance(values, Mapping) or not values:
        raise RobotError(f"workspace is {values!r:.40}; want a table for each joint that moves")
    factors = {joint["name"]: _kind(joint, "workspace")[1] for joint in joints}
    rows = []
    for name, row in values.items():
        where = f"workspace.{name}"
        if name not in factors or not isinstance(row, Mapping):
            raise RobotError(f"{where}: want a table for one of the joints {', '.join(factors)}")
        _check_keys(row, _WORKSPACE_KEYS, ("lower", "upper", "speed"), where)
        rows.append({k: _number(v, f"{where}: {k}") * factors[name] for k, v in row.items()})
        if not (rows[-1]["lower"] < rows[-1]["upper"] and rows[-1]["speed"] > 0):
            raise RobotError(f"{where}: lower must be below upper, and speed above 0")
    shared = [key for key in _WORKSPACE_KEYS if all(key in row for row in rows)]
    return Workspace(tuple(values), **{key: np.array([row[key] for row in rows]) for key in shared})


def _kind(values: Mapping[str, Any], where: str) -> tuple[Any, float]:
    """Kind of a joint and the factor from its unit in the file to SI."""
    kind = values.get("kind", "revolute")
    if kind not in tuple(_UNITS):
        raise RobotError(f"{where}: kind is {kind!r:.40}; want {' or '.join(_UNITS)}")
    unit = values.get("unit", next(iter(_UNITS[kind])))
    if unit not in tuple(_UNITS[kind]):
        units = " or ".join(_UNITS[kind])
        raise RobotError(f"{where}: unit {unit!r:.40} does not fit a {kind} joint; want {units}")
    return kind, _UNITS[kind][unit]


def _kinematics(values: Any, joints: Sequence[Joint], folder: Path | None) -> Kinematics:
    if not isinstance(values, Mapping):
        raise RobotError(f"kinematics is {values!r:.40}; want a table")
    if "urdf" in values:
        from truejoint.robots.urdf import read_urdf  # noqa: PLC0415  # an optional extra

        _check_keys(values, _URDF_KEYS, (), "kinematics")
        if folder is None or not all(isinstance(value, str) for value in values.values()):
            raise RobotError("kinematics: urdf, base and tip are texts, and stand in a robot file")
        path = folder / values["urdf"]
        return read_urdf(path, joints, values.get("base", ""), values.get("tip", ""))
    return _chain(values, joints)


def _chain(values: Mapping[str, Any], joints: Sequence[Joint]) -> SerialChain:
    from truejoint.robots.chain import Axis, SerialChain  # noqa: PLC0415

    _check_keys(values, _CHAIN_KEYS, ("axes",), "kinematics")
    unit = values.get("unit", "rad")
    if unit not in tuple(_ANGLES):
        angles = " or ".join(_ANGLES)
        raise RobotError(f"kinematics: unit {unit!r:.40} is no angle's; want {angles}")
    axes = []
    for n, row in enumerate(_tables(values["axes"], "kinematics: axes"), 1):
        where = f"kinematics: axis {n}"
        _check_keys(row, _AXIS_KEYS, (), where)
        kind, _ = _kind({"kind": row.get("kind", "revolute")}, where)
        alpha, a, d, theta = (
            _number(row.get(key, 0.0), f"{where}: {key}") for key in _AXIS_KEYS[:4]
        )
        axes.append(Axis(alpha * _ANGLES[unit], a, d, theta * _ANGLES[unit], kind))
    matrices = [np.eye(len(axes), len(joints)), np.eye(4), np.eye(3)]
    for k, key in enumerate(_MATRIX_KEYS):
        expected = matrices[k].shape
        if key in values:
            matrices[k] = _matrix(values[key], f"kinematics: {key}")
        if matrices[k].shape != expected:
            shape = matrices[k].shape
            raise RobotError(f"kinematics: {key} is of shape {shape}, expected {expected}")
    return SerialChain(tuple(axes), *matrices)


def _check_keys(
    values: Mapping[str, Any], known: Sequence[str], needed: Sequence[str], where: str
) -> None:
    for key in values:
        if key not in known:
            raise RobotError(f"{where}: key {key!r:.60} is not known; use {', '.join(known)}")
    for key in needed:
        if key not in values:
            raise RobotError(f"{where}: {key!r} is missing; add it")


def _tables(values: Any, where: str) -> Sequence[Mapping[str, Any]]:
    good = isinstance(values, list | tuple) and all(isinstance(row, Mapping) for row in values)
    if not good or not 0 < len(values) <= MAX_JOINTS:
        raise RobotError(f"{where} are {values!r:.40}; want 1 to {MAX_JOINTS} tables")
    rows: Sequence[Mapping[str, Any]] = values
    return rows


def _name(value: Any, where: str) -> str:
    if not isinstance(value, str) or not _NAME.fullmatch(value):
        raise RobotError(f"{where} is {value!r:.80}; want up to 60 letters, digits and _")
    return value


def _names(values: Any, where: str) -> tuple[str, ...]:
    if not isinstance(values, list | tuple) or len(values) > MAX_JOINTS:
        raise RobotError(f"{where} is {values!r:.40}; want a list of at most {MAX_JOINTS} names")
    return tuple(_name(value, where) for value in values)


def _number(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise RobotError(f"{where} is {value!r:.40}; want a number")
    if not -_LARGEST <= value <= _LARGEST:
        raise RobotError(
            f"{where} is beyond {_LARGEST:g} in size; leave it out where there is none"
        )
    return float(value)


def _matrix(values: Any, where: str) -> Array:
    rows = values if isinstance(values, list | tuple) else [values]
    if not all(isinstance(row, list | tuple) and len(row) == len(rows[0]) for row in rows):
        raise RobotError(f"{where} is {values!r:.40}; want a list of rows of the same length")
    return np.array([[_number(value, where) for value in row] for row in rows], dtype=np.float64)
