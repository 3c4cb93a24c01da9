"""Parameters of the virtual forceps, and the numbers that its compiled dynamics read."""

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from truejoint.errors import TruejointError
from truejoint.robots.cable_mechanism import Forceps
from truejoint.schema import Bounds
from truejoint.simulation.friction import ContactLaw
from truejoint.simulation.parameter_file import Parameters

DT: Final = 1e-4  # [s] of the integrator


class Assembly(NamedTuple):
    """Pretension ``F_pre`` [N], gear at its output, and run-out of the winding wheel [m, rad]."""

    pretension: Annotated[float, Bounds(0.5, 100.0)]
    gear_stiffness: Annotated[float, Bounds(1.0, 1e5)]
    gear_backlash: Annotated[float, Bounds(0.0, 0.05)]
    wheel_eccentricity: Annotated[float, Bounds(0.0, 1e-3)]
    wheel_phase: Annotated[float, Bounds(-math.pi, math.pi)]


class Cable(NamedTuple):
    """One cable of (4) or (5): ``K`` [N/m], ``B`` [N s/m], ``m`` [kg], and what is not linear."""

    stiffness: Annotated[float, Bounds(500.0, 1e5)]
    damping: Annotated[float, Bounds(0.0, 30.0)]
    mass: Annotated[float, Bounds(0.0, 0.01)]
    stiffening: Annotated[float, Bounds(0.0, 0.7)]
    elastic_share: Annotated[float, Bounds(0.7, 1.0)]
    hysteresis_distance: Annotated[float, Bounds(5e-6, 1e-3)]
    guide_friction: Annotated[float, Bounds(0.0, 0.5)]
    guide_position: Annotated[float, Bounds(0.1, 0.9)]
    creep_share: Annotated[float, Bounds(0.0, 0.3)]
    creep_time: Annotated[float, Bounds(0.1, 1e4)]


class Jaw(NamedTuple):
    """Jaw: ``J_e`` [kg m2], arm of the load [m], pulley eccentricity [m, rad], stops [rad]."""

    inertia: Annotated[float, Bounds(1e-7, 1e-4)]
    load_arm: Annotated[float, Bounds(1e-3, 0.1)]
    eccentricity: Annotated[float, Bounds(0.0, 1e-3)]
    eccentricity_phase: Annotated[float, Bounds(-math.pi, math.pi)]
    stop_lower: Annotated[float, Bounds(-math.pi / 2, -0.01)]
    stop_upper: Annotated[float, Bounds(0.01, math.pi / 2)]
    stop_stiffness: Annotated[float, Bounds(0.1, 100.0)]
    stop_damping: Annotated[float, Bounds(0.0, 1e-3)]


class Slider(NamedTuple):
    """Slide block on the reset cable; `mass` is ``m_g2`` [kg]."""

    mass: Annotated[float, Bounds(5e-3, 1.0)]


class Contact(NamedTuple):
    """Friction law of both contacts, jaw and slider, where they hardly move."""

    law: Literal["lugre", "maxwell_slip"]


class JawFriction(NamedTuple):
    """Friction of the jaw in Nm and rad; `tension_share` multiplies both tensions times ``r``."""

    constant: Annotated[float, Bounds(0.0, 0.05)]
    tension_share: Annotated[float, Bounds(0.0, 0.5)]
    viscous: Annotated[float, Bounds(0.0, 1e-3)]
    presliding: Annotated[float, Bounds(1e-4, 0.02)]
    stribeck_ratio: Annotated[float, Bounds(1.0, 2.0)]
    stribeck_velocity: Annotated[float, Bounds(1e-3, 10.0)]
    bristle_damping: Annotated[float, Bounds(0.0, 1.0)]


class SliderFriction(NamedTuple):
    """Friction of slide rail and guide pulleys in N and m; `tension_share` multiplies ``F_wr``."""

    constant: Annotated[float, Bounds(0.0, 5.0)]
    tension_share: Annotated[float, Bounds(0.0, 0.5)]
    viscous: Annotated[float, Bounds(0.0, 50.0)]
    presliding: Annotated[float, Bounds(1e-6, 1e-3)]
    stribeck_ratio: Annotated[float, Bounds(1.0, 2.0)]
    stribeck_velocity: Annotated[float, Bounds(1e-5, 0.1)]
    bristle_damping: Annotated[float, Bounds(0.0, 1.0)]


