"""The measured positions in the place of a corrector, for a loop around the motors."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from truejoint.robots import Robot
from truejoint.runtime.status import Status


class MotorReadings:
    """Gives a compensator the measured positions as they are."""

    def __init__(self, robot: Robot) -> None:
        self.made_for: Final = robot.name, robot.arm
        self.joints: Final = robot.joint_names
        self.signals: Final = tuple(f"measured/{name}" for name in self.joints)
        self.spike_speed: Final = np.full(len(self.joints), math.inf)
        self.position, self.correction, self.offset = np.zeros((3, len(self.joints)))
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
        is_stale = stamp <= self._t
        self._t = max(self._t, stamp)
        return Status.STALE if is_stale else Status.OK

    def release(self) -> None:
        """Forget the last stamp: another arm's clock may be earlier."""
        self._t = -math.inf
