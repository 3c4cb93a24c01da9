"""Messages of CRTK and of RAVEN-II as columns of a recording in SI units, and back.

Nothing of ROS is needed: messages come and go as arrays by field, a row a message, whether they
were read from a bag or arrive one by one. What a robot does differently from CRTK's rules is in its
`Profile`, by name, and in nothing else.
"""

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from truejoint import schema
from truejoint.array_types import Array
from truejoint.errors import RobotError, unknown
from truejoint.robots import Robot
from truejoint.toml_file import read_toml, shipped_table
from truejoint.units import SI_UNITS

JOINT_STATE: Final = "sensor_msgs/JointState"
RAVEN_STATE: Final = "raven_2/raven_state"
OPERATING_STATE: Final = "crtk_msgs/OperatingState"
# The one name since crtk_msgs 1.1.0 (2023-11); the other until then, on RAVEN-II to this day.
OPERATING_STATES: Final = (OPERATING_STATE, "crtk_msgs/operating_state")
STRING_STAMPED: Final = "crtk_msgs/StringStamped"
RAVEN_TOPIC: Final = "/ravenstate"
TRUTH_TOPIC: Final = "/ext_jpos"
"""Topic of the temporary joint encoders.

Source: uw-biorobotics/raven2_CRTK_Python_controller:joint_encoder.
"""
POT_TOPIC: Final = "io/pot/measured_js"
"""A dVRK's potentiometers, in an arm's namespace; others are ``IO/<io>/<arm>/pot/measured_js``.

Their joint states hold the actuators, called ``actuator_0`` and so on, in rad and m. Sources:
jhu-dvrk/dvrk-ros (dvrk_robot, console), jhu-dvrk/sawRobotIO1394 (mtsRobot1394.cpp),
jhu-dvrk/dvrk_python (scripts/dvrk_calibrate_potentiometers.py).
"""
FORCES: Final = {"force_gauge": ("gauge", 0), "force_cmd": ("command", 3)}
"""Topics of a force [N]: what it is, and where it stands in the positions of a joint state.

Source: uw-biorobotics/raven2_CRTK_Python_controller:python_controller/run_r2_force_gauge_pub.py,
run_r2_trajectory_follow_with_force.py.
"""
CORRECTED: Final = "corrected"  # namespace, within an arm's, of what a correcting node says

_DEFINITIONS: Final = Path(__file__).with_name("definitions")


def _definition(kind: str, ending: str = "msg") -> str:
    return (_DEFINITIONS / f"{kind}.{ending}").read_text(encoding="utf-8")


# The state of both arms as uw-biorobotics/raven2:msg/raven_state.msg has it, by its MD5 sum
# ce9e7f4969049d8bb365de3c98461a01. Other variants are read by the definition in their file.
_RAVEN_TYPES: Final = {
    name: kind
    for kind, name in re.findall(r"^(\w+)\[\d+\] (\w+)$", _definition(RAVEN_STATE), re.MULTILINE)
}
DEFINITIONS: Final[Mapping[str, str]] = {
    RAVEN_STATE: _definition(RAVEN_STATE),
    **dict.fromkeys(OPERATING_STATES, _definition(OPERATING_STATE)),
    STRING_STAMPED: _definition(STRING_STAMPED),
}
"""Definition, as ROS 1 writes it, of each message type that ROS itself does not bring."""

FORWARD: Final = "crtk_msgs/QueryForwardKinematics"
INVERSE: Final = "crtk_msgs/QueryInverseKinematics"
_SUMS: Final = {
    FORWARD: "787c6da7a75e9886573c4af11f1a381f",
    INVERSE: "ce8dbc3b4384e2f7567488e7e75496d8",
}
SERVICES: Final[Mapping[str, tuple[str, ...]]] = {
    kind: (md5, *_definition(kind, "srv").split("---\n")) for kind, md5 in _SUMS.items()
}
"""MD5 sum, request and response of each service type that ROS itself does not bring.

Source: collaborative-robotics/crtk_msgs:srv, since 1.1.0 (2023-11).
"""


def ros2_definition(name: str) -> str:
    """Definition of one of `DEFINITIONS` as ROS 2 writes it."""
    text = re.sub("^Header ", "std_msgs/Header ", DEFINITIONS[name], flags=re.MULTILINE)
    return re.sub("^duration ", "builtin_interfaces/Duration ", text, flags=re.MULTILINE)


ARMS: Final = ("left", "right")  # in the order of every array of RAVEN-II's state: gold, then green

