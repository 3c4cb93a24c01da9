"""Parameters of the RAVEN-II twin; nominal.toml says what each means and comes from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Final, NamedTuple

from truejoint.schema import Bounds, Length
from truejoint.simulation.parameter_file import Parameters

Numbers = tuple[float, ...]
"""One value per positioning joint (shoulder, elbow, insertion) or per tool joint."""
THREE: Final = Length(3, 3)
FOUR: Final = Length(4, 4)


class Motor(NamedTuple):
    """Inertia (3,) [kg m^2] at the motor shafts of the positioning joints."""

    inertia: Annotated[Numbers, Bounds(1e-6, 1e-2), THREE]


class MotorFriction(NamedTuple):
    """Friction of motors and gearboxes, as torque at the capstan."""

    coulomb: Annotated[Numbers, Bounds(0.0, 0.3), THREE]
    viscous: Annotated[Numbers, Bounds(0.0, 0.05), THREE]
    presliding: Annotated[Numbers, Bounds(0.02, 5.0), THREE]
    gear_loss: Annotated[float, Bounds(0.0, 0.5)]
    capstan_ripple: Annotated[float, Bounds(0.0, 0.5)]
    gear_ripple: Annotated[float, Bounds(0.0, 0.5)]
    gear_ripple_cycles: Annotated[float, Bounds(1.0, 100.0)]
    wander: Annotated[float, Bounds(0.0, 0.2)]
    wander_time: Annotated[float, Bounds(1.0, 1e5)]
    warm_up: Annotated[float, Bounds(0.0, 1.0)]
    warm_up_time: Annotated[float, Bounds(10.0, 1e5)]


class JointFriction(NamedTuple):
    """Friction behind the capstan, at the joint; this is what makes hysteresis."""

    coulomb: Annotated[Numbers, Bounds(0.0, 50.0), THREE]
    load_share: Annotated[Numbers, Bounds(0.0, 0.5), THREE]
    presliding: Annotated[Numbers, Bounds(1e-5, 0.05), THREE]


class Cable(NamedTuple):
    """Stiffness (3,) [Nm/rad, Nm/rad, N/m] between capstan and joint, at the joint."""

    stiffness: Annotated[Numbers, Bounds(20.0, 1e7), THREE]


class Pulleys(NamedTuple):
    """Real against nominal transmission: scale, coupling and run-out."""

    scale: Annotated[Numbers, Bounds(-0.2, 0.2), THREE]
    coupling_shoulder_elbow: Annotated[float, Bounds(-0.3, 0.3)]
    coupling_shoulder_insertion: Annotated[float, Bounds(-0.02, 0.02)]
    coupling_elbow_insertion: Annotated[float, Bounds(-0.02, 0.02)]
    capstan_run_out: Annotated[Numbers, Bounds(0.0, 1e-3), THREE]
    capstan_phase: Annotated[Numbers, Bounds(-7.0, 7.0), THREE]
    joint_run_out: Annotated[Numbers, Bounds(0.0, 2e-3), THREE]
    joint_phase: Annotated[Numbers, Bounds(-7.0, 7.0), THREE]


class Wrap(NamedTuple):
    """Change of cable length where runs leave their pulleys at an angle."""

    free_run: Annotated[Numbers, Bounds(0.01, 2.0), THREE]
    sideways_shoulder: Annotated[Numbers, Bounds(-0.05, 0.05), THREE]
    sideways_elbow: Annotated[Numbers, Bounds(-0.05, 0.05), THREE]
    sideways_insertion: Annotated[Numbers, Bounds(-0.5, 0.5), THREE]
    aligned: Annotated[Numbers, Bounds(-3.2, 3.2), THREE]


class Creep(NamedTuple):
    """Lengthening of the cables over hours of work."""

    final: Annotated[Numbers, Bounds(-0.1, 0.1), THREE]
    travel: Annotated[Numbers, Bounds(0.1, 1e6), THREE]
    load_gain: Annotated[float, Bounds(0.0, 20.0)]
    idle_time: Annotated[float, Bounds(1e3, 1e12)]


class Mass(NamedTuple):
    """Mass [kg] that the robot's own link masses leave out."""

    instrument: Annotated[float, Bounds(0.0, 2.0)]


class Homing(NamedTuple):
    """How registration at the hard stops errs."""

    registration_sd: Annotated[Numbers, Bounds(0.0, 0.1), THREE]
    registration_bias: Annotated[Numbers, Bounds(-0.1, 0.1), THREE]


class ExternalEncoders(NamedTuple):
    """Clock of the temporary joint encoders."""

    rate: Annotated[float, Bounds(1.0, 1000.0)]
    jitter: Annotated[float, Bounds(0.0, 0.01)]
    stamp_delay: Annotated[float, Bounds(0.0, 0.1)]


class StateStream(NamedTuple):
    """Time stamps of the robot's own state messages."""

    jitter: Annotated[float, Bounds(0.0, 0.01)]


class Tool(NamedTuple):
    """Motors of roll, wrist and jaws, and how well they keep their joints where they are."""

    inertia: Annotated[Numbers, Bounds(1e-7, 1e-3), FOUR]
    coulomb: Annotated[Numbers, Bounds(0.0, 0.1), FOUR]
    viscous: Annotated[Numbers, Bounds(0.0, 0.05), FOUR]
    presliding: Annotated[Numbers, Bounds(0.02, 5.0), FOUR]
    registration_sd: Annotated[Numbers, Bounds(0.0, 0.1), FOUR]
    wander: Annotated[Numbers, Bounds(0.0, 0.1), FOUR]
    wander_effort: Annotated[Numbers, Bounds(0.0, 0.02), FOUR]
    wander_time: Annotated[float, Bounds(1.0, 1e5)]


@dataclass(frozen=True)
class Raven2Parameters(Parameters):
    """Everything that makes the twin of a RAVEN-II arm err; one attribute per section."""

    SPECIMENS: ClassVar[tuple[str, ...]] = "nominal", "peng2024"
    FOLDER: ClassVar[str] = "raven2"

    motor: Motor
    motor_friction: MotorFriction
    joint_friction: JointFriction
    cable: Cable
    pulleys: Pulleys
    wrap: Wrap
    creep: Creep
    mass: Mass
    homing: Homing
    external_encoders: ExternalEncoders
    state_stream: StateStream
    tool: Tool
