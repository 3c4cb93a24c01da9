"""A recording out of the bags of a session: which topics tell what, on one clock, in SI units."""

from __future__ import annotations

import hashlib
import os
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from truejoint.array_types import Array
from truejoint.crtk.messages import (
    ARMS,
    CORRECTED,
    JOINT_STATE,
    OPERATING_STATE,
    PROFILES,
    RAVEN_FIELDS,
    RUN_LEVELS,
    TRUTH_TOPIC,
    USUAL_QUANTITIES,
    Profile,
    crtk_name,
    joint_state_columns,
    message_type,
    profile_of,
    raven_state_columns,
)
from truejoint.errors import RecordingError, RobotError, unknown
from truejoint.recordings.bags.container import Topic, list_topics, read_batches
from truejoint.recordings.bags.fields import STAMP, Decoder, Fields
from truejoint.recordings.joining import join_truth
from truejoint.recordings.numeric_text import MAX_VALUES
from truejoint.recordings.readers.raven_csv import without_homing
from truejoint.recordings.recording import (
    MISSING,
    Provenance,
    Recording,
    last_of_each_stamp,
    nominal_rates,
)
from truejoint.recordings.signals import GAP_STEPS
from truejoint.recordings.synchronise import Stream, synchronise, usable_rows
from truejoint.robots import Robot, get_robot

RAVEN_TYPE: Final = "raven_state"  # of whatever package: there are two at least
JOINT_FIELDS: Final = ("position", "velocity", "effort")
HOMED: Final = "is_homed"
# Names of CRTK, and of others, that are no joint sensors'.
_NO_TRUTH: Final = ("measured_js", "setpoint_js", "goal_js", "joint_states", "joint_enc")
OPERATING_STATES: Final = (OPERATING_STATE, "crtk_msgs/operating_state")
_COMMANDS: Final = ("servo_", "move_", "interpolate_", "force")
_OVERLAP: Final = 0.5  # share of the shorter stream that truth and state have in common, on a clock
_SECOND: Final = 1e9  # ns


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
    >>> from truejoint.recordings.bags.reading import Wiring
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


def bag_topics(
    bags: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
) -> dict[str, tuple[str, int]]:
    """Topics of bags: the type of each, and how many messages it has in all of them.

    Raises RecordingError if one is no bag.

    Examples
    --------
    >>> truejoint.recordings.write_bag(test, "session.bag")
    >>> truejoint.recordings.bag_topics("session.bag")["/ext_jpos"]
    ('sensor_msgs/JointState', 400)
    """
    found: dict[str, tuple[str, int]] = {}
    for path in _paths(bags):
        for topic, count in list_topics(path).items():
            before = found.get(topic.name, ("", 0))[1]
            found[topic.name] = message_type(topic.type), before + count
    return found


