"""What a robot is, and as plain data: joints with units and limits, transmission, kinematics."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, Protocol, get_args

import numpy as np
from numpy.typing import ArrayLike

from truejoint.array_types import Array, floats
from truejoint.errors import RobotError, other_kind, unknown
from truejoint.robots.cable_mechanism import CableMechanism
from truejoint.robots.forceps_mechanism import ForcepsMechanism
from truejoint.robots.joint_encoder import JointEncoder
from truejoint.robots.plain import check_keys
from truejoint.summary import Summarised
from truejoint.toml_file import read_toml

if TYPE_CHECKING:  # the compiler behind it takes longer to import than the rest
    from truejoint.robots.chain import SerialChain

Effort = Literal["joint", "motor"]

MAX_JOINTS: Final = 64
_LARGEST: Final = 1e9
_NAME: Final = re.compile(r"\w{1,60}", re.ASCII)
_UNITS: Final[Mapping[str, Mapping[str, float]]] = {
    "revolute": {"rad": 1.0, "deg": math.pi / 180.0},
    "prismatic": {"m": 1.0, "mm": 1e-3},
}
_ANGLES: Final = _UNITS["revolute"]
_LIMIT_KEYS: Final = ("lower", "upper", "home", "max_speed")
_AXIS_KEYS: Final = ("alpha", "a", "d", "theta", "kind")
_MATRIX_KEYS: Final = ("axis_from_joint", "crtk_from_base", "tool_rotation")
_CHAIN_KEYS: Final = ("axes", "unit", *_MATRIX_KEYS)
_URDF_KEYS: Final = ("urdf", "base", "tip")
_KEYS: Final = ("name", "arm", "joints", "channels", "positioning", "effort", "transmission",
                "gear", "kinematics", "workspace", "mechanism", "grasper", "encoders",
                "cable_mechanism")  # fmt: skip
_FILE_KEYS: Final = ("name", "arms", *_KEYS[2:])
_ENCODER_KEYS: Final = ("joint", "resolution", "hard_stop", "end", "direction", "tolerance")
_WORKSPACE_KEYS: Final = ("lower", "upper", "speed", "margin", "slowest", "fastest", "crawl")


@dataclass(frozen=True)
class Joint:
    """One joint; positions are in rad (revolute) or m (prismatic).

    Raises
    ------
    RobotError
        If its kind is unknown, its limits are upside down, its home lies outside of them or its
        speed is not positive.

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
        if self.kind not in _UNITS:
            kinds = " or ".join(_UNITS)
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
        shape = matrix.shape
        finite = len(shape) == 2 and shape[0] == shape[1] and np.isfinite(matrix).all()
        if not finite or np.linalg.matrix_rank(matrix) < len(matrix):
            raise RobotError(
                f"transmission matrix of shape {shape} must be square, finite and "
                "invertible: each joint needs a motor of its own"
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
        joint: Array = np.asarray(effort, dtype=float) @ self._effort_matrix
        return joint

    def motor_effort(self, effort: ArrayLike) -> Array:
        """Torques (..., n_joints) at the motors [Nm] of efforts on the joints [Nm or N].

        The inverse of `joint_effort`.
        """
        motor: Array = np.asarray(effort, dtype=float) @ np.linalg.inv(self._effort_matrix)
        return motor

    @cached_property
    def _effort_matrix(self) -> Array:
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
        for key in _WORKSPACE_KEYS:
            if getattr(self, key) is None:
                continue
            values = floats(getattr(self, key), f"workspace: {key}", RobotError)
            object.__setattr__(self, key, values)
            if values.shape != (len(self.joints),) or not np.isfinite(values).all():
                raise RobotError(
                    f"workspace: {key} is {values.tolist()!s:.60}; want a finite number for "
                    f"each of {', '.join(self.joints)}"
                )
        for joint, lower, upper, speed in zip(
            self.joints, self.lower, self.upper, self.speed, strict=True
        ):
            if not (lower < upper and speed > 0):
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


@dataclass(frozen=True, eq=False, repr=False)
class Robot(Summarised):
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
    transmission, kinematics, workspace
        None where unknown; the workspace is where a calibration moves.
    effort : {"joint", "motor"}
        Where the effort that the robot reports acts: on the joint itself, or at the motor.
    mechanism : ForcepsMechanism, optional
        Of a jaw that a motor's cable opens and a spring's shuts; None where it is not stated.
    grasper : tuple of str
        Joints that are jaws, whose positions add up to the opening; empty where there are none.
    encoders : tuple of JointEncoder
        Temporary ones on the joints, in the order of the counts that they send.
    cable_mechanism : CableMechanism, optional
        Of joints that several cables turn; the transmission is then that of its cables.

    Raises
    ------
    RobotError
        If a name stands twice, a joint has no channel, a positioning joint is none of the joints,
        the transmission is for another number of joints, or the workspace is beyond the limits.

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
    mechanism: ForcepsMechanism | None = None
    grasper: tuple[str, ...] = ()
    encoders: tuple[JointEncoder, ...] = ()
    cable_mechanism: CableMechanism | None = None

    def __post_init__(self) -> None:
        if not self.channels:
            object.__setattr__(self, "channels", self.joint_names)
        if not self.positioning:
            object.__setattr__(self, "positioning", self.joint_names)
        _check_once(self.joint_names, f"{self.name}: joints")
        _check_once(self.channels, f"{self.name}: channels")
        _check_once(self.positioning, f"{self.name}: positioning")
        if tuple(name for name in self.channels if name in self.joint_names) != self.joint_names:
            raise RobotError(
                f"{self.name}: its channels must hold every joint, in order: "
                f"{', '.join(self.joint_names)}"
            )
        _check_once(self.grasper, f"{self.name}: grasper")
        encoded = tuple(one.joint for one in self.encoders)
        _check_once(encoded, f"{self.name}: encoders")
        self.index((*self.positioning, *self.grasper, *encoded))
        n = len(self.joints)
        if self.cable_mechanism is not None:
            self._take_cables(self.cable_mechanism)
        if self.transmission is not None and self.transmission.matrix.shape != (n, n):
            raise RobotError(
                f"{self.name}: transmission of shape {self.transmission.matrix.shape} does not "
                f"fit its {n} joints; want one row and one column for each"
            )
        if self.workspace is not None:
            self.check_workspace(self.workspace)
        if self.effort not in get_args(Effort):
            raise RobotError(f"{self.name}: effort is {self.effort!r:.40}; want joint or motor")

    def _take_cables(self, mechanism: CableMechanism) -> None:
        """Make the transmission that of the cables, which are of the robot's joints."""
        if mechanism.joint_names != self.joint_names:
            raise RobotError(
                f"{self.name}: its cables have pins {', '.join(mechanism.joint_names)}; want one "
                f"for each joint, in order: {', '.join(self.joint_names)}"
            )
        for joint in self.joints:
            if joint.kind != "revolute":
                raise RobotError(
                    f"{self.name}: joint {joint.name!r} is {joint.kind}; cables here turn revolute "
                    "joints"
                )
        if self.transmission is None:
            object.__setattr__(self, "transmission", Transmission(mechanism.coupling))
        elif not np.allclose(self.transmission.matrix, mechanism.coupling, rtol=1e-9, atol=1e-12):
            raise RobotError(
                f"{self.name}: transmission is another than that of its cables; leave it out"
            )

    def check_workspace(self, space: Workspace) -> None:
        """Raise RobotError where a workspace is of no joint, or beyond the limits of one."""
        rows = zip(space.joints, space.lower, space.upper, space.speed, strict=True)
        for name, lower, upper, speed in rows:
            joint = self.joint(name)
            if lower < joint.lower or upper > joint.upper or speed > joint.max_speed:
                raise RobotError(
                    f"workspace.{name}: {lower:g} to {upper:g} {joint.unit} at {speed:g} "
                    f"{joint.unit}/s is beyond what the joint can: {joint.lower:g} to "
                    f"{joint.upper:g} at {joint.max_speed:g}"
                )

    @classmethod
    def from_dict(
        cls, values: Mapping[str, Any], source: str = "robot", *, folder: Path | None = None
    ) -> Robot:
        """Robot of plain data, as `to_dict` gives or a robot file has (docs/robots.md).

        The kinematics may name a URDF in `folder`. Raises RobotError, naming `source`, key and the
        rule that it breaks.
        """
        check_keys(values, _KEYS, ("name", "joints"), source)
        joints = _tables(values["joints"], f"{source}: joints")
        try:
            made = tuple(_joint(joint, f"joint {n}") for n, joint in enumerate(joints, 1))
            names = tuple(joint.name for joint in made)
            matrix = values.get("transmission")
            kinematics, workspace = values.get("kinematics"), values.get("workspace")
            mechanism = values.get("mechanism")
            cables = values.get("cable_mechanism")
            for key, table in (("mechanism", mechanism), ("cable_mechanism", cables)):
                if not isinstance(table, Mapping | None):
                    raise RobotError(f"{key} is {table!r:.40}; want a table")
            return cls(
                _name(values["name"], "name"),
                made,
                _name(values.get("arm", ""), "arm") if values.get("arm") else "",
                _names(values.get("channels", names), "channels"),
                _names(values.get("positioning", names), "positioning"),
                None if matrix is None else _transmission(matrix, values.get("gear", ())),
                None if kinematics is None else _kinematics(kinematics, made, folder),
                values.get("effort", "joint"),
                None if workspace is None else _workspace(workspace, joints),
                None if mechanism is None else ForcepsMechanism.from_dict(mechanism),
                _names(values.get("grasper", ()), "grasper"),
                _encoders(values["encoders"], joints) if values.get("encoders") else (),
                None if cables is None else CableMechanism.from_dict(cables),
            )
        except RobotError as error:
            raise RobotError(f"{source}: {error}") from None

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON, SI; of kinematics that are code only the chain of axes."""
        joints, limitless = [asdict(joint) for joint in self.joints], (math.inf, -math.inf)
        values: dict[str, Any] = {
            "joints": [{k: v for k, v in joint.items() if v not in limitless} for joint in joints],
            **{key: getattr(self, key) for key in ("name", "arm", "effort")},
            **{key: list(getattr(self, key)) for key in ("channels", "positioning", "grasper")},
        }
        if self.transmission is not None:
            values["transmission"] = self.transmission.matrix.tolist()
            if self.transmission.gear:
                values["gear"] = list(self.transmission.gear)
        if self.encoders:
            values["encoders"] = [asdict(encoder) for encoder in self.encoders]
        if self.mechanism is not None:
            values["mechanism"] = dict(vars(self.mechanism))
        if self.cable_mechanism is not None:
            values["cable_mechanism"] = self.cable_mechanism.to_dict()
        space = self.workspace
        if space is not None:
            rows = {key: getattr(space, key) for key in _WORKSPACE_KEYS}
            values["workspace"] = {
                joint: {key: float(row[k]) for key, row in rows.items() if row is not None}
                for k, joint in enumerate(space.joints)
            }
        chain: Any = self.kinematics
        if hasattr(chain, "axes"):
            values["kinematics"] = {
                "axes": [asdict(axis) for axis in chain.axes],
                **{key: np.asarray(getattr(chain, key)).tolist() for key in _MATRIX_KEYS},
            }
        return values

    def summary(self) -> dict[str, str]:
        """Joints, which of them place the tool, and what else is known of the robot, by label."""
        known = [
            what for what in ("transmission", "kinematics", "workspace") if getattr(self, what)
        ]
        return {
            "robot": self.title,
            "joints": ", ".join(f"{joint.name} [{joint.unit}]" for joint in self.joints),
            "positioning": ", ".join(self.positioning),
            "effort": f"of the {self.effort}",
            "known": ", ".join(known) or "-",
        }

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


def as_robot(value: object) -> Robot:
    """Give back a robot; raises RobotError for anything else, saying how to get one."""
    if isinstance(value, Robot):
        return value
    raise RobotError(other_kind(value, "Robot", "get_robot(name) gives one"))


def read_robot(path: Path, arm: str = "", source: str = "") -> Robot:
    """Robot of a TOML file, which may also name its ``arms`` and a URDF for its kinematics.

    `arm`, in any case, is one of these; errors name `source`, the path by default.
    """
    values = read_toml(path, RobotError)
    source = source or str(path)
    check_keys(values, _FILE_KEYS, (), source)
    arms = _names(values.pop("arms", []), f"{source}: arms")
    _check_once(arms, f"{source}: arms")
    wanted = arm.strip().lower()
    if wanted and wanted not in arms:
        known = ", ".join(arms) or "none: leave the arm empty"
        raise RobotError(f"{source}: has no arm called {arm!r}; its arms: {known}")
    return Robot.from_dict({**values, "arm": wanted}, source, folder=path.parent)


def _joint(values: Mapping[str, Any], where: str) -> Joint:
    check_keys(values, ("name", "kind", "unit", *_LIMIT_KEYS), ("name",), where)
    name = _name(values["name"], f"{where}: name")
    kind, factor = _kind(values, f"joint {name!r}")
    limits = {key: values[key] for key in _LIMIT_KEYS if key in values}
    numbers = {k: _number(v, f"joint {name!r}: {k}") * factor for k, v in limits.items()}
    return Joint(name, kind, **numbers)


def _workspace(values: Any, joints: Sequence[Mapping[str, Any]]) -> Workspace:
    """Workspace of one table a joint, ``jaw = {lower = -50, ...}`` in that joint's unit."""
    if not isinstance(values, Mapping) or not values:
        raise RobotError(f"workspace is {values!r:.40}; want a table for each joint that moves")
    factors = {joint["name"]: _kind(joint, "workspace")[1] for joint in joints}
    rows = []
    for name, row in values.items():
        where = f"workspace.{name}"
        if name not in factors or not isinstance(row, Mapping):
            raise RobotError(f"{where}: want a table for one of the joints {', '.join(factors)}")
        check_keys(row, _WORKSPACE_KEYS, ("lower", "upper", "speed"), where)
        rows.append({k: _number(v, f"{where}: {k}") * factors[name] for k, v in row.items()})
    shared = [key for key in _WORKSPACE_KEYS if any(key in row for row in rows)]
    for key in shared:
        without = [name for name, row in zip(values, rows, strict=True) if key not in row]
        if without:
            raise RobotError(
                f"workspace: {key} is missing for {', '.join(without)}; state it for every joint "
                "or for none"
            )
    return Workspace(tuple(values), **{key: np.array([row[key] for row in rows]) for key in shared})


def _encoders(values: Any, joints: Sequence[Mapping[str, Any]]) -> tuple[JointEncoder, ...]:
    """Read encoders of tables, each in the unit of its joint."""
    factors = {joint["name"]: _kind(joint, "encoders")[1] for joint in joints}
    encoders = []
    for n, row in enumerate(_tables(values, "encoders"), 1):
        where = f"encoder {n}"
        check_keys(row, _ENCODER_KEYS, _ENCODER_KEYS[:3], where)
        joint = str(row["joint"])
        if joint not in factors:
            raise RobotError(f"{where}: {unknown('joint', joint, tuple(factors))}")
        size = {
            key: _number(row[key], f"{where}: {key}") * factors[joint]
            for key in ("resolution", "hard_stop")
        }
        whole: dict[str, Any] = {k: row[k] for k in ("direction", "tolerance") if k in row}
        if not all(type(value) is int for value in whole.values()):
            raise RobotError(f"{where}: direction and tolerance are whole numbers")
        whole |= {"end": row["end"]} if "end" in row else {}
        encoders.append(JointEncoder(joint, size["resolution"], size["hard_stop"], **whole))
    return tuple(encoders)


def _transmission(matrix: Any, gear: Any) -> Transmission:
    if not isinstance(gear, list | tuple) or len(gear) > MAX_JOINTS:
        raise RobotError(f"gear is {gear!r:.40}; want a number for each motor")
    turns = tuple(_number(value, "gear") for value in gear)
    return Transmission(_matrix(matrix, "transmission"), turns)


def _kind(values: Mapping[str, Any], where: str) -> tuple[Any, float]:
    """Kind of a joint and the factor from its unit in the file to SI."""
    kind = values.get("kind", "revolute")
    if kind not in tuple(_UNITS):
        raise RobotError(f"{where}: kind is {kind!r:.40}; want {' or '.join(_UNITS)}")
    unit = values.get("unit", next(iter(_UNITS[kind])))
    if unit not in tuple(_UNITS[kind]):
        units = " or ".join(_UNITS[kind])
        raise RobotError(f"{where}: unit {unit!r:.40} does not fit a {kind} joint; want {units}")
    return kind, _UNITS[kind][unit]


def _kinematics(values: Any, joints: Sequence[Joint], folder: Path | None) -> Kinematics:
    if not isinstance(values, Mapping):
        raise RobotError(f"kinematics is {values!r:.40}; want a table")
    if "urdf" in values:
        from truejoint.robots.urdf import read_urdf  # noqa: PLC0415  # an optional extra

        check_keys(values, _URDF_KEYS, (), "kinematics")
        if folder is None or not all(isinstance(value, str) for value in values.values()):
            raise RobotError("kinematics: urdf, base and tip are texts, and stand in a robot file")
        path = folder / values["urdf"]
        kinds = {joint.name: joint.kind for joint in joints}
        return read_urdf(path, kinds, values.get("base", ""), values.get("tip", ""))
    return _chain(values, joints)


def _chain(values: Mapping[str, Any], joints: Sequence[Joint]) -> SerialChain:
    from truejoint.robots.chain import Axis, SerialChain  # noqa: PLC0415

    check_keys(values, _CHAIN_KEYS, ("axes",), "kinematics")
    unit = values.get("unit", "rad")
    if unit not in tuple(_ANGLES):
        angles = " or ".join(_ANGLES)
        raise RobotError(f"kinematics: unit {unit!r:.40} is no angle's; want {angles}")
    axes = []
    for n, row in enumerate(_tables(values["axes"], "kinematics: axes"), 1):
        where = f"kinematics: axis {n}"
        check_keys(row, _AXIS_KEYS, (), where)
        kind, _ = _kind({"kind": row.get("kind", "revolute")}, where)
        alpha, a, d, theta = (
            _number(row.get(key, 0.0), f"{where}: {key}") for key in _AXIS_KEYS[:4]
        )
        axes.append(Axis(alpha * _ANGLES[unit], a, d, theta * _ANGLES[unit], kind))
    matrices = [np.eye(len(axes), len(joints)), np.eye(4), np.eye(3)]
    for k, key in enumerate(_MATRIX_KEYS):
        expected = matrices[k].shape
        if key in values:
            matrices[k] = _matrix(values[key], f"kinematics: {key}")
        if matrices[k].shape != expected:
            shape = matrices[k].shape
            raise RobotError(f"kinematics: {key} is of shape {shape}, expected {expected}")
    if "axis_from_joint" not in values:
        kinds = [joint.kind for joint in joints[: len(axes)]]
        if [axis.kind for axis in axes] != kinds:
            raise RobotError(
                f"kinematics: axes {', '.join(axis.kind for axis in axes)} do not fit the joints "
                f"{', '.join(joint.kind for joint in joints)}; say what moves each by "
                "axis_from_joint"
            )
    return SerialChain(tuple(axes), *matrices)


def _check_once(names: Sequence[str], where: str) -> None:
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise RobotError(f"{where}: {twice[0]!r} stands twice; keep one")


def _tables(values: Any, where: str) -> Sequence[Mapping[str, Any]]:
    good = isinstance(values, list | tuple) and all(isinstance(row, Mapping) for row in values)
    if not good or not 0 < len(values) <= MAX_JOINTS:
        raise RobotError(f"{where} are {values!r:.40}; want 1 to {MAX_JOINTS} tables")
    return list(values)


def _name(value: Any, where: str) -> str:
    if not isinstance(value, str) or not _NAME.fullmatch(value):
        raise RobotError(f"{where} is {value!r:.80}; want up to 60 letters, digits and _")
    return value


def _names(values: Any, where: str) -> tuple[str, ...]:
    if not isinstance(values, list | tuple) or len(values) > MAX_JOINTS:
        raise RobotError(f"{where} is {values!r:.40}; want a list of at most {MAX_JOINTS} names")
    return tuple(_name(value, where) for value in values)


def _number(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise RobotError(f"{where} is {value!r:.40}; want a number")
    if not -_LARGEST <= value <= _LARGEST:
        raise RobotError(
            f"{where} is beyond {_LARGEST:g} in size; leave it out where there is none"
        )
    return float(value)


def _matrix(values: Any, where: str) -> Array:
    rows = values if isinstance(values, list | tuple) else [values]
    if not all(isinstance(row, list | tuple) and len(row) == len(rows[0]) for row in rows):
        raise RobotError(f"{where} is {values!r:.40}; want a list of rows of the same length")
    return np.array([[_number(value, where) for value in row] for row in rows], dtype=np.float64)
