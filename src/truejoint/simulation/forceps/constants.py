"""The forceps' parameters as the flat numbers that its compiled dynamics read."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from truejoint.simulation.forceps.parameters import (
    Cable,
    ForcepsParameters,
    JawFriction,
    SliderFriction,
    friction_at_pretension,
)


class CableConstants(NamedTuple):
    """One cable: ``K`` [N/m], ``B`` [N s/m], ``m`` [kg] and its nonlinear parts."""

    stiffness: float
    damping: float
    mass: float
    elastic: float  # [N] and
    growth: float  # [1/m] of the elastic force ``elastic * (exp(growth * stretch) - 1)``
    hysteretic: float  # [N] of a Bouc-Wen element that has yielded
    hysteresis_distance: float  # [m]


class FrictionConstants(NamedTuple):
    """One sliding contact, in N and m or in Nm and rad."""

    constant: float
    tension_share: float
    viscous: float
    presliding: float
    stribeck_excess: float
    stribeck_velocity: float
    bristle_damping: float  # [N s/m or Nm s/rad]


class PlantConstants(NamedTuple):
    """The whole forceps."""

    drive: CableConstants
    reset: CableConstants
    jaw_friction: FrictionConstants
    slider_friction: FrictionConstants
    pretension: float
    gear_compliance: float  # [m/N] of the gear's torsion, seen at the drive cable
    wheel_eccentricity: float
    wheel_phase: float
    wheel_per_motor: float  # [rad/rad]
    wheel_radius: float
    jaw_radius: float
    jaw_eccentricity: float
    jaw_phase: float
    load_arm: float
    inertia: float
    slider_mass: float
    spring_stiffness: float
    stop_lower: float
    stop_upper: float
    stop_stiffness: float
    stop_damping: float
    motor_frequency: float  # [rad/s]
    motor_damping: float
    motor_max_speed: float
    motor_max_acceleration: float


def plant_constants(parameters: ForcepsParameters) -> PlantConstants:
    """Flatten `parameters` into what the compiled dynamics read."""
    p = parameters
    jaw_level, slider_level = friction_at_pretension(p)
    return PlantConstants(
        drive=_cable(p.drive_cable, p.assembly.pretension),
        reset=_cable(p.reset_cable, p.assembly.pretension),
        jaw_friction=_friction(p.jaw_friction, jaw_level, p.jaw.inertia),
        slider_friction=_friction(p.slider_friction, slider_level, p.slider.mass),
        gear_compliance=p.mechanism.wheel_radius**2 / p.assembly.gear_stiffness,
        wheel_per_motor=1.0 / p.mechanism.gear_ratio,
        jaw_eccentricity=p.jaw.eccentricity,
        jaw_phase=p.jaw.eccentricity_phase,
        slider_mass=p.slider.mass,
        motor_frequency=2.0 * math.pi * p.motor_loop.bandwidth,
        motor_damping=p.motor_loop.damping_ratio,
        motor_max_speed=p.motor_loop.max_speed,
        motor_max_acceleration=p.motor_loop.max_acceleration,
        **_alike(PlantConstants, p.assembly, p.mechanism, p.jaw),
    )


def _alike(kind: type[Any], *sections: object) -> dict[str, float]:
    """Values that the sections and the dynamics call by the same name."""
    values = {name: value for section in sections for name, value in vars(section).items()}
    return {name: values[name] for name in kind._fields if name in values}


def _cable(cable: Cable, pretension: float) -> CableConstants:
    # dK/K = stiffening * dF/F_pre integrates to an exponential; without stiffening a rate of 1e-6
    # of a stretch at the pretension keeps the same formula and is linear to 1e-6.
    stiffening = max(cable.stiffening, 1e-6)
    return CableConstants(
        elastic=cable.elastic_share * pretension / stiffening,
        growth=stiffening * cable.stiffness / pretension,
        hysteretic=(1.0 - cable.elastic_share) * cable.stiffness * cable.hysteresis_distance,
        **_alike(CableConstants, cable),
    )


def _friction(
    friction: JawFriction | SliderFriction, level: float, inertia: float
) -> FrictionConstants:
    stuck = math.sqrt(level / friction.presliding * inertia)
    changed = {
        "stribeck_excess": friction.stribeck_ratio - 1.0,
        "bristle_damping": 2.0 * friction.bristle_damping * stuck,
    }
    return FrictionConstants(**(_alike(FrictionConstants, friction) | changed))
