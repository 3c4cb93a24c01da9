"""Zig-zag paths that cover the calibration workspace evenly (peng2024 II-B)."""

from __future__ import annotations

from typing import Final

import numpy as np

from truejoint.array_types import Array
from truejoint.errors import TrajectoryError
from truejoint.motion.trajectory import Trajectory, generated, workspace_of
from truejoint.robots import Robot, Workspace

DIRECTIONS: Final = ("J1", "J2", "J3", "J1-J2", "J2-J3", "J1-J3", "J1-J2-J3")
"""Joints that move along the strokes of a zig-zag; J1 to J3 are the positioning joints."""

_MOST_DIVISIONS: Final = 50

_EDGE: Final = 1.0 / np.sqrt(3.0)
_HALF_DIAGONAL: Final = 1.0 / np.sqrt(6.0)


def zigzag(
    robot: Robot,
    direction: str = "J2-J3",
    sparsity: float = 1 / 4,
    *,
    workspace: Workspace | None = None,
) -> Trajectory:
    """Zig-zag path: strokes along `direction` on an even grid across it.

    Every direction has the same centre (peng2024 eq. 4) and covers the same volume, 1/sqrt(27)
    of the workspace: a box whose joint ranges are, as shares of the workspace's (eq. 5),
    1/sqrt(3) for a joint that moves alone, sqrt(2/3) for two that move together and 1 for three.

    A rigid turn of the unit cube (eq. 1 and 2) meets this exactly for one and two joints, but no
    rotation has equal extents of sqrt(3) along three axes, and scaling the turned cube to range 1
    (eq. 3) covers more volume than the other directions do. So for three joints the box is the
    one nearest to a cube that has range 1 and the common volume, both exactly; its edges are
    1.3 % longer than the cube's and stand at 98.8 deg.

    Parameters
    ----------
    robot : Robot
        With three positioning joints.
    direction : str
        One of `DIRECTIONS`.
    sparsity : float
        Distance between neighbouring strokes as a share of the box, in [1/50, 1]. The box is
        divided evenly, so that 1/sparsity is rounded to the nearest whole number: 0.33 is 1/3.
    workspace : Workspace, optional
        Where to move; by default `workspace_of(robot)`.

    Returns
    -------
    Trajectory
        A path, by its 2 (1/sparsity + 1)^2 corners.

    Raises
    ------
    TrajectoryError
        If the direction is unknown, the sparsity out of range or the robot has no workspace.

    Examples
    --------
    >>> zigzag(truejoint.get_robot("raven2"), "J2-J3", 1 / 4).joints
    ('shoulder', 'elbow', 'insertion')
    """
    if direction.upper() not in DIRECTIONS:
        raise TrajectoryError(
            f"direction {direction!r} is unknown; choose one of {', '.join(DIRECTIONS)}"
        )
    if not 1.0 / _MOST_DIVISIONS <= sparsity <= 1.0:
        raise TrajectoryError(f"sparsity {sparsity} must be within [1/{_MOST_DIVISIONS}, 1]")
    space = workspace or workspace_of(robot)
    if len(space.joints) != 3:
        raise TrajectoryError(
            f"a zig-zag needs 3 joints; the workspace has {', '.join(space.joints)}"
        )
    direction, divisions = direction.upper(), round(1.0 / sparsity)
    shares = (_unit_snake(divisions) - 0.5) @ zigzag_box(direction).T
    meta = {"kind": "zigzag", "direction": direction, "sparsity": 1.0 / divisions}
    ends = {"lower": space.lower.tolist(), "upper": space.upper.tolist()}
    name, positions = f"zigzag {direction} 1/{divisions}", space.centre + space.extent * shares
    return generated(robot, space, positions, name=name, meta=meta | ends)


def zigzag_box(direction: str) -> Array:
    """Edges (3, 3) of the box that a zig-zag covers, as shares of the joints' ranges.

    One edge a column, one joint a row: the first edge is the stroke, the strokes of a layer lie
    along the second, the layers along the third.
    """
    moving = [int(part[1]) - 1 for part in direction.split("-")]
    if len(moving) == 3:
        return _triple_box()
    if len(moving) == 1:
        # Joints in cyclic order from the one that moves: a turn of the whole cube.
        return np.asarray(np.roll(np.eye(3), moving[0], axis=0) * _EDGE)
    box = np.zeros((3, 3))
    box[moving, 0] = _HALF_DIAGONAL
    box[moving, 1] = -_HALF_DIAGONAL, _HALF_DIAGONAL
    box[3 - sum(moving), 2] = _EDGE
    return box


def _triple_box() -> Array:
    """Edges (3, 3) whose rows have absolute sum 1 and whose volume is 1/sqrt(27).

    Signed cyclic shifts of (a, a, b) with 2 a + b = 1 have the volume (a + b)^2 (2 a - b); of the
    two solutions the nearer to a cube is taken. Among all boxes with these ranges and this
    volume, it has the smallest deviation of the edges' inner products from those of a cube.
    """
    # (1 - a)^2 (4 a - 1) = 1 / sqrt(27)
    roots = np.roots([4.0, -9.0, 6.0, -1.0 - 1.0 / np.sqrt(27.0)]).real
    a = float(np.sort(roots)[0])
    b = 1.0 - 2.0 * a
    return np.array([[a, -b, a], [a, a, -b], [b, -a, -a]])


def _unit_snake(divisions: int) -> Array:
    """Corners (2 (divisions + 1)^2, 3) of a zig-zag through the unit cube.

    Strokes along the first axis turn back each time, rows along the second with each layer.
    """
    rows = divisions + 1
    stroke = np.arange(rows * rows)
    layer, row = np.divmod(stroke, rows)
    row = np.where(layer % 2 == 0, row, divisions - row)
    across = np.repeat(np.column_stack([row, layer]) / divisions, 2, axis=0)
    along = np.resize([0.0, 1.0, 1.0, 0.0], len(across))
    return np.column_stack([along, across])
