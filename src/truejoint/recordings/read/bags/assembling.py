"""Recordings out of bags: of an arm, on one clock, in SI units, without homing; or any topic."""

import hashlib
import os
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from truejoint.array_types import Array
from truejoint.crtk import messages
from truejoint.errors import RecordingError, RobotError, unknown
from truejoint.recordings.join.joining import cover_same_time, join_truth
from truejoint.recordings.read.bags.container import list_topics
from truejoint.recordings.read.bags.fields import Lot, Series, keep_rows, lots_of
from truejoint.recordings.read.raven_csv import without_homing
from truejoint.recordings.table.recording import (
    MISSING,
    Provenance,
    Recording,
    last_of_each_stamp,
    nominal_rates,
)
from truejoint.recordings.table.stream import GAP_STEPS, Stream, synchronise, usable_rows
from truejoint.robots import Robot, arm_names, get_robot

Topics = Mapping[str, tuple[str, int]]
"""Type of each topic, and how many messages it has."""

RAVEN_TYPE: Final = "/raven_state"  # of whatever package: there are two at least
JOINT_FIELDS: Final = ("position", "velocity", "effort")
HOMED: Final = "is_homed"
# Names of CRTK, and of others, that are no joint sensors'.
_NO_TRUTH: Final = ("measured_js", "setpoint_js", "goal_js", "joint_states", "joint_enc")
_COMMANDS: Final = ("servo_", "move_", "interpolate_", "force")


@dataclass(frozen=True)
class Wiring:
    """Which topics of a session's bags tell what of an arm."""

    robot: Robot
    state: str  # of the arm's measured joints, ``raven_state`` or a joint state
    others: tuple[str, ...] = ()  # joint states that add to it: set-points, a jaw of its own
    truth: str = ""  # of joint sensors
    homed: str = ""  # says whether the arm is homed, where the state itself does not
    profile: messages.Profile = field(default_factory=lambda: messages.PROFILES["crtk"])

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
    chosen = messages.profile_of(robot, profile)
    for named in filter(None, (state, truth)):
        require_topic(path, topics, named)
    corrected = f"/{messages.CORRECTED}/"
    # Of a dVRK's actuators and sensors, not of its joints.
    of_io = [name for name in topics if chosen.actuators and "/io/" in name.lower()]
    of_robot = {n: about for n, about in topics.items() if n not in of_io and corrected not in n}
    state = state or _find_state(path, of_robot, robot, chosen)
    if truth == state:
        raise RecordingError(f"{path}: {truth} is the state; give another topic as the truth")
    space = state.rpartition("/")[0]
    added, homed = [], ""
    for name in sorted(of_robot) if topics[state][0] == messages.JOINT_STATE else ():
        kind, what, near = of_robot[name][0], messages.crtk_name(name), name.rpartition("/")[0]
        inside = near.startswith(space + "/") and what == "measured_js"
        aim = what == "setpoint_js" and near == space and not chosen.no_setpoint
        if name != state and kind == messages.JOINT_STATE and (inside or aim):
            added.append(name)
        of_arm = chosen.arm_of(name)
        here = of_arm == robot.arm if of_arm and robot.arm else near == space
        if kind in messages.OPERATING_STATES and what == "operating_state" and here:
            homed = name
    pots = (name for name in of_io if messages.is_pot(name) and chosen.arm_of(name) == robot.arm)
    added += [*pots][:1]
    if truth == "":
        others = {name: about for name, about in of_robot.items() if name not in (state, *added)}
        truth = _find_truth(others)
    return Wiring(robot, state, tuple(added), truth or "", homed, chosen)