class MotorLoop(NamedTuple):
    """Position loop of the motor: second order [Hz] with limits [rad/s, rad/s2] at the shaft."""

    bandwidth: Annotated[float, Bounds(1.0, 200.0)]
    damping_ratio: Annotated[float, Bounds(0.2, 3.0)]
    max_speed: Annotated[float, Bounds(1.0, 5000.0)]
    max_acceleration: Annotated[float, Bounds(10.0, 1e6)]


class MotorEncoder(NamedTuple):
    """Encoder on the motor shaft: `counts` a turn, `noise` [rad] before quantisation."""

    counts: Annotated[int, Bounds(16, 10_000_000)]
    noise: Annotated[float, Bounds(0.0, 1.0)]


class LinearEncoder(NamedTuple):
    """Optical encoder on a cable: `resolution` and `noise` [m]; left out if not `installed`."""

    installed: bool
    resolution: Annotated[float, Bounds(1e-9, 1e-3)]
    noise: Annotated[float, Bounds(0.0, 1e-3)]


class ReferenceEncoder(NamedTuple):
    """Absolute encoder at the jaw: `counts` a turn, `noise` and harmonic errors [rad]."""

    counts: Annotated[int, Bounds(16, 10_000_000)]
    noise: Annotated[float, Bounds(0.0, 0.1)]
    first_harmonic: Annotated[float, Bounds(0.0, 0.1)]
    first_phase: Annotated[float, Bounds(-math.pi, math.pi)]
    second_harmonic: Annotated[float, Bounds(0.0, 0.1)]
    second_phase: Annotated[float, Bounds(-math.pi, math.pi)]


class Homing(NamedTuple):
    """How far the zeros of both cable encoders vary from homing to homing [m]."""

    registration_sd: Annotated[float, Bounds(0.0, 1e-3)]


@dataclass(frozen=True, kw_only=True)
class ForcepsParameters(Parameters):
    """Everything that the virtual forceps is made of; one attribute per section of the file."""

    SPECIMENS: ClassVar[tuple[str, ...]] = "nominal", "A", "B"

    mechanism: Forceps = Forceps()  # noqa: RUF009  # frozen
    assembly: Assembly
    drive_cable: Cable
    reset_cable: Cable
    jaw: Jaw
    contact: Contact
    jaw_friction: JawFriction
    slider: Slider
    slider_friction: SliderFriction
    motor_loop: MotorLoop
    motor_encoder: MotorEncoder
    drive_encoder: LinearEncoder
    reset_encoder: LinearEncoder
    reference_encoder: ReferenceEncoder
    homing: Homing

    def check(self, source: str) -> None:
        """Refuse what the fixed step cannot resolve: its fastest mode may turn one rad a step."""
        stop = self.jaw.stop_stiffness / self.jaw.inertia
        fastest = math.hypot(
            2.0 * math.pi * float(eigenfrequencies(self, stuck=True)[1]), math.sqrt(stop)
        )
        if not fastest * DT <= 1.0:
            limit = 1.0 / (2.0 * math.pi * DT)
            raise TruejointError(
                f"{source}: the fastest mode has {fastest / (2 * math.pi):.0f} Hz, more than the "
                f"{limit:.0f} Hz that a step of {DT:g} s resolves; raise jaw.inertia, "
                "slider.mass or a presliding distance, or lower a stiffness"
            )


def friction_at_pretension(parameters: ForcepsParameters) -> tuple[float, float]:
    """Coulomb friction of the jaw [Nm] and of the slider [N] with both cables at ``F_pre``."""
    pretension = parameters.assembly.pretension
    jaw, slider = parameters.jaw_friction, parameters.slider_friction
    tensions = 2.0 * pretension * parameters.mechanism.jaw_radius
    return (
        jaw.constant + jaw.tension_share * tensions,
        slider.constant + slider.tension_share * pretension,
    )


