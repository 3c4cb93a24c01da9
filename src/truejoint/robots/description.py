"""Tables of a robot file (docs/robots.md), in the units that a person writes; SI comes out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

import numpy as np

from truejoint import schema
from truejoint.array_types import Array
from truejoint.errors import RobotError, unknown
from truejoint.robots.cable_mechanism import CableMechanism
from truejoint.robots.forceps import Forceps
from truejoint.robots.joint_encoder import JointEncoder
from truejoint.robots.parts import (
    UNITS,
    WORKSPACE_KEYS,
    Effort,
    Joint,
    Kind,
    Kinematics,
    Transmission,
    Workspace,
)
from truejoint.schema import Bounds, Length, Name, Shape

if TYPE_CHECKING:  # the compiler behind it takes longer to import than the rest
    from truejoint.robots.chain import SerialChain

MAX_JOINTS: Final = 64
MATRIX_KEYS: Final = ("axis_from_joint", "crtk_from_base", "tool_rotation")
Number = Annotated[float, Bounds(-1e9, 1e9)]
Names = Annotated[tuple[Name, ...], Length(0, MAX_JOINTS)]
_Matrix = Annotated[Array, Shape((None, None)), Bounds(-1e9, 1e9)]


@dataclass(frozen=True)
class JointTable:
    """A joint, whose limits are in the unit that it states."""

    name: Name
    kind: Kind = "revolute"
    unit: str = ""
    lower: Number | None = None
    upper: Number | None = None
    home: Number | None = None
    max_speed: Number | None = None

    def __post_init__(self) -> None:
        if self.unit and self.unit not in UNITS[self.kind]:
            units = " or ".join(UNITS[self.kind])
            raise RobotError(
                f"unit {self.unit!r:.40} does not fit a {self.kind} joint; want {units}"
            )

    @property
    def factor(self) -> float:
        """Factor from the unit of the table to SI."""
        return UNITS[self.kind][self.unit] if self.unit else 1.0

    def joint(self) -> Joint:
        """Joint in SI units."""
        limits = {key: getattr(self, key) for key in ("lower", "upper", "home", "max_speed")}
        factor = self.factor
        stated = {key: value * factor for key, value in limits.items() if value is not None}
        return Joint(self.name, self.kind, **stated)


@dataclass(frozen=True)
class BoxTable:
    """Range and speeds of one joint in a calibration, in that joint's unit."""

    lower: Number
    upper: Number
    speed: Number
    margin: Number | None = None
    slowest: Number | None = None
    fastest: Number | None = None
    crawl: Number | None = None


@dataclass(frozen=True)
class AxisTable:
    """Modified Denavit-Hartenberg row; angles in the unit of the kinematics, lengths in m."""

    alpha: Number = 0.0
    a: Number = 0.0
    d: Number = 0.0
    theta: Number = 0.0
    kind: Kind = "revolute"


@dataclass(frozen=True)
class KinematicsTable:
    """A chain of axes, or a URDF beside the file with its first and last link."""

    axes: Annotated[tuple[AxisTable, ...], Length(1, MAX_JOINTS)] | None = None
    unit: Literal["rad", "deg"] = "rad"
    axis_from_joint: _Matrix | None = None
    crtk_from_base: _Matrix | None = None
    tool_rotation: _Matrix | None = None
    urdf: str = ""
    base: str = ""
    tip: str = ""

    def __post_init__(self) -> None:
        chain = [key for key in ("axes", *MATRIX_KEYS) if getattr(self, key) is not None]
        chain += ["unit"] if self.unit != "rad" else []
        if not self.urdf and self.axes is None:
            raise RobotError("'axes' is missing; add it, or name a urdf")
        if chain and (self.urdf or self.base or self.tip):
            raise RobotError(f"{chain[0]} and a URDF's urdf, base or tip; keep one of them")

    def chain(self, joints: Sequence[Joint], folder: Path | None) -> Kinematics:
        """Kinematics of the joints."""
        if self.urdf:
            from truejoint.robots.urdf import read_urdf  # noqa: PLC0415  # an optional extra

            if folder is None:
                raise RobotError("kinematics: a urdf stands in a robot file")
            kinds = {joint.name: joint.kind for joint in joints}
            return read_urdf(folder / self.urdf, kinds, self.base, self.tip)
        return self._serial_chain(joints)

    def _serial_chain(self, joints: Sequence[Joint]) -> SerialChain:
        from truejoint.robots.chain import Axis, SerialChain  # noqa: PLC0415

        turn, axes = UNITS["revolute"][self.unit], self.axes or ()
        matrices = [np.eye(len(axes), len(joints)), np.eye(4), np.eye(3)]
        for k, key in enumerate(MATRIX_KEYS):
            matrix = getattr(self, key)
            if matrix is not None and matrix.shape != matrices[k].shape:
                raise RobotError(
                    f"kinematics: {key} is of shape {matrix.shape}, expected {matrices[k].shape}"
                )
            matrices[k] = matrices[k] if matrix is None else matrix
        kinds = [joint.kind for joint in joints[: len(axes)]]
        if self.axis_from_joint is None and [axis.kind for axis in axes] != kinds:
            raise RobotError(
                f"kinematics: axes {', '.join(axis.kind for axis in axes)} do not fit the joints "
                f"{', '.join(joint.kind for joint in joints)}; say what moves each by "
                "axis_from_joint"
            )
        made = (Axis(x.alpha * turn, x.a, x.d, x.theta * turn, x.kind) for x in axes)
        return SerialChain(tuple(made), *matrices)


