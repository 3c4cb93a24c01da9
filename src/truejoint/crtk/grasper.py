"""The grasper of an arm under CRTK's names: its opening is the sum of its jaws."""

from __future__ import annotations

from typing import Final

import numpy as np

from truejoint.array_types import Array
from truejoint.crtk.arm import Arm, as_arm
from truejoint.crtk.handle import Motion
from truejoint.crtk.states import JointState
from truejoint.errors import RobotError


class Grasper:
    """Opens and shuts the jaws of an arm, the other joints staying where they are.

    The opening is the sum of the jaws' positions [rad], as in the topics of RAVEN's grasper
    (uw-biorobotics/raven2, branch crtk); a change of it is shared evenly by the jaws, so that they
    keep their direction.

    Parameters
    ----------
    arm : Arm

    Raises
    ------
    RobotError
        If the robot names no jaws.

    Examples
    --------
    >>> grasper = Grasper(arm)
    >>> grasper.move_jp(1.0).wait()
    >>> print(grasper.setpoint_js().position.round(3))
    [1.]
    """

    def __init__(self, arm: Arm) -> None:
        if not as_arm(arm).robot.grasper:
            raise RobotError(f"grasper: {arm.robot.title} names no jaws; its file may, as grasper")
        self.arm: Final = arm
        self._jaws = arm.robot.index(arm.robot.grasper)

    def measured_js(self) -> JointState:
        """Give the opening, its speed and the jaws' mean effort; refused as the arm's."""
        return self._state(self.arm.measured_js())

    def setpoint_js(self) -> JointState:
        """Latest set-point of the opening; refused as the arm's."""
        return self._state(self.arm.setpoint_js())

    def servo_jp(self, opening: float) -> None:
        """Go to an `opening` [rad] within one servo period; refused as the arm's."""
        self.arm.servo_jp(self._jaws_at(opening))

    def servo_jr(self, increment: float) -> None:
        """Go by an `increment` [rad] from the latest set-point; refused as the arm's."""
        self.arm.servo_jr(self._shared(increment))

    def servo_jv(self, velocity: float) -> None:
        """Go on at a `velocity` [rad/s] for one servo period; refused as the arm's."""
        self.arm.servo_jr(self._shared(velocity / self.arm.rate))

    def move_jp(self, opening: float) -> Motion:
        """Go to an `opening` [rad]; as the arm's."""
        return self.arm.move_jp(self._jaws_at(opening))

    def move_jr(self, increment: float) -> Motion:
        """Go by an `increment` [rad] from the latest set-point; as the arm's."""
        return self.arm.move_jr(self._shared(increment))

    def _shared(self, change: float) -> Array:
        step = np.zeros(len(self.arm.robot.joints))
        step[self._jaws] = change / len(self._jaws)
        return step

    def _jaws_at(self, opening: float) -> Array:
        now = self.arm.setpoint_js(np.inf).position  # however long it has stood
        return np.asarray(now + self._shared(opening - float(now[self._jaws].sum())))

    def _state(self, joints: JointState) -> JointState:
        position, velocity = (
            values[self._jaws].sum(keepdims=True) for values in (joints.position, joints.velocity)
        )
        effort = (
            joints.effort[self._jaws].mean(keepdims=True) if joints.effort.size else np.empty(0)
        )
        return JointState(joints.t, ("grasper",), position, velocity, effort)