def _find_state(path: Path | str, topics: Topics, robot: Robot, profile: messages.Profile) -> str:
    raven = [name for name, (kind, _) in topics.items() if kind.endswith(RAVEN_TYPE)]
    if raven and robot.name == "raven2":
        return max(raven, key=lambda name: topics[name][1])  # one may be thinned out
    measured = [name for name, what in _joint_states(topics).items() if what == "measured_js"]
    arms = {}  # the robot's if a namespace of the topic is called like it, or any other name
    for name in measured:
        spaces = [part.lower() for part in name.strip("/").split("/")[:-1]]
        of_space = robot.arm if robot.arm.lower() in spaces else "/".join(spaces)
        arms[name] = profile.arm_of(name) or (of_space if robot.arm else "")
    of_arm = [name for name in measured if arms[name] == robot.arm] or [
        name for name in measured if not arms[name] or not robot.arm
    ]
    space_of = {name: name.rpartition("/")[0] for name in of_arm}
    outer = [
        name
        for name, space in space_of.items()
        if not any(space.startswith(f"{other}/") for other in space_of.values())
    ]
    if not outer:
        raise RecordingError(
            f"{path}: no state of the arm, neither raven_state nor .../measured_js; name the topic "
            f"(--state); {listed(topics)}"
        )
    if len({space_of[name] for name in outer}) > 1:
        raise RecordingError(
            f"{path}: measured joints of several arms, {', '.join(sorted(outer))}; say which "
            "(--robot NAME:ARM or --state)"
        )
    return max(outer, key=lambda name: topics[name][1])


def _joint_states(topics: Topics) -> dict[str, str]:
    """Name in CRTK of each topic with joint states."""
    states = (n for n, (kind, count) in topics.items() if kind == messages.JOINT_STATE and count)
    return {name: messages.crtk_name(name) for name in states}


def _find_truth(topics: Topics) -> str:
    """Topic of joint sensors: the known one, or the only joint state that is nothing of CRTK's."""
    names = _joint_states(topics)
    standard = [topic for topic, name in names.items() if f"/{name}" == messages.TRUTH_TOPIC]
    if standard:
        return max(standard, key=lambda topic: topics[topic][1])
    others = [t for t, n in names.items() if n not in _NO_TRUTH and not n.startswith(_COMMANDS)]
    return others[0] if len(others) == 1 else ""


def wanted_fields(kind: str, quantities: Collection[str]) -> tuple[str, ...]:
    """Fields to read of messages of a type; of RAVEN's state those of some `RAVEN_FIELDS`."""
    if kind in messages.OPERATING_STATES:
        return (HOMED,)
    if not kind.endswith(RAVEN_TYPE):
        return JOINT_FIELDS
    return (*(messages.RAVEN_FIELDS[quantity][0] for quantity in quantities), "runlevel")


def listed(topics: Topics) -> str:
    """Topics for a person."""
    texts = [f"{name} ({kind}, {count})" for name, (kind, count) in sorted(topics.items())]
    return f"there are {', '.join(texts[:30]) or 'none'}" + (", ..." if len(texts) > 30 else "")


def require_topic(path: Path | str, topics: Topics, name: str) -> None:
    """Raise RecordingError, listing all topics, where there is none of that name."""
    if name not in topics:
        raise RecordingError(f"{path}: no topic {name!r}; {listed(topics)}")


def robot_of(place: Path | str, topics: Topics, robot: str | Robot, arm: str) -> Robot:
    """Robot that is named, else RAVEN-II where its state is there; raises RecordingError.

    Its arm, unless that is named too, is the one whose name is a namespace of the topics.
    """
    if isinstance(robot, Robot):
        return get_robot(robot, arm)
    if robot:
        spaces = {part.lower() for name in topics for part in name.split("/")[:-1]}
        alone = spaces.intersection(arm_names(robot))
        return get_robot(robot, arm or (alone.pop() if len(alone) == 1 else ""))
    if any(kind.endswith(RAVEN_TYPE) for kind, _ in topics.values()):
        return get_robot("raven2", arm)
    raise RecordingError(f"{place}: which robot is it (--robot)? {listed(topics)}")


_SECOND: Final = 1e9  # ns
_RAVEN_VALUES: Final = 16  # in each list of RAVEN's state: of both arms
_HOMING: Final = messages.RUN_LEVELS["homing"]


