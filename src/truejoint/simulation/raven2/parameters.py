"""Parameters of the RAVEN-II twin; nominal.toml says what each means and comes from."""

from dataclasses import dataclass
from typing import Annotated, ClassVar, Final, NamedTuple

from truejoint.schema import Bounds, Length
from truejoint.simulation.arm.parameters import ArmParameters, Numbers

THREE: Final = Length(3, 3)


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


class Mass(NamedTuple):
    """Mass [kg] that the robot's own link masses leave out."""

    instrument: Annotated[float, Bounds(0.0, 2.0)]


class Homing(NamedTuple):
    """How registration at the hard stops errs."""

    registration_sd: Annotated[Numbers, Bounds(0.0, 0.1), THREE]
    registration_bias: Annotated[Numbers, Bounds(-0.1, 0.1), THREE]


@dataclass(frozen=True)
class Raven2Parameters(ArmParameters):
    """Everything that makes the twin of a RAVEN-II arm err; one attribute per section."""

    SPECIMENS: ClassVar[tuple[str, ...]] = "nominal", "peng2024"
    FOLDER: ClassVar[str] = "raven2"

    pulleys: Pulleys
    wrap: Wrap
    mass: Mass
    homing: Homing
