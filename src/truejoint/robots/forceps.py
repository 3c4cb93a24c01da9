"""The one-jaw cable-driven forceps: its mechanism, from yan2020, Table 1."""

from __future__ import annotations

from typing import Annotated, Final, NamedTuple

from truejoint.errors import RobotError
from truejoint.robots.cable_mechanism import Cable, CableMechanism, Motor, Pin
from truejoint.schema import Bounds

_PIN: Final = Pin(inertia=1e-6, radius=1.0e-3)  # the forceps' own twin takes others


class Forceps(NamedTuple):
    """Transmission from motor to jaw; symbols and defaults of yan2020, Table 1.

    Examples
    --------
    >>> Forceps.of(truejoint.get_robot("forceps").mechanism).gear_ratio
    35.0
    """

    gear_ratio: Annotated[float, Bounds(1.0, 1000.0)] = 35.0
    """Motor turns per turn of the winding wheel, ``z_i``."""
    spring_stiffness: Annotated[float, Bounds(10.0, 1e4)] = 656.6
    """Reset spring ``K_sp`` [N/m]."""
    wheel_radius: Annotated[float, Bounds(1e-3, 0.1)] = 9.75e-3
    """Effective radius of the winding wheel ``R`` [m]."""
    jaw_radius: Annotated[float, Bounds(1e-3, 0.02)] = 4.0e-3
    """Radius at which both cables act on the jaw ``r`` [m]."""

    @classmethod
    def of(cls, mechanism: CableMechanism | None) -> Forceps:
        """Read a mechanism of one joint, a motor's cable and a spring's; else RobotError."""
        cables = () if mechanism is None else mechanism.cables
        if (
            mechanism is None
            or len(mechanism.pins) != 1
            or [c.spring > 0 for c in cables] != [0, 1]
        ):
            raise RobotError(
                "the mechanism is not a forceps'; want one joint, a motor's cable and then a "
                "spring's"
            )
        (motor,), (moment,) = mechanism.motors.values(), cables[0].moments.values()
        return cls(motor.gear, cables[1].spring, motor.radius, cables[0].sign * moment)

    def mechanism(self, joint: str = "jaw") -> CableMechanism:
        """Cables of the forceps."""
        return CableMechanism(
            {joint: _PIN},
            {"motor": Motor(self.wheel_radius, self.gear_ratio)},
            (
                Cable("drive", {joint: self.jaw_radius}, "motor"),
                Cable("reset", {joint: -self.jaw_radius}, spring=self.spring_stiffness),
            ),
        )

    @property
    def motor_per_jaw(self) -> float:
        """Motor-shaft angle per jaw angle with rigid cables [rad/rad], ``z_i r / R``."""
        return self.gear_ratio * self.jaw_radius / self.wheel_radius
