"""The forceps' parameters as the flat numbers that its compiled dynamics read."""

from __future__ import annotations

import math
from typing import NamedTuple

from truejoint.simulation.forceps.parameters import (
    MAXWELL_SLIP,
    Assembly,
    Cable,
    ForcepsParameters,
    Friction,
    Jaw,
    JawFriction,
    MotorLoop,
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
    guide_ratio: float  # of the tensions before and behind a guide that the cable slides over
    before_guide: float  # share of the cable
    creep: float  # [m/N]
    creep_rate: float  # [1/s]


class PlantConstants(NamedTuple):
    """The whole forceps."""

    drive: CableConstants
    reset: CableConstants
    jaw_friction: JawFriction
    slider_friction: SliderFriction
    jaw_damping: float  # [Nm s/rad] of the bristle
    slider_damping: float  # [N s/m]
    assembly: Assembly
    jaw: Jaw
    motor: MotorLoop
    motor_frequency: float  # [rad/s]
    is_maxwell_slip: bool  # law of both contacts; else LuGre
    gear_compliance: float  # [m/N] of the gear's torsion, seen at the drive cable
    wheel_per_motor: float  # [rad/rad]
    wheel_radius: float
    jaw_radius: float
    slider_mass: float
    spring_stiffness: float


def plant_constants(parameters: ForcepsParameters) -> PlantConstants:
    """Flatten `parameters` into what the compiled dynamics read."""
    p, mechanism = parameters, parameters.mechanism
    jaw_level, slider_level = friction_at_pretension(p)
    return PlantConstants(
        drive=_cable(p.drive_cable, p.assembly.pretension),
        reset=_cable(p.reset_cable, p.assembly.pretension),
        jaw_friction=p.jaw_friction,
        slider_friction=p.slider_friction,
        jaw_damping=_bristle_damping(p.jaw_friction, jaw_level, p.jaw.inertia),
        slider_damping=_bristle_damping(p.slider_friction, slider_level, p.slider.mass),
        assembly=p.assembly,
        jaw=p.jaw,
        motor=p.motor_loop,
        motor_frequency=2.0 * math.pi * p.motor_loop.bandwidth,
        is_maxwell_slip=p.contact.law == MAXWELL_SLIP,
        gear_compliance=mechanism.wheel_radius**2 / p.assembly.gear_stiffness,
        wheel_per_motor=1.0 / mechanism.gear_ratio,
        wheel_radius=mechanism.wheel_radius,
        jaw_radius=mechanism.jaw_radius,
        slider_mass=p.slider.mass,
        spring_stiffness=mechanism.spring_stiffness,
    )


def _cable(cable: Cable, pretension: float) -> CableConstants:
    # dK/K = stiffening * dF/F_pre integrates to an exponential; without stiffening a rate of 1e-6
    # of a stretch at the pretension keeps the same formula and is linear to 1e-6.
    stiffening = max(cable.stiffening, 1e-6)
    return CableConstants(
        stiffness=cable.stiffness,
        damping=cable.damping,
        mass=cable.mass,
        elastic=cable.elastic_share * pretension / stiffening,
        growth=stiffening * cable.stiffness / pretension,
        hysteretic=(1.0 - cable.elastic_share) * cable.stiffness * cable.hysteresis_distance,
        hysteresis_distance=cable.hysteresis_distance,
        guide_ratio=math.exp(cable.guide_friction),
        before_guide=cable.guide_position,
        creep=cable.creep_share / cable.stiffness,
        creep_rate=1.0 / cable.creep_time,
    )


def _bristle_damping(friction: Friction, level: float, inertia: float) -> float:
    return 2.0 * friction.bristle_damping * math.sqrt(level / friction.presliding * inertia)
