"""Tests of truejoint.crtk.backends.paced; of what it does, never of how fast."""

import threading

import numpy as np
import pytest
from tests.conftest import homed
from tests.crtk.instant_twin import InstantTwin, hear

from truejoint.crtk import PacedBackend
from truejoint.errors import CommandRefused, MotionStopped


@pytest.fixture
def paced():
    backend = PacedBackend(InstantTwin())
    arm = homed(backend)
    yield arm, backend
    arm.close()


def test_it_reports_row_by_row_also_when_nobody_commands(paced):
    arm, _ = paced
    blocks = hear(arm, 20)  # several rows where this computer is late
    assert np.diff(np.concatenate([block.t for block in blocks])) == pytest.approx(1e-3)
    assert arm.measured_js().position == pytest.approx(arm.robot.home)


@pytest.fixture
def stepped(monkeypatch):
    """Back end without the thread that keeps its time, homed."""
    monkeypatch.setattr(PacedBackend, "_loop", lambda self: None)
    return PacedBackend(InstantTwin(), homed=True)


def test_a_late_clock_makes_up_for_its_periods_along_the_set_points_that_wait(stepped):
    blocks = []
    stepped.connect(blocks.append)
    blocks.clear()
    assert stepped._pass(4) == 4  # at rest it holds
    path = stepped.robot.home + np.arange(1, 8)[:, None] * 1e-5 * np.ones(7)
    stepped._waiting.extend(path)
    assert [stepped._pass(5), stepped._pass(5)] == [5, 2]
    assert stepped._pass(5) == 1  # the next set-point of a stream is about to come
    followed = np.concatenate([b.setpoint[:, stepped.robot.joint_channels] for b in blocks])
    hold = [stepped.robot.home] * 4
    assert followed == pytest.approx(np.vstack([hold, path, path[-1:]]))
    for _ in range(100):
        stepped._pass(1)
    assert stepped._pass(5) == 5
    assert np.diff(np.concatenate([b.t for b in blocks])) == pytest.approx(1e-3)


def test_a_stream_arrives_whole_and_in_order(paced):
    arm, backend = paced
    path = arm.robot.home + np.arange(1, 101)[:, None] * 1e-5 * np.ones(7)
    before = len(backend.twin.rows)
    arm.servo_jp_stream(path)
    rows = np.vstack(backend.twin.rows[before:])
    moving = rows[(rows != arm.robot.home).any(axis=1)]
    _, first = np.unique(moving, axis=0, return_index=True)
    assert moving[np.sort(first)][:100] == pytest.approx(path)
    assert arm.setpoint_js().position == pytest.approx(path[-1])


def test_pause_from_another_thread_stops_a_move(paced):
    arm, backend = paced
    motion = arm.move_jr([0.5, 0, 0, 0, 0, 0, 0])
    under_way = threading.Event()
    arm.subscribe(lambda _: under_way.set() if motion.elapsed > 0.1 else None)
    assert under_way.wait(60.0)
    arm.pause()
    assert arm.operating_state().state == "PAUSED"
    with pytest.raises(MotionStopped, match="PAUSED"):
        motion.wait(60.0)
    path = np.vstack(backend.twin.rows)[:, 0]
    assert path[-1] > path[0]
    assert path[-1] - path[-2] <= 1e-12
    moving = np.diff(path)[np.diff(path) > 0.0]
    assert np.abs(np.diff(moving)).max() < 2.0 * moving.max() / 50  # it brakes in 50 steps


def test_a_failing_subscriber_pauses_the_arm(paced):
    arm, _ = paced

    def broken(block):
        raise ZeroDivisionError

    arm.subscribe(broken)
    with pytest.raises((ZeroDivisionError, CommandRefused)):
        arm.servo_jp_stream(np.tile(arm.robot.home, (400, 1)))
    assert arm.operating_state().state == "PAUSED"
