"""Parameters of an instrument's cables: a commented TOML file in, a checked frozen value out."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar, Final, Literal, NamedTuple

from truejoint.schema import Bounds
from truejoint.simulation.parameter_file import Parameters

MAXWELL_SLIP: Final = "maxwell_slip"


class Cables(NamedTuple):
    """Every cable: stiffness [N/m] and pretension [N].

    Coefficients of friction at nodes that no joint turns, and at those that one does. And how
    many times as much as the mechanism says, beside the rest, a cable gives way between its nodes.
    """

    stiffness: Annotated[float, Bounds(1e3, 1e6)]
    pretension: Annotated[float, Bounds(0.1, 100.0)]
    guide_friction: Annotated[float, Bounds(0.0, 1.0)]
    wrist_friction: Annotated[float, Bounds(0.0, 0.5)]
    shaft_compliance: Annotated[float, Bounds(0.01, 100.0)]


class Variation(NamedTuple):
    """How far single cables and pulleys stray: shares, eccentricity in m; drawn with `seed`."""

    seed: Annotated[int, Bounds(0, 2**31 - 1)]
    stiffness: Annotated[float, Bounds(0.0, 0.3)]
    moment: Annotated[float, Bounds(0.0, 0.1)]
    capstan: Annotated[float, Bounds(0.0, 0.1)]
    eccentricity: Annotated[float, Bounds(0.0, 5e-4)]


class JointFriction(NamedTuple):
    """Friction of the pins; `tension_share` multiplies radius and tensions, `constant` their own.

    `presliding` [rad] and `viscous` [Nm s/rad] are of every joint.
    """

    law: Literal["dahl", "maxwell_slip"]
    tension_share: Annotated[float, Bounds(0.0, 1.0)]
    constant: Annotated[float, Bounds(0.0, 20.0)]
    presliding: Annotated[float, Bounds(5e-4, 0.05)]
    viscous: Annotated[float, Bounds(0.0, 1e-2)]


class Stops(NamedTuple):
    """Where every joint ends: so far `beyond` its limit [rad], stiffness and damping there.

    In Nm/rad and Nm s/rad.
    """

    beyond: Annotated[float, Bounds(0.0, 1.0)]
    stiffness: Annotated[float, Bounds(0.1, 1e3)]
    damping: Annotated[float, Bounds(0.0, 1e-2)]


class Motor(NamedTuple):
    """Every motor: position loop [Hz], friction [Nm, Nm s/rad], presliding [rad]."""

    bandwidth: Annotated[float, Bounds(1.0, 200.0)]
    damping_ratio: Annotated[float, Bounds(0.2, 3.0)]
    coulomb: Annotated[float, Bounds(0.0, 1.0)]
    viscous: Annotated[float, Bounds(0.0, 1.0)]
    presliding: Annotated[float, Bounds(1e-5, 0.1)]

    @property
    def lag(self) -> float:
        """Time by which a motor follows a set-point that moves evenly [s]."""
        return self.damping_ratio / (math.pi * self.bandwidth)


class Sensors(NamedTuple):
    """Noise [rad, Nm, N] of what is read; gains' deviations are shares."""

    motor_noise: Annotated[float, Bounds(0.0, 0.1)]
    effort_noise: Annotated[float, Bounds(0.0, 1.0)]
    effort_gain: Annotated[float, Bounds(0.0, 0.5)]
    tensions: Literal["none", "one", "both"]
    tension_noise: Annotated[float, Bounds(0.0, 10.0)]
    tension_gain: Annotated[float, Bounds(0.0, 0.5)]
    tension_offset: Annotated[float, Bounds(0.0, 10.0)]
    reference_noise: Annotated[float, Bounds(0.0, 0.1)]


class Homing(NamedTuple):
    """Standard deviations [rad] of the motors' zeros: as assembled, and at every homing."""

    assembly: Annotated[float, Bounds(0.0, 0.5)]
    registration: Annotated[float, Bounds(0.0, 0.5)]


@dataclass(frozen=True)
class WristParameters(Parameters):
    """What an instrument's cables, friction and sensors are; an attribute per section."""

    SPECIMENS: ClassVar[Mapping[str, str]] = {
        "nominal": "wrist/nominal.toml",
        "cable_only": "wrist/cable_only.toml",
        "endowrist": "wrist/endowrist.toml",
    }

    cables: Cables
    variation: Variation
    joint_friction: JointFriction
    stops: Stops
    motor: Motor
    sensors: Sensors
    homing: Homing
