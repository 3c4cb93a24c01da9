"""Parts of a robot of plain values, as they stand in its file (docs/robots.md).

All raise RobotError, which names the key and the rule that it breaks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from truejoint.errors import RobotError, unknown
from truejoint.robots.joint_encoder import JointEncoder
from truejoint.robots.parts import UNITS, WORKSPACE_KEYS, Joint, Kinematics, Transmission, Workspace
from truejoint.robots.plain import MAX_JOINTS, check_keys, matrix_of, name_of, number, tables

if TYPE_CHECKING:  # the compiler behind it takes longer to import than the rest
    from truejoint.robots.chain import SerialChain

MATRIX_KEYS: Final = ("axis_from_joint", "crtk_from_base", "tool_rotation")
_ANGLES: Final = UNITS["revolute"]
_LIMIT_KEYS: Final = ("lower", "upper", "home", "max_speed")
_AXIS_KEYS: Final = ("alpha", "a", "d", "theta", "kind")
_CHAIN_KEYS: Final = ("axes", "unit", *MATRIX_KEYS)
_URDF_KEYS: Final = ("urdf", "base", "tip")
_ENCODER_KEYS: Final = ("joint", "resolution", "hard_stop", "end", "direction", "tolerance")


def read_joint(values: Mapping[str, Any], where: str) -> Joint:
    """Read a joint, whose limits are in the unit that it states."""
    check_keys(values, ("name", "kind", "unit", *_LIMIT_KEYS), ("name",), where)
    name = name_of(values["name"], f"{where}: name")
    kind, factor = _kind(values, f"joint {name!r}")
    limits = {key: values[key] for key in _LIMIT_KEYS if key in values}
    numbers = {k: number(v, f"joint {name!r}: {k}") * factor for k, v in limits.items()}
    return Joint(name, kind, **numbers)


def read_workspace(values: Any, joints: Sequence[Mapping[str, Any]]) -> Workspace:
    """Workspace of one table a joint, ``jaw = {lower = -50, ...}`` in that joint's unit."""
    if not isinstance(values, Mapping) or not values:
        raise RobotError(f"workspace is {values!r:.40}; want a table for each joint that moves")
    factors = {joint["name"]: _kind(joint, "workspace")[1] for joint in joints}
    rows = []
    for name, row in values.items():
        where = f"workspace.{name}"
        if name not in factors or not isinstance(row, Mapping):
            raise RobotError(f"{where}: want a table for one of the joints {', '.join(factors)}")
        check_keys(row, WORKSPACE_KEYS, ("lower", "upper", "speed"), where)
        rows.append({k: number(v, f"{where}: {k}") * factors[name] for k, v in row.items()})
    shared = [key for key in WORKSPACE_KEYS if any(key in row for row in rows)]
    for key in shared:
        without = [name for name, row in zip(values, rows, strict=True) if key not in row]
        if without:
            raise RobotError(
                f"workspace: {key} is missing for {', '.join(without)}; state it for every joint "
                "or for none"
            )
    return Workspace(tuple(values), **{key: np.array([row[key] for row in rows]) for key in shared})


def read_encoders(values: Any, joints: Sequence[Mapping[str, Any]]) -> tuple[JointEncoder, ...]:
    """Read encoders of tables, each in the unit of its joint."""
    factors = {joint["name"]: _kind(joint, "encoders")[1] for joint in joints}
    encoders = []
    for n, row in enumerate(tables(values, "encoders"), 1):
        where = f"encoder {n}"
        check_keys(row, _ENCODER_KEYS, _ENCODER_KEYS[:3], where)
        joint = str(row["joint"])
        if joint not in factors:
            raise RobotError(f"{where}: {unknown('joint', joint, tuple(factors))}")
        size = {
            key: number(row[key], f"{where}: {key}") * factors[joint]
            for key in ("resolution", "hard_stop")
        }
        whole: dict[str, Any] = {k: row[k] for k in ("direction", "tolerance") if k in row}
        if not all(type(value) is int for value in whole.values()):
            raise RobotError(f"{where}: direction and tolerance are whole numbers")
        whole |= {"end": row["end"]} if "end" in row else {}
        encoders.append(JointEncoder(joint, size["resolution"], size["hard_stop"], **whole))
    return tuple(encoders)


