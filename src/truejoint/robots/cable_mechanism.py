"""Joints that cables turn: motors, cables, springs, contact and arms as data; a forceps'."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Annotated, ClassVar, Final, Literal, NamedTuple

import numpy as np

from truejoint.array_types import Array
from truejoint.errors import RobotError, unknown
from truejoint.schema import Bounds, Length, NotNegative, Ordered, Positive

MAX_CABLES: Final = 64
_SAME: Final = 1e-9  # [m] between the moments of two cables of one motor
_ByJoint = Mapping[str, Annotated[float, Bounds(-1e12, 1e12)]]
_Size = Annotated[float, Bounds(1e-12, 1e12)]


@dataclass(frozen=True)
class Pin:
    """Pin of a joint: moved inertia [kg m2], radius [m], constant friction [Nm]."""

    inertia: _Size
    radius: _Size
    friction: float = 0.0


@dataclass(frozen=True)
class Motor:
    """Radius [m] of a motor's capstan, and turns of its shaft per turn of the capstan."""

    SHORT: ClassVar[str] = "radius"

    radius: _Size
    gear: Annotated[float, Bounds(1.0, 1e6)] = 1.0


@dataclass(frozen=True)
class Node:
    """Bend of a cable: wrap angle [rad] in the pose of zeros.

    A `joint` that is named turns the cable's path with it: its angle shortens the wrap of cables
    whose moment about it is positive and lengthens that of those whose moment is negative.
    """

    wrap: NotNegative
    joint: str = ""


@dataclass(frozen=True)
class Cable:
    """One cable, from its end at a motor's capstan, or a spring, to the link that it pulls."""

    name: str
    moments: _ByJoint  # by how much each joint's angle lets the cable's end go [m/rad]
    motor: str = ""  # whose capstan winds it up; empty if it ends at a spring
    sign: Literal[1, -1] = 1  # which way the motor turns to wind it up
    spring: NotNegative = 0.0  # stiffness [N/m] of the spring at its end; 0 if it ends at a motor
    # Shares of the cable's compliance before, between and behind its nodes, from the motor on;
    # their sum is 1, and there is one more than nodes.
    segments: tuple[Positive, ...] = (1.0,)
    nodes: tuple[Node, ...] = ()


@dataclass(frozen=True)
class Contact:
    """Jaws that meet: opening = sum of `opening[joint]` x angle; stiffness and damping [Nm ...]."""

    opening: _ByJoint
    stiffness: Positive = 1.5
    damping: NotNegative = 2e-3


