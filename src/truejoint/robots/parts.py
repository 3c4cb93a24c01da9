"""Parts of a robot: joints and their encoders, transmission, calibration workspace, kinematics."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Final, Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike

from truejoint.array_types import Array, floats
from truejoint.errors import RobotError
from truejoint.schema import Bounds, Positive
from truejoint.units import FACTORS

Kind = Literal["revolute", "prismatic"]
Effort = Literal["joint", "motor"]
End = Literal["lower", "upper"]
UNITS: Final = {"revolute": FACTORS["rad"], "prismatic": FACTORS["m"]}
"""By kind of joint, the units that a file may be in, and the factor from each to SI."""
Number = Annotated[float, Bounds(-1e9, 1e9)]


@dataclass(frozen=True)
class Joint:
    """One joint; positions are in rad (revolute) or m (prismatic).

    Raises RobotError if its limits are upside down, its home lies outside of them or its speed is
    not positive.

    Examples
    --------
    >>> truejoint.get_robot("raven2").joint("insertion").unit
    'm'
    """

    name: str
    kind: Kind = "revolute"
    lower: float = -math.inf
    upper: float = math.inf
    home: float = 0.0
    max_speed: float = math.inf

    def __post_init__(self) -> None:
        if self.kind not in tuple(UNITS):
            kinds = " or ".join(UNITS)
            raise RobotError(f"joint {self.name!r}: kind is {self.kind!r:.40}; want {kinds}")
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
    gear : tuple of float, optional
        Turns of each motor's shaft per turn of where its effort is stated, behind a gearbox; by
        default 1.

    Raises
    ------
    RobotError
        If `matrix` is not square, finite and invertible, or `gear` is not as many positive numbers.

    Examples
    --------
    >>> truejoint.get_robot("raven2").transmission is None
    False
    """

    matrix: Array
    gear: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        matrix = floats(self.matrix, "transmission matrix", RobotError)
        object.__setattr__(self, "matrix", matrix)
        gear = floats(self.gear, "transmission gear", RobotError).ravel()
        object.__setattr__(self, "gear", tuple(gear.tolist()))
        shape = matrix.shape
        finite = len(shape) == 2 and shape[0] == shape[1] and np.isfinite(matrix).all()
        if not finite or np.linalg.matrix_rank(matrix) < len(matrix):
            raise RobotError(
                f"transmission matrix of shape {shape} must be square, finite and "
                "invertible: each joint needs a separate motor"
            )
        if self.gear and not (len(self.gear) == len(matrix) and min(self.gear) > 0):
            raise RobotError(
                f"transmission gear {self.gear} must be {len(matrix)} numbers above 0, one a motor"
            )

    def motor_from_joint(self, joint: ArrayLike) -> Array:
        """Motor-shaft angles (..., n_joints) [rad] of joint positions (..., n_joints)."""
        return np.asarray(joint, dtype=float) @ self.matrix.T

    def joint_from_motor(self, motor: ArrayLike) -> Array:
        """Joint positions (..., n_joints) [rad or m] of motor-shaft angles [rad]."""
        return np.asarray(motor, dtype=float) @ self.inverse.T

    def joint_effort(self, effort: ArrayLike) -> Array:
        """Torque or force (..., n_joints) on the joints [Nm or N] of efforts at the motors [Nm].

        By virtual work: what the motors do in a small motion is what the joints receive.
        """
        return np.asarray(np.asarray(effort, dtype=float) @ self.capstan_matrix)

    def motor_effort(self, effort: ArrayLike) -> Array:
        """Torques (..., n_joints) at the motors [Nm] of efforts on the joints [Nm or N].

        The inverse of `joint_effort`.
        """
        return np.asarray(np.asarray(effort, dtype=float) @ np.linalg.inv(self.capstan_matrix))

    @cached_property
    def capstan_matrix(self) -> Array:
        """Turn of each motor's capstan, behind its gearbox, per joint position [rad/rad or rad/m].

        Shape (n_joints, n_joints).
        """
        gear = np.array(self.gear or np.ones(len(self.matrix)))
        return np.asarray(self.matrix / gear[:, None], dtype=np.float64)

    @cached_property
    def inverse(self) -> Array:
        """Joint position per motor-shaft angle (n_joints, n_joints) [rad/rad or m/rad]."""
        return np.linalg.inv(self.matrix).astype(np.float64)


