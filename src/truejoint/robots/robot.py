"""The robot model that everything else takes: its parts, and how it stands in a file."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Final, Literal, NamedTuple

import numpy as np

from truejoint import schema
from truejoint.array_types import Array
from truejoint.errors import RobotError, other_kind, unknown
from truejoint.robots import parts
from truejoint.robots.cable_mechanism import CableMechanism, Forceps
from truejoint.robots.parts import Joint, JointEncoder, Kinematics, Number, Transmission, Workspace
from truejoint.schema import Bounds, Length, Name, Shape
from truejoint.summary import Summarised
from truejoint.toml_file import read_differences

MAX_JOINTS: Final = 64
_MATRICES: Final = ("axis_from_joint", "crtk_from_base", "tool_rotation")
_PLAIN: Final = ("name", "arm", "joints", "effort", "channels", "positioning", "grasper")
_Names = Annotated[tuple[Name, ...], Length(0, MAX_JOINTS)]
_Matrix = Annotated[Array, Shape((None, None)), Bounds(-1e9, 1e9)]


@dataclass(frozen=True)
class _JointTable:
    """A joint, whose limits are in the unit that it states."""

    name: Name
    kind: parts.Kind = "revolute"
    unit: str = ""
    lower: Number = -math.inf
    upper: Number = math.inf
    home: Number = 0.0
    max_speed: Number = math.inf

    def __post_init__(self) -> None:
        if self.unit and self.unit not in parts.UNITS[self.kind]:
            units = " or ".join(parts.UNITS[self.kind])
            raise RobotError(
                f"unit {self.unit!r:.40} does not fit a {self.kind} joint; want {units}"
            )

    @property
    def factor(self) -> float:
        """Factor from the unit of the table to SI."""
        return parts.UNITS[self.kind][self.unit] if self.unit else 1.0

    def joint(self) -> Joint:
        """Joint in SI units."""
        factor, numbers = self.factor, (self.lower, self.upper, self.home, self.max_speed)
        return Joint(self.name, self.kind, *(number * factor for number in numbers))


class _BoxTable(NamedTuple):
    """Range and speeds of one joint in a calibration, in that joint's unit."""

    lower: Number
    upper: Number
    speed: Number
    margin: Number | None = None
    slowest: Number | None = None
    fastest: Number | None = None
    crawl: Number | None = None


@dataclass(frozen=True)
class _KinematicsTable:
    """A chain of axes, angles in its unit, or a URDF beside the file with its first and last link.

    Lengths are in m.
    """

    axes: Annotated[tuple[parts.Axis, ...], Length(1, MAX_JOINTS)] = ()
    unit: Literal["rad", "deg"] = "rad"
    axis_from_joint: _Matrix | None = None
    crtk_from_base: Annotated[Array, Shape((4, 4)), Bounds(-1e9, 1e9)] | None = None
    tool_rotation: Annotated[Array, Shape((3, 3)), Bounds(-1e9, 1e9)] | None = None
    urdf: str = ""
    base: str = ""
    tip: str = ""

    def __post_init__(self) -> None:
        if not self.urdf and not self.axes:
            raise RobotError("'axes' is missing; add it, or name a urdf")
        chain = ["axes"] if self.axes else []
        chain += [key for key in _MATRICES if getattr(self, key) is not None]
        chain += ["unit"] if self.unit != "rad" else []
        if chain and (self.urdf or self.base or self.tip):
            raise RobotError(f"{chain[0]} and a URDF's urdf, base or tip; keep one of them")

    def chain(self, joints: Sequence[Joint], folder: Path | None) -> Kinematics:
        """Kinematics of the joints."""
        kinds = [joint.kind for joint in joints]
        if self.urdf:
            from truejoint.robots.urdf import read_urdf  # noqa: PLC0415  # an optional extra

            if folder is None:
                raise RobotError("kinematics: a urdf stands in a robot file")
            by_name = {joint.name: joint.kind for joint in joints}
            return read_urdf(folder / self.urdf, by_name, self.base, self.tip)
        from truejoint.robots.chain import SerialChain  # noqa: PLC0415  # brings the compiler

        moving, shape = [axis.kind for axis in self.axes], (len(self.axes), len(joints))
        if self.axis_from_joint is None and moving != kinds[: len(moving)]:
            raise RobotError(
                f"kinematics: axes {', '.join(moving)} do not fit the joints "
                f"{', '.join(kinds)}; say what moves each by axis_from_joint"
            )
        stated = {key: getattr(self, key) for key in _MATRICES if getattr(self, key) is not None}
        matrices = {"axis_from_joint": np.eye(*shape), **stated}
        if matrices["axis_from_joint"].shape != shape:
            raise RobotError(f"kinematics: axis_from_joint must be {shape[0]} x {shape[1]} numbers")
        turn = parts.UNITS["revolute"][self.unit]
        axes = (replace(x, alpha=x.alpha * turn, theta=x.theta * turn) for x in self.axes)
        return SerialChain(tuple(axes), **matrices)


