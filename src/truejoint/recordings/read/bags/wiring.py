"""Which topics of a session tell what: by type, by CRTK's names, by the robot's profile."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from truejoint.crtk.messages import (
    CORRECTED,
    JOINT_STATE,
    OPERATING_STATE,
    PROFILES,
    RAVEN_FIELDS,
    TRUTH_TOPIC,
    Profile,
    crtk_name,
    profile_of,
)
from truejoint.errors import RecordingError
from truejoint.robots import Robot, get_robot

Topics = Mapping[str, tuple[str, int]]
"""Type of each topic, and how many messages it has."""

RAVEN_TYPE: Final = "raven_state"  # of whatever package: there are two at least
JOINT_FIELDS: Final = ("position", "velocity", "effort")
HOMED: Final = "is_homed"
OPERATING_STATES: Final = (OPERATING_STATE, "crtk_msgs/operating_state")
# Names of CRTK, and of others, that are no joint sensors'.
_NO_TRUTH: Final = ("measured_js", "setpoint_js", "goal_js", "joint_states", "joint_enc")
_COMMANDS: Final = ("servo_", "move_", "interpolate_", "force")


@dataclass(frozen=True)
class Wiring:
    """Which topics of a session's bags tell what.

    Attributes
    ----------
    state : str
        Topic of the arm's measured joints, ``raven_state`` or a joint state.
    others : tuple of str
        Joint states that add to it: set-points, a jaw of its own.
    truth : str
        Topic of joint sensors; empty without any.
    homed : str
        Topic that says whether the arm is homed, where the state itself does not.
    profile : Profile

    Examples
    --------
    >>> from truejoint.recordings.read.bags.wiring import Wiring
    >>> Wiring("/ravenstate").truth
    ''
    """

    state: str
    others: tuple[str, ...] = ()
    truth: str = ""
    homed: str = ""
    profile: Profile = field(default_factory=lambda: PROFILES["crtk"])

    @property
    def joints(self) -> tuple[str, ...]:
        """Topics of joints, the state first."""
        return tuple(filter(None, (self.state, *self.others, self.truth)))


def find_wiring(
    path: Path | str,
    topics: Topics,
    robot: Robot,
    profile: str = "",
    state: str = "",
    truth: str | None = "",
) -> Wiring:
    """Tell which of a bag's `topics` are the arm's: by type, by CRTK's names, by the profile.

    What a correcting node says beside the arm is not the arm's. A `truth` of None is left out.
    Raises RecordingError if the state is not there or could be several, listing all topics.
    """
    chosen = profile_of(robot, profile)
    for named in filter(None, (state, truth)):
        require_topic(path, topics, named)
    of_robot = {name: about for name, about in topics.items() if f"/{CORRECTED}/" not in name}
    if not state:
        state = _find_state(path, of_robot, robot, chosen)
    if truth == state:
        raise RecordingError(f"{path}: {truth} is the state; give another topic as the truth")
    space = state.rpartition("/")[0]
    others, homed = [], ""
    if topics[state][0] == JOINT_STATE:
        for name in sorted(of_robot):
            what, near = crtk_name(name), name.rpartition("/")[0]
            inside = near.startswith(space + "/") and what == "measured_js"
            aim = what == "setpoint_js" and near == space and not chosen.no_setpoint
            if name != state and of_robot[name][0] == JOINT_STATE and (inside or aim):
                others.append(name)
            of_arm = chosen.arm_of(name)
            here = of_arm == robot.arm if of_arm else near == space
            if of_robot[name][0] in OPERATING_STATES and what == "operating_state" and here:
                homed = name
    others_left = {name: about for name, about in of_robot.items() if name not in (state, *others)}
    truth_topic = "" if truth is None else truth or _find_truth(others_left)
    return Wiring(state, tuple(others), truth_topic, homed, chosen)


def _find_state(path: Path | str, topics: Topics, robot: Robot, profile: Profile) -> str:
    raven = [name for name, (kind, _) in topics.items() if kind.endswith(f"/{RAVEN_TYPE}")]
    if raven and robot.name == "raven2":
        return max(raven, key=lambda name: topics[name][1])  # one may be thinned out
    measured = [
        name
        for name, (kind, count) in topics.items()
        if kind == JOINT_STATE and crtk_name(name) == "measured_js" and count
    ]
    arms = {name: profile.arm_of(name) or _space_of_arm(name, robot) for name in measured}
    of_arm = [name for name in measured if arms[name] == robot.arm] or [
        name for name in measured if not arms[name] or not robot.arm
    ]
    outer = [n for n in of_arm if not any(_holds(other, n) for other in of_arm)]
    spaces = {name.rpartition("/")[0] for name in outer}
    if not outer:
        raise RecordingError(
            f"{path}: no state of the arm, neither raven_state nor .../measured_js; name the topic "
            f"(--state); {listed(topics)}"
        )
    if len(spaces) > 1:
        raise RecordingError(
            f"{path}: measured joints of several arms, {', '.join(sorted(outer))}; say which "
            "(--robot NAME:ARM or --state)"
        )
    return max(outer, key=lambda name: topics[name][1])


def _holds(outer: str, name: str) -> bool:
    """Whether a topic is in a namespace within that of another."""
    return name != outer and name.rpartition("/")[0].startswith(outer.rpartition("/")[0] + "/")


def _space_of_arm(topic: str, robot: Robot) -> str:
    """Give the robot's arm if a namespace of the topic is called like it, or any other name."""
    spaces = [part.lower() for part in topic.strip("/").split("/")[:-1]]
    return robot.arm if robot.arm.lower() in spaces else ("" if not robot.arm else "/".join(spaces))


