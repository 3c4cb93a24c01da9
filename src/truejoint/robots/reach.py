"""Positions of the joints that place the tool's tip at points, whichever way it looks there."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from truejoint.array_types import Array, Mask
from truejoint.errors import RobotError
from truejoint.robots.chain import newton
from truejoint.robots.robot import Robot

_THERE: Final = 1e-9  # [m]


def reach(
    robot: Robot, points: ArrayLike, seed: ArrayLike, joints: Sequence[str] = ()
) -> tuple[Array, Mask]:
    """Find joint positions (m, n_joints) with the tip at `points` (m, 3) of the base [m].

    Newton's method from `seed` (n_joints,) moves `joints`, by default the positioning ones, the
    shortest way where they are more than three; the others stay. Says as well which points (m,)
    are reached, within any range of the joints. Raises RobotError if the kinematics are not known.
    """
    if robot.kinematics is None:
        raise RobotError(
            f"the kinematics of {robot.title} are not known; give its robot file a table "
            "[kinematics]"
        )
    chain, columns = robot.kinematics, robot.index(joints or robot.positioning)
    goal = np.asarray(points, dtype=np.float64)
    joint = newton(
        np.tile(np.asarray(seed, dtype=np.float64), (len(goal), 1)),
        lambda joint: goal - chain.forward(joint)[:, :3, 3],
        lambda joint: chain.jacobian(joint)[:, :3],
        columns,
        0.1 * _THERE,
    )
    there = np.abs(goal - chain.forward(joint)[:, :3, 3]).max(axis=1) < _THERE
    return joint, np.asarray(there)
