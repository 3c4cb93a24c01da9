"""Bags of what a tracker says, in each type of message that is read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

KINDS = ("PointStamped", "PoseStamped", "PoseWithCovarianceStamped", "TransformStamped")
"""Of geometry_msgs."""


def write_marker_bag(
    path: Path,
    t: np.ndarray,
    points: np.ndarray,
    turns: np.ndarray,
    topics: dict[str, str],
) -> None:
    """Say at stamps (n,) [s] where a marker is (n, 3) [m], (n, 4), on topics of one of `KINDS`.

    A path that ends in ``.bag`` is of ROS 1; a folder ``.mcap`` or ``.db3`` of ROS 2.
    """
    rosbags = pytest.importorskip("rosbags", reason="rosbags is not installed (truejoint[ros])")
    assert rosbags
    from rosbags import rosbag1, rosbag2, typesys  # noqa: PLC0415

    ros1 = path.suffix == ".bag"
    stores = typesys.Stores
    store = typesys.get_typestore(stores.ROS1_NOETIC if ros1 else stores.ROS2_HUMBLE)
    serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
    if ros1:
        writer: Any = rosbag1.Writer(path)
    else:
        plugins = {".mcap": rosbag2.StoragePlugin.MCAP, ".db3": rosbag2.StoragePlugin.SQLITE3}
        writer = rosbag2.Writer(path, version=9, storage_plugin=plugins[path.suffix])
    with writer:
        links = {
            name: (kind, writer.add_connection(name, f"geometry_msgs/msg/{kind}", typestore=store))
            for name, kind in topics.items()
        }
        for k in range(len(t)):
            stamp = round(1e9 * t[k])
            for kind, link in links.values():
                message = _message(store.types, kind, k, stamp, points[k], turns[k])
                writer.write(link, stamp + 10**7, serialize(message, f"geometry_msgs/msg/{kind}"))


def _message(
    of: Any, kind: str, number: int, stamp: int, point: np.ndarray, turn: np.ndarray
) -> object:
    time = of["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9))
    header = of["std_msgs/msg/Header"]
    numbered = "seq" in header.__dataclass_fields__  # ROS 2 counts no messages
    head = header(**({"seq": number} if numbered else {}), stamp=time, frame_id="tracker")
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
