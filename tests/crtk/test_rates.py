"""Tests of arms whose back ends take set-points at other rates than RAVEN-II's 1 kHz."""

import threading
from types import SimpleNamespace

import numpy as np
import pytest
from tests.conftest import LaggingBackend, homed
from tests.crtk.faulty_backend import Fault, FaultyBackend
from tests.runtime.test_compensator import Insertion

from truejoint.crtk import Arm, PacedBackend
from truejoint.crtk.arm import BRAKING
from truejoint.errors import MotionStopped, RobotError
from truejoint.motion import Jog, Trajectory, follow, workspace_of
from truejoint.recordings import Recorder
from truejoint.robots import get_robot
from truejoint.runtime import Compensator

from .instant_twin import InstantTwin, hear

SPACE = workspace_of(get_robot("raven2"))
STEP = np.array([0.04, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])


@pytest.fixture(params=[500.0, 1500.0])
def rate(request):
    return request.param


@pytest.fixture
def backend(rate):
    return LaggingBackend(0.02, rate)


@pytest.fixture
def arm(backend):
    return homed(backend)


def test_moves_take_their_time_and_servoing_its_speed(arm, backend, rate):
    start = arm.time
    motion = arm.move_jr(STEP, speed=np.full(7, 0.04))
    motion.wait()
    assert arm.time - start == pytest.approx(motion.duration, abs=1.5 / rate)
    assert np.diff(np.vstack(backend.sent)[:, 0]).max() * rate == pytest.approx(0.04)
    start, place = arm.time, arm.setpoint_js().position
    for _ in range(30):
        arm.servo_jv(0.2 * STEP)
    assert arm.time - start == pytest.approx(30 / rate)
    assert arm.setpoint_js().position - place == pytest.approx(30 / rate * 0.2 * STEP)
    assert arm.setpoint_js().velocity == pytest.approx(0.2 * STEP)
    with pytest.raises(Exception, match=rf"in {1e3 / rate:.3g} ms, more than"):
        arm.servo_jr(np.full(7, 10.0 / rate))


def test_a_pause_acts_within_a_grain_and_the_braking(arm, backend, rate):
    asked = []

    def stop(_):
        if not asked and arm.time > start + 0.3:
            asked.append(arm.time)
            arm.pause()

    start = arm.time
    arm.subscribe(stop)
    with pytest.raises(MotionStopped):
        arm.move_jr(10 * STEP).wait()
    assert arm.time - asked[0] <= arm.grain + BRAKING + 1e-9
    path = np.vstack(backend.sent)[:, 0]
    assert path[-1] == pytest.approx(path[-2], abs=1e-12)
    arm.resume()
    start = arm.time
    arm.wait(0.5)
    assert arm.time == pytest.approx(start + 0.5)


def test_a_trajectory_is_followed_and_recorded(arm, backend, rate):
    path = Trajectory(
        ("shoulder", "elbow", "insertion"), ("rad", "rad", "m"),
        np.add(SPACE.centre, [[0.0, 0.0, 0.0], [0.04, 0.0, 0.0]]),
    )  # fmt: skip
    arm.move_jp([*SPACE.centre, *arm.setpoint_js().position[3:]]).wait()
    sent = len(backend.sent)
    with Recorder(arm, state_rate=np.inf) as recorder:
        report = follow(arm, path)
    cap = SPACE.speed[0]
    assert report.max_speed[0] == pytest.approx(cap, rel=1e-3)
    rows = np.vstack(backend.sent[sent:])
    assert np.abs(np.diff(rows[:, 0])).max() * rate == pytest.approx(cap)
    blend = round(0.25 * rate)  # the way to the start, which is none, takes no longer
    assert len(rows) - np.ceil(report.duration * rate) <= blend + 2
    recording = recorder.recording()
    assert np.diff(recording.t) == pytest.approx(1.0 / rate)
    assert np.array_equal(recording.column("setpoint/shoulder"), rows[:, 0])


def test_jogging_keeps_its_speed(arm, backend, rate):
    over, count = threading.Event(), len(backend.sent)
    jog = Jog(arm)
    jog.joints(STEP)  # before it begins: this arm's clock does not wait for a busy machine
    end = arm.time + 0.5
    arm.subscribe(lambda _: over.set() if arm.time > end else None)
    with jog:
        assert over.wait(60.0)
    speed = np.diff(np.vstack(backend.sent[count:])[:, 0]) * rate
    assert speed.max() == pytest.approx(0.04)


def test_a_compensator_steps_at_a_part_of_the_rate(arm, rate):
    told = Insertion(0.0)
    told.spike_speed, told.offset = np.ones(1), np.full(1, 0.002)
    loop = Compensator(told, arm.robot, rate=250.0, lag=0.02)
    start = arm.robot.home[2]
    n = round(2.0 * rate)
    wanted = start + 0.01 * (1.0 - np.cos(np.linspace(0.0, np.pi, n))) / 2.0
    steps = []
    loop.drive(arm, wanted[:, None], lambda t, goal, _: steps.append((t, *goal)))
    t, goals = np.array(steps).T
    assert len(t) == 500
    assert np.diff(t) == pytest.approx(1.0 / 250.0)
    assert np.array_equal(goals, wanted[round(rate / 250.0) - 1 :: round(rate / 250)])


def test_a_fault_comes_with_the_grain_of_what_is_behind(backend):
    arm = Arm(FaultyBackend(backend, [Fault("fault", 0.5)]))
    assert (arm.rate, arm.grain) == (backend.rate, backend.grain)
    arm.enable()
    arm.home()
    with pytest.raises(MotionStopped, match="FAULT"):
        arm.move_jr(10 * STEP).wait()
    assert backend.time <= 0.5 + arm.grain + 1.5 / arm.rate


def test_a_paced_arm_runs_at_the_rate_it_is_told(monkeypatch):
    now = [0.0]  # of a computer that is never late, which would leave rows out

    def sleep(seconds):
        now[0] += seconds

    clock = SimpleNamespace(perf_counter=lambda: now[0], sleep=sleep)
    monkeypatch.setattr("truejoint.crtk.backends.paced.time", clock)
    backend = PacedBackend(InstantTwin(), rate=500.0)
    arm = homed(backend)
    running = hear(arm, 20)
    arm.pause()
    paused = hear(arm, 5)  # paused, it goes on to report
    arm.close()
    for blocks in (running, paused):
        assert np.diff([block.t[0] for block in blocks]) == pytest.approx(2e-3)


@pytest.mark.parametrize(
    ("rate", "grain", "match"),
    [
        (0.0, 0.01, "0.0 set-points a second"),
        (-5.0, 0.01, "-5.0 set-points"),
        (np.nan, 0.01, "nan set-points"),
        (np.inf, 0.01, "inf set-points"),
        (1000.0, 0.05, "1000.0 set-points a second and a grain of 0.05 s"),
        (1000.0, 1e-4, "a grain of a period or more"),
        (1000.0, np.nan, "a grain of nan s"),
        (20.0, 0.05, "at most 0.02 s"),
        ("fast", 0.01, "declares fast set-points a second"),
        (1000.0, None, "a grain of None s; want a finite rate"),
    ],
)
def test_what_no_arm_can_be_stopped_with_is_refused(rate, grain, match):
    backend = LaggingBackend(0.02)
    backend.rate, backend.grain = rate, grain
    with pytest.raises(RobotError, match=match):
        Arm(backend)
    with pytest.raises(RobotError, match=r"not a Backend; it lacks robot, rate, grain, stretch"):
        Arm("raven2")