def assemble(
    lots: Iterable[Lot],
    wiring: Wiring,
    quantities: Collection[str],
    origin: Provenance,
    lost: Mapping[str, int],
    place: str,
    offset: float | None = None,
    near: float | None = None,
) -> Recording:
    """Make the recording of an arm of the messages of its topics, in whatever lots they come.

    `quantities` are of `RAVEN_FIELDS`; `lost` counts what could not be read, by reason, while
    `lots` are drawn; `place` is named in messages; `offset` and `near` are as `read_bag` takes
    them. Raises RecordingError if a topic has no message, or one that is no joint state of the
    robot.
    """
    series = _series_of(lots, wiring, quantities, place)
    for name in filter(None, (wiring.state, wiring.truth)):
        if not series[name].count:
            raise RecordingError(f"{place}: {name} has no message that can be read")
    base = series[wiring.state].start
    dropped: dict[str, int] = {}
    columns = _columns(series[wiring.state], base, "state", dropped)
    if series[wiring.homed].count:
        _leave_out_unhomed(columns, series[wiring.homed], base, dropped)
    rates = nominal_rates(state=columns["t"])
    for name in wiring.others:
        if series[name].count < 2:
            continue
        other = _stream(series[name], base, name, dropped)
        limit = GAP_STEPS * float(np.median(np.diff(other.t)))
        matched, _ = synchronise(Stream(columns["t"], {}), other, limit)
        columns |= {name: values for name, values in matched.items() if name not in columns}
    finite = np.logical_and.reduce([np.isfinite(values) for values in columns.values()])
    if not finite.all():
        dropped[f"state: {MISSING} in one of its topics"] = int((~finite).sum())
        keep_rows(columns, np.flatnonzero(finite))
    dropped |= lost  # counted to the end of the files, which is now
    truth = _stream(series[wiring.truth], base, "truth", dropped) if wiring.truth else None
    provenance = replace(origin, rates=rates, dropped=dropped, notes=_notes(wiring))
    recording = Recording.from_columns(columns, provenance, robot=wiring.robot, copy=False)
    notes = provenance.notes
    if truth is not None:
        # By stamps, or by motion where they have too little in common.
        alike = offset is None and near is None and cover_same_time(recording.t, truth.t)
        recording, _ = join_truth(recording, truth, 0.0 if alike else offset, near=near)
        notes = notes if alike else recording.provenance.notes
    provenance = replace(recording.provenance, start=base / _SECOND, notes=notes)
    return replace(recording, provenance=provenance)


def _series_of(
    lots: Iterable[Lot], wiring: Wiring, quantities: Collection[str], place: str
) -> dict[str, Series]:
    """Columns of the topics of a wiring, by topic."""
    quantity_of = {wiring.state: "measured", wiring.truth: "truth"} | {
        name: "pot" if messages.is_pot(name) else messages.crtk_name(name).partition("_")[0]
        for name in wiring.others
    }
    series = {name: Series() for name in (*wiring.joints, wiring.homed)}
    for lot in lots:
        if lot.topic == wiring.homed:
            columns = {HOMED: lot.numbers(HOMED, 1, place)[:, 0].astype(np.float64)}
        elif "runlevel" in lot.fields:
            for name in lot.fields.keys() - {"runlevel"}:
                lot.numbers(name, _RAVEN_VALUES, place)
            columns = messages.raven_state_columns(wiring.robot, lot.fields, quantities)
            columns["state/run_level"] = lot.numbers("runlevel", 1, place)[:, 0].astype(np.float64)
        else:
            lot.numbers("position", 0, place)
            names, quantity = lot.texts.get("name", ()), quantity_of[lot.topic]
            try:
                columns = messages.joint_state_columns(
                    wiring.robot, quantity, names, lot.fields, wiring.profile
                )
            except RobotError as error:
                raise RecordingError(f"{place}: {lot.topic}: {error}") from None
        series[lot.topic].add(lot, columns)
    return series


def _stream(series: Series, base: int, name: str, dropped: dict[str, int]) -> Stream:
    """Columns of a topic at stamps [s] since `base` [ns] that rise."""
    columns = _columns(series, base, name, dropped)
    return Stream(columns.pop("t"), columns)


def _columns(series: Series, base: int, name: str, dropped: dict[str, int]) -> dict[str, Array]:
    """Columns of a topic, with ``t`` [s] since `base` [ns] that rises, without homing."""
    stamps, columns = series.joined()
    last = last_of_each_stamp(stamps)
    levels = columns.get("state/run_level")
    keep, homing = (last, {}) if levels is None else without_homing(levels == _HOMING)
    dropped |= {f"{name}: repeated time stamp": int((~last).sum()), **homing}
    rows = np.flatnonzero(last & keep).astype(np.float64)
    t = (stamps[last & keep] - base) / _SECOND
    # By their numbers alone: the columns of a day take much memory.
    usable = usable_rows(Stream(t, {"row": rows}), name, dropped)
    if len(usable.t) < len(stamps):
        keep_rows(columns, usable.columns["row"].astype(np.int64))
    return {"t": usable.t, **columns}


