"""A temporary encoder on a joint, the ground truth of a calibration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from truejoint.schema import Bounds, Positive

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
        End of the joint's range at which the stop is.
    direction : int
        +1 where counts rise with the joint's position, -1 where they fall.
    tolerance : int
        Counts from the extreme that still belong to the stop.

    Examples
    --------
    >>> truejoint.get_robot("raven2").encoders[0].end
    'lower'
    """

    joint: str
    resolution: Positive
    hard_stop: float
    end: End = "upper"
    direction: Literal[1, -1] = 1
    tolerance: Annotated[int, Bounds(0)] = 20
