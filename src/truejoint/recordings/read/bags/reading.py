"""Recordings out of bags, and any topic of them as arrays."""

import hashlib
import os
from collections import Counter
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truejoint.array_types import Array
from truejoint.crtk.messages import ARMS, RAVEN_FIELDS, USUAL_QUANTITIES, message_type
from truejoint.errors import RecordingError, unknown
from truejoint.recordings.read.bags import assembling
from truejoint.recordings.read.bags.container import list_topics
from truejoint.recordings.read.bags.fields import Series, lots_of
from truejoint.recordings.table.recording import Provenance, Recording
from truejoint.robots import Robot, get_robot

Bags = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]


def bag_topics(bags: Bags) -> dict[str, tuple[str, int]]:
    """Topics of bags: the type of each, and how many messages it has in all of them.

    Raises RecordingError if one is no bag.

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
            topics[topic.name] = message_type(topic.type), before + count
    return topics


def read_bag(
    bags: Bags,
    robot: str | Robot = "",
    arm: str = "",
    *,
    profile: str = "",
    state: str = "",
    truth: str | None = "",
    quantities: Collection[str] = USUAL_QUANTITIES,
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
        if quantity not in RAVEN_FIELDS:
            raise RecordingError(unknown("quantity", quantity, RAVEN_FIELDS))
    topics = bag_topics(paths)
    machine = assembling.robot_of(paths[0], topics, robot, arm)
    wiring = assembling.find_wiring(paths[0], topics, machine, profile, state, truth)
    return _read(paths, machine, wiring, topics, quantities, offset=offset, near=near)


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
    if not any(kind.endswith(assembling.RAVEN_TYPE) for kind, _ in topics.values()):
        return None
    other = get_robot(robot.name, next(arm for arm in ARMS if arm != robot.arm))
    # Without the truth, which is not of this arm: no motion of it would tell a clock's offset.
    wiring = assembling.find_wiring(paths[0], topics, other, truth=None)
    return _read(paths, other, wiring, topics, ("measured",))


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
    assembling.require_topic(paths[0], topics, topic)
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
    paths: Sequence[Path],
    robot: Robot,
    wiring: assembling.Wiring,
    topics: assembling.Topics,
    quantities: Collection[str],
    **clock: float | None,
) -> Recording:
    """Read the topics of a wiring."""
    lost: Counter[str] = Counter()
    wanted = {
        name: assembling.wanted_fields(topics[name][0], quantities)
        for name in filter(None, (*wiring.joints, wiring.homed))
    }
    digest = hashlib.sha256()  # of all files, one after the other
    for path in paths:
        within = sorted(part for part in path.iterdir() if part.is_file()) if path.is_dir() else []
        for part in within or [path]:
            with part.open("rb") as file:
                hashlib.file_digest(file, lambda: digest)
    origin = Provenance(
        robot.name,
        robot.arm,
        source=", ".join(path.name for path in paths),
        sha256=digest.hexdigest(),
        session=paths[0].name.partition(".")[0],
    )
    lots, place = lots_of(paths, wanted, lost), str(paths[0])
    return assembling.assemble(lots, robot, wiring, quantities, origin, lost, place, **clock)