def _leave_out_unhomed(
    columns: dict[str, Array], homed: Series, base: int, dropped: dict[str, int]
) -> None:
    """Leave out rows of a state before, and amid which, its arm said that it was not homed.

    One that never says that it is homed has no homing.
    """
    stamps, flags = homed.joined()
    order = np.argsort(stamps, kind="stable")
    t, is_homed = (stamps[order] - base) / _SECOND, flags[HOMED][order] > 0.0
    last = np.maximum(np.searchsorted(t, columns["t"], side="right") - 1, 0)
    if not is_homed[last].any():
        return
    keep, homing = without_homing(~is_homed[last])
    dropped |= homing
    if not keep.all():
        keep_rows(columns, np.flatnonzero(keep))


def _notes(wiring: Wiring) -> str:
    """Say what was read, and what the profile changed of it."""
    profile, others = wiring.profile, ", ".join(wiring.others)
    topics = f"state of {wiring.state}" + (f" and {others}" if others else "")
    changes = f"profile {profile.name}: {profile.summary}" if profile.name != "crtk" else ""
    truth = f", truth of {wiring.truth}" if wiring.truth else ""
    zero = profile.truth_note if wiring.truth else ""
    return "; ".join(filter(None, (topics + truth, changes, zero)))


Bags = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]


def bag_topics(bags: Bags) -> dict[str, tuple[str, int]]:
    """Topics of bags: the type of each, and how many messages it has in all of them.

    Raises RecordingError if one is no bag, or none has a topic.

    Examples
    --------
    >>> truejoint.recordings.write_bag(test, "session.bag")
    >>> truejoint.recordings.bag_topics("session.bag")["/ext_jpos"]
    ('sensor_msgs/JointState', 400)
    """
    topics: dict[str, tuple[str, int]] = {}
    for path in as_paths(bags):
        for topic, count in list_topics(path).items():
            before = topics.get(topic.name, ("", 0))[1]
            topics[topic.name] = messages.message_type(topic.type), before + count
    if not topics:
        raise RecordingError(f"{path}: no topic in it can be read; is it cut short or damaged?")
    return topics


def read_bag(
    bags: Bags,
    robot: str | Robot = "",
    arm: str = "",
    *,
    profile: str = "",
    state: str = "",
    truth: str | None = "",
    quantities: Collection[str] = messages.USUAL_QUANTITIES,
    offset: float | None = None,
    near: float | None = None,
) -> Recording:
    """Read the recording of an arm from one bag or from all those of a session.

    Parameters
    ----------
    bags : path-like or sequence of path-like
        ROS 1 (``.bag``, ``.bag.active``) or ROS 2 (``.mcap``, ``.db3``, a folder), packed or not,
        whole or cut short. Messages are read by the definitions in the bags.
    robot, arm : str
        As in `truejoint.robots.get_robot`; without one RAVEN-II, if its state is there.
    profile : str
        One of `truejoint.crtk.messages.PROFILES`: how this robot's messages differ from what CRTK
        says of them; by default the robot's.
    state, truth : str
        Topics, if they are not to be found by type and content; None to leave the truth out.
    quantities : collection of str
        Fields to read of RAVEN's state, of `truejoint.crtk.messages.RAVEN_FIELDS`.
    offset : float, optional
        Time to add to the stamps of the truth [s]; by default none where both streams cover the
        same time, else the offset by the motion.
    near : float, optional
        About how large it is [s], where the motion shall say it but repeats itself.

    Returns
    -------
    Recording
        At the stamps of the state; the truth as `synchronise` brings it there. Its provenance says
        what was lost, and what the profile changed.

    Raises
    ------
    RecordingError
        If one is no bag, or needed topics are missing: the message lists those that there are.

    Examples
    --------
    >>> truejoint.recordings.write_bag(test, "session.bag")
    >>> recording = truejoint.recordings.read_bag("session.bag", "davinci_grasper")
    >>> recording.joints_of("truth"), len(recording)
    (('jaw',), 400)
    """
    paths = as_paths(bags)
    quantities = [quantities] if isinstance(quantities, str) else list(quantities)
    for quantity in quantities:
        if quantity not in messages.RAVEN_FIELDS:
            raise RecordingError(unknown("quantity", quantity, messages.RAVEN_FIELDS))
    topics = bag_topics(paths)
    machine = robot_of(paths[0], topics, robot, arm)
    wiring = find_wiring(paths[0], topics, machine, profile, state, truth)
    return _read(paths, wiring, topics, quantities, offset=offset, near=near)


