"""Kinematics of the two RAVEN-II arms, with the closed-form inverse."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike

from truejoint.array_types import Array
from truejoint.compiled import compiled, local_matrix, local_vector
from truejoint.errors import RobotError
from truejoint.robots.chain import Axis, SerialChain, advance, rigid, to_base

Arm = Literal["left", "right"]

# Link twists, shaft and wrist: uw-biorobotics/raven2:include/raven/r2_kinematics.h, described
# in the University of Washington technical report UWEETR-2012-0006.
LINK1_TWIST: Final = math.radians(75.0)
LINK2_TWIST: Final = math.radians(52.0)
SHAFT_OFFSET: Final = -0.47  # from the insertion's zero to the wrist along the shaft [m]
WRIST_LENGTH: Final = 0.013  # from wrist axis to jaw axis of the 10 mm RAVEN grasper [m]

# Angle of the first two axes where the joint reads zero:
# uw-biorobotics/raven2:src/raven/r2_kinematics.cpp (joint2theta).
_SHOULDER_ZERO: Final = {"left": math.radians(205.0), "right": math.radians(25.0)}
_ELBOW_ZERO: Final = {"left": math.pi, "right": 0.0}

# Rotation of frame 0 in the frame of the CRTK topics:
# uw-biorobotics/raven2:src/raven/crtk_motion_api.cpp (branch crtk).
_CRTK_ROTATION: Final = {
    "left": ((0.0, -1.0, 0.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0)),
    "right": ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)),
}

# Columns: shoulder elbow insertion roll wrist jaw1 jaw2; the last axis is the direction in which
# the closed jaws would point (r2_kinematics.cpp: half the difference of the jaws).
_AXIS_FROM_JOINT: Final = np.vstack([np.eye(5, 7), [0, 0, 0, 0, 0, -0.5, 0.5]])

# A pose is refused where the wrist is nearer than this to the remote centre [m]: the shaft's
# direction, and with it shoulder and elbow, is lost there.
_REMOTE_CENTRE: Final = 1e-3
# How much 1 m of insertion counts against 1 rad when the nearest solution is chosen; the
# weight that the robot's own controller uses (r2_kinematics.cpp, check_solutions).
_WEIGHTS: Final = np.array([1.0, 1.0, 100.0, 1.0, 1.0, 1.0])
_TURNS: Final = [0, 1, 3, 4, 5]  # axes whose value is an angle

_REACHED, _OUT_OF_CONE, _AT_CENTRE, _WRIST_UNDEFINED = 0, 1, 2, 3
_REASONS: Final = {
    _OUT_OF_CONE: "shoulder and elbow cannot point the shaft there; keep the wrist more than "
    "23 deg off the shoulder's axis, as seen from the remote centre",
    _AT_CENTRE: "the wrist would be within 1 mm of the remote centre, where the shaft's "
    "direction is undefined; move the tool away from it",
    _WRIST_UNDEFINED: "the jaw axis passes through the remote centre, so that the wrist is "
    "undefined; turn the tool a little",
}


@dataclass(frozen=True, eq=False)
class Raven2Kinematics(SerialChain):
    """Kinematics of one RAVEN-II arm with the 10 mm RAVEN grasper.

    Joint vectors are shoulder, elbow, insertion, roll, wrist, jaw1, jaw2 [rad, insertion m]; poses
    are those of the tool in frame 0, whose origin is the remote centre of motion.
    """

    def solutions(self, pose: ArrayLike, opening: float = 0.0) -> Array:
        """All joint positions (n_solutions, 7) that reach a pose; up to 8, angles in [-pi, pi].

        Two bends of wrist and elbow and two sides of the remote centre (UWEETR-2012-0006), without
        joint limits. `pose` (4, 4) [m] is the tool's in frame 0, `opening` the sum of the jaw
        positions [rad], on which it does not depend. Raises RobotError if `pose` is not rigid or
        out of reach.
        """
        target = rigid(pose)
        axes = np.full((8, 6), np.nan)
        status = _solve(target, self._arrays[0], axes)
        found = axes[np.isfinite(axes).all(axis=1)]
        # At the centre also where the wrist could bend the other way: the arm would leap there.
        if status == _AT_CENTRE or len(found) == 0:
            x, y, z = 1e3 * target[:3, 3]
            raise RobotError(
                f"pose with the tool at ({x:.1f}, {y:.1f}, {z:.1f}) mm cannot be reached: "
                f"{_REASONS[status]}"
            )
        found[:, _TURNS] = _wrapped(found[:, _TURNS])
        return _joints(found, opening)

    def inverse(self, pose: ArrayLike, seed: ArrayLike) -> Array:
        """Joint positions (7,) that reach `pose`, of the solutions the one nearest to `seed` (7,).

        The jaws' opening is taken from the seed [rad, m], and angles are given within half a turn
        of it. Raises RobotError as `solutions`, and if `seed` is not 7 finite values.
        """
        start = np.asarray(seed, dtype=float)
        if start.shape != (7,) or not np.isfinite(start).all():
            raise RobotError(f"seed {start.tolist()} must be 7 finite joint positions")
        origin = self.axis_from_joint @ start
        opening = float(start[5] + start[6])
        axes = self.solutions(pose, opening) @ self.axis_from_joint.T
        axes[:, _TURNS] = origin[_TURNS] + _wrapped(axes[:, _TURNS] - origin[_TURNS])
        nearest = int(np.argmin((((axes - origin) * _WEIGHTS) ** 2).sum(axis=1)))
        return np.asarray(_joints(axes[nearest : nearest + 1], opening)[0])


def kinematics(arm: Arm) -> Raven2Kinematics:
    """Kinematics of the left (gold) or the right (green) arm.

    Source: uw-biorobotics/raven2:src/raven/r2_kinematics.cpp, UWEETR-2012-0006.
    """
    left = arm == "left"
    quarter = math.pi / 2 if left else -math.pi / 2
    axes = (
        Axis(0.0 if left else math.pi, 0.0, 0.0, _SHOULDER_ZERO[arm]),
        Axis(LINK1_TWIST, 0.0, 0.0, _ELBOW_ZERO[arm]),
        Axis(math.pi - LINK2_TWIST if left else LINK2_TWIST, 0.0, 0.0, quarter, "prismatic"),
        Axis(0.0, 0.0, SHAFT_OFFSET, 0.0),
        Axis(math.pi / 2, 0.0, 0.0, -math.pi / 2),
        Axis(math.pi / 2, WRIST_LENGTH, 0.0, 0.0),
    )
    crtk_from_base = np.eye(4)
    crtk_from_base[:3, :3] = _CRTK_ROTATION[arm]
    return Raven2Kinematics(axes, _AXIS_FROM_JOINT, crtk_from_base)


def _joints(axes: Array, opening: float) -> Array:
    """Joint positions (n, 7) of axis values (n, 6) with the jaws `opening` [rad] apart."""
    jaws = np.column_stack([opening / 2 - axes[:, 5], opening / 2 + axes[:, 5]])
    return np.hstack([axes[:, :5], jaws])


def _wrapped(angle: Array) -> Array:
    return np.asarray(np.remainder(angle + np.pi, 2 * np.pi) - np.pi)


@compiled
def _solve(pose: Array, table: Array, out: Array) -> int:
    """Fill `out` (8, 6) with the axis values that reach `pose`; rows stay NaN where none does.

    The shaft passes through the remote centre (the origin), and wrist, remote centre and the
    jaw axis' direction share a plane: that gives the wrist, the wrist gives the shaft, the shaft
    gives shoulder and elbow, and what rotation is left gives roll, wrist and jaws.
    """
    tool, x6, z6 = local_vector(3), local_vector(3), local_vector(3)
    for i in range(3):
        tool[i], x6[i], z6[i] = pose[i, 3], pose[i, 0], pose[i, 2]
    across, x5, wrist = local_vector(3), local_vector(3), local_vector(3)
    wrist_length, shaft_offset = table[5, 2], table[3, 3]
    # The wrist lies where the remote centre is seen from the tool, across the jaw axis.
    along = _dot(tool, z6)
    for i in range(3):
        across[i] = along * z6[i] - tool[i]
    distance = np.sqrt(_dot(across, across))
    if not (distance > 1e-9):
        return _WRIST_UNDEFINED
    status = _OUT_OF_CONE
    row = 0
    for bend in (-1.0, 1.0):
        for i in range(3):
            x5[i] = bend * across[i] / distance
            wrist[i] = tool[i] - wrist_length * x5[i]
        depth = np.sqrt(_dot(wrist, wrist))
        if not (depth > _REMOTE_CENTRE):
            return _AT_CENTRE
        for side in (-1.0, 1.0):
            # The shaft's direction, seen before the shoulder turns, gives the elbow.
            away = side * depth
            v_x, y, z = wrist[0] / away, wrist[1] / away, wrist[2] / away
            v_y = table[0, 0] * y + table[0, 1] * z
            v_z = table[0, 0] * z - table[0, 1] * y
            cosine = (table[1, 0] * table[2, 0] - v_z) / (table[1, 1] * table[2, 1])
            if not (abs(cosine) <= 1.0 + 1e-9):
                row += 2
                continue
            for elbow in (-1.0, 1.0):
                status = _REACHED
                theta2 = elbow * np.arccos(min(1.0, max(-1.0, cosine)))
                insertion = side * depth - shaft_offset
                _finish(theta2, v_x, v_y, insertion, x5, x6, z6, table, out[row])
                row += 1
    return status


@compiled
def _finish(
    theta2: float,
    v_x: float,
    v_y: float,
    insertion: float,
    x5: Array,
    x6: Array,
    z6: Array,
    table: Array,
    out: Array,
) -> None:
    """Axis values (6,) of one solution, given the elbow's angle and the wrist's x axis."""
    h_x = np.sin(theta2) * table[2, 1]
    h_y = -np.cos(theta2) * table[2, 1] * table[1, 0] - table[2, 0] * table[1, 1]
    theta1 = np.arctan2(v_y, v_x) - np.arctan2(h_y, h_x)
    out[0] = theta1 - table[0, 4]
    out[1] = theta2 - table[1, 4]
    out[2] = insertion
    frame, tip, jaw = local_matrix(3, 4), local_vector(3), local_vector(3)
    to_base(frame)
    advance(frame, table[0], out[0], False)
    advance(frame, table[1], out[1], False)
    advance(frame, table[2], out[2], True)
    for k in range(3):
        tip[k], jaw[k] = _along(frame, k, x5), _along(frame, k, z6)
    cos5, sin5 = -jaw[2], tip[2]
    theta4 = np.arctan2(cos5 * tip[1] + sin5 * jaw[1], cos5 * tip[0] + sin5 * jaw[0])
    z5_along_x6 = np.sin(theta4) * _along(frame, 0, x6) - np.cos(theta4) * _along(frame, 1, x6)
    out[3] = theta4 - table[3, 4]
    out[4] = np.arctan2(sin5, cos5) - table[4, 4]
    out[5] = np.arctan2(z5_along_x6, _dot(x5, x6)) - table[5, 4]


@compiled
def _dot(a: Array, b: Array) -> float:
    """Scalar product of two vectors (3,)."""
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


@compiled
def _along(frame: Array, k: int, vector: Array) -> float:
    """Component of a vector (3,) along axis `k` of a frame (3, 4)."""
    return float(frame[0, k] * vector[0] + frame[1, k] * vector[1] + frame[2, k] * vector[2])