class _RobotTable(NamedTuple):
    """One arm of a robot as its file or `Robot.to_dict` has it."""

    name: Name
    joints: Annotated[tuple[_JointTable, ...], Length(1, MAX_JOINTS)]
    arm: Literal[""] | Name = ""
    channels: _Names = ()
    positioning: _Names = ()
    effort: parts.Effort = "joint"
    transmission: _Matrix | None = None
    gear: Annotated[tuple[Number, ...], Length(0, MAX_JOINTS)] = ()
    kinematics: _KinematicsTable | None = None
    workspace: Annotated[Mapping[str, _BoxTable], Length(1, MAX_JOINTS)] | None = None
    mechanism: Mapping[str, Any] | None = None
    grasper: _Names = ()
    encoders: Annotated[tuple[JointEncoder, ...], Length(0, MAX_JOINTS)] = ()

    def parts(self, folder: Path | None) -> dict[str, Any]:
        """Fields of a `Robot` in SI units; a URDF stands in `folder`. Raises RobotError."""
        joints = tuple(row.joint() for row in self.joints)
        factors = {row.name: row.factor for row in self.joints}
        matrix = self.transmission
        return {
            **{key: getattr(self, key) for key in _PLAIN},
            "joints": joints,
            "transmission": None if matrix is None else Transmission(matrix, self.gear),
            "kinematics": self.kinematics and self.kinematics.chain(joints, folder),
            "workspace": self.workspace and _workspace(self.workspace, factors),
            "mechanism": None if self.mechanism is None else self._mechanism(self.mechanism),
            "encoders": tuple(
                replace(
                    encoder,
                    resolution=encoder.resolution * factors.get(encoder.joint, 1.0),
                    hard_stop=encoder.hard_stop * factors.get(encoder.joint, 1.0),
                )
                for encoder in self.encoders
            ),
        }

    def _mechanism(self, values: Mapping[str, Any]) -> CableMechanism:
        """Read a table of cables, or the four numbers of a forceps."""
        if set(values) & {field.name for field in fields(CableMechanism)}:
            return schema.read(CableMechanism, values, "mechanism", RobotError)
        forceps = schema.read(Forceps, values, "mechanism", RobotError)
        return forceps.mechanism(self.joints[0].name)


