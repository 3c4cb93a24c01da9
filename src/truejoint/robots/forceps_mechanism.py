"""The one-jaw cable-driven forceps: geometry and sensors, from yan2020, Table 1 and IV-A."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Final, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from truejoint.errors import RobotError

Angle = TypeVar("Angle", float, NDArray[np.float64])


@dataclass(frozen=True)
class ForcepsMechanism:
    """What turns the motor's angle into the jaw's; symbols of yan2020, Table 1.

    Raises RobotError for a value that is not above 0, or a gear below 1.
    """

    gear_ratio: float  # motor turns per turn of the winding wheel, ``z_i``
    spring_stiffness: float  # reset spring ``K_sp`` [N/m]
    wheel_radius: float  # effective radius of the winding wheel ``R`` [m]
    jaw_radius: float  # radius at which both cables act on the jaw ``r`` [m]

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            least = 1.0 if name == "gear_ratio" else 0.0
            number = isinstance(value, (int, float)) and not isinstance(value, bool)
            if not (number and math.isfinite(value) and value >= least and value > 0.0):
                rule = "1 or more" if least else "above 0, in SI units"
                raise RobotError(f"mechanism: {name} is {value!r:.40}; it must be {rule}")

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Mechanism of plain values; what they do not state is Table 1's.

        Raises RobotError for a name that is none of the four, or a value that cannot be.
        """
        known = [field.name for field in fields(cls)]
        for name in values:
            if name not in known:
                raise RobotError(f"mechanism: {name!r:.60} is not known; use {', '.join(known)}")
        return cls(**{**vars(TABLE_1), **values})

    @property
    def motor_per_jaw(self) -> float:
        """Motor-shaft angle per jaw angle with rigid cables [rad/rad], ``z_i r / R``."""
        return self.gear_ratio * self.jaw_radius / self.wheel_radius

    def motor_from_jaw(self, jaw: Angle) -> Angle:
        """Motor angle [rad] that rigid cables need for jaw angles `jaw` [rad]; (2), (3), (7)."""
        return jaw * self.motor_per_jaw

    def drive_from_motor(self, motor: Angle) -> Angle:
        """Displacement of the drive cable ``x1`` [m] at motor angles `motor` [rad]; (2), (3)."""
        return motor * (self.wheel_radius / self.gear_ratio)


TABLE_1: Final = ForcepsMechanism(
    gear_ratio=35.0, spring_stiffness=656.6, wheel_radius=9.75e-3, jaw_radius=4.0e-3
)

# Section IV-A. The motor's encoder has 1000 lines, which quadrature makes 4000 counts.
MOTOR_ENCODER_COUNTS: Final = 4000
LINEAR_ENCODER_RESOLUTION: Final = 1.0e-6  # [m], scale RGS-40 with an RH100 head
REFERENCE_ENCODER_COUNTS: Final = 4096  # RM08, 12 bit absolute
CABLE_LENGTH: Final = 0.65  # [m], from motor to jaw
CABLE_MASS_PER_LENGTH: Final = 0.81e-3  # [kg/m], 0.45 mm steel cable
