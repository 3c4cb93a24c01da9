"""Parameters of the RAVEN-II twin; raven2_twin.toml says what each means and comes from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Final, get_type_hints

from truejoint.simulation.parameter_file import (
    Bounds,
    Sections,
    build_section,
    overlay,
    read_sections,
    shipped_sections,
)

Numbers = tuple[float, ...]
"""One value per positioning joint (shoulder, elbow, insertion) or per tool joint."""

SHIPPED: Final = "raven2_twin.toml"


@dataclass(frozen=True)
class Motor:
    """Inertia (3,) [kg m^2] at the motor shafts of the positioning joints."""

    inertia: Annotated[Numbers, Bounds(1e-6, 1e-2, 3)]


@dataclass(frozen=True)
class MotorFriction:
    """Friction of motors and gearboxes, as torque at the capstan."""

    coulomb: Annotated[Numbers, Bounds(0.0, 0.3, 3)]
    viscous: Annotated[Numbers, Bounds(0.0, 0.05, 3)]
    presliding: Annotated[Numbers, Bounds(0.02, 5.0, 3)]
    gear_loss: Annotated[float, Bounds(0.0, 0.5)]
    capstan_ripple: Annotated[float, Bounds(0.0, 0.5)]
    gear_ripple: Annotated[float, Bounds(0.0, 0.5)]
    gear_ripple_cycles: Annotated[float, Bounds(1.0, 100.0)]
    wander: Annotated[float, Bounds(0.0, 0.2)]
    wander_time: Annotated[float, Bounds(1.0, 1e5)]
    warm_up: Annotated[float, Bounds(0.0, 1.0)]
    warm_up_time: Annotated[float, Bounds(10.0, 1e5)]


@dataclass(frozen=True)
class JointFriction:
    """Friction behind the capstan, at the joint; this is what makes hysteresis."""

    coulomb: Annotated[Numbers, Bounds(0.0, 50.0, 3)]
    load_share: Annotated[Numbers, Bounds(0.0, 0.5, 3)]
    presliding: Annotated[Numbers, Bounds(1e-5, 0.05, 3)]


@dataclass(frozen=True)
class Cable:
    """Stiffness (3,) [Nm/rad, Nm/rad, N/m] between capstan and joint, at the joint."""

    stiffness: Annotated[Numbers, Bounds(20.0, 1e7, 3)]


@dataclass(frozen=True)
class Pulleys:
    """Real against nominal transmission: scale, coupling and run-out."""

    scale: Annotated[Numbers, Bounds(-0.2, 0.2, 3)]
    coupling_shoulder_elbow: Annotated[float, Bounds(-0.3, 0.3)]
    coupling_shoulder_insertion: Annotated[float, Bounds(-0.02, 0.02)]
    coupling_elbow_insertion: Annotated[float, Bounds(-0.02, 0.02)]
    capstan_run_out: Annotated[Numbers, Bounds(0.0, 1e-3, 3)]
    capstan_phase: Annotated[Numbers, Bounds(-7.0, 7.0, 3)]
    joint_run_out: Annotated[Numbers, Bounds(0.0, 2e-3, 3)]
    joint_phase: Annotated[Numbers, Bounds(-7.0, 7.0, 3)]


@dataclass(frozen=True)
class Wrap:
    """Change of cable length where runs leave their pulleys at an angle."""

    free_run: Annotated[Numbers, Bounds(0.01, 2.0, 3)]
    sideways_shoulder: Annotated[Numbers, Bounds(-0.05, 0.05, 3)]
    sideways_elbow: Annotated[Numbers, Bounds(-0.05, 0.05, 3)]
    sideways_insertion: Annotated[Numbers, Bounds(-0.5, 0.5, 3)]
    aligned: Annotated[Numbers, Bounds(-3.2, 3.2, 3)]


@dataclass(frozen=True)
class Creep:
    """Lengthening of the cables over hours of work."""

    final: Annotated[Numbers, Bounds(-0.1, 0.1, 3)]
    travel: Annotated[Numbers, Bounds(0.1, 1e6, 3)]
    load_gain: Annotated[float, Bounds(0.0, 20.0)]
    idle_time: Annotated[float, Bounds(1e3, 1e12)]


@dataclass(frozen=True)
class Mass:
    """Mass [kg] that the robot's own link masses leave out."""

    instrument: Annotated[float, Bounds(0.0, 2.0)]


