"""RAVEN-II's own controller on the arm that is served with its quirks, over a real ROS 1."""

import os
import subprocess
import sys
from pathlib import Path

from tests.ros_master import Master, environment, free_port, needs_ros

CLIENT = Path(__file__).with_name("raven_client.py")


@needs_ros
def test_go_to_random_motion_and_following_run_to_their_end(tmp_path):
    port = free_port()
    variables = {**os.environ, **environment(port, tmp_path)}
    robot = [sys.executable, "-m", "truejoint", "node", "simulate", "--homed", "--quirks"]
    with (
        Master(port, tmp_path),
        subprocess.Popen(robot, env=variables, stderr=subprocess.PIPE) as served,  # noqa: S603
    ):
        done = subprocess.run(  # noqa: S603 - Debian's Python, which knows nothing of truejoint
            ["/usr/bin/python3", CLIENT, "1"],
            env={**variables, "PYTHONPATH": ""},
            capture_output=True, text=True, timeout=600, check=False,
        )  # fmt: skip
        served.terminate()
        said = served.communicate()[1]
    assert done.returncode == 0, done.stderr
    assert b"refused" not in said, said
