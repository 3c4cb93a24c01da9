"""Tests of how an arm is stopped: from any thread, whatever it is doing."""

import threading

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.conftest import LaggingBackend, homed
from tests.crtk.faulty_backend import Fault, FaultyBackend

from truejoint.crtk import Arm, Motion, SimulatedBackend, simulated_arm
from truejoint.crtk.arm import BRAKING
from truejoint.errors import CommandRefused, MotionStopped
from truejoint.simulation import make_twin

FAR = np.array([0.5, 0.3, 0.05, 1.0, 0.5, 0.2, 0.2])


def pausable_homing(backend, t):
    """Let the homing wait at a time [s], once, until a state command waits for it."""
    pieces, begun = backend.twin.homing, threading.Event()

    def homing():
        for piece in pieces():
            if backend.twin.time > t and not begun.is_set():
                begun.set()
                while backend._entry_lock.acquire(blocking=False):
                    backend._entry_lock.release()
            yield piece

    backend.twin.homing = homing
    return begun


@given(
    delay=st.floats(0.0, 1.5),
    command=st.sampled_from(["pause", "disable", "hold"]),
    motion=st.sampled_from(["move_jp", "move_jr", "servo_jp_stream", "wait"]),
)
def test_every_motion_stops_within_a_piece_and_the_braking(delay, command, motion):
    backend = LaggingBackend(0.02)
    arm = homed(backend)
    home, asked = arm.robot.home, []

    def stop(block):
        if not asked and arm.time >= start + delay:
            asked.append(arm.time)
            getattr(arm, command)()

    calls = {
        "move_jp": lambda: arm.move_jp(home + FAR * 0.5).wait(),
        "move_jr": lambda: arm.move_jr(-FAR * 0.5).wait(),
        "servo_jp_stream": lambda: arm.servo_jp_stream(
            home + np.linspace(0, 0.2, 6000)[:, None] * FAR
        ),
        "wait": lambda: arm.wait(6.0),
    }
    start = arm.time
    arm.subscribe(stop)
    with pytest.raises(MotionStopped, match=f"^{motion} stopped at t = .* s, .*% done: "):
        calls[motion]()
    assert arm.time - asked[0] <= 0.02 + BRAKING + 1e-9
    path = np.vstack(backend.sent)
    speed = np.diff(path, axis=0, prepend=home[None])
    assert np.abs(speed[-1]).max() <= 1e-12
    braking = np.abs(speed[-round(BRAKING * 1000) :])
    assert (np.diff(braking, axis=0) <= 1e-12).all()
    state = {"pause": "PAUSED", "disable": "DISABLED", "hold": "ENABLED"}[command]
    assert arm.operating_state().state == state
    assert not arm.operating_state().is_busy
    if command == "hold":
        np.testing.assert_array_equal(arm.latest_setpoint("servo_jr"), path[-1])


def test_braking_leaves_no_range(lagging_arm, lagging_backend):
    rows, upper = np.tile(lagging_arm.robot.home, (524, 1)), lagging_arm.robot.upper[0]
    rows[:, 0] = upper - 2e-3 * np.arange(524)[::-1]
    lagging_arm.servo_jp_stream(rows)
    lagging_arm.pause()
    assert lagging_backend.sent[-1][:, 0] == pytest.approx(upper, abs=1e-12)


def test_a_move_returns_a_handle_that_another_thread_can_cancel(lagging_arm, monkeypatch):
    reached, asked = threading.Event(), threading.Event()

    def stay(_):
        if lagging_arm.time > 5.0:  # until it is asked to stop: its clock does not wait
            reached.set()
            asked.wait(60.0)

    lagging_arm.subscribe(stay)
    motion = lagging_arm.move_jp(lagging_arm.robot.home + FAR)
    assert isinstance(motion, Motion)
    assert motion.command == "move_jp"
    assert reached.wait(60.0)
    over = motion.over.wait
    monkeypatch.setattr(motion.over, "wait", lambda timeout=None: asked.set() or over(timeout))
    motion.cancel()
    assert not motion.is_busy()
    with pytest.raises(MotionStopped, match="held"):
        motion.wait()
    assert lagging_arm.operating_state().is_ready
    assert 0.0 <= motion.progress <= 1.0
    assert motion.time_left == 0.0
    motion.cancel()  # once more does nothing