def eigenfrequencies(parameters: ForcepsParameters, *, stuck: bool) -> NDArray[np.float64]:
    """Undamped eigenfrequencies (2,) [Hz] of jaw and slider about the initial position.

    Those of (12) in yan2020, or `stuck`: friction holds both, and bristles stiffen the cables, of
    which a guide that holds them leaves only the piece behind it to stretch.
    """
    r, spring = parameters.mechanism.jaw_radius, parameters.mechanism.spring_stiffness
    drive, reset = parameters.drive_cable, parameters.reset_cable
    at_jaw, at_slider, between = drive.stiffness + reset.stiffness, reset.stiffness, reset.stiffness
    if stuck and drive.guide_friction > 0.0:
        at_jaw += drive.stiffness / (1.0 - drive.guide_position) - drive.stiffness
    if stuck and reset.guide_friction > 0.0:
        at_jaw += reset.stiffness / reset.guide_position - reset.stiffness
        at_slider, between = reset.stiffness / (1.0 - reset.guide_position), 0.0
    stiffness = np.array([[at_jaw * r**2, -between * r], [-between * r, at_slider + spring]])
    if stuck:
        jaw, slider = friction_at_pretension(parameters)
        stiffness[0, 0] += jaw / parameters.jaw_friction.presliding
        stiffness[1, 1] += slider / parameters.slider_friction.presliding
    scale = 1.0 / np.sqrt([parameters.jaw.inertia, parameters.slider.mass])
    values = np.linalg.eigvalsh(stiffness * np.outer(scale, scale))
    return np.asarray(np.sqrt(values) / (2.0 * math.pi), dtype=np.float64)


class CableConstants(NamedTuple):
    """One cable and its nonlinear parts."""

    of: Cable
    number: int  # 0 for the drive cable, 1 for the reset cable
    pretension: float  # [N]
    compliance: float  # [m/N] of the gear's torsion, seen at the cable
    elastic: float  # [N] and
    growth: float  # [1/m] of the elastic force ``elastic * (exp(growth * stretch) - 1)``
    hysteretic: float  # [N] of a Bouc-Wen element that has yielded
    guide_ratio: float  # of the tensions before and behind a guide that the cable slides over
    creep: float  # [m/N]
    creep_rate: float  # [1/s]


class PlantConstants(NamedTuple):
    """The whole forceps."""

    drive: CableConstants
    reset: CableConstants
    jaw_friction: JawFriction
    slider_friction: SliderFriction
    jaw_law: ContactLaw
    slider_law: ContactLaw
    assembly: Assembly
    jaw: Jaw
    motor: MotorLoop
    motor_frequency: float  # [rad/s]
    is_maxwell_slip: bool  # law of both contacts; else LuGre
    mechanism: Forceps
    wheel_per_motor: float  # [rad/rad]
    slider_mass: float


def plant_constants(parameters: ForcepsParameters) -> PlantConstants:
    """Flatten `parameters` into what the compiled dynamics read."""
    p, mechanism = parameters, parameters.mechanism
    pretension, gear_stiffness = p.assembly[:2]
    jaw_level, slider_level = friction_at_pretension(p)
    return PlantConstants(
        drive=_cable(0, p.drive_cable, pretension, mechanism.wheel_radius**2 / gear_stiffness),
        reset=_cable(1, p.reset_cable, pretension, 0.0),
        jaw_friction=p.jaw_friction,
        slider_friction=p.slider_friction,
        jaw_law=_contact_law(p.jaw_friction, jaw_level, p.jaw.inertia),
        slider_law=_contact_law(p.slider_friction, slider_level, p.slider.mass),
        assembly=p.assembly,
        jaw=p.jaw,
        motor=p.motor_loop,
        motor_frequency=2.0 * math.pi * p.motor_loop.bandwidth,
        is_maxwell_slip=p.contact.law == "maxwell_slip",
        mechanism=mechanism,
        wheel_per_motor=1.0 / mechanism.gear_ratio,
        slider_mass=p.slider.mass,
    )


def _cable(number: int, cable: Cable, pretension: float, compliance: float) -> CableConstants:
    # dK/K = stiffening * dF/F_pre integrates to an exponential; without stiffening a rate of 1e-6
    # of a stretch at the pretension keeps the same formula and is linear to 1e-6.
    stiffening = max(cable.stiffening, 1e-6)
    return CableConstants(
        of=cable,
        number=number,
        pretension=pretension,
        compliance=compliance,
        elastic=cable.elastic_share * pretension / stiffening,
        growth=stiffening * cable.stiffness / pretension,
        hysteretic=(1.0 - cable.elastic_share) * cable.stiffness * cable.hysteresis_distance,
        guide_ratio=math.exp(cable.guide_friction),
        creep=cable.creep_share / cable.stiffness,
        creep_rate=1.0 / cable.creep_time,
    )


def _contact_law(
    friction: JawFriction | SliderFriction, level: float, inertia: float
) -> ContactLaw:
    damping = 2.0 * friction.bristle_damping * math.sqrt(level / friction.presliding * inertia)
    return ContactLaw(*friction[2:6], damping)
