"""A temporary encoder on a joint, the ground truth of a calibration."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

from truejoint.errors import RobotError

End = Literal["lower", "upper"]


@dataclass(frozen=True)
class JointEncoder:
    """Encoder that counts from where it was switched on, registered at the joint's hard stop.

    Attributes
    ----------
    joint : str
    resolution : float
        Joint motion per count [rad or m].
    hard_stop : float
        Position that is assigned to the hard stop [rad or m]; it may be another than the robot's
        own homing assigns, which makes a constant offset between the two.
    end : {"lower", "upper"}
        Of the joint, at which the stop is.
    direction : int
        +1 where counts rise with the joint's position, -1 where they fall.
    tolerance : int
        Counts from the extreme that still belong to the stop.

    Raises
    ------
    RobotError
        If a number is out of range.

    Examples
    --------
    >>> truejoint.get_robot("raven2").encoders[0].end
    'lower'
    """

    joint: str
    resolution: float
    hard_stop: float
    end: End = "upper"
    direction: int = 1
    tolerance: int = 20

    def __post_init__(self) -> None:
        good = 0 < self.resolution < math.inf and math.isfinite(self.hard_stop)
        good = good and self.direction in (-1, 1) and self.tolerance >= 0
        if not good or self.end not in get_args(End):
            raise RobotError(
                f"encoder of {self.joint}: resolution {self.resolution:g}, hard stop "
                f"{self.hard_stop:g}, direction {self.direction}, tolerance {self.tolerance}, end "
                f"{self.end!r:.40}; want a resolution above 0, a hard stop that is a number, a "
                "direction of 1 or -1, 0 or more counts, lower or upper"
            )