@dataclass(frozen=True)
class Homing:
    """How registration at the hard stops errs."""

    registration_sd: Annotated[Numbers, Bounds(0.0, 0.1, 3)]
    registration_bias: Annotated[Numbers, Bounds(-0.1, 0.1, 3)]


@dataclass(frozen=True)
class ExternalEncoders:
    """Clock of the temporary joint encoders."""

    rate: Annotated[float, Bounds(1.0, 1000.0)]
    jitter: Annotated[float, Bounds(0.0, 0.01)]
    stamp_delay: Annotated[float, Bounds(0.0, 0.1)]


@dataclass(frozen=True)
class Tool:
    """Motors of roll, wrist and jaws."""

    inertia: Annotated[Numbers, Bounds(1e-7, 1e-3, 4)]
    coulomb: Annotated[Numbers, Bounds(0.0, 0.1, 4)]
    viscous: Annotated[Numbers, Bounds(0.0, 0.05, 4)]
    presliding: Annotated[Numbers, Bounds(0.02, 5.0, 4)]


@dataclass(frozen=True)
class TwinParameters:
    """Everything that makes the twin of a RAVEN-II arm err; one attribute per section of the file.

    SI units. `load` reads a file in the format of the shipped ``raven2_twin.toml``, whose comments
    give the meaning, unit and source of every number.

    Examples
    --------
    >>> softer = TwinParameters.load().with_values({"creep.final": [0.0, 0.0, 0.0]})
    >>> softer.creep.final
    (0.0, 0.0, 0.0)
    """

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
    tool: Tool

    @classmethod
    def load(cls, path: str | Path | None = None) -> TwinParameters:
        """Parameters of a TOML file; what the file leaves out keeps the shipped value.

        Parameters
        ----------
        path : str or Path, optional
            Without it, the shipped parameters.

        Raises
        ------
        TruejointError
            If the file cannot be read, or has an unknown key or a value out of bounds.
        """
        shipped = shipped_sections(SHIPPED)
        if path is None:
            return cls._built(shipped, SHIPPED)
        changes = read_sections(Path(path))
        return cls._built(overlay(shipped, changes, str(path)), str(path))

    def with_values(self, changes: Mapping[str, Any]) -> TwinParameters:
        """Copy with some values changed, by dotted name: ``{"cable.stiffness": (1e3, 4e2, 2e4)}``.

        Raises
        ------
        TruejointError
            If a name is unknown or a value out of bounds.
        """
        sections: dict[str, dict[str, Any]] = {}
        for name, value in changes.items():
            section, _, key = name.partition(".")
            sections.setdefault(section, {})[key] = value
        return self._built(overlay(self.to_dict(), sections, "with_values"), "with_values")

    def to_dict(self) -> dict[str, dict[str, Any]]:
        """Plain nested dictionary in the layout of the file."""
        return asdict(self)

    def to_toml(self) -> str:
        """Text that `load` turns into these parameters again, without the comments."""
        lines = []
        for section, values in self.to_dict().items():
            lines.append(f"[{section}]")
            for key, value in values.items():
                text = repr(list(value)) if isinstance(value, tuple) else repr(value)
                lines.append(f"{key} = {text}")
            lines.append("")
        return "\n".join(lines)

    @classmethod
    def _built(cls, sections: Sections, source: str) -> TwinParameters:
        kinds = get_type_hints(cls)
        return cls(
            **{
                f.name: build_section(kinds[f.name], f.name, sections[f.name], source)
                for f in fields(cls)
            }
        )
