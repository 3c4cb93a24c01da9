"""Tests of `truejoint monitor`."""

import socket
from pathlib import Path

import pytest
from tests.cli.conftest import Call

from truejoint.cli import monitor
from truejoint.motion import Trajectory, write_trajectory


@pytest.fixture(autouse=True)
def _interrupted(monkeypatch):
    """Ctrl-C as soon as the page stands, or the arm has followed what it was to follow."""

    def interrupt():
        raise KeyboardInterrupt

    monkeypatch.setattr(monitor, "_wait", interrupt)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A recording of a jaw that says what robot it is of."""
    path = tmp_path_factory.mktemp("run") / "run.csv"
    path.write_text("t,measured/jaw\n0.0,0.1\n0.1,0.2\n0.2,0.3\n")
    return path


def test_a_recording_is_opened(call: Call, run: Path) -> None:
    shown = call("monitor", run, "--robot", "davinci_grasper", "--port", "0")
    assert shown.code == 0, shown.err
    assert shown.out.startswith("Open http://127.0.0.1:")
    assert shown.err.strip().endswith("stopped")


def test_a_simulated_arm_follows_a_trajectory(call: Call, tmp_path: Path) -> None:
    way = Trajectory(("jaw",), ("rad",), [[0.0], [0.02]], name="short")
    write_trajectory(way, tmp_path / "way.csv")
    shown = call("monitor", "--robot", "forceps", "--follow", tmp_path / "way.csv", "--port", "0")
    assert shown.code == 0, shown.err
    assert "Homing forceps" in shown.err
    assert "Open http://127.0.0.1:" in shown.out


def test_a_busy_port_is_one_line(call: Call, run: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        refused = call("monitor", run, "--robot", "davinci_grasper", "--port", port)
    assert refused.code == 2
    last = refused.err.strip().splitlines()[-1]
    assert f"127.0.0.1, port {port}: cannot listen there: Address already in use; give" in last