RAVEN_FIELDS: Final[Mapping[str, tuple[str, float]]] = {
    quantity: (field, SI_UNITS[unit][1])
    for quantity, (field, unit) in shipped_table(__package__, "raven_state.toml").items()
}
"""Quantity of a recording: field of ``raven_state``, eight channels an arm, and factor to SI."""

# Quantities of `RAVEN_FIELDS` that are read from a bag by default.
USUAL_QUANTITIES: Final = ("measured", "velocity", "effort", "setpoint")

RUN_LEVELS: Final[Mapping[str, int]] = {"stopped": 0, "homing": 1, "pedal up": 2, "pedal down": 3}
"""Field ``runlevel``. While homing the arm explores its hard stops: positions mean nothing."""


@dataclass(frozen=True)
class Profile:
    """How a robot's topics and messages differ from what CRTK says of them."""

    name: str
    summary: str
    # Namespace of a topic to the arm it is for, where the robot does not name arms that way.
    arms: Mapping[str, str] = field(default_factory=dict)
    swapped: tuple[str, ...] = ()  # CRTK names that stand in the other arm's namespace
    # Name in a message to the joint's, where they differ, after `prefixes` are taken off.
    joints: Mapping[str, str] = field(default_factory=dict)
    # Namespace of a topic to what stands before each joint's name in its messages.
    prefixes: Mapping[str, str] = field(default_factory=dict)
    no_effort: bool = False  # the effort of ``measured_js`` is always 0 and says nothing
    no_setpoint: bool = False  # ``setpoint_js`` is no position to go to
    operating_state: str = OPERATING_STATE  # message type of that topic
    repeats_state: bool = False  # with every state message, not on change and ten times a second
    # ``servo_jr`` may hold more values than there are joints, of which the first count; it and
    # ``servo_jp`` may hold a single one, which is the first joint's.
    longer_increments: bool = False
    # Namespace of an arm's topics to that of its grasper, whose ``measured_js`` has the opening and
    # the two jaws.
    grasper: Mapping[str, str] = field(default_factory=dict)
    # Offsets added to readings of joint sensors that count from another zero [rad or m].
    truth_offsets: Mapping[str, float] = field(default_factory=dict)
    # Joints that an actuator turns alone, in the order of the actuators, which are the first.
    actuators: tuple[str, ...] = ()

    @property
    def truth_note(self) -> str:
        """What is added to the truth, for a person; empty where nothing is."""
        added = ", ".join(f"{shift:+.6g} to {j}" for j, shift in self.truth_offsets.items())
        return added and f"added to the truth [rad or m]: {added}"

    def arm_of(self, topic: str) -> str:
        """Arm of which a topic tells; empty where its name does not say."""
        spaces = [space for space in topic.split("/") if space in self.arms]
        if not spaces:
            return ""
        others = [arm for arm in self.arms.values() if arm != self.arms[spaces[-1]]]
        return others[0] if crtk_name(topic) in self.swapped and others else self.arms[spaces[-1]]

    def topic(self, arm: str, name: str, namespace: str = "") -> str:
        """Topic of an arm's CRTK name: the inverse of `arm_of`; in a `namespace`, or its own."""
        if namespace:
            return f"{namespace.rstrip('/')}/{name}"
        for space in self.arms:
            if self.arm_of(f"{space}/{name}") == arm:
                return f"/{space}/{name}"
        if arm[:1].isdecimal():  # ROS 2 lets no name begin so
            arm = f"arm_{arm}"
        return f"/{arm}/{name}" if arm else f"/{name}"

    def joint_values(self, name: str, values: Array, rest: Array) -> Array:
        """Values (n_joints,) in a message of the command `name`, `rest` for what it leaves out."""
        if self.longer_increments and name in ("servo_jr", "servo_jp") and values.shape == (1,):
            return np.append(values, rest[1:])
        return values[: len(rest)] if self.longer_increments and name == "servo_jr" else values

    def joint(self, name: str) -> str:
        """Joint that is called `name` in a message."""
        for prefix in self.prefixes.values():
            name = name.removeprefix(prefix)
        return self.joints.get(name, name)

    def joint_in(self, topic: str, joint: str) -> str:
        """Name that a joint has in the messages of a topic: the inverse of `joint`."""
        names = {ours: theirs for theirs, ours in self.joints.items()}
        spaces = [space for space in topic.split("/") if space in self.prefixes]
        return "".join(self.prefixes[space] for space in spaces[-1:]) + names.get(joint, joint)