def read_other_arm(bags: Bags, recording: Recording) -> Recording | None:
    """Read what RAVEN's state in the same bags says of the other arm's positions.

    None where the robot has no other arm, or the bags no such state.

    Examples
    --------
    >>> truejoint.recordings.write_bag(test, "session.bag")
    >>> truejoint.recordings.read_other_arm("session.bag", test) is None
    True
    """
    robot, paths = recording.robot, as_paths(bags)
    topics = bag_topics(paths) if robot.name == "raven2" else {}
    if not any(kind.endswith(RAVEN_TYPE) for kind, _ in topics.values()):
        return None
    other = get_robot(robot.name, next(arm for arm in messages.ARMS if arm != robot.arm))
    # Without the truth, which is not of this arm: no motion of it would tell a clock's offset.
    wiring = find_wiring(paths[0], topics, other, truth=None)
    return _read(paths, wiring, topics, ("measured",))


def read_topic(
    bags: Bags, topic: str, fields: Collection[str]
) -> tuple[NDArray[np.int64], dict[str, NDArray[Any]]]:
    """Fields of all messages of any topic, for instance ``pose.position.x`` of a tracker.

    Parameters
    ----------
    bags : path-like or sequence of path-like
    topic : str
    fields : collection of str
        Numbers; a field within another behind a dot.

    Returns
    -------
    stamps : ndarray of int64, shape (n,)
        Stamps of the messages' headers [ns], or of their arrival without a header.
    values : dict of str to ndarray, shape (n, k)
        By field, in the message's own unit; NaN where a list is shorter than the longest.

    Raises
    ------
    RecordingError
        If there is no such topic or field, a field is no number, or no message can be read.

    Examples
    --------
    >>> truejoint.recordings.write_bag(test, "session.bag")
    >>> stamps, found = truejoint.recordings.read_topic("session.bag", "/ext_jpos", ["position"])
    >>> found["position"].shape
    (400, 1)
    """
    paths, fields = as_paths(bags), [fields] if isinstance(fields, str) else list(fields)
    topics = bag_topics(paths)
    require_topic(paths[0], topics, topic)
    series = Series()
    for lot in lots_of(paths, {topic: tuple(fields)}, Counter()):
        for name in fields:
            if name not in lot.fields:
                raise RecordingError(f"{paths[0]}: {topic}: {name} is no number; give one within")
        columns = {f"{n}[{k}]": c for n in fields for k, c in enumerate(lot.fields[n].T)}
        series.add(lot, columns)
    if not series.count:
        raise RecordingError(f"{paths[0]}: {topic} has no message that can be read")
    stamps, columns = series.joined()
    parts: dict[str, list[Array]] = {}
    for column, values in columns.items():
        parts.setdefault(column.rpartition("[")[0], []).append(values)
    return stamps, {name: np.column_stack(values) for name, values in parts.items()}


def as_paths(bags: Bags) -> list[Path]:
    """Paths of one file or of several; raises RecordingError without any."""
    paths = [Path(bag) for bag in ([bags] if isinstance(bags, str | os.PathLike) else bags)]
    if not paths:
        raise RecordingError("there is no file to read; give at least one")
    return paths


def _read(
    paths: Sequence[Path], wiring: Wiring, topics: Topics, quantities: Collection[str], **clock: Any
) -> Recording:
    lost: Counter[str] = Counter()
    wanted = {
        name: wanted_fields(topics[name][0], quantities)
        for name in filter(None, (*wiring.joints, wiring.homed))
    }
    digest = hashlib.sha256()  # of all files, one after the other
    for path in paths:
        within = sorted(part for part in path.iterdir() if part.is_file()) if path.is_dir() else []
        for part in within or [path]:
            with part.open("rb") as file:
                hashlib.file_digest(file, lambda: digest)
    origin = Provenance(
        wiring.robot.name,
        wiring.robot.arm,
        source=", ".join(path.name for path in paths),
        sha256=digest.hexdigest(),
        session=paths[0].name.partition(".")[0],
    )
    lots, place = lots_of(paths, wanted, lost), str(paths[0])
    return assemble(lots, wiring, quantities, origin, lost, place, **clock)