def read_transmission(matrix: Any, gear: Any) -> Transmission:
    """Read a transmission of its matrix and its gearboxes."""
    if not isinstance(gear, list | tuple) or len(gear) > MAX_JOINTS:
        raise RobotError(f"gear is {gear!r:.40}; want a number for each motor")
    turns = tuple(number(value, "gear") for value in gear)
    return Transmission(matrix_of(matrix, "transmission"), turns)


def _kind(values: Mapping[str, Any], where: str) -> tuple[Any, float]:
    """Kind of a joint and the factor from its unit in the file to SI."""
    kind = values.get("kind", "revolute")
    if kind not in tuple(UNITS):
        raise RobotError(f"{where}: kind is {kind!r:.40}; want {' or '.join(UNITS)}")
    unit = values.get("unit", next(iter(UNITS[kind])))
    if unit not in tuple(UNITS[kind]):
        units = " or ".join(UNITS[kind])
        raise RobotError(f"{where}: unit {unit!r:.40} does not fit a {kind} joint; want {units}")
    return kind, UNITS[kind][unit]


def read_kinematics(values: Any, joints: Sequence[Joint], folder: Path | None) -> Kinematics:
    """Read a chain of axes, or that of a URDF in `folder`."""
    if not isinstance(values, Mapping):
        raise RobotError(f"kinematics is {values!r:.40}; want a table")
    if "urdf" in values:
        from truejoint.robots.urdf import read_urdf  # noqa: PLC0415  # an optional extra

        check_keys(values, _URDF_KEYS, (), "kinematics")
        if folder is None or not all(isinstance(value, str) for value in values.values()):
            raise RobotError("kinematics: urdf, base and tip are texts, and stand in a robot file")
        path = folder / values["urdf"]
        kinds = {joint.name: joint.kind for joint in joints}
        return read_urdf(path, kinds, values.get("base", ""), values.get("tip", ""))
    return _chain(values, joints)


def _chain(values: Mapping[str, Any], joints: Sequence[Joint]) -> SerialChain:
    from truejoint.robots.chain import Axis, SerialChain  # noqa: PLC0415

    check_keys(values, _CHAIN_KEYS, ("axes",), "kinematics")
    unit = values.get("unit", "rad")
    if unit not in tuple(_ANGLES):
        angles = " or ".join(_ANGLES)
        raise RobotError(f"kinematics: unit {unit!r:.40} is no angle's; want {angles}")
    axes = []
    for n, row in enumerate(tables(values["axes"], "kinematics: axes"), 1):
        where = f"kinematics: axis {n}"
        check_keys(row, _AXIS_KEYS, (), where)
        kind, _ = _kind({"kind": row.get("kind", "revolute")}, where)
        alpha, a, d, theta = (
            number(row.get(key, 0.0), f"{where}: {key}") for key in _AXIS_KEYS[:4]
        )
        axes.append(Axis(alpha * _ANGLES[unit], a, d, theta * _ANGLES[unit], kind))
    matrices = [np.eye(len(axes), len(joints)), np.eye(4), np.eye(3)]
    for k, key in enumerate(MATRIX_KEYS):
        expected = matrices[k].shape
        if key in values:
            matrices[k] = matrix_of(values[key], f"kinematics: {key}")
        if matrices[k].shape != expected:
            shape = matrices[k].shape
            raise RobotError(f"kinematics: {key} is of shape {shape}, expected {expected}")
    if "axis_from_joint" not in values:
        kinds = [joint.kind for joint in joints[: len(axes)]]
        if [axis.kind for axis in axes] != kinds:
            raise RobotError(
                f"kinematics: axes {', '.join(axis.kind for axis in axes)} do not fit the joints "
                f"{', '.join(joint.kind for joint in joints)}; say what moves each by "
                "axis_from_joint"
            )
    return SerialChain(tuple(axes), *matrices)
