"""A trajectory as data, joint positions with or without times, and the workspace that one fills."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from truejoint.array_types import Array, floats
from truejoint.errors import TrajectoryError, other_kind
from truejoint.robots import Robot, Workspace
from truejoint.robots.robot import as_robot
from truejoint.units import shown_range

_NAME: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_UNITS: Final = frozenset({"rad", "m"})


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Joint positions in order; straight lines in joint space join them.

    A path is kept by its corners alone: the lines between them carry no more information, files
    stay small, a plot is exact at any zoom, and the time law decides on points.

    Attributes
    ----------
    joints : tuple of str
    units : tuple of str
        ``"rad"`` or ``"m"`` for each joint.
    positions : ndarray, shape (n, n_joints)
        At least two rows [rad or m].
    times : ndarray, shape (n,), or None
        Strictly increasing [s]; None for a path without a time law.
    name : str
    meta : mapping
        Origin: plain values that JSON can hold.

    Raises
    ------
    TrajectoryError
        If shapes, names, units or values break one of these rules.

    Examples
    --------
    >>> path = Trajectory(("elbow",), ("rad",), np.array([[0.5], [0.9]]))
    >>> len(path), path.units
    (2, ('rad',))
    """

    joints: tuple[str, ...]
    units: tuple[str, ...]
    positions: Array
    times: Array | None = None
    name: str = "trajectory"
    meta: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for key in ("positions", "times"):
            if (values := getattr(self, key)) is not None:
                numbers = floats(values, f"{self.name}: {key}", TrajectoryError)
                object.__setattr__(self, key, numbers)
        name, joints, positions = self.name, self.joints, self.positions
        bad = any(not _NAME.fullmatch(str(joint)) or joint == "t" for joint in joints)
        bad |= len(set(joints)) != len(joints) or not joints or len(self.units) != len(joints)
        if bad or not set(self.units) <= _UNITS:
            raise TrajectoryError(
                f"{name}: joints {list(joints)} in {list(self.units)}; want distinct names of "
                "letters, digits and _, not t, and for each joint a unit, 'rad' or 'm'"
            )
        if positions.ndim != 2 or positions.shape[1] != len(joints) or len(positions) < 2:
            raise TrajectoryError(
                f"{name}: positions have shape {positions.shape}; want at least 2 rows of "
                f"{len(joints)} joints"
            )
        if not np.isfinite(positions).all():
            row, column = np.argwhere(~np.isfinite(positions))[0]
            raise TrajectoryError(
                f"{name}: {joints[column]} is {positions[row, column]} in row {row}; remove the row"
            )
        times = self.times
        if times is None:
            return
        if times.shape != (len(positions),) or not np.isfinite(times).all():
            raise TrajectoryError(
                f"{name}: times must be {len(positions)} finite values, one for each row"
            )
        if not (np.diff(times) > 0.0).all():
            row = int(np.argmax(np.diff(times) <= 0.0)) + 1
            raise TrajectoryError(
                f"{name}: times must increase, but row {row} has {times[row]:g} s after "
                f"{times[row - 1]:g} s"
            )

    def __len__(self) -> int:
        return len(self.positions)

    def check_within(self, robot: Robot) -> None:
        """Raise TrajectoryError unless all of it lies within the joint limits of `robot`."""
        for k, column in enumerate(robot.index(self.joints)):
            joint = robot.joints[column]
            if joint.unit != self.units[k]:
                raise TrajectoryError(
                    f"{self.name}: {joint.name} is in {self.units[k]}, but {robot.title} moves "
                    f"it in {joint.unit}; convert the trajectory"
                )
            low, high = self.positions[:, k].min(), self.positions[:, k].max()
            if low < joint.lower or high > joint.upper:
                spanned = shown_range(low, high, joint.unit)
                allowed = shown_range(joint.lower, joint.upper, joint.unit)
                raise TrajectoryError(
                    f"{self.name}: {joint.name} spans {spanned}, outside the range {allowed} of "
                    f"{robot.title}; make it smaller"
                )


def as_trajectory(value: object) -> Trajectory:
    """Give back a trajectory; raises TrajectoryError for anything else, saying how to get one."""
    if isinstance(value, Trajectory):
        return value
    raise TrajectoryError(other_kind(value, "Trajectory", "read_trajectory(path) reads one"))


def workspace_of(robot: Robot, stated: Workspace | None = None) -> Workspace:
    """Calibration workspace of a robot, or one that is `stated` for it.

    Raises TrajectoryError where none is known, RobotError where a stated one is beyond the limits
    of the joints, or it is no robot.

    Examples
    --------
    >>> workspace_of(truejoint.get_robot("raven2")).joints
    ('shoulder', 'elbow', 'insertion')
    """
    if stated is not None:
        as_robot(robot).check_workspace(stated)
        return stated
    workspace = as_robot(robot).workspace
    if workspace is None:
        raise TrajectoryError(
            f"no calibration workspace is known for {robot.title}; give its robot file "
            "a table [workspace], or pass a Workspace"
        )
    return workspace