_PROFILES_FILE: Final = Path(__file__).with_name("profiles.toml")
PROFILES: Final[Mapping[str, Profile]] = {
    name: schema.read(Profile, {"name": name, **table}, str(_PROFILES_FILE), RobotError)
    for name, table in read_toml(_PROFILES_FILE, RobotError).items()
}


def profile_of(robot: Robot, name: str = "") -> Profile:
    """Profile called `name`, else that most like the robot's name, else CRTK's; or RobotError."""
    alike = [profile for profile in PROFILES if robot.name.startswith(profile)]
    name = name or max(alike, key=len, default="crtk")
    if name not in PROFILES:
        raise RobotError(unknown("profile", name, PROFILES))
    return PROFILES[name]


def crtk_name(topic: str) -> str:
    """CRTK's name of what a topic tells, its last part, whether it was thinned out or not.

    RAVEN's recorder, which thins out with `topic_tools throttle`, says ``measured_js_100hz``
    (raven2_CRTK_Python_controller:bag_reader/r2_enc_CRTK_recorder.launch).
    """
    return re.sub(r"_\d+hz$", "", topic.rpartition("/")[2])


def is_pot(topic: str) -> bool:
    """Whether a topic tells of potentiometers (`POT_TOPIC`), whatever reads them."""
    return topic.endswith(POT_TOPIC.removeprefix("io"))


def message_type(name: str) -> str:
    """Name of a message type as ROS 1 writes it: ``a/msg/B`` of ROS 2 is ``a/B``."""
    return name.replace("/msg/", "/")


def joint_order(robot: Robot, names: Sequence[str], count: int, profile: Profile) -> list[str]:
    """Joints whose values stand in a joint state of `count` values, in its order.

    Without names, as joint sensors publish, they are all of the robot's, or its positioning ones,
    by their number. Raises RobotError for names or numbers that no joint has.
    """
    if not names:
        for joints in (robot.joint_names, robot.positioning):
            if count == len(joints):
                return list(joints)
        raise RobotError(
            f"{count} positions without names; {robot.title} has {len(robot.joint_names)} joints, "
            f"of which {len(robot.positioning)} place the tool: name the joints in the message"
        )
    order = [name if name in robot.joint_names else profile.joint(name) for name in names]
    robot.index(order)
    if len(order) != count or len(set(order)) != len(order):
        raise RobotError(
            f"{len(order)} joint names for {count} positions ({', '.join(names):.200}); a message "
            "has one for each"
        )
    return order


def joint_state_columns(
    robot: Robot, quantity: str, names: Sequence[str], fields: Mapping[str, Array], profile: Profile
) -> dict[str, Array]:
    """Columns of a recording (n,) [SI] that n joint states with the same `names` hold.

    `fields` has ``position``, ``velocity`` and ``effort``, (n, k) or (n, 0). Gives
    ``<quantity>/<joint>`` for a `quantity` of ``"measured"``, ``"setpoint"``, ``"truth"`` or
    ``"pot"``, of `Profile.actuators` alone; beside measured joints ``velocity/<joint>`` and
    ``effort/<joint>``, at the motor where the robot states it there (`Robot.effort`) and all joints
    are in the message. Raises RobotError as `joint_order`, or if the fields are not of the same
    number of joints.
    """
    position = fields["position"]
    if quantity == "pot":
        columns = zip(profile.actuators, position.T, strict=False)
        return {f"pot/{joint}": values for joint, values in columns}
    joints = joint_order(robot, names, position.shape[1], profile)
    if quantity != "measured":
        offsets = profile.truth_offsets if quantity == "truth" else {}
        shifted = {k: position[:, k] + offsets[j] for k, j in enumerate(joints) if j in offsets}
        return {f"{quantity}/{j}": shifted.get(k, position[:, k]) for k, j in enumerate(joints)}
    quantities = {"measured": position}
    for name in ("velocity", "effort"):
        values = fields.get(name, position[:, :0])
        if values.shape[1] not in (0, len(joints)):
            raise RobotError(
                f"{len(joints)} positions and {values.shape[1]} values of {name}; a joint state "
                "has as many of each, or none"
            )
        if values.shape[1]:
            quantities[name] = values
    if profile.no_effort:
        quantities.pop("effort", None)
    elif "effort" in quantities and robot.effort == "motor" and robot.transmission is not None:
        effort = quantities.pop("effort")
        if set(joints) == set(robot.joint_names):  # cables couple the joints: it takes all of them
            order = [joints.index(joint) for joint in robot.joint_names]
            quantities["effort"] = np.empty_like(effort)
            quantities["effort"][:, order] = robot.transmission.motor_effort(effort[:, order])
    return {
        f"{name}/{joint}": values[:, k]
        for name, values in quantities.items()
        for k, joint in enumerate(joints)
    }


