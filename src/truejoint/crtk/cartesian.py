"""Poses and twists of a tool, in the frame of the robot's CRTK topics."""

from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation, Slerp

from truejoint.array_types import Array
from truejoint.errors import RobotError
from truejoint.robots.chain import rigid
from truejoint.robots.parts import Kinematics

# Between two points of a straight line the joints go straight: 2 mm or 2 deg apart the tool
# strays by micrometres.
_SPACING: Final = 2e-3
_TURN: Final = np.deg2rad(2.0)
_FARTHEST: Final = 10.0  # [m] that no tool goes: a pose in mm


def pose(kinematics: Kinematics, joint: ArrayLike) -> Array:
    """Tool poses (..., 4, 4) [m] at joint positions (..., n_joints) [rad or m]."""
    return np.asarray(kinematics.crtk_from_base @ kinematics.forward(joint))


def jacobian(kinematics: Kinematics, joint: ArrayLike, frame: str = "") -> Array:
    """Geometric Jacobian (..., 6, n_joints): velocity over angular velocity.

    The velocity is that of the tool's point along the axes of the CRTK topics, or along the tool's
    own (``"body"``), or that of the point of the tool which passes the origin (``"spatial"``), as
    R. Murray, Z. Li and S. Sastry have it (A Mathematical Introduction to Robotic Manipulation,
    1994, 2.4).
    """
    rows, turned = kinematics.jacobian(joint), kinematics.crtk_from_base[:3, :3]
    if frame == "body":
        turned = np.swapaxes(pose(kinematics, joint)[..., :3, :3], -1, -2) @ turned
    velocity, turning = turned @ rows[..., :3, :], turned @ rows[..., 3:, :]
    if frame == "spatial":
        place = pose(kinematics, joint)[..., :3, 3:]
        velocity = velocity - np.cross(turning, place, axis=-2)
    return np.concatenate([velocity, turning], axis=-2)


def place_and_turn(pose: Array) -> tuple[Array, Array]:
    """Place (3,) [m] and unit quaternion (4,), x, y, z and w, of a pose (4, 4)."""
    return pose[:3, 3], Rotation.from_matrix(pose[:3, :3]).as_quat()


def joints_at(kinematics: Kinematics, target: ArrayLike, seed: Array) -> Array:
    """Joint positions near `seed` (n_joints,) at a tool pose (4, 4); RobotError out of reach."""
    base_from_crtk = np.linalg.inv(kinematics.crtk_from_base)
    return kinematics.inverse(base_from_crtk @ rigid(target), seed)


def moved(start: Array, increment: ArrayLike) -> Array:
    """Pose (4, 4) shifted by that of an `increment` (4, 4) and turned by it about the tool."""
    by, after = rigid(increment), start.copy()
    after[:3, 3] += by[:3, 3]
    after[:3, :3] = by[:3, :3] @ start[:3, :3]
    return after


def straight_line(kinematics: Kinematics, start: Array, goal: ArrayLike) -> Array:
    """Joint positions (n, n_joints) on a straight line of the tool from `start` to a pose `goal`.

    It turns at an even rate meanwhile. Raises RobotError if some of the way is out of reach.
    """
    first, last = pose(kinematics, start), rigid(goal)
    way = last[:3, 3] - first[:3, 3]
    if (far := np.abs(way).max()) > _FARTHEST:
        raise RobotError(f"the pose is {far:.3g} m from where the tool is; give it in m")
    ends = Rotation.from_matrix(np.stack([first[:3, :3], last[:3, :3]]))
    turn = float((ends[1] * ends[0].inv()).magnitude())
    n = max(1, int(np.ceil(max(np.linalg.norm(way) / _SPACING, turn / _TURN))))
    shares = np.arange(1, n + 1) / n
    turned, target = Slerp([0.0, 1.0], ends)(shares).as_matrix(), last.copy()
    knots, joint = np.empty((n, len(start))), start
    for k, share in enumerate(shares):
        target[:3, 3], target[:3, :3] = first[:3, 3] + share * way, turned[k]
        knots[k] = joint = joints_at(kinematics, target, joint)
    return knots
