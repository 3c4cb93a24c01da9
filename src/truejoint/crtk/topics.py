"""Fields of an arm's CRTK topics, computed from its state messages, many at a time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, get_args

import numpy as np
from scipy.spatial.transform import Rotation

from truejoint.array_types import Array
from truejoint.crtk import cartesian
from truejoint.crtk.states import OperatingState, State
from truejoint.errors import CommandRefused, unknown
from truejoint.robots import Robot
from truejoint.robots.blocks import StateBlock

STATES: Final[tuple[State, ...]] = get_args(State)
"""Names of operating states by their number in a recording."""
OPERATING_STATE: Final = "operating_state"
TOPICS: Final = (
    OPERATING_STATE, "measured_js", "setpoint_js", "measured_cp", "setpoint_cp", "measured_cv",
)  # fmt: skip
"""Topics of which a recorder keeps what an arm says."""

_POSE: Final = ("x", "y", "z", "qx", "qy", "qz", "qw")
_TWIST: Final = ("vx", "vy", "vz", "wx", "wy", "wz")


def check_topics(robot: Robot, rates: Mapping[str, float]) -> None:
    """Refuse topics that an arm does not offer, and rates [Hz] that are not above 0.

    Raises CommandRefused, or RobotError for one that needs kinematics which are not known.

    Examples
    --------
    >>> from truejoint.crtk.topics import check_topics
    >>> check_topics(arm.robot, {"measured_js": 100.0})
    """
    for topic, rate in rates.items():
        if topic not in TOPICS:
            raise CommandRefused(unknown("topic", topic, TOPICS))
        if not rate > 0.0:
            raise CommandRefused(f"topic {topic}: rate {rate} Hz; give one above 0 Hz")
        if topic.endswith(("_cp", "_cv")):
            robot.known_kinematics(f"topic {topic}")


def topic_columns(robot: Robot, topic: str, block: StateBlock) -> dict[str, Array]:
    """Give the fields of a topic's messages (n,) each, by name, for n state messages.

    Joint states have ``position/<joint>`` [rad or m], measured ones also ``velocity/<joint>``
    and, where the robot states it, ``effort/<joint>`` on the joint itself [Nm or N]; poses have
    x, y, z [m] and a unit quaternion; twists velocity [m/s] and angular velocity [rad/s], all in
    the frame of the CRTK topics.
    """
    joints = robot.joint_channels
    quantity, _, kind = topic.partition("_")
    position = (block.measured if quantity == "measured" else block.setpoint)[:, joints]
    if kind == "js":
        fields = {"position": position}
        if quantity == "measured":
            fields |= {"velocity": block.velocity[:, joints], "effort": joint_efforts(robot, block)}
        return {
            f"{field}/{name}": values[:, k]
            for field, values in fields.items()
            if values.shape[1]
            for k, name in enumerate(robot.joint_names)
        }
    kinematics = robot.known_kinematics(f"topic {topic}")
    if kind == "cv":
        rows = cartesian.jacobian(kinematics, position)
        twist = (rows @ block.velocity[:, joints, None])[..., 0]
        return dict(zip(_TWIST, twist.T, strict=True))
    poses = cartesian.pose(kinematics, position)
    turns = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    return dict(zip(_POSE, np.column_stack([poses[:, :3, 3], turns]).T, strict=True))


def joint_efforts(robot: Robot, block: StateBlock) -> Array:
    """Efforts (n, n_joints) on the joints themselves [Nm or N]; (n, 0) where none are stated."""
    if not block.effort.shape[1]:
        return np.empty((len(block.t), 0))
    efforts = block.effort[:, robot.joint_channels]
    if robot.transmission is not None and robot.effort == "motor":
        efforts = robot.transmission.joint_effort(efforts)
    return efforts


def state_columns(state: OperatingState) -> dict[str, Array]:
    """Fields of one operating state, (1,) each: its number in `STATES`, and 0 or 1."""
    homed, busy = float(state.is_homed), float(state.is_busy)
    values = {"state": float(STATES.index(state.state)), "is_homed": homed, "is_busy": busy}
    return {name: np.array([value]) for name, value in values.items()}