def test_a_pause_is_not_sent_again_to_an_arm_that_was_resumed_at_once(lagging_arm, monkeypatch):
    reached, asked, sent = threading.Event(), threading.Event(), []
    send = lagging_arm._backend.state_command

    def and_resume(command, timeout):
        sent.append(command)
        send(command, timeout)
        send("resume", timeout)

    monkeypatch.setattr(lagging_arm._backend, "state_command", and_resume)
    lagging_arm.subscribe(lambda block: reached.set() or asked.wait(60.0))
    motion = lagging_arm.move_jp(lagging_arm.robot.home + FAR)
    assert reached.wait(60.0)
    over = motion.over.wait
    monkeypatch.setattr(motion.over, "wait", lambda timeout=None: asked.set() or over(timeout))
    lagging_arm.pause()
    assert sent == ["pause"]
    assert lagging_arm.operating_state().state == "ENABLED"


def test_a_time_out_leaves_the_motion_going(lagging_arm):
    gate = threading.Event()
    lagging_arm.subscribe(lambda block: gate.wait(60.0) and None)
    motion = lagging_arm.move_jp(lagging_arm.robot.home + 0.1 * FAR)
    with pytest.raises(CommandRefused, match=r"move_jp is not over after 0.01 s .* it goes on"):
        motion.wait(0.01)
    assert motion.is_busy()
    with pytest.raises(CommandRefused, match="busy"):
        lagging_arm.move_jp(lagging_arm.robot.home)
    lagging_arm.pause(0.01)  # which does not wait for a subscriber that hangs
    assert lagging_arm.operating_state().state == "PAUSED"
    gate.set()
    with pytest.raises(MotionStopped, match="PAUSED"):
        motion.wait(60.0)


def test_an_exception_in_a_subscriber_pauses_the_arm(lagging_arm, lagging_backend):
    def broken(block):
        raise ZeroDivisionError("of the subscriber")

    lagging_arm.subscribe(broken)
    with pytest.raises(ZeroDivisionError, match="of the subscriber"):
        lagging_arm.move_jp(lagging_arm.robot.home + FAR).wait()
    assert lagging_arm.operating_state().state == "PAUSED"


def test_left_by_an_exception_the_arm_is_paused(lagging_backend):
    def crash():
        with homed(lagging_backend) as arm:
            arm.move_jp(arm.robot.home + FAR)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        crash()
    assert lagging_backend.state.state == "PAUSED"


def test_an_interrupt_while_waiting_pauses_the_arm(lagging_arm, monkeypatch):
    motion = lagging_arm.move_jp(lagging_arm.robot.home + FAR)
    real = motion.over.wait

    def interrupted(timeout=None):
        monkeypatch.setattr(motion.over, "wait", real)
        raise KeyboardInterrupt

    monkeypatch.setattr(motion.over, "wait", interrupted)
    with pytest.raises(KeyboardInterrupt):
        motion.wait()
    assert lagging_arm.operating_state().state == "PAUSED"


def test_homing_can_be_paused_and_is_then_to_be_done_again():
    backend = SimulatedBackend(make_twin("raven2", seed=1))
    arm, ended = Arm(backend), []
    begun = pausable_homing(backend, 0.5)
    arm.enable()

    def home():
        with pytest.raises(MotionStopped, match=r"'home' stopped at t = .*: PAUSED; .*not homed"):
            arm.home()
        ended.append(True)

    thread = threading.Thread(target=home)
    thread.start()
    assert begun.wait(60.0)
    asked = arm.time  # which waits for nobody
    arm.pause()
    thread.join(60.0)
    assert ended
    assert arm.time - asked <= 0.02 + 1e-9
    state = arm.operating_state()
    assert (state.state, state.is_homed, state.is_busy) == ("PAUSED", False, False)
    arm.resume()
    arm.home()
    assert arm.operating_state().is_ready
    assert arm.measured_js().position[:3] == pytest.approx(arm.robot.home[:3], abs=0.02)


