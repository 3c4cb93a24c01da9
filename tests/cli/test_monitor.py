"""Tests of `truejoint monitor`."""

import socket
from pathlib import Path

import pytest

from truejoint.cli import monitor
from truejoint.motion import Trajectory, write_trajectory


@pytest.fixture(autouse=True)
def _interrupted(monkeypatch):
    """Ctrl-C as soon as the page stands, or the arm has followed what it was to follow."""

    def interrupt():
        raise KeyboardInterrupt

    monkeypatch.setattr(monitor, "_wait", interrupt)


@pytest.fixture
def line(call) -> str:
    """Shows a recording of a jaw."""
    Path("run.csv").write_text("t,measured/jaw\n0.0,0.1\n0.1,0.2\n0.2,0.3\n")
    return "monitor run.csv --robot davinci_grasper --port"


def test_a_recording_is_opened(call, line):
    shown = call.good(f"{line} 0")
    assert shown.out.startswith("Open http://127.0.0.1:")
    assert shown.err.strip().endswith("stopped")


def test_a_simulated_arm_follows_a_trajectory(call):
    way = Trajectory(("jaw",), ("rad",), [[0.0], [0.02]], name="short")
    write_trajectory(way, "way.csv")
    shown = call.good("monitor --robot forceps --follow way.csv --port 0")
    assert "Homing forceps" in shown.err
    assert "Open http://127.0.0.1:" in shown.out


def test_a_busy_port_is_one_line(call, line):
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        said = f"127.0.0.1, port {port}: cannot listen there: Address already in use; give"
        call.refuses(said, f"{line} {port}")