def beside_columns(
    robot: Robot, topic: str, names: Sequence[str], position: Array, profile: Profile
) -> dict[str, Array]:
    """Columns (n,) [SI] of joint states (n, k) of a topic that is recorded beside an arm's state.

    It tells of potentiometers (`POT_TOPIC`) or of a force (`FORCES`). Raises RobotError for any
    other, or if a message is too short.
    """
    name = crtk_name(topic)
    if is_pot(topic):
        return joint_state_columns(robot, "pot", names, {"position": position}, profile)
    if name not in FORCES:
        known = ", ".join([POT_TOPIC, *FORCES])
        raise RobotError(f"{topic} cannot be recorded beside the state; these can: {known}")
    force, place = FORCES[name]
    if position.shape[1] <= place:
        raise RobotError(f"{topic}: {position.shape[1]} values; the force is value {place + 1}")
    return {f"force/{force}": position[:, place]}


def joint_state_fields(
    robot: Robot, quantity: str, topic: str, columns: Mapping[str, Array], profile: Profile
) -> tuple[tuple[str, ...], dict[str, Array]]:
    """Names and fields of joint states that hold an arm's columns: inverse of the one above.

    Gives names (k,) as they are in the messages of `topic`, and ``position``, ``velocity`` and
    ``effort``, (n, k) or (n, 0) where not all the joints have a column of it. A robot that states
    no effort has zeros.
    """
    is_pot = quantity == "pot"
    of_quantity = profile.actuators if is_pot else robot.joint_names
    joints = [joint for joint in of_quantity if f"{quantity}/{joint}" in columns]
    if is_pot and len(joints) < len(of_quantity):  # they stand by their number
        joints = []
    rows = len(next(iter(columns.values())))

    def table(name: str) -> Array:
        stated = [columns[key] for joint in joints if (key := f"{name}/{joint}") in columns]
        whole = stated and len(stated) == len(joints)
        return np.column_stack(stated) if whole else np.empty((rows, 0))

    fields = {"position": table(quantity)}
    if quantity == "truth":
        fields["position"] = fields["position"] - [profile.truth_offsets.get(j, 0) for j in joints]
    if quantity == "measured":
        fields |= {"velocity": table("velocity"), "effort": table("effort")}
        if profile.no_effort:
            fields["effort"] = np.zeros_like(fields["position"])
        elif robot.effort == "motor" and robot.transmission is not None and fields["effort"].size:
            whole = len(joints) == len(robot.joint_names)
            fields["effort"] = (
                robot.transmission.joint_effort(fields["effort"]) if whole else np.empty((rows, 0))
            )
    if is_pot:
        return tuple(f"actuator_{k}" for k in range(len(joints))), fields
    return tuple(profile.joint_in(topic, joint) for joint in joints), fields


def raven_state_columns(
    robot: Robot, fields: Mapping[str, Array], quantities: Collection[str]
) -> dict[str, Array]:
    """Columns ``<quantity>/<channel>`` (n,) [SI] of one RAVEN-II arm in messages ``raven_state``.

    `fields` (n, 16) are as in the messages, of any variant; of them those of `RAVEN_FIELDS` that
    the `quantities` ask for.
    """
    first = ARMS.index(robot.arm) * len(robot.channels)
    return {
        f"{quantity}/{channel}": fields[name][:, first + k].astype(np.float64) * factor
        for quantity, (name, factor) in RAVEN_FIELDS.items()
        if quantity in quantities
        for k, channel in enumerate(robot.channels)
    }


def raven_state_fields(robot: Robot, columns: Mapping[str, Array]) -> dict[str, Array]:
    """Fields of ``raven_state`` that hold an arm's columns: the inverse of `raven_state_columns`.

    Gives each array field of `RAVEN_FIELDS`, (n, 16), in the message's own type; what there is no
    column of is zero, as is the other arm: add those of both.
    """
    rows = len(next(iter(columns.values())))
    first = ARMS.index(robot.arm) * len(robot.channels)
    fields = {}
    for quantity, (name, factor) in RAVEN_FIELDS.items():
        values = np.zeros((rows, len(ARMS) * len(robot.channels)))
        for k, channel in enumerate(robot.channels):
            values[:, first + k] = columns.get(f"{quantity}/{channel}", np.zeros(rows)) / factor
        fields[name] = values.astype(_RAVEN_TYPES[name])
    return fields
