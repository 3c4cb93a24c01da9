"""Bags of what a tracker says, in each type of message that is read."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

KINDS = ("PointStamped", "PoseStamped", "PoseWithCovarianceStamped", "TransformStamped")
"""Of geometry_msgs."""


def write_marker_bag(
    path: Path, t: np.ndarray, points: np.ndarray, turns: np.ndarray, topics: dict[str, str]
) -> None:
    """Say at stamps (n,) [s] where a marker is (n, 3) [m], (n, 4), on topics of one of `KINDS`.

    What the `path` ends in says of which kind, as for `bag_writer`.
    """
    with bag_writer(path) as (writer, store, serialize):
        links = {
            name: (kind, writer.add_connection(name, f"geometry_msgs/msg/{kind}", typestore=store))
            for name, kind in topics.items()
        }
        for k in range(len(t)):
            stamp = round(1e9 * t[k])
            for kind, link in links.values():
                message = _message(store.types, kind, stamp, points[k], turns[k])
                writer.write(link, stamp + 10**7, serialize(message, f"geometry_msgs/msg/{kind}"))


@contextmanager
def bag_writer(path: Path) -> Iterator[tuple[Any, Any, Callable[[Any, str], bytes]]]:
    """Give a writer of a bag, the types it may hold, and what makes bytes of a message.

    A path that ends in ``.bag`` is of ROS 1; a folder ``.mcap`` or ``.db3`` of ROS 2.
    """
    rosbag1, rosbag2, typesys = (
        pytest.importorskip(f"rosbags.{name}", reason="rosbags is not installed (truejoint[ros])")
        for name in ("rosbag1", "rosbag2", "typesys")
    )
    ros1 = path.suffix == ".bag"
    stores = typesys.Stores
    store = typesys.get_typestore(stores.ROS1_NOETIC if ros1 else stores.ROS2_HUMBLE)
    serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
    if ros1:
        made: Any = rosbag1.Writer(path)
    else:
        plugins = {".mcap": rosbag2.StoragePlugin.MCAP, ".db3": rosbag2.StoragePlugin.SQLITE3}
        made = rosbag2.Writer(path, version=9, storage_plugin=plugins[path.suffix])
    with made as writer:
        yield writer, store, serialize


def header_at(of: Any, stamp: int) -> object:
    """Header of a message at a stamp [ns], which in ROS 1 counts messages too."""
    made = of["std_msgs/msg/Header"]
    counted = {"seq": 0} if "seq" in made.__dataclass_fields__ else {}
    time = of["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9))
    return made(**counted, stamp=time, frame_id="tracker")


def _message(of: Any, kind: str, stamp: int, point: np.ndarray, turn: np.ndarray) -> object:
    head = header_at(of, stamp)
    made = of[f"geometry_msgs/msg/{kind}"]
    place = of["geometry_msgs/msg/Point"](*point)
    way = of["geometry_msgs/msg/Quaternion"](*turn)
    pose = of["geometry_msgs/msg/Pose"](place, way)
    if kind == "PointStamped":
        return made(head, place)
    if kind == "PoseStamped":
        return made(head, pose)
    if kind == "PoseWithCovarianceStamped":
        return made(head, of["geometry_msgs/msg/PoseWithCovariance"](pose, np.zeros(36)))
    shift = of["geometry_msgs/msg/Vector3"](*point)
    return made(head, "marker", of["geometry_msgs/msg/Transform"](shift, way))
