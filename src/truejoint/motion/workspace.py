"""Where a calibration moves: ranges and speeds of the positioning joints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from truejoint.crtk.messages import Array
from truejoint.errors import TrajectoryError
from truejoint.robots import Robot, raven2


@dataclass(frozen=True, eq=False)
class Workspace:
    """Box of joint positions that a calibration covers; all arrays are (n_joints,).

    Attributes
    ----------
    joints : tuple of str
        In the order of every array.
    lower, upper : ndarray
        Range of each joint [rad or m].
    speed : ndarray
        Speed caps while following a path [rad/s or m/s].

    Examples
    --------
    >>> workspace_of(truejoint.get_robot("raven2")).lower.shape
    (3,)
    """

    joints: tuple[str, ...]
    lower: Array
    upper: Array
    speed: Array

    @property
    def centre(self) -> Array:
        """Middle of each range [rad or m] (peng2024 eq. 4)."""
        return np.asarray((self.lower + self.upper) / 2)

    @property
    def extent(self) -> Array:
        """Width of each range [rad or m] (peng2024 eq. 5)."""
        return np.asarray(self.upper - self.lower)


_RAVEN2: Final = Workspace(
    joints=raven2.POSITIONING,
    lower=np.array([raven2.CALIBRATION_RANGE[name][0] for name in raven2.POSITIONING]),
    upper=np.array([raven2.CALIBRATION_RANGE[name][1] for name in raven2.POSITIONING]),
    speed=np.array([raven2.CALIBRATION_SPEED[name] for name in raven2.POSITIONING]),
)


def workspace_of(robot: Robot) -> Workspace:
    """Calibration workspace of a robot; raises TrajectoryError where none is known.

    Examples
    --------
    >>> workspace_of(truejoint.get_robot("raven2")).joints
    ('shoulder', 'elbow', 'insertion')
    """
    if robot.name == "raven2":
        return _RAVEN2
    raise TrajectoryError(
        f"no calibration workspace is known for {robot.title}; give one as a Workspace"
    )