@dataclass(frozen=True)
class RobotTable:
    """One arm of a robot as its file or `Robot.to_dict` has it."""

    name: Name
    joints: Annotated[tuple[JointTable, ...], Length(1, MAX_JOINTS)]
    arm: Literal[""] | Name = ""
    channels: Names = ()
    positioning: Names = ()
    effort: Effort = "joint"
    transmission: _Matrix | None = None
    gear: Annotated[tuple[Number, ...], Length(0, MAX_JOINTS)] = ()
    kinematics: KinematicsTable | None = None
    workspace: Annotated[Mapping[str, BoxTable], Length(1, MAX_JOINTS)] | None = None
    mechanism: Mapping[str, Any] | None = None
    grasper: Names = ()
    encoders: Annotated[tuple[JointEncoder, ...], Length(0, MAX_JOINTS)] = ()

    def parts(self, folder: Path | None) -> dict[str, Any]:
        """Fields of a `Robot` in SI units; a URDF stands in `folder`. Raises RobotError."""
        joints = tuple(row.joint() for row in self.joints)
        plain = ("name", "arm", "channels", "positioning", "effort", "grasper")
        matrix = self.transmission
        return {
            **{key: getattr(self, key) for key in plain},
            "joints": joints,
            "transmission": None if matrix is None else Transmission(matrix, self.gear),
            "kinematics": self.kinematics and self.kinematics.chain(joints, folder),
            "workspace": self.workspace and self._workspace(self.workspace),
            "mechanism": None if self.mechanism is None else self._mechanism(self.mechanism),
            "encoders": tuple(map(self._encoder, self.encoders)),
        }

    @cached_property
    def _factors(self) -> dict[str, float]:
        return {joint.name: joint.factor for joint in self.joints}

    def _mechanism(self, values: Mapping[str, Any]) -> CableMechanism:
        """Read a table of cables, or the four numbers of a forceps."""
        if set(values) & {field.name for field in fields(CableMechanism)}:
            return schema.read(CableMechanism, values, "mechanism", RobotError)
        forceps = schema.read(Forceps, values, "mechanism", RobotError)
        return forceps.mechanism(self.joints[0].name)

    def _workspace(self, boxes: Mapping[str, BoxTable]) -> Workspace:
        for name in boxes:
            if name not in self._factors:
                raise RobotError(
                    f"workspace.{name}: want a table for one of the joints "
                    f"{', '.join(self._factors)}"
                )
        rows = {}
        for key in WORKSPACE_KEYS:
            values = {name: getattr(box, key) for name, box in boxes.items()}
            without = [name for name, value in values.items() if value is None]
            if without and len(without) < len(values):
                raise RobotError(
                    f"workspace: {key} is missing for {', '.join(without)}; state it for every "
                    "joint or for none"
                )
            if not without:
                rows[key] = np.array([self._factors[name] * v for name, v in values.items()])
        return Workspace(tuple(boxes), **rows)

    def _encoder(self, encoder: JointEncoder) -> JointEncoder:
        """Bring an encoder, whose table is in the unit of its joint, to SI units."""
        if encoder.joint not in self._factors:
            raise RobotError(f"encoders: {unknown('joint', encoder.joint, self._factors)}")
        factor = self._factors[encoder.joint]
        return replace(
            encoder, resolution=encoder.resolution * factor, hard_stop=encoder.hard_stop * factor
        )
