"""What a robot is: its joints with units and limits, its transmission and its kinematics."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, Protocol, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truejoint.errors import RobotError, unknown
from truejoint.robots.workspace import Workspace

Array = NDArray[np.float64]
Effort = Literal["joint", "motor"]


@dataclass(frozen=True)
class Joint:
    """One joint; positions are in rad (revolute) or m (prismatic).

    Raises
    ------
    RobotError
        If its limits are upside down, its home lies outside of them or its speed is not positive.

    Examples
    --------
    >>> truejoint.get_robot("raven2").joint("insertion").unit
    'm'
    """

    name: str
    kind: Literal["revolute", "prismatic"] = "revolute"
    lower: float = -math.inf
    upper: float = math.inf
    home: float = 0.0
    max_speed: float = math.inf

    def __post_init__(self) -> None:
        if not self.lower < self.upper:
            raise RobotError(
                f"joint {self.name!r}: lower limit {self.lower:g} {self.unit} is not below the "
                f"upper one, {self.upper:g}; exchange them"
            )
        if not self.lower <= self.home <= self.upper:
            raise RobotError(
                f"joint {self.name!r}: home {self.home:g} {self.unit} is not within its limits "
                f"{self.lower:g} and {self.upper:g}; state a home that is"
            )
        if not self.max_speed > 0:
            raise RobotError(f"joint {self.name!r}: max_speed is {self.max_speed:g}; want above 0")

    @property
    def unit(self) -> str:
        """SI unit of the joint's position, ``"rad"`` or ``"m"``."""
        return "rad" if self.kind == "revolute" else "m"

    @property
    def effort_unit(self) -> str:
        """SI unit of the effort that acts on the joint itself, ``"Nm"`` or ``"N"``."""
        return "Nm" if self.kind == "revolute" else "N"


@dataclass(frozen=True, eq=False)
class Transmission:
    """Linear cable transmission with coupling, ``motor = matrix @ joint``.

    Attributes
    ----------
    matrix : ndarray, shape (n_joints, n_joints)
        Motor-shaft angle per joint position, rad/rad or rad/m; off-diagonal terms are the
        cable coupling between joints.

    Raises
    ------
    RobotError
        If `matrix` is not square, finite and invertible.

    Examples
    --------
    >>> truejoint.get_robot("raven2").transmission is None
    False
    """

    matrix: Array

    def __post_init__(self) -> None:
        matrix, shape = self.matrix, self.matrix.shape
        finite = len(shape) == 2 and shape[0] == shape[1] and np.isfinite(matrix).all()
        if not finite or np.linalg.matrix_rank(matrix) < len(matrix):
            raise RobotError(
                f"transmission matrix of shape {shape} must be square, finite and "
                "invertible: each joint needs a motor of its own"
            )

    def motor_from_joint(self, joint: ArrayLike) -> Array:
        """Motor-shaft angles (..., n_joints) [rad] of joint positions (..., n_joints)."""
        return np.asarray(joint, dtype=float) @ self.matrix.T

    def joint_from_motor(self, motor: ArrayLike) -> Array:
        """Joint positions (..., n_joints) [rad or m] of motor-shaft angles [rad]."""
        return np.asarray(motor, dtype=float) @ self.inverse.T

    @cached_property
    def inverse(self) -> Array:
        """Joint position per motor-shaft angle (n_joints, n_joints) [rad/rad or m/rad]."""
        return np.linalg.inv(self.matrix).astype(np.float64)


class Kinematics(Protocol):
    """Geometry of an arm; joint vectors are in the robot's own joint order."""

    @property
    def crtk_from_base(self) -> Array:
        """Pose (4, 4) of the base frame in the frame of the robot's CRTK topics [m]."""
        ...

    def forward(self, joint: ArrayLike) -> Array:
        """Tool poses (..., 4, 4) [m] in the base frame, of joint positions (..., n_joints)."""
        ...

    def jacobian(self, joint: ArrayLike) -> Array:
        """Geometric Jacobian (..., 6, n_joints): linear [m] over angular [rad] per joint unit."""
        ...