def _find_truth(topics: Topics) -> str:
    """Topic of joint sensors: the known one, or the only joint state that is nothing of CRTK's."""
    joints = [n for n, (kind, count) in topics.items() if kind == JOINT_STATE and count]
    standard = [name for name in joints if f"/{crtk_name(name)}" == TRUTH_TOPIC]
    others = [
        name
        for name in joints
        if crtk_name(name) not in _NO_TRUTH and not crtk_name(name).startswith(_COMMANDS)
    ]
    if standard:
        return max(standard, key=lambda name: topics[name][1])
    return others[0] if len(others) == 1 else ""


def listed(topics: Topics) -> str:
    """Topics for a person."""
    texts = [f"{name} ({kind}, {count})" for name, (kind, count) in sorted(topics.items())]
    return f"there are {', '.join(texts[:30]) or 'none'}" + (", ..." if len(texts) > 30 else "")


def require_topic(path: Path | str, topics: Topics, name: str) -> None:
    """Raise RecordingError, listing all topics, where there is none of that name."""
    if name not in topics:
        raise RecordingError(f"{path}: no topic {name!r}; {listed(topics)}")


def robot_of(place: Path | str, topics: Topics, robot: str, arm: str) -> Robot:
    """Robot that is named, else RAVEN-II where its state is there; raises RecordingError."""
    if robot:
        return get_robot(robot, arm)
    if any(kind.endswith(f"/{RAVEN_TYPE}") for kind, _ in topics.values()):
        return get_robot("raven2", arm)
    raise RecordingError(f"{place}: which robot is it (--robot)? {listed(topics)}")


def wanted_fields(
    wiring: Wiring, topics: Topics, quantities: Collection[str]
) -> dict[str, tuple[str, ...]]:
    """Fields that are read of each topic of a wiring; `topics` are types and counts of all."""
    raven = (*(RAVEN_FIELDS[quantity][0] for quantity in quantities), "runlevel")
    wanted = {
        name: raven if topics[name][0].endswith(RAVEN_TYPE) else JOINT_FIELDS
        for name in wiring.joints
    }
    return {**wanted, wiring.homed: (HOMED,)} if wiring.homed else wanted