def read_bag(
    bags: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    robot: str = "",
    arm: str = "",
    *,
    profile: str = "",
    state: str = "",
    truth: str | None = "",
    quantities: Collection[str] = USUAL_QUANTITIES,
    offset: float | None = None,
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
        Of `truejoint.crtk.messages.RAVEN_FIELDS`, what to read of RAVEN's state.
    offset : float, optional
        To be added to the stamps of the truth [s]; by default none where both streams cover the
        same time, and what the motion that both saw says where they do not.

    Returns
    -------
    Recording
        At the stamps of the state; the truth as `synchronise` brings it there. What was lost, and
        what the profile changed, is in its provenance.

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
    paths = _paths(bags)
    for quantity in quantities:
        if quantity not in RAVEN_FIELDS:
            raise RecordingError(unknown("quantity", quantity, RAVEN_FIELDS))
    topics = bag_topics(paths)
    machine = robot_of(paths[0], topics, robot, arm)
    wiring = find_wiring(paths[0], topics, machine, profile, state, truth)
    return _read(paths, machine, wiring, topics, quantities, offset)


def read_other_arm(
    bags: str | os.PathLike[str] | Sequence[str | os.PathLike[str]], recording: Recording
) -> Recording | None:
    """Read what RAVEN's state in the same bags says of the other arm's positions.

    None where the robot has no other arm, or the bags no such state.

    Examples
    --------
    >>> truejoint.recordings.write_bag(test, "session.bag")
    >>> truejoint.recordings.read_other_arm("session.bag", test) is None
    True
    """
    robot, paths = recording.robot, _paths(bags)
    topics = bag_topics(paths)
    kinds = [kind for kind, _ in topics.values()]
    if robot.name != "raven2" or not any(kind.endswith(f"/{RAVEN_TYPE}") for kind in kinds):
        return None
    other = get_robot(robot.name, next(arm for arm in ARMS if arm != robot.arm))
    # Without the truth, which is not of this arm: no motion of it would tell a clock's offset.
    wiring = find_wiring(paths[0], topics, other, truth=None)
    return _read(paths, other, wiring, topics, ("measured",), None)


def read_topic(
    bags: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    topic: str,
    fields: Collection[str],
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
        Of the messages' headers [ns], or of their arrival where there is none.
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
    paths = _paths(bags)
    topics = bag_topics(paths)
    _require_topic(paths[0], topics, topic)
    series = _Series()
    for _, places, stamps, values, _ in _lots(paths, {topic: tuple(fields)}, Counter()):
        for name in fields:
            if name not in values:
                raise RecordingError(f"{paths[0]}: {topic}: {name} is no number; give one within")
        flat = {
            f"{name}[{k}]": values[name][:, k]
            for name in fields
            for k in range(values[name].shape[1])
        }
        series.add(places, stamps, flat)
    if not series.stamps:
        raise RecordingError(f"{paths[0]}: {topic} has no message that can be read")
    found = [sum(column.startswith(f"{name}[") for column in series.columns) for name in fields]
    stamps, columns = series.joined()
    return stamps, {
        name: np.column_stack([columns[f"{name}[{k}]"] for k in range(count)])
        for name, count in zip(fields, found, strict=True)
        if count
    }


def find_wiring(
    path: Path | str,
    topics: Mapping[str, tuple[str, int]],
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
        _require_topic(path, topics, named)
    own = {name: told for name, told in topics.items() if f"/{CORRECTED}/" not in name}
    if not state:
        state = _find_state(path, own, robot, chosen)
    if truth == state:
        raise RecordingError(f"{path}: {truth} is the state; give another topic as the truth")
    space = state.rpartition("/")[0]
    others, homed = [], ""
    if topics[state][0] == JOINT_STATE:
        for name in sorted(own):
            what, near = crtk_name(name), name.rpartition("/")[0]
            inside = near.startswith(space + "/") and what == "measured_js"
            aim = what == "setpoint_js" and near == space and not chosen.no_setpoint
            if name != state and own[name][0] == JOINT_STATE and (inside or aim):
                others.append(name)
            of_arm = chosen.arm_of(name)
            here = of_arm == robot.arm if of_arm else near == space
            if own[name][0] in OPERATING_STATES and what == "operating_state" and here:
                homed = name
    left = {name: told for name, told in own.items() if name not in (state, *others)}
    found = "" if truth is None else truth or _find_truth(left)
    return Wiring(state, tuple(others), found, homed, chosen)


def _find_state(
    path: Path | str, topics: Mapping[str, tuple[str, int]], robot: Robot, profile: Profile
) -> str:
    raven = [name for name, (kind, _) in topics.items() if kind.endswith(f"/{RAVEN_TYPE}")]
    if raven and robot.name == "raven2":
        return max(raven, key=lambda name: topics[name][1])  # one may be thinned out
    found = [
        name
        for name, (kind, count) in topics.items()
        if kind == JOINT_STATE and crtk_name(name) == "measured_js" and count
    ]
    told = {name: profile.arm_of(name) or _space_of_arm(name, robot) for name in found}
    of_arm = [name for name in found if told[name] == robot.arm] or [
        name for name in found if not told[name] or not robot.arm
    ]
    outer = [n for n in of_arm if not any(_holds(other, n) for other in of_arm)]
    spaces = {name.rpartition("/")[0] for name in outer}
    if not outer:
        raise RecordingError(
            f"{path}: no state of the arm, neither raven_state nor .../measured_js; name the topic "
            f"(--state); {_listed(topics)}"
        )
    if len(spaces) > 1:
        raise RecordingError(
            f"{path}: measured joints of several arms, {', '.join(sorted(outer))}; say which "
            "(--arm or --state)"
        )
    return max(outer, key=lambda name: topics[name][1])


def _holds(outer: str, name: str) -> bool:
    """Whether a topic is in a namespace within that of another."""
    return name != outer and name.rpartition("/")[0].startswith(outer.rpartition("/")[0] + "/")


def _space_of_arm(topic: str, robot: Robot) -> str:
    """Give the robot's arm if a namespace of the topic is called like it, or any other name."""
    spaces = [part.lower() for part in topic.strip("/").split("/")[:-1]]
    return robot.arm if robot.arm.lower() in spaces else ("" if not robot.arm else "/".join(spaces))


def _find_truth(topics: Mapping[str, tuple[str, int]]) -> str:
    """Topic of joint sensors: the known one, or the only joint state that is nothing of CRTK's."""
    joints = [n for n, (kind, count) in topics.items() if kind == JOINT_STATE and count]
    known = [name for name in joints if f"/{crtk_name(name)}" == TRUTH_TOPIC]
    others = [
        name
        for name in joints
        if crtk_name(name) not in _NO_TRUTH and not crtk_name(name).startswith(_COMMANDS)
    ]
    if known:
        return max(known, key=lambda name: topics[name][1])
    return others[0] if len(others) == 1 else ""


def _listed(topics: Mapping[str, tuple[str, int]]) -> str:
    """Topics for a person."""
    texts = [f"{name} ({kind}, {count})" for name, (kind, count) in sorted(topics.items())]
    return f"there are {', '.join(texts[:30]) or 'none'}" + (", ..." if len(texts) > 30 else "")


def _require_topic(path: Path | str, topics: Mapping[str, tuple[str, int]], name: str) -> None:
    if name not in topics:
        raise RecordingError(f"{path}: no topic {name!r}; {_listed(topics)}")


def _paths(
    bags: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
) -> list[Path]:
    given = [bags] if isinstance(bags, str | os.PathLike) else list(bags)
    paths = [Path(bag) for bag in given]
    for path in paths:
        if not path.exists():
            raise RecordingError(f"{path}: there is no such file or folder; check the path")
    if not paths:
        raise RecordingError("there is no bag to read; give at least one")
    return paths


def robot_of(
    place: Path | str, topics: Mapping[str, tuple[str, int]], robot: str, arm: str
) -> Robot:
    """Robot that is named, else RAVEN-II where its state is there; raises RecordingError."""
    if robot:
        return get_robot(robot, arm)
    if any(kind.endswith(f"/{RAVEN_TYPE}") for kind, _ in topics.values()):
        return get_robot("raven2", arm)
    raise RecordingError(f"{place}: which robot is it (--robot)? {_listed(topics)}")


@dataclass
class _Series:
    """Messages of one topic as they come in."""

    places: list[NDArray[np.int64]] = field(default_factory=list)
    stamps: list[NDArray[np.int64]] = field(default_factory=list)
    columns: dict[str, list[Array]] = field(default_factory=dict)
    values: int = 0

    def add(
        self, places: NDArray[np.int64], stamps: NDArray[np.int64], columns: Mapping[str, Array]
    ) -> None:
        """Take a lot of messages; a column that is new has no value in those before."""
        before = sum(map(len, self.stamps))
        self.places.append(places)
        self.stamps.append(stamps)
        for name in {**self.columns, **columns}:
            own = self.columns.setdefault(name, [np.full(before, np.nan)] if before else [])
            own.append(columns.get(name, np.full(len(stamps), np.nan)))
        self.values += len(stamps) * (len(columns) + 1)
        if self.values > MAX_VALUES:
            raise RecordingError(f"more than {MAX_VALUES} values; extract fewer bags at a time")

    def joined(self) -> tuple[NDArray[np.int64], dict[str, Array]]:
        """Stamps [ns] and columns, which are forgotten here one by one."""
        place, names = np.concatenate(self.places), list(self.columns)
        columns = {name: np.concatenate(self.columns.pop(name)) for name in names}
        stamps = np.concatenate(self.stamps)
        if (np.diff(place) < 0).any():  # messages of different lengths came in lots of their own
            order = np.argsort(place)
            _keep(columns, order)
            stamps = stamps[order]
        return stamps, columns


Lot = tuple[str, NDArray[np.int64], NDArray[np.int64], Fields, Mapping[str, tuple[str, ...]]]
"""Topic, places of messages among all of it and their stamps [ns] (m,), fields and lists of text"""


def _lots(
    paths: Sequence[Path], wanted: Mapping[str, Collection[str]], lost: Counter[str]
) -> Iterator[Lot]:
    """Lots of messages of the topics that are `wanted`, with the fields of each that are."""
    decoders: dict[Topic, Decoder] = {}
    count: Counter[str] = Counter()
    for path in paths:
        for topic, times, messages in read_batches(path, lambda t: t.name in wanted, lost):
            if topic not in decoders:
                decoders[topic] = Decoder(topic, wanted[topic.name])
            arrivals = np.array(times, dtype=np.int64)
            for rows, fields, texts in decoders[topic].decode(messages):
                stamps = np.where(fields[STAMP] == 0, arrivals[rows], fields[STAMP])
                yield topic.name, count[topic.name] + rows, stamps, fields, texts
            count[topic.name] += len(messages)
    for topic, decoder in decoders.items():
        if decoder.damaged:
            what = f"messages of {topic.name} that are not as their definition says"
            lost[what] += decoder.damaged


def _read(
    paths: Sequence[Path],
    robot: Robot,
    wiring: Wiring,
    topics: Mapping[str, tuple[str, int]],
    quantities: Collection[str],
    offset: float | None,
) -> Recording:
    """Read the topics of a wiring."""
    lost: Counter[str] = Counter()
    wanted = wanted_fields(wiring, topics, quantities)
    origin = Provenance(
        robot.name,
        robot.arm,
        source=", ".join(path.name for path in paths),
        sha256=_hash(paths),
        session=paths[0].name.partition(".")[0],
    )
    lots = _lots(paths, wanted, lost)
    return assemble(lots, robot, wiring, quantities, origin, lost, offset, str(paths[0]))


def wanted_fields(
    wiring: Wiring, topics: Mapping[str, tuple[str, int]], quantities: Collection[str]
) -> dict[str, tuple[str, ...]]:
    """Fields that are read of each topic of a wiring; `topics` are types and counts of all."""
    raven = (*(RAVEN_FIELDS[quantity][0] for quantity in quantities), "runlevel")
    wanted = {
        name: raven if topics[name][0].endswith(RAVEN_TYPE) else JOINT_FIELDS
        for name in wiring.joints
    }
    return {**wanted, wiring.homed: (HOMED,)} if wiring.homed else wanted


def assemble(
    lots: Iterable[Lot],
    robot: Robot,
    wiring: Wiring,
    quantities: Collection[str],
    origin: Provenance,
    lost: Mapping[str, int],
    offset: float | None,
    place: str,
) -> Recording:
    """Make the recording of an arm of the messages of its topics, in whatever lots they come.

    Parameters
    ----------
    lots : iterable of Lot
        With the fields that `wanted_fields` names.
    robot : Robot
    wiring : Wiring
    quantities : collection of str
        Of `RAVEN_FIELDS`.
    origin : Provenance
        What is known of where they come from.
    lost : mapping of str to int
        What could not be read, by reason; counted while `lots` are drawn.
    offset : float, optional
        As `read_bag` takes it.
    place : str
        Where they come from, for messages.

    Raises
    ------
    RecordingError
        If a topic has no message, or one that is no joint state of the robot.
    """
    series = _series_of(lots, robot, wiring, quantities, place)
    for name in filter(None, (wiring.state, wiring.truth)):
        if not series[name].stamps:
            raise RecordingError(f"{place}: {name} has no message that can be read")
    base = int(series[wiring.state].stamps[0][0])
    dropped: dict[str, int] = {}
    state = _stream(series[wiring.state], base, "state", dropped)
    if series[wiring.homed].stamps:
        state = _homed(state, series[wiring.homed], base, dropped)
    columns = {"t": state.t, **state.columns}
    for name in wiring.others:
        if sum(map(len, series[name].stamps)) > 1:
            other = _stream(series[name], base, name, dropped)
            columns |= _at(state.t, other, [name for name in other.columns if name not in columns])
    dropped |= _keep_known(columns)
    dropped |= lost  # counted to the end of the files, which is now
    provenance = replace(
        origin, rates=nominal_rates(state=state.t), dropped=dropped, notes=_notes(wiring)
    )
    recording = Recording.from_columns(columns, provenance)
    if wiring.truth:
        counts: dict[str, int] = {}
        truth = _stream(series[wiring.truth], base, "truth", counts)
        recording = replace(
            recording, provenance=replace(provenance, dropped={**dropped, **counts})
        )
        recording = _with_truth(recording, truth, offset)
    return replace(recording, provenance=replace(recording.provenance, start=base / _SECOND))


def _series_of(
    lots: Iterable[Lot],
    robot: Robot,
    wiring: Wiring,
    quantities: Collection[str],
    place: str,
) -> dict[str, _Series]:
    """Columns of the topics of a wiring, by topic."""
    told = {wiring.state: "measured", wiring.truth: "truth"} | {
        name: crtk_name(name).partition("_")[0] for name in wiring.others
    }
    series = {name: _Series() for name in (*wiring.joints, wiring.homed)}
    for name, places, stamps, fields, texts in lots:
        if name == wiring.homed:
            columns = {HOMED: fields[HOMED][:, 0].astype(np.float64)}
        elif "runlevel" in fields:
            columns = raven_state_columns(robot, fields, quantities)
            columns["state/run_level"] = fields["runlevel"][:, 0].astype(np.float64)
        else:
            names = texts.get("name", ())
            try:
                columns = joint_state_columns(robot, told[name], names, fields, wiring.profile)
            except RobotError as error:
                raise RecordingError(f"{place}: {name}: {error}") from None
        series[name].add(places, stamps, columns)
    return series


def _with_truth(recording: Recording, truth: Stream, offset: float | None) -> Recording:
    """Join the truth by stamps, or by motion where they have too little in common."""
    t, notes = recording.t, recording.provenance.notes
    common = min(t[-1], truth.t[-1]) - max(t[0], truth.t[0])
    if offset is None and common >= _OVERLAP * min(np.ptp(t), np.ptp(truth.t)):
        joined, _ = join_truth(recording, truth, 0.0)
        return replace(joined, provenance=replace(joined.provenance, notes=notes))
    return join_truth(recording, truth, offset)[0]


def _stream(series: _Series, base: int, name: str, dropped: dict[str, int]) -> Stream:
    """Columns of a topic at stamps [s] since `base` [ns] that rise, without homing."""
    stamps, columns = series.joined()
    last = last_of_each_stamp(stamps)
    levels = columns.get("state/run_level")
    keep, homing = (last, {}) if levels is None else without_homing(levels)
    repeated = int((~last).sum())
    dropped |= ({f"{name}: repeated time stamp": repeated} if repeated else {}) | homing
    rows = np.flatnonzero(last & keep)
    t = (stamps[rows] - base) / _SECOND
    # By their numbers alone: the columns of a day take much memory.
    kept = usable_rows(Stream(t, {"row": rows.astype(np.float64)}), name, dropped)
    if len(kept.t) < len(stamps):
        _keep(columns, kept.columns["row"].astype(np.int64))
    return Stream(kept.t, columns)


def _homed(state: Stream, told: _Series, base: int, dropped: dict[str, int]) -> Stream:
    """Leave out rows of a state before, and amid which, its arm said that it was not homed.

    One that never says that it is homed has no homing.
    """
    stamps, columns = told.joined()
    order = np.argsort(stamps, kind="stable")
    t, is_homed = (stamps[order] - base) / _SECOND, columns[HOMED][order] > 0.0
    last = np.maximum(np.searchsorted(t, state.t, side="right") - 1, 0)
    if not is_homed[last].any():
        return state
    names = np.where(is_homed[last], RUN_LEVELS["pedal down"], RUN_LEVELS["homing"])
    keep, homing = without_homing(names.astype(np.float64))
    dropped |= homing
    return state if keep.all() else state.rows(keep)


def _keep(columns: dict[str, Array], rows: NDArray[np.int64]) -> None:
    """Keep some rows of all columns, one after the other."""
    for name in list(columns):
        columns[name] = columns[name][rows]


def _keep_known(columns: dict[str, Array]) -> dict[str, int]:
    """Keep the rows in which no value is missing, and count the others."""
    known = np.ones(len(columns["t"]), dtype=np.bool_)
    for values in columns.values():
        known &= np.isfinite(values)
    if known.all():
        return {}
    _keep(columns, np.flatnonzero(known))
    return {f"state: {MISSING} in one of its topics": int((~known).sum())}


def _at(t: Array, other: Stream, names: Collection[str]) -> dict[str, Array]:
    """Columns `names` of another topic at the stamps `t` (n,) [s]; NaN where it is silent."""
    chosen = Stream(other.t, {name: other.columns[name] for name in names})
    columns, _ = synchronise(Stream(t, {}), chosen, GAP_STEPS * float(np.median(np.diff(other.t))))
    del columns["t"]
    return columns


def _notes(wiring: Wiring) -> str:
    """Say what was read, and what the profile changed of it."""
    profile = wiring.profile
    topics = f"state of {wiring.state}"
    if wiring.others:
        topics += f" and {', '.join(wiring.others)}"
    notes = [topics + (f", truth of {wiring.truth}" if wiring.truth else "")]
    if profile.name != "crtk":
        notes.append(f"profile {profile.name}: {profile.summary}")
    if wiring.truth and profile.truth_offsets:
        added = ", ".join(f"{shift:+.6g} to {j}" for j, shift in profile.truth_offsets.items())
        notes.append(f"added to the truth [rad or m]: {added}")
    return "; ".join(notes)


def _hash(paths: Sequence[Path]) -> str:
    """SHA-256 of all files, one after the other."""
    digest = hashlib.sha256()
    for path in paths:
        for part in sorted(path.iterdir()) if path.is_dir() else [path]:
            with part.open("rb") as file:
                while block := file.read(1 << 20):
                    digest.update(block)
    return digest.hexdigest()
