"""Kinematics of a serial arm in modified Denavit-Hartenberg parameters, compiled."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truejoint.array_types import Array, Mask
from truejoint.compiled import compiled, local_matrix
from truejoint.errors import RobotError
from truejoint.mechanics import solve
from truejoint.robots.parts import Axis, Kinematics

_RIGID_TOLERANCE: Final = 1e-6
# How near a search for joint positions comes [m, rad], far below what any joint encoder resolves.
_THERE: Final = 1e-11
_AT_POINT: Final = 1e-9  # [m]
_STEPS: Final = 100
_DAMPING: Final = 1e-14  # the least that keeps steps solvable where an arm is singular
_LONGEST_STEP: Final = 0.3  # [rad, m]


@dataclass(frozen=True, eq=False)
class SerialChain:
    """Kinematics of a serial arm, vectorised over rows."""

    axes: Sequence[Axis]  # from the base to the tool
    # Values of the axes as a linear function of the joint positions, (n_axes, n_joints): the two
    # jaws of a gripper, for instance, turn the last axis by half their difference.
    axis_from_joint: Array
    # Pose (4, 4) of the base frame in the frame in which the robot's CRTK topics state poses.
    crtk_from_base: Array = field(default_factory=lambda: np.eye(4))
    # Orientation (3, 3) of the tool in the last axis' frame.
    tool_rotation: Array = field(default_factory=lambda: np.eye(3))

    def forward(self, joint: ArrayLike) -> Array:
        """Tool poses (..., 4, 4) [m] in the base frame, of joint positions (..., n_joints)."""
        poses = self._frames(joint, 1)[..., 0, :, :]
        poses[..., :3, :3] = poses[..., :3, :3] @ self.tool_rotation
        return poses

    def link_frames(self, joint: ArrayLike) -> Array:
        """Frames of all axes (..., n_axes, 4, 4) [m] in the base frame."""
        return self._frames(joint, len(self.axes))

    def jacobian(self, joint: ArrayLike) -> Array:
        """Jacobian (..., 6, n_joints) at the tool, in the base frame: linear over angular."""
        rows, shape = self._rows(joint)
        by_axis = np.empty((len(rows), 6, len(self.axes)))
        _jacobian(*self._arrays, rows, by_axis)
        jacobian: Array = by_axis @ self.axis_from_joint
        return jacobian.reshape(*shape, 6, rows.shape[1])

    def inverse(self, pose: ArrayLike, seed: ArrayLike) -> Array:
        """Joint positions (n_joints,) that reach a tool pose (4, 4) [m], found from `seed`.

        By Newton steps along the Jacobian, the shortest ones where there are more joints than the
        tool can tell; of several solutions one near the seed. Raises RobotError if `pose` is not
        rigid, `seed` not finite, or no solution is found.
        """
        target, (rows, _) = rigid(pose), self._rows(seed)
        if not np.isfinite(rows).all():
            raise RobotError(f"seed {rows[0].tolist()} must be finite joint positions")
        last, joints = target.copy(), rows.copy()  # the last axis' pose, without the tool
        last[:3, :3] = target[:3, :3] @ self.tool_rotation.T
        _search(*self._arrays, last, joints)
        joint: Array = joints[0]
        if np.abs(self.forward(joint) - target).max() < 10.0 * _THERE:
            return joint
        x, y, z = 1e3 * target[:3, 3]
        raise RobotError(
            f"pose with the tool at ({x:.1f}, {y:.1f}, {z:.1f}) mm cannot be reached from where "
            "the joints are; approach it in smaller steps"
        )

    def up_to(self, joint: int) -> "SerialChain":
        """Chain as far as the link that the joint with that place in a joint vector moves.

        `forward` and `jacobian` are then of that link. Raises RobotError if the joint moves none.
        """
        moved = np.flatnonzero(self.axis_from_joint[:, joint])
        if not moved.size:
            raise RobotError(f"joint {joint} moves no axis of the chain; name another one")
        count = int(moved[-1]) + 1
        return SerialChain(self.axes[:count], self.axis_from_joint[:count], self.crtk_from_base)

    def _frames(self, joint: ArrayLike, last: int) -> Array:
        """Frames of the last axes (..., last, 4, 4)."""
        rows, shape = self._rows(joint)
        frames = np.empty((len(rows), last, 4, 4))
        _link_frames(*self._arrays, rows, frames)
        return frames.reshape(*shape, last, 4, 4)

    def _rows(self, joint: ArrayLike) -> tuple[Array, tuple[int, ...]]:
        array = np.asarray(joint, dtype=float)
        n_joints = self.axis_from_joint.shape[1]
        if array.ndim == 0 or array.shape[-1] != n_joints:
            raise RobotError(
                f"joint positions have shape {array.shape}; the last dimension must be the "
                f"{n_joints} joints of the arm"
            )
        return np.ascontiguousarray(array.reshape(-1, n_joints)), array.shape[:-1]

    @cached_property
    def _arrays(self) -> tuple[Array, NDArray[np.bool_], Array]:
        """What the kernels take: table of the axes, which are prismatic, `axis_from_joint`."""
        rows = [[np.cos(x.alpha), np.sin(x.alpha), x.a, x.d, x.theta] for x in self.axes]
        prismatic = np.array([axis.kind == "prismatic" for axis in self.axes])
        mapping = np.ascontiguousarray(self.axis_from_joint, dtype=float)
        return np.array(rows), prismatic, mapping


def reach(
    chain: Kinematics, columns: Sequence[int], points: ArrayLike, seed: ArrayLike
) -> tuple[Array, Mask]:
    """Find joint positions (m, n_joints) with the tip at `points` (m, 3) of the base [m].

    Newton's method from `seed` (n_joints,) moves the joints of these `columns`, the shortest way
    where they are more than three; the others stay. Says as well which points (m,) are reached,
    within any range of the joints.
    """
    goal = np.asarray(points, dtype=np.float64)
    joint = np.tile(np.asarray(seed, dtype=np.float64), (len(goal), 1))
    for _ in range(_STEPS):
        error = goal - chain.forward(joint)[:, :3, 3]
        if np.abs(error).max(initial=0.0) < 0.1 * _AT_POINT:
            break
        slope = chain.jacobian(joint)[:, :3, columns]
        across = slope.transpose(0, 2, 1)
        gram = slope @ across
        gram += _DAMPING * gram.trace(axis1=1, axis2=2)[:, None, None] * np.eye(3)
        step = (across @ np.linalg.solve(gram, error[:, :, None]))[:, :, 0]
        largest = np.abs(step).max(axis=1, keepdims=True)
        joint[:, columns] += step * np.minimum(1.0, _LONGEST_STEP / np.maximum(largest, 1e-12))
    there = np.abs(goal - chain.forward(joint)[:, :3, 3]).max(axis=1) < _AT_POINT
    return joint, np.asarray(there)


def rigid(pose: ArrayLike) -> Array:
    """Pose (4, 4) as floats; raises RobotError unless it is a finite rigid transform."""
    target = np.ascontiguousarray(pose, dtype=float)
    if target.shape != (4, 4) or not np.isfinite(target).all():
        raise RobotError(f"pose of shape {target.shape} must be 4 x 4 and finite")
    rotation = target[:3, :3]
    skew = float(np.abs(rotation.T @ rotation - np.eye(3)).max())
    bottom = np.array_equal(target[3], [0.0, 0.0, 0.0, 1.0])
    if not (skew < _RIGID_TOLERANCE and np.linalg.det(rotation) > 0 and bottom):
        raise RobotError(
            "pose is not a rigid transform: its upper left 3 x 3 must be a rotation matrix "
            f"(off by {skew:.1e}) and its last row 0 0 0 1"
        )
    return target


@compiled
def _advance(frame: Array, row: Array, value: float, prismatic: bool) -> None:
    """Move `frame` (3, 4) in place from one axis to the next: Rx(alpha) Tx(a) Rz(theta) Tz(d).

    Turning the columns of the frame takes a third of the products of a matrix multiplication.
    """
    cos_alpha, sin_alpha, a, d, theta = row[0], row[1], row[2], row[3], row[4]
    if prismatic:
        d += value
    else:
        theta += value
    cos_theta, sin_theta = np.cos(theta), np.sin(theta)
    for i in range(3):
        x, y, z = frame[i, 0], frame[i, 1], frame[i, 2]
        turned = cos_alpha * y + sin_alpha * z
        along = cos_alpha * z - sin_alpha * y
        frame[i, 0] = cos_theta * x + sin_theta * turned
        frame[i, 1] = cos_theta * turned - sin_theta * x
        frame[i, 2] = along
        frame[i, 3] += a * x + d * along


@compiled
def _axis_value(mapping: Array, axis: int, joint: Array) -> float:
    value = 0.0
    for j in range(joint.size):
        # A joint that does not move the axis must not hand its NaN on to it.
        if mapping[axis, j] != 0.0:
            value += mapping[axis, j] * joint[j]
    return value


@compiled
def _to_base(frame: Array) -> None:
    """Make `frame` (3, 4) that of the base."""
    for i in range(3):
        for j in range(4):
            frame[i, j] = 1.0 if i == j else 0.0


@compiled
def _link_frames(
    table: Array, prismatic: NDArray[np.bool_], mapping: Array, joints: Array, frames: Array
) -> None:
    """Fill `frames` (n, m, 4, 4) with those of the last m axes."""
    first, frame = table.shape[0] - frames.shape[1], local_matrix(3, 4)
    for n in range(joints.shape[0]):
        _to_base(frame)
        for k in range(table.shape[0]):
            _advance(frame, table[k], _axis_value(mapping, k, joints[n]), prismatic[k])
            if k >= first:
                for j in range(4):
                    for i in range(3):
                        frames[n, k - first, i, j] = frame[i, j]
                    frames[n, k - first, 3, j] = 1.0 if j == 3 else 0.0


@compiled
def _jacobian(
    table: Array, prismatic: NDArray[np.bool_], mapping: Array, joints: Array, out: Array
) -> None:
    n_axes, frame = table.shape[0], local_matrix(3, 4)
    for n in range(joints.shape[0]):
        _to_base(frame)
        for k in range(n_axes):
            _advance(frame, table[k], _axis_value(mapping, k, joints[n]), prismatic[k])
            for i in range(3):  # each axis' place and direction, until the tool's place is known
                out[n, i, k], out[n, 3 + i, k] = frame[i, 3], frame[i, 2]
        for k in range(n_axes):
            zx, zy, zz = out[n, 3, k], out[n, 4, k], out[n, 5, k]
            x, y = frame[0, 3] - out[n, 0, k], frame[1, 3] - out[n, 1, k]
            z = frame[2, 3] - out[n, 2, k]
            if prismatic[k]:
                out[n, 0, k], out[n, 1, k], out[n, 2, k] = zx, zy, zz
                out[n, 3, k], out[n, 4, k], out[n, 5, k] = 0.0, 0.0, 0.0
            else:
                out[n, 0, k] = zy * z - zz * y
                out[n, 1, k] = zz * x - zx * z
                out[n, 2, k] = zx * y - zy * x


@compiled
def _miss(frame: Array, goal: Array, error: Array) -> float:
    """Fill `error` (1, 6) with the way [m] and turn [rad] from a frame to `goal`; the largest."""
    turn = local_matrix(3, 3)
    for i in range(3):
        error[0, i] = goal[i, 3] - frame[i, 3]
        for j in range(3):
            turn[i, j] = 0.0
            for k in range(3):
                turn[i, j] += goal[i, k] * frame[j, k]
    error[0, 3] = 0.5 * (turn[2, 1] - turn[1, 2])
    error[0, 4] = 0.5 * (turn[0, 2] - turn[2, 0])
    error[0, 5] = 0.5 * (turn[1, 0] - turn[0, 1])
    sine = np.sqrt(error[0, 3] ** 2 + error[0, 4] ** 2 + error[0, 5] ** 2)
    angle = np.arctan2(sine, 0.5 * (turn[0, 0] + turn[1, 1] + turn[2, 2] - 1.0))
    largest = 0.0
    for i in range(6):
        if i >= 3 and sine > 0.0:
            error[0, i] *= angle / sine
        largest = max(largest, abs(error[0, i]))
    return float(largest)


@compiled
def _newton_step(by_axis: Array, mapping: Array, slope: Array, error: Array) -> float:
    """Fill the first row of `slope` (6, n_joints) with the step that mends `error`; the largest."""
    gram, trace, n_joints = local_matrix(6, 6), 0.0, mapping.shape[1]
    for i in range(6):
        for j in range(n_joints):
            slope[i, j] = 0.0
            for k in range(mapping.shape[0]):
                slope[i, j] += by_axis[i, k] * mapping[k, j]
            trace += slope[i, j] * slope[i, j]
    for i in range(6):
        for j in range(6):
            gram[i, j] = _DAMPING * trace if i == j else 0.0
            for k in range(n_joints):
                gram[i, j] += slope[i, k] * slope[j, k]
    solve(gram, error[0])
    largest = 1e-12
    for j in range(n_joints):
        step = 0.0
        for i in range(6):
            step += slope[i, j] * error[0, i]
        slope[0, j] = step
        largest = max(largest, abs(step))
    return float(largest)


@compiled
def _search(
    table: Array, prismatic: NDArray[np.bool_], mapping: Array, goal: Array, joint: Array
) -> None:
    """Take Newton's steps from `joint` (1, n_joints) to the last axis' pose `goal` (4, 4)."""
    frames, by_axis = np.empty((1, 1, 4, 4)), np.empty((1, 6, table.shape[0]))
    error, slope = local_matrix(1, 6), np.empty((6, joint.shape[1]))
    for _ in range(_STEPS):
        _link_frames(table, prismatic, mapping, joint, frames)
        if _miss(frames[0, 0], goal, error) < _THERE:
            break
        _jacobian(table, prismatic, mapping, joint, by_axis)
        largest = _newton_step(by_axis[0], mapping, slope, error)
        for j in range(joint.shape[1]):
            joint[0, j] += slope[0, j] * min(1.0, _LONGEST_STEP / largest)