def test_homing_that_takes_too_long_is_given_up():
    arm = simulated_arm(seed=1)
    arm.enable()
    with pytest.raises(CommandRefused, match="'home' stopped: not done after 2 s"):
        arm.home(timeout=2.0)
    assert not arm.operating_state().is_homed
    assert arm.time == pytest.approx(2.0, abs=0.02)
    with pytest.raises(CommandRefused, match="timeout 0 s; give more than 0 s"):
        arm.home(timeout=0)


def test_one_arm_has_one_controller():
    backend = SimulatedBackend(make_twin("forceps", seed=1))
    first = Arm(backend)
    with pytest.raises(CommandRefused, match="another Arm controls it; close that one first"):
        Arm(backend)
    first.close()
    Arm(backend)


def test_old_state_is_no_measurement():
    inner = SimulatedBackend(make_twin("forceps", seed=1))
    arm = homed(inner)
    assert arm.measured_js().t == pytest.approx(arm.time, abs=2e-3)
    inner.disconnect()  # its messages are lost
    arm.wait(0.5)
    for read in (arm.measured_js, arm.setpoint_js):
        with pytest.raises(CommandRefused, match=r"message is 0\.5 s old, more than 0\.1"):
            read()
    assert arm.measured_js(age=10.0).position.shape == (1,)


@pytest.mark.parametrize(
    ("fault", "match", "state"),
    [
        (Fault("fault", 14.0), "stopped at t = 14.*: FAULT", "FAULT"),
        (Fault("pause", 14.0), "stopped at t = 14.*: PAUSED", "PAUSED"),
        (Fault("link", 14.0), "servo_jp refused: the link to raven2 .* is lost", "ENABLED"),
    ],
)
def test_what_the_robot_does_ends_a_motion(fault, match, state):
    arm = homed(FaultyBackend(SimulatedBackend(make_twin("raven2", seed=1)), [fault]))
    assert arm.time < 13.0
    with pytest.raises(CommandRefused, match=match):
        arm.move_jp(arm.robot.home + FAR * 0.2).wait()
    assert arm.operating_state().state == state
    with pytest.raises(CommandRefused):
        arm.move_jp(arm.robot.home).wait()


@pytest.mark.parametrize("way", ["a move", "one set-point at a time"])
@pytest.mark.parametrize(
    ("fault", "match"),
    [
        (Fault("silence", 13.0), r"no state message for 1\.. s; does it report"),
        (Fault("slip", 13.0, "elbow", 0.05), r"elbow jumped by 2\.\d+ deg at t = 13\.00.* slip"),
    ],
)
def test_a_silent_arm_is_stopped_and_one_whose_encoder_slips(fault, match, way):
    arm = homed(FaultyBackend(SimulatedBackend(make_twin("raven2", seed=1)), [fault]))
    home = arm.robot.home

    def move():
        if way == "a move":
            arm.move_jr(0.5 * FAR).wait()
        while arm.time < 16.0:
            arm.servo_jp(home)

    with pytest.raises(MotionStopped, match=match):
        move()
    assert arm.operating_state().state == "PAUSED"
    stopped = arm.time
    if fault.kind == "silence":
        with pytest.raises(CommandRefused, match="newest state message"):
            arm.measured_js()
    else:
        assert stopped < 13.0 + 0.5 + BRAKING + 0.02
        lag = arm.measured_js().position - arm.setpoint_js().position
        assert lag[1] == pytest.approx(0.05, abs=1e-2)
    arm.resume()
    arm.servo_jp(arm.setpoint_js(np.inf).position)  # what was said then is over
    assert stopped < arm.time < (14.2 if way == "one set-point at a time" else 15.0)


def test_a_slip_at_the_end_of_a_motion_stops_the_next_one():
    slip = Fault("slip", 13.0, "elbow", 0.05)
    arm = homed(FaultyBackend(SimulatedBackend(make_twin("raven2", seed=1)), [slip]))
    arm.wait(12.9 - arm.time)
    arm.wait(0.15)  # a single piece
    with pytest.raises(MotionStopped, match=r"elbow jumped .* at t = 13\.00"):
        arm.move_jr(0.05 * FAR).wait()
    arm.resume()
    arm.home()
    arm.move_jr(0.05 * FAR).wait()


def test_a_set_point_has_no_speed_after_another_homing(lagging_arm):
    lagging_arm.move_jr(0.1 * FAR).wait()
    lagging_arm.home()
    assert not lagging_arm.setpoint_js().velocity.any()