@dataclass(frozen=True, eq=False)
class Robot:
    """One arm of a robot.

    Attributes
    ----------
    name : str
        Robot model, for instance ``"raven2"``; recordings and model files carry it.
    arm : str
        Which arm, for instance ``"left"``; empty for a robot with one arm.
    joints : tuple of Joint
        In the order of every joint vector.
    channels : tuple of str
        Names in the order of the robot's own state message; joints and any unused channel.
    positioning : tuple of str
        Joints that mainly place the tool, and that a calibration corrects by default.
    transmission, kinematics
        None where unknown.
    effort : {"joint", "motor"}
        Where the effort that the robot reports acts: on the joint itself, or at the motor.
    workspace : Workspace, optional
        Where a calibration moves; None where unknown.

    Raises
    ------
    RobotError
        If a name stands twice, a joint has no channel, a positioning joint is none of the joints,
        or the transmission is for another number of joints.

    Examples
    --------
    >>> robot = truejoint.get_robot("raven2", "right")
    >>> robot.title, robot.positioning
    ('raven2 (right arm)', ('shoulder', 'elbow', 'insertion'))
    """

    name: str
    joints: tuple[Joint, ...]
    arm: str = ""
    channels: tuple[str, ...] = ()
    positioning: tuple[str, ...] = ()
    transmission: Transmission | None = None
    kinematics: Kinematics | None = None
    effort: Effort = "joint"
    workspace: Workspace | None = None

    def __post_init__(self) -> None:
        if not self.channels:
            object.__setattr__(self, "channels", self.joint_names)
        if not self.positioning:
            object.__setattr__(self, "positioning", self.joint_names)
        for what in ("joint_names", "channels", "positioning"):
            names = getattr(self, what)
            twice = [name for name in names if names.count(name) > 1]
            if twice:
                raise RobotError(f"{self.name}: {twice[0]!r} is twice among its {what}; keep one")
        if tuple(name for name in self.channels if name in self.joint_names) != self.joint_names:
            raise RobotError(
                f"{self.name}: its channels must hold every joint, in order: "
                f"{', '.join(self.joint_names)}"
            )
        self.index(self.positioning)
        n = len(self.joints)
        if self.transmission is not None and self.transmission.matrix.shape != (n, n):
            raise RobotError(
                f"{self.name}: transmission of shape {self.transmission.matrix.shape} does not "
                f"fit its {n} joints; want one row and one column for each"
            )
        if self.effort not in get_args(Effort):
            raise RobotError(f"{self.name}: effort is {self.effort!r:.40}; want joint or motor")

    @classmethod
    def from_dict(cls, values: Mapping[str, Any], source: str = "robot") -> Robot:
        """Robot of plain data, each value checked.

        Parameters
        ----------
        values : mapping
            As `to_dict` gives.
        source : str
            What errors name.

        Raises
        ------
        RobotError
            Naming source, key and the rule that it breaks.

        Examples
        --------
        >>> tool = {"name": "tool", "joints": [{"name": "jaw", "unit": "deg", "upper": 90}]}
        >>> Robot.from_dict(tool).joint_names
        ('jaw',)
        """
        from truejoint.robots.description import robot_from_dict  # noqa: PLC0415

        return robot_from_dict(values, source)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON, SI; of kinematics that are code only the chain of axes."""
        from truejoint.robots.description import robot_to_dict  # noqa: PLC0415

        return robot_to_dict(self)

    @property
    def title(self) -> str:
        """Name and arm for a person, for instance ``"raven2 (left arm)"``."""
        return f"{self.name} ({self.arm} arm)" if self.arm else self.name

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints, in order."""
        return tuple(joint.name for joint in self.joints)

    @property
    def unused_channels(self) -> tuple[str, ...]:
        """Channels of the state message that belong to no joint."""
        return tuple(name for name in self.channels if name not in self.joint_names)

    @property
    def lower(self) -> Array:
        """Lower joint limits (n_joints,) [rad or m]."""
        return np.array([joint.lower for joint in self.joints])

    @property
    def upper(self) -> Array:
        """Upper joint limits (n_joints,) [rad or m]."""
        return np.array([joint.upper for joint in self.joints])

    @property
    def home(self) -> Array:
        """Joint positions (n_joints,) [rad or m] after homing."""
        return np.array([joint.home for joint in self.joints])

    def joint(self, name: str) -> Joint:
        """Return the joint called `name`; raises RobotError when there is none."""
        for joint in self.joints:
            if joint.name == name:
                return joint
        raise RobotError(f"{self.title}: {unknown('joint', name, self.joint_names)}")

    def index(self, names: Sequence[str]) -> list[int]:
        """Positions of the joints `names` in a joint vector; raises RobotError if unknown."""
        for name in names:
            self.joint(name)
        return [self.joint_names.index(name) for name in names]