@dataclass(frozen=True, eq=False)
class Workspace:
    """Box of joint positions that a calibration covers; all arrays are (n_joints,).

    Attributes
    ----------
    joints : tuple of str
        In the order of every array.
    lower, upper : ndarray
        Range of each joint [rad or m].
    speed : ndarray
        Speed caps while following a path [rad/s or m/s].
    margin : ndarray, optional
        A random motion turns within this distance of either end [rad or m]; by default a tenth
        of the range.
    slowest, fastest : ndarray, optional
        Range of a random motion's peak speeds [rad/s or m/s]; by default from half of `speed`
        up to it.
    crawl : ndarray, optional
        Speed with which a random motion of the laboratory's profile arrives [rad/s or m/s]; by
        default a fifth of `slowest`.

    Raises
    ------
    RobotError
        If an array is not a finite number for each joint, a range is upside down or a speed is not
        above 0.

    Examples
    --------
    >>> truejoint.get_robot("raven2").workspace.joints
    ('shoulder', 'elbow', 'insertion')
    """

    joints: tuple[str, ...]
    lower: Array
    upper: Array
    speed: Array
    margin: Array | None = None
    slowest: Array | None = None
    fastest: Array | None = None
    crawl: Array | None = None

    def __post_init__(self) -> None:
        for key in ("lower", "upper", "speed", "margin", "slowest", "fastest", "crawl"):
            if getattr(self, key) is None:
                continue
            values = floats(getattr(self, key), f"workspace: {key}", RobotError)
            object.__setattr__(self, key, values)
            if values.shape != (len(self.joints),) or not np.isfinite(values).all():
                raise RobotError(
                    f"workspace: {key} is {values.tolist()!s:.60}; want a finite number for "
                    f"each of {', '.join(self.joints)}"
                )
        good = (self.lower < self.upper) & (self.speed > 0)
        if not good.all():
            joint = self.joints[int(np.argmin(good))]
            raise RobotError(f"workspace.{joint}: lower must be below upper, and speed above 0")

    @property
    def centre(self) -> Array:
        """Middle of each range [rad or m] (peng2024 eq. 4)."""
        return np.asarray((self.lower + self.upper) / 2)

    @property
    def extent(self) -> Array:
        """Width of each range [rad or m] (peng2024 eq. 5)."""
        return np.asarray(self.upper - self.lower)

    @property
    def swings(self) -> Array:
        """Margin, slowest and fastest peak speed and crawl of a random motion (4, n_joints)."""
        margin = 0.1 * self.extent if self.margin is None else self.margin
        slowest = 0.5 * self.speed if self.slowest is None else self.slowest
        fastest = self.speed if self.fastest is None else self.fastest
        crawl = 0.2 * slowest if self.crawl is None else self.crawl
        return np.stack([margin, slowest, fastest, crawl])


@dataclass(frozen=True)
class JointEncoder:
    """Encoder that counts from where it was switched on, registered at the joint's hard stop.

    The position that is assigned to the stop may be another than the robot's own homing assigns,
    which makes a constant offset between the two.
    """

    joint: str
    resolution: Positive  # joint motion per count [rad or m]
    hard_stop: float  # position that is assigned to the stop [rad or m]
    end: End = "upper"  # of the joint's range, at which the stop is
    direction: Literal[1, -1] = 1  # 1 where counts rise with the joint's position
    tolerance: Annotated[int, Bounds(0)] = 20  # counts from the extreme that belong to the stop


@dataclass(frozen=True)
class Axis:
    """One axis of a chain, modified (Craig) Denavit-Hartenberg parameters [rad, m]."""

    alpha: Number = 0.0  # twist about and shift along the previous frame's x axis
    a: Number = 0.0
    d: Number = 0.0  # shift along and turn about the new z axis where the axis' value is zero
    theta: Number = 0.0
    kind: Kind = "revolute"  # the value adds to `theta` or to `d`


class Kinematics(Protocol):
    """Geometry of an arm; joint vectors are in the robot's own joint order."""

    @property
    def crtk_from_base(self) -> Array:
        """Pose (4, 4) of the base frame in the frame of the robot's CRTK topics [m]."""

    def forward(self, joint: ArrayLike) -> Array:
        """Tool poses (..., 4, 4) [m] in the base frame, of joint positions (..., n_joints)."""

    def inverse(self, pose: ArrayLike, seed: ArrayLike) -> Array:
        """Joint positions (n_joints,) near `seed` that reach a tool pose (4, 4) [m].

        Raises RobotError if `pose` is not rigid or out of reach.
        """

    def jacobian(self, joint: ArrayLike) -> Array:
        """Geometric Jacobian (..., 6, n_joints): linear [m] over angular [rad] per joint unit."""
