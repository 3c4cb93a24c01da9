"""Parameters that the twins of all arms have; the shipped files say what each means."""

from dataclasses import dataclass
from typing import Annotated, ClassVar, NamedTuple

from truejoint.errors import TruejointError
from truejoint.schema import Bounds, Length
from truejoint.simulation.parameter_file import Parameters

Numbers = Annotated[tuple[float, ...], Length(1, 7)]
"""One value per joint whose cable gives way, or per joint that follows its motor (`Tool`)."""


class Motor(NamedTuple):
    """Inertia [kg m^2] at the motor shafts of the joints whose cables give way."""

    inertia: Annotated[Numbers, Bounds(1e-7, 1e-2)]


class MotorFriction(NamedTuple):
    """Friction of motors and gearboxes, as torque at the capstan."""

    coulomb: Annotated[Numbers, Bounds(0.0, 10.0)]
    viscous: Annotated[Numbers, Bounds(0.0, 0.5)]
    presliding: Annotated[Numbers, Bounds(0.02, 5.0)]
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

    coulomb: Annotated[Numbers, Bounds(0.0, 50.0)]
    load_share: Annotated[Numbers, Bounds(0.0, 0.5)]
    presliding: Annotated[Numbers, Bounds(1e-5, 0.2)]


class Cable(NamedTuple):
    """Stiffness [Nm/rad or N/m] between capstan and joint, at the joint."""

    stiffness: Annotated[Numbers, Bounds(0.1, 1e7)]


class Creep(NamedTuple):
    """Lengthening of the cables over hours of work."""

    final: Annotated[Numbers, Bounds(-0.1, 0.1)]
    travel: Annotated[Numbers, Bounds(0.1, 1e6)]
    load_gain: Annotated[float, Bounds(0.0, 20.0)]
    idle_time: Annotated[float, Bounds(1e3, 1e12)]


class ExternalEncoders(NamedTuple):
    """Clock of the temporary joint encoders."""

    rate: Annotated[float, Bounds(1.0, 1000.0)]
    jitter: Annotated[float, Bounds(0.0, 0.01)]
    stamp_delay: Annotated[float, Bounds(0.0, 0.1)]


class StateStream(NamedTuple):
    """Time stamps of the robot's own state messages."""

    jitter: Annotated[float, Bounds(0.0, 0.01)]


class Tool(NamedTuple):
    """Motors of joints that follow them, and how well they keep these where they are."""

    inertia: Annotated[Numbers, Bounds(1e-7, 1e-3)]
    coulomb: Annotated[Numbers, Bounds(0.0, 0.1)]
    viscous: Annotated[Numbers, Bounds(0.0, 0.5)]
    presliding: Annotated[Numbers, Bounds(0.02, 5.0)]
    registration_sd: Annotated[Numbers, Bounds(0.0, 0.1)]
    wander: Annotated[Numbers, Bounds(0.0, 0.1)]
    wander_effort: Annotated[Numbers, Bounds(0.0, 0.02)]
    wander_time: Annotated[float, Bounds(1.0, 1e5)]


@dataclass(frozen=True)
class ArmParameters(Parameters):
    """What makes the twin of an arm err; one attribute per section."""

    ON_CABLES: ClassVar[int] = 3
    """Number of joints whose cables give way; the others of the seven are the tool's."""
    OF_ALL: ClassVar[tuple[str, ...]] = ()
    """Sections that have a value for each of the seven joints."""

    motor: Motor
    motor_friction: MotorFriction
    joint_friction: JointFriction
    cable: Cable
    creep: Creep
    external_encoders: ExternalEncoders
    state_stream: StateStream
    tool: Tool

    def check(self, source: str) -> None:
        """Refuse a list that is not as long as the arm has joints."""
        for name, section in vars(self).items():
            want = 7 if name in self.OF_ALL else self.ON_CABLES
            want = 7 - want if name == "tool" else want
            for key, value in section._asdict().items():
                if isinstance(value, tuple) and len(value) != want:
                    raise TruejointError(
                        f"{source}: {name}.{key} has {len(value)} numbers; want {want}, one for "
                        "each joint"
                    )
