"""Kinematics from a URDF, which pytransform3d reads, as modified Denavit-Hartenberg axes."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from truejoint.array_types import Array
from truejoint.errors import RobotError, TruejointError, words
from truejoint.extras import require
from truejoint.files import read_small
from truejoint.robots.chain import SerialChain
from truejoint.robots.parts import Axis

_MAX_BYTES: Final = 1 << 24
KINDS: Final = {"continuous": "revolute", "revolute": "revolute", "prismatic": "prismatic"}
_PARALLEL: Final = 1e-9


def read_urdf(path: Path, kinds: Mapping[str, str], base: str = "", tip: str = "") -> SerialChain:
    """Kinematics of the chain from link `base` to link `tip` of a URDF; its first and last link.

    `kinds` are those of the robot's joints, by name; joints after the tip move nothing. Raises
    RobotError if the file is no URDF, has no such chain, or moves others on it.
    """
    urdf = require("pytransform3d.urdf", "urdf", "a URDF")
    data = urdf_bytes(path, RobotError)
    try:
        _, _, joints = urdf.parse_urdf(data.decode("utf-8"))
    except Exception as error:  # noqa: BLE001  # the library lets through what its parsers raise
        raise RobotError(f"{path}: cannot be read as a URDF ({words(error, 120)})") from None
    try:
        return _chain(_path(joints, base, tip), kinds)
    except RobotError as error:
        raise RobotError(f"{path}: {error}") from None


def urdf_bytes(path: Path, error: type[TruejointError]) -> bytes:
    """Content of a URDF without entities, which would read files of others; else raises `error`."""
    data = read_small(path, error, _MAX_BYTES, "a URDF")
    if b"<!" in data.replace(b"<!--", b""):
        raise error(f"{path}: no document type or CDATA is read; take out what begins with <!")
    return data


def _path(joints: Sequence[Any], base: str, tip: str) -> list[Any]:
    """Joints of the URDF from `base` to `tip`."""
    above = {joint.child: joint for joint in joints}
    if not tip:
        ends = sorted(set(above) - {joint.parent for joint in joints})
        if len(ends) != 1:
            raise RobotError(f"ends in the links {', '.join(ends) or 'none'}; name one as tip")
        tip = ends[0]
    chain: list[Any] = []
    link = tip
    while link != base and link in above:
        chain.insert(0, above.pop(link))
        link = chain[0].parent
    if not chain or (base and link != base):
        raise RobotError(f"no joints lead from link {base or link!r} to link {tip!r}")
    return chain


def _chain(joints: Sequence[Any], kinds: Mapping[str, str]) -> SerialChain:
    names = list(kinds)
    axes = [Axis(0.0, 0.0, 0.0, 0.0)]
    rows = [np.zeros(len(names))]
    fixed = np.eye(4)
    for joint in joints:
        fixed = fixed @ np.asarray(joint.child2parent, dtype=float)
        if joint.joint_type == "fixed":
            continue
        name, kind = joint.joint_name, KINDS[joint.joint_type]
        if name not in names:
            raise RobotError(
                f"joint {name!r} is not among the robot's joints {', '.join(names)}; "
                "add it to the robot file, or choose another tip"
            )
        if kinds[name] != kind:
            raise RobotError(f"joint {name!r} is {kind} there, but not in the robot file")
        axis = np.asarray(joint.joint_axis, dtype=float)
        length = float(np.linalg.norm(axis)) if axis.shape == (3,) else 0.0
        if not length > 0:
            raise RobotError(f"joint {name!r} has the axis {axis.tolist()}; want a direction")
        z = axis / length
        x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
        x /= np.linalg.norm(x)
        turn = np.eye(4)  # brings z onto the axis
        turn[:3, :3] = np.column_stack([x, np.cross(z, x), z])
        _append(axes, fixed @ turn, kind)
        rows.append(np.eye(len(names))[names.index(name)])
        fixed = turn.T
    _append(axes, fixed, "revolute")
    rows.append(np.zeros(len(names)))
    return SerialChain(tuple(axes), np.array(rows))


def _append(axes: list[Axis], fixed: Array, kind: Any) -> None:
    """Go on from the last axis by a rigid transform (4, 4) to an axis along its z.

    Any rigid transform is Rz(theta0) Tz(d0) Rx(alpha) Tx(a) Rz(theta) Tz(d), along the common
    normal of the two z axes; the first two go into the last axis, the others make the new one.
    """
    x, y, z = fixed[:3, 3]
    sine, cosine = math.hypot(fixed[0, 2], fixed[1, 2]), fixed[2, 2]
    if sine > _PARALLEL:
        theta0 = math.atan2(fixed[0, 2], -fixed[1, 2])
        d = (x * math.sin(theta0) - y * math.cos(theta0)) / sine
    else:
        sine, cosine = 0.0, math.copysign(1.0, cosine)
        theta0, d = math.atan2(y, x), 0.0
    alpha = math.atan2(sine, cosine)
    a = x * math.cos(theta0) + y * math.sin(theta0)
    normal = np.array([math.cos(theta0), math.sin(theta0), 0.0])
    # The normal, seen from the new frame, is turned back by theta.
    turned = fixed[:3, :3].T @ normal
    theta = math.atan2(-turned[1], turned[0])
    last = axes[-1]
    axes[-1] = Axis(last.alpha, last.a, last.d + z - d * cosine, last.theta + theta0, last.kind)
    axes.append(Axis(alpha, a, d, theta, kind))
