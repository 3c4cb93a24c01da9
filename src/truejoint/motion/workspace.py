"""Where a calibration of a robot moves, and the trajectories that fill it."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import version
from typing import Any

from truejoint.crtk.messages import Array
from truejoint.errors import TrajectoryError
from truejoint.motion.trajectory import Trajectory
from truejoint.robots import Robot, Workspace


def workspace_of(robot: Robot) -> Workspace:
    """Calibration workspace of a robot; raises TrajectoryError where none is known.

    Examples
    --------
    >>> workspace_of(truejoint.get_robot("raven2")).joints
    ('shoulder', 'elbow', 'insertion')
    """
    if robot.workspace is None:
        raise TrajectoryError(
            f"no calibration workspace is known for {robot.title}; give one as a Workspace"
        )
    return robot.workspace


def generated(
    robot: Robot,
    space: Workspace,
    positions: Array,
    times: Array | None = None,
    *,
    name: str,
    meta: Mapping[str, Any],
) -> Trajectory:
    """Trajectory through `positions` (n, n_joints) [rad or m] of `space`, saying who made it."""
    units = tuple(robot.joint(joint).unit for joint in space.joints)
    origin = {"robot": robot.name, "arm": robot.arm, "version": version("truejoint")}
    return Trajectory(space.joints, units, positions, times, name, {**meta, **origin})