def _workspace(boxes: Mapping[str, _BoxTable], factors: Mapping[str, float]) -> Workspace:
    """Workspace of tables in the units of the joints, each with a factor to SI units."""
    rows = {}
    for key in _BoxTable._fields:
        values = {name: getattr(box, key) for name, box in boxes.items()}
        without = [name for name, value in values.items() if value is None]
        if without and len(without) < len(values):
            raise RobotError(
                f"workspace: {key} is missing for {', '.join(without)}; state it for every "
                "joint or for none"
            )
        if not without:
            rows[key] = np.array([factors.get(name, 1.0) * v for name, v in values.items()])
    return Workspace(tuple(boxes), **rows)


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
        Whether the reported effort acts on the joint itself or at the motor.
    mechanism : CableMechanism, optional
        Cables that turn the joints; the transmission is then theirs.
    grasper : tuple of str
        Joints that are jaws, whose positions add up to the opening; empty where there are none.
    encoders : tuple of JointEncoder
        Temporary ones on the joints, in the order of the counts that they send.

    Raises
    ------
    RobotError
        If a name stands twice, a joint has no channel, a positioning joint is not among the joints,
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
    effort: parts.Effort = "joint"
    workspace: Workspace | None = None
    mechanism: CableMechanism | None = None
    grasper: tuple[str, ...] = ()
    encoders: tuple[JointEncoder, ...] = ()

    def __post_init__(self) -> None:
        if not self.channels:
            object.__setattr__(self, "channels", self.joint_names)
        if not self.positioning:
            object.__setattr__(self, "positioning", self.joint_names)
        encoded = tuple(encoder.joint for encoder in self.encoders)
        for key in ("channels", "positioning", "grasper"):
            _check_once(getattr(self, key), f"{self.name}: {key}")
        _check_once(self.joint_names, f"{self.name}: joints")
        _check_once(encoded, f"{self.name}: encoders")
        if tuple(name for name in self.channels if name in self.joint_names) != self.joint_names:
            raise RobotError(
                f"{self.name}: its channels must hold every joint, in order: "
                f"{', '.join(self.joint_names)}"
            )
        self.index((*self.positioning, *self.grasper, *encoded))
        n = len(self.joints)
        if self.mechanism is not None:
            self._take_cables(self.mechanism)
        if self.transmission is not None and self.transmission.matrix.shape != (n, n):
            raise RobotError(
                f"{self.name}: transmission of shape {self.transmission.matrix.shape} does not "
                f"fit its {n} joints; want one row and one column for each"
            )
        if self.workspace is not None:
            self.check_workspace(self.workspace)

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
    ) -> "Robot":
        """Robot of plain data, as `to_dict` gives or a robot file has (docs/robots.md).

        The kinematics may name a URDF in `folder`. Raises RobotError, naming `source`, key and the
        rule that it breaks.
        """
        table = schema.read(_RobotTable, values, source, RobotError)
        try:
            return cls(**table.parts(folder))
        except RobotError as error:
            raise RobotError(f"{source}: {error}") from None

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON, SI; of kinematics that are code only the chain of axes."""
        values = {key: schema.plain(getattr(self, key)) for key in _PLAIN}
        if self.transmission is not None:
            values["transmission"] = self.transmission.matrix.tolist()
            if self.transmission.gear:
                values["gear"] = list(self.transmission.gear)
        for key in ("encoders", "mechanism"):
            if getattr(self, key):
                values[key] = schema.plain(getattr(self, key))
        space = self.workspace
        if space is not None:
            rows = {key: getattr(space, key) for key in _BoxTable._fields}
            values["workspace"] = {
                joint: {key: float(row[k]) for key, row in rows.items() if row is not None}
                for k, joint in enumerate(space.joints)
            }
        chain: Any = self.kinematics
        if hasattr(chain, "axes"):
            values["kinematics"] = {
                "axes": schema.plain(tuple(chain.axes)),
                **{key: schema.plain(getattr(chain, key)) for key in _MATRICES},
            }
        return values

    def summary(self) -> dict[str, str]:
        """Joints, which of them place the tool, and what else is known of the robot, by label."""
        stated = [
            part for part in ("transmission", "kinematics", "workspace") if getattr(self, part)
        ]
        return {
            "robot": self.title,
            "joints": ", ".join(f"{joint.name} [{joint.unit}]" for joint in self.joints),
            "positioning": ", ".join(self.positioning),
            "effort": f"of the {self.effort}",
            "known": ", ".join(stated) or "-",
        }

    @property
    def title(self) -> str:
        """Name and arm for a person, for instance ``"raven2 (left arm)"``."""
        return f"{self.name} ({self.arm} arm)" if self.arm else self.name

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints, in order."""
        return tuple(joint.name for joint in self.joints)

    @cached_property
    def joint_channels(self) -> list[int]:
        """Position of each joint among the channels."""
        return [self.channels.index(name) for name in self.joint_names]

    @cached_property
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

    def known_kinematics(self, what: str) -> Kinematics:
        """Kinematics; raises RobotError, saying `what` needs them, where they are not known."""
        if self.kinematics is None:
            raise RobotError(
                f"{what}: the kinematics of {self.title} are not known; give its robot file a "
                "table [kinematics]"
            )
        return self.kinematics

    def joint(self, name: str) -> Joint:
        """Return the joint called `name`; raises RobotError for another name."""
        return self.joints[self.index([name])[0]]

    def index(self, names: Sequence[str]) -> list[int]:
        """Positions of the joints `names` in a joint vector; raises RobotError if unknown."""
        for name in names:
            if name not in self.joint_names:
                raise RobotError(f"{self.title}: {unknown('joint', name, self.joint_names)}")
        return [self.joint_names.index(name) for name in names]


def as_robot(value: object) -> Robot:
    """Give back a robot; raises RobotError for anything else, saying how to get one."""
    if isinstance(value, Robot):
        return value
    raise RobotError(other_kind(value, "Robot", "get_robot(name) gives one"))


def read_robot(path: Path, arm: str = "", source: str = "") -> Robot:
    """Robot of a TOML file, which may also name its ``arms`` and a URDF for its kinematics.

    `arm`, in any case, is one of these; errors name `source`, the path by default. With ``like``
    the file states only how it differs from another one beside it.
    """
    values = read_differences(path, RobotError)
    source = source or str(path)
    if "arm" in values:
        raise RobotError(
            f"{source}: {unknown('key', 'arm', ('arms', *sorted({*values} - {'arm'})))}"
        )
    arms = schema.read(_Arms, {"arms": values.pop("arms", [])}, source, RobotError).arms
    _check_once(arms, f"{source}: arms")
    name = arm.strip().lower()
    if name and name not in arms:
        choices = ", ".join(arms) or "none: leave the arm empty"
        raise RobotError(f"{source}: has no arm called {arm!r}; its arms: {choices}")
    return Robot.from_dict({**values, "arm": name}, source, folder=path.parent)


class _Arms(NamedTuple):
    """Arms of a robot file, which are alike."""

    arms: _Names


def _check_once(names: Sequence[str], where: str) -> None:
    repeated = [name for name in names if names.count(name) > 1]
    if repeated:
        raise RobotError(f"{where}: {repeated[0]!r} stands twice; keep one")
