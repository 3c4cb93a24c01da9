"""The robot model that everything else takes: its parts, and how it stands in a file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, get_args

import numpy as np

from truejoint import schema
from truejoint.array_types import Array
from truejoint.errors import RobotError, other_kind, unknown
from truejoint.robots.cable_mechanism import CableMechanism
from truejoint.robots.description import MATRIX_KEYS, Names, RobotTable
from truejoint.robots.joint_encoder import JointEncoder
from truejoint.robots.parts import (
    WORKSPACE_KEYS,
    Effort,
    Joint,
    Kinematics,
    Transmission,
    Workspace,
)
from truejoint.summary import Summarised
from truejoint.toml_file import read_toml


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
    mechanism: CableMechanism | None = None
    grasper: tuple[str, ...] = ()
    encoders: tuple[JointEncoder, ...] = ()

    def __post_init__(self) -> None:
        if not self.channels:
            object.__setattr__(self, "channels", self.joint_names)
        if not self.positioning:
            object.__setattr__(self, "positioning", self.joint_names)
        encoded = tuple(encoder.joint for encoder in self.encoders)
        for key in ("joints", "channels", "positioning", "grasper", "encoders"):
            names = {"joints": self.joint_names, "encoders": encoded}.get(key) or getattr(self, key)
            _check_once(names, f"{self.name}: {key}")
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
        table = schema.read(RobotTable, values, source, RobotError)
        try:
            return cls(**table.parts(folder))
        except RobotError as error:
            raise RobotError(f"{source}: {error}") from None

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON, SI; of kinematics that are code only the chain of axes."""
        plain = ("name", "arm", "joints", "effort", "channels", "positioning", "grasper")
        values = {key: schema.plain(getattr(self, key)) for key in plain}
        if self.transmission is not None:
            values["transmission"] = self.transmission.matrix.tolist()
            if self.transmission.gear:
                values["gear"] = list(self.transmission.gear)
        if self.encoders:
            values["encoders"] = schema.plain(self.encoders)
        if self.mechanism is not None:
            values["mechanism"] = schema.plain(self.mechanism)
        space = self.workspace
        if space is not None:
            rows = {key: getattr(space, key) for key in WORKSPACE_KEYS}
            values["workspace"] = {
                joint: {key: float(row[k]) for key, row in rows.items() if row is not None}
                for k, joint in enumerate(space.joints)
            }
        chain: Any = self.kinematics
        if hasattr(chain, "axes"):
            values["kinematics"] = {
                "axes": schema.plain(tuple(chain.axes)),
                **{key: schema.plain(getattr(chain, key)) for key in MATRIX_KEYS},
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

    @property
    def joint_channels(self) -> list[int]:
        """Position of each joint among the channels."""
        return [self.channels.index(name) for name in self.joint_names]

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

    arms: Names


def _check_once(names: Sequence[str], where: str) -> None:
    repeated = [name for name in names if names.count(name) > 1]
    if repeated:
        raise RobotError(f"{where}: {repeated[0]!r} stands twice; keep one")
