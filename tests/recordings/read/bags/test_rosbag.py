"""Bags of the real rosbag, from Debian's ROS 1, and ours in its hands."""

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest

from truejoint.recordings import read_bag

PYTHON = Path("/usr/bin/python3")
# Writes what rospy's messages serialise, packed and not, closed and left open, and reads ours.
SCRIPT = """
import json, os, shutil, sys
try:
    import rosbag, rospy
    from sensor_msgs.msg import JointState
except ImportError:
    sys.exit(77)
ours, folder = sys.argv[1:]
read = []
for topic, message, stamp in rosbag.Bag(ours).read_messages():
    values = message.position if hasattr(message, "position") else message.jpos
    read.append((topic, message._type, values[0], stamp.to_nsec()))
for name in ("none", "bz2", "lz4"):
    path = os.path.join(folder, name + ".bag")
    bag = rosbag.Bag(path, "w", compression=name, chunk_threshold=4096)
    for k in range(200):
        message = JointState(name=["shoulder", "elbow"], position=[k, 2.0 * k], effort=[0.5, k])
        message.header.stamp = rospy.Time(1000 + k, k)
        bag.write("/measured_js", message, rospy.Time(1000 + k, 500))
    if name == "none":
        bag._file.flush()
        shutil.copy(path, os.path.join(folder, "open.bag.active"))
    bag.close()
print(json.dumps(read))
"""


@pytest.fixture(scope="module")
def rosbag_run(bag, tmp_path_factory):
    """Folder of bags that rosbag wrote, and what it read of ours."""
    folder, done = tmp_path_factory.mktemp("rosbag"), None
    if PYTHON.exists():
        line = [str(PYTHON), "-c", SCRIPT, str(bag), str(folder)]
        done = subprocess.run(line, capture_output=True, text=True, check=False)  # noqa: S603
    if done is None or done.returncode == 77:
        pytest.skip("Debian's python3-rosbag and python3-sensor-msgs are not installed")
    assert done.returncode == 0, done.stderr
    return folder, json.loads(done.stdout.splitlines()[-1])


@pytest.mark.parametrize("name", ["none.bag", "bz2.bag", "lz4.bag", "open.bag.active"])
def test_bags_of_rosbag_are_read(rosbag_run, name):
    found = read_bag(rosbag_run[0] / name, "raven2", profile="crtk")
    rows = len(found)
    assert rows == 200 or (name == "open.bag.active" and 100 < rows <= 200)
    np.testing.assert_array_equal(found.column("measured/elbow"), 2.0 * np.arange(rows))
    np.testing.assert_allclose(found.t, np.arange(rows) * (1 + 1e-9), rtol=0, atol=1e-12)


def test_rosbag_reads_ours(rosbag_run, session):
    read = rosbag_run[1]
    topics = {topic: kind for topic, kind, _, _ in read}
    assert topics == {
        "/ravenstate": "raven_2/raven_state",
        "/arm2/measured_js": "sensor_msgs/JointState",
        "/ext_jpos": "sensor_msgs/JointState",
    }
    state = [value for topic, _, value, _ in read if topic == "/ravenstate"]
    np.testing.assert_array_equal(
        np.float32(state), np.float32(np.rad2deg(session.column("measured/shoulder")))
    )
    stamps = [stamp for topic, _, _, stamp in read if topic == "/ravenstate"]
    np.testing.assert_array_equal(stamps, 1_700_000_000 * 10**9 + np.arange(300) * 10**7)
