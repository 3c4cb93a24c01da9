"""A ROS master of a test's own, on a free port of this computer, ended by its process."""

import os
import shutil
import socket
import subprocess
from pathlib import Path
from typing import Self

import pytest

needs_ros = pytest.mark.skipif(
    shutil.which("rosmaster") is None, reason="needs ROS 1: Debian's ros-core"
)


def free_port() -> int:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return int(taken.getsockname()[1])


def environment(port: int, logs: Path) -> dict[str, str]:
    """Variables of a program that is to find the master, and no other computer."""
    return {
        "ROS_MASTER_URI": f"http://127.0.0.1:{port}",
        "ROS_IP": "127.0.0.1",
        "ROS_HOSTNAME": "127.0.0.1",
        "ROS_LOG_DIR": str(logs),
    }


class Master:
    """``rosmaster`` on a port, while the block lasts."""

    def __init__(self, port: int, logs: Path) -> None:
        self.port, self._logs = port, logs

    def __enter__(self) -> Self:
        command = ["rosmaster", "--core", "-p", str(self.port), "-w", "3"]
        variables = {**os.environ, **environment(self.port, self._logs)}
        with (self._logs / "master.log").open("ab") as log:
            self._process = subprocess.Popen(  # noqa: S603 - a line of our own
                command, env=variables, stdout=log, stderr=log
            )
        while self._process.poll() is None:  # an open port says that it is up
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", self.port)) == 0:
                    return self
        raise RuntimeError(f"rosmaster did not start: see {self._logs}/master.log")

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        self._process.wait()
