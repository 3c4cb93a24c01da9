"""A loop around motors in place of joints: it keeps what they report to where they shall be."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from truejoint.array_types import Array
from truejoint.robots import Robot
from truejoint.robots.robot import as_robot
from truejoint.runtime.compensator import LAG, Compensator
from truejoint.runtime.status import Status


class Uncorrected:
    """Stands for a corrector where the motors shall be what is wanted: it says what they report.

    Parameters
    ----------
    robot : Robot

    Examples
    --------
    >>> Uncorrected(truejoint.get_robot("raven2")).joints[:2]
    ('shoulder', 'elbow')
    """

    def __init__(self, robot: Robot) -> None:
        self.made_for: Final = as_robot(robot).name, robot.arm
        self.joints: Final = robot.joint_names
        self.signals: Final = tuple(f"measured/{name}" for name in self.joints)
        self.spike_speed: Final = np.full(len(self.joints), math.inf)
        self.position, self.correction, self.offset = np.zeros((3, len(self.joints)))
        self.beside: Final[dict[str, Array]] = {}
        self.gives_way: Final[dict[str, Array]] = {}
        self._t = -math.inf

    def step(self, t: float, sample: ArrayLike) -> Status:
        """Take the `sample` (n_joints,) of `t` [s] as it is, unless it is old or not finite."""
        try:
            values, stamp = np.asarray(sample, dtype=np.float64), float(t)
        except (TypeError, ValueError):
            return Status.WRONG_SIZE
        if values.shape != self.position.shape:
            return Status.WRONG_SIZE
        if not (math.isfinite(stamp) and np.isfinite(values).all()):
            return Status.NOT_FINITE
        self.position[:] = values
        if stamp <= self._t:
            return Status.STALE
        self._t = stamp
        return Status.OK

    def release(self) -> None:
        """Forget the last stamp: another arm's clock may be earlier."""
        self._t = -math.inf


def motor_loop(robot: Robot, rate: float = 100.0, lag: float = LAG) -> Compensator:
    """Loop for `truejoint.motion.follow` that keeps what an arm reports to a trajectory.

    It makes up for what friction and the robot's own controller leave between set-point and
    measured position; of what the cables lose it knows nothing. `rate` [Hz] must divide the arm's;
    `lag` [s] is that of `Compensator`.

    Examples
    --------
    >>> path = truejoint.motion.Trajectory(("elbow",), ("rad",), np.array([[1.5], [1.52]]))
    >>> report = truejoint.motion.follow(arm, path, steering=motor_loop(arm.robot))
    >>> bool(report.rms[0] < 1e-3)
    True
    """
    return Compensator(Uncorrected(robot), robot, rate=rate, lag=lag)