@dataclass(frozen=True, eq=False, repr=False)
class CableMechanism:
    """Joints, motors and the cables between them; everything in SI.

    Raises RobotError if a cable ends nowhere, a name is not one of the joints or motors, or the
    coupling cannot be inverted.
    """

    pins: Annotated[Mapping[str, Pin], Ordered()]  # by joint, in the order of every joint vector
    motors: Annotated[Mapping[str, Motor], Ordered()]  # in the order of every motor vector
    cables: Annotated[tuple[Cable, ...], Length(1, MAX_CABLES)]
    contact: Contact | None = None  # of two jaws; None without jaws
    # By the name of a force at the tip, the moment arm [m] about each joint that it turns.
    arms: Annotated[Mapping[str, _ByJoint], Ordered()] = field(default_factory=dict)

    def __repr__(self) -> str:
        """One line, as it stands among an estimator's settings; `vars` has the rest."""
        turned = ", ".join(self.joint_names)
        return f"<{turned} by {len(self.motors)} motors and {len(self.cables)} cables>"

    def __post_init__(self) -> None:
        names = [cable.name for cable in self.cables]
        for cable in self.cables:
            if names.count(cable.name) > 1:
                raise RobotError(f"cable {cable.name!r} stands twice; keep one")
            fault = self._fault(cable)
            if fault:
                raise RobotError(f"cable {cable.name!r:.40}{fault}")
        self._check_joints({} if self.contact is None else self.contact.opening, "contact")
        for name, arm in self.arms.items():
            self._check_joints(arm, f"arm {name!r}")
        matrix = self.coupling
        if len(matrix) != len(self.pins) or np.linalg.matrix_rank(matrix) < len(matrix):
            raise RobotError(
                f"the coupling of {len(self.motors)} motors to {len(self.pins)} joints cannot be "
                "inverted; each joint needs a separate motor, and cables that turn it"
            )

    def _fault(self, cable: Cable) -> str:
        """Say which rule a cable breaks, else nothing; raises RobotError for an unknown joint."""
        if bool(cable.motor) == bool(cable.spring):
            both = " ends at a motor and at a spring; keep one"
            return both if cable.motor else " ends nowhere; give it a motor, or a spring [N/m]"
        if cable.motor and cable.motor not in self.motors:
            return f": {unknown('motor', cable.motor, self.motors)}"
        turning = [node.joint for node in cable.nodes if node.joint]
        self._check_joints([*cable.moments, *turning], f"cable {cable.name!r:.40}")
        if not any(cable.moments.values()):
            return " ends nowhere: it turns no joint; give it a moment [m]"
        if len(cable.nodes) != len(cable.segments) - 1:
            return (
                f": {len(cable.segments)} segments and {len(cable.nodes)} nodes; want one segment "
                "more than nodes"
            )
        whole = math.fsum(cable.segments)
        if abs(whole - 1.0) > 1e-6:
            return f": segments add up to {whole:g}; want shares of 1"
        return ""

    def _check_joints(self, joints: Iterable[str], where: str) -> None:
        for joint in joints:
            if joint not in self.pins:
                raise RobotError(f"{where}: {unknown('joint', joint, self.pins)}")

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints, in order."""
        return tuple(self.pins)

    @property
    def radii(self) -> Array:
        """Cable that each motor winds up per turn of its shaft (n_motors,) [m/rad]."""
        return np.array([motor.radius / motor.gear for motor in self.motors.values()])

    @property
    def moments(self) -> Array:
        """Moment of each cable about each joint (n_cables, n_joints) [m]."""
        return np.array([self.row(cable.moments) for cable in self.cables])

    def row(self, by_joint: Mapping[str, float]) -> Array:
        """Numbers by joint as a vector (n_joints,), 0 where there is none."""
        return np.array([float(by_joint.get(joint, 0.0)) for joint in self.pins])

    @property
    def coupling(self) -> Array:
        """Motor angle per joint angle (n_motors, n_joints) [rad/rad] where no cable gives way.

        Raises RobotError if a motor winds up no cable, or its cables ask for different angles.
        """
        rows = []
        for name, motor in self.motors.items():
            wound = [c.sign * self.row(c.moments) for c in self.cables if c.motor == name]
            if not wound:
                raise RobotError(f"motor {name!r} winds up no cable; give it one")
            if any(np.abs(moments - wound[0]).max() > _SAME for moments in wound):
                raise RobotError(
                    f"the cables of motor {name!r} have different moments; what one gets the "
                    "other must give"
                )
            rows.append(motor.gear * wound[0] / motor.radius)
        return np.array(rows)


class Forceps(NamedTuple):
    """Transmission from motor to jaw; symbols and defaults of yan2020, Table 1."""

    gear_ratio: Annotated[float, Bounds(1.0, 1000.0)] = 35.0
    """Motor turns per turn of the winding wheel, ``z_i``."""
    spring_stiffness: Annotated[float, Bounds(10.0, 1e4)] = 656.6
    """Reset spring ``K_sp`` [N/m]."""
    wheel_radius: Annotated[float, Bounds(1e-3, 0.1)] = 9.75e-3
    """Effective radius of the winding wheel ``R`` [m]."""
    jaw_radius: Annotated[float, Bounds(1e-3, 0.02)] = 4.0e-3
    """Radius at which both cables act on the jaw ``r`` [m]."""

    @classmethod
    def of(cls, mechanism: CableMechanism | None) -> "Forceps":
        """Read a mechanism of one joint, a motor's cable and a spring's; else RobotError."""
        cables = () if mechanism is None else mechanism.cables
        has_spring = [cable.spring > 0 for cable in cables]
        if mechanism is None or len(mechanism.pins) != 1 or has_spring != [False, True]:
            raise RobotError(
                "the mechanism is not a forceps'; want one joint, a motor's cable and then a "
                "spring's"
            )
        (motor,), (moment,) = mechanism.motors.values(), cables[0].moments.values()
        return cls(motor.gear, cables[1].spring, motor.radius, cables[0].sign * moment)

    def mechanism(self, joint: str = "jaw") -> CableMechanism:
        """Cables of the forceps."""
        return CableMechanism(
            {joint: Pin(inertia=1e-6, radius=1.0e-3)},  # the forceps' own twin takes others
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
