"""A recording as a bag of CRTK's topics, for others' tools."""

import heapq
import math
import os
import tempfile
from collections.abc import Iterator
from itertools import count, repeat
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from truejoint.crtk import messages
from truejoint.errors import RecordingError
from truejoint.extras import require
from truejoint.files import write_atomically
from truejoint.recordings.read.bags.fields import PURPOSE, full_name, typesys
from truejoint.recordings.table.recording import Recording, as_recording

# Stamp of `t = 0` where the recording knows none [ns]: 0 would mean that there is no stamp.
_BEGIN: Final = 1_000_000_000

_Messages = tuple[str, str, NDArray[np.int64], dict[str, Any]]
"""Topic, type, stamps (n,) [ns], and fields, each a value for all messages or (n, ...)."""


def write_bag(
    recording: Recording,
    path: str | os.PathLike[str],
    *,
    profile: str = "",
    overwrite: bool = False,
) -> None:
    """Write a recording as a bag: ROS 1 to ``.bag``, ROS 2 to ``.mcap``.

    RAVEN-II has its ``ravenstate`` beside CRTK's joint state; joint sensors are on ``ext_jpos``,
    where they are known. Stamps are the recording's, to the nanosecond, from 1 s on where it does
    not know when it began.

    Parameters
    ----------
    recording : Recording
    path : path-like
    profile : str
        One of `truejoint.crtk.messages.PROFILES`; by default the robot's, quirks included.
    overwrite : bool
        Replace a file that is there; refused by default.

    Raises
    ------
    RecordingError
        If `path` is called neither, exists and may not be replaced, its folder does not exist, or
        no position of a joint is recorded.

    Examples
    --------
    >>> truejoint.recordings.write_bag(test, "session.bag")
    >>> truejoint.recordings.bag_topics("session.bag")["/measured_js"]
    ('sensor_msgs/JointState', 400)
    """
    target, recording = Path(path), as_recording(recording)
    chosen = messages.profile_of(recording.robot, profile)
    if target.suffix not in (".bag", ".mcap"):
        raise RecordingError(f"{target}: call it .bag for ROS 1 or .mcap for ROS 2")
    topics = list(_topics(recording, chosen))
    if not topics:
        raise RecordingError(f"{target}: the recording has no position of a joint to write")

    system, ros1 = typesys(), target.suffix == ".bag"
    store = system.get_typestore(getattr(system.Stores, "ROS1_NOETIC" if ros1 else "ROS2_HUMBLE"))
    for kind, text in messages.DEFINITIONS.items():
        definition = text if ros1 else messages.ros2_definition(kind)
        store.register(system.get_types_from_msg(definition, full_name(kind)))
    module = require("rosbags.rosbag1" if ros1 else "rosbags.rosbag2", "ros", PURPOSE)
    how = {} if ros1 else {"version": 9, "storage_plugin": module.StoragePlugin.MCAP}

    def write(part: Path) -> None:
        with tempfile.TemporaryDirectory(dir=part.parent, prefix=".truejoint-") as folder:
            bag = Path(folder) / "bag"
            with module.Writer(bag, **how) as writer:
                _write(writer, store, topics, store.serialize_ros1 if ros1 else store.serialize_cdr)
            (bag if ros1 else bag / "bag.mcap").replace(part)

    write_atomically(target, write, overwrite=overwrite, error=RecordingError)


def _topics(recording: Recording, profile: messages.Profile) -> Iterator[_Messages]:
    start = recording.provenance.start
    begin = _BEGIN if math.isnan(start) else round(start * 1e9)
    stamps = begin + np.round(recording.t * 1e9).astype(np.int64)
    columns = {name: recording.column(name) for name in recording.units}
    robot = recording.robot
    if robot.name == "raven2":
        usual = np.full(len(stamps), messages.RUN_LEVELS["pedal down"])
        level = columns.get("state/run_level", usual)
        yield messages.RAVEN_TOPIC, messages.RAVEN_STATE, stamps, {
            "runlevel": level.astype(np.int32),
            **messages.raven_state_fields(robot, columns),
        }  # fmt: skip
    for quantity in ("measured", "setpoint", "pot", "truth"):
        if not (joints := recording.joints_of(quantity)):
            continue
        topic = messages.POT_TOPIC if quantity == "pot" else f"{quantity}_js"
        name = messages.TRUTH_TOPIC if quantity == "truth" else profile.topic(robot.arm, topic)
        rows = ~np.isnan(recording.columns(quantity, joints)).any(axis=1)
        valid = {column: values[rows] for column, values in columns.items()}
        names, fields = messages.joint_state_fields(robot, quantity, name, valid, profile)
        if names and not (quantity == "setpoint" and profile.no_setpoint):
            yield name, messages.JOINT_STATE, stamps[rows], {"name": list(names), **fields}


def _write(writer: Any, store: Any, topics: list[_Messages], serialize: Any) -> None:
    """Write all messages in the order of their stamps."""
    connections = [
        writer.add_connection(name, full_name(kind), typestore=store) for name, kind, _, _ in topics
    ]
    blanks = [_blank(store, full_name(kind)) for _, kind, _, _ in topics]
    lines = [zip(stamps.tolist(), repeat(k), count()) for k, (_, _, stamps, _) in enumerate(topics)]
    for stamp, topic, number in heapq.merge(*lines):
        _, kind, _, fields = topics[topic]
        message = blanks[topic]
        for name, values in fields.items():
            value = values if isinstance(values, list) else values[number]
            setattr(message, name, value if isinstance(value, list | np.ndarray) else value.item())
        header = message.hdr if kind == messages.RAVEN_STATE else message.header
        header.stamp.sec, header.stamp.nanosec = divmod(stamp, 1_000_000_000)
        if hasattr(header, "seq"):
            header.seq = number
        writer.write(connections[topic], stamp, serialize(message, full_name(kind)))


def _blank(store: Any, kind: str) -> Any:
    """Message of a type whose numbers are 0 and whose texts and lists are empty."""
    values: dict[str, Any] = {}
    for name, (shape, inner) in store.fielddefs[kind][1]:
        if int(shape) == 1:
            values[name] = "" if inner[0] == "string" else 0
        elif int(shape) == 2:
            values[name] = _blank(store, inner)
        else:
            (_, (base, _)), count = inner
            text = base == "string"
            values[name] = [] if text else np.zeros(count if int(shape) == 3 else 0, dtype=base)
    return store.types[kind](**values)
