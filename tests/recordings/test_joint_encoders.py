"""Tests of truejoint.recordings.joint_encoders: a real pseudo-terminal, and its node on a ROS."""

import logging
import os
import pty
import threading
import tty

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.local_ros import LocalRos
from tests.recordings.refusals import refused

from truejoint.crtk.messages import PROFILES, TRUTH_TOPIC, joint_state_columns
from truejoint.errors import RecordingError
from truejoint.recordings.joint_encoders import REGISTRATION, EncoderNode, JointEncoders
from truejoint.robots import get_robot

ROBOT = get_robot("raven2")
JOINT_ENCODERS = ROBOT.encoders

pytest.importorskip("serial", reason="pyserial is not installed")


class Line:
    """A pseudo-terminal, to whose other end a sensor's messages are written."""

    def __init__(self):
        self.ours, theirs = pty.openpty()
        tty.setraw(theirs)
        self.port = os.ttyname(theirs)
        self.theirs = theirs

    def send(self, text):
        os.write(self.ours, text if isinstance(text, bytes) else text.encode())

    def close(self):
        for descriptor in (self.ours, self.theirs):
            os.close(descriptor)


@pytest.fixture
def line():
    one = Line()
    yield one
    one.close()


def reached(condition):
    """Wait until a condition of the reading thread holds."""
    pause = threading.Event()
    for _ in range(6000):
        if condition():
            return
        pause.wait(0.01)
    raise AssertionError


def test_counts_become_positions_once_registered(line):
    ticks = iter(np.arange(10000) * 0.01)
    with JointEncoders(line.port, JOINT_ENCODERS, clock=lambda: next(ticks)) as encoders:
        blocks = []
        encoders.subscribe(blocks.append)
        line.send("100_200_300\n")  # before the registration: no position
        reached(lambda: encoders.messages == 1)
        encoders.start_registration()
        # To the stops: the shoulder's lower end with counts that fall with it, the others' upper.
        for share in np.linspace(0, 1, 21):
            line.send(f"{round(5000 * share)}_{round(9000 * share)}_{round(7000 * share)}\n")
        for bounce in (0, -10, 10, 0):
            line.send(f"{5000 + bounce}_{9000 + bounce}_{7000 + bounce}\n")
        reached(lambda: encoders.messages == 26)
        zero = encoders.register()
        assert zero == pytest.approx([5000, 9000, 7000], abs=5)
        line.send("4000_8000_5000\r\n")
        reached(lambda: blocks)
    (block,) = blocks
    stops = np.array([encoder.hard_stop for encoder in JOINT_ENCODERS])
    steps = np.array([encoder.resolution for encoder in JOINT_ENCODERS])
    moved = np.array([1000, -1000, -2000]) + np.array([1, -1, -1]) * (zero - [5000, 9000, 7000])
    assert block.name == ("shoulder", "elbow", "insertion")
    assert block.position[0] == pytest.approx(stops + steps * moved)
    assert block.position[0, 0] > stops[0]
    assert (block.position[0, 1:] < stops[1:]).all()


def test_garbage_and_half_lines_are_left_out():
    encoders = JointEncoders("none", JOINT_ENCODERS)
    encoders._take(b"7_8")
    encoders._take(b"_9\n\xff\x00garbage\n1_2\n1_2_3_4\n99999999999_1_1\n9999999999_1_1\n\n3_4_5\n")
    assert (encoders.messages, encoders.garbage) == (2, 6)


def test_an_unplugged_sensor_is_opened_again(line, monkeypatch, tmp_path):
    monkeypatch.setattr("truejoint.recordings.joint_encoders.RECONNECT", 0.01)
    port = tmp_path / "encoders"
    port.symlink_to(line.port)
    again = Line()
    try:
        with JointEncoders(str(port), JOINT_ENCODERS) as encoders:
            line.send("1_2_3\n")
            reached(lambda: encoders.messages == 1)
            port.unlink()
            port.symlink_to(again.port)
            os.close(line.ours)  # the other end is gone
            line.ours = os.open(os.devnull, os.O_RDONLY)
            reached(lambda: encoders.disconnections >= 1)
            pause = threading.Event()
            while encoders.messages < 2:
                again.send("4_5_6\n")
                pause.wait(0.01)
    finally:
        again.close()


def test_a_registration_that_cannot_be_is_refused():
    now = [0.0]
    encoders = JointEncoders("none", JOINT_ENCODERS, clock=lambda: now[0])
    encoders.start_registration()
    now[0] = REGISTRATION + 1.0
    encoders._take(b"0_0_0\n5000_5000_5000\n")  # too late
    refused("no counts were read during the homing", encoders.register)
    encoders.start_registration()
    encoders._take(b"0_0_0\n5000_10_5000\n")
    refused("encoder of elbow did not move", encoders.register)
    refused("no counts were read during the homing", encoders.register)


def test_a_port_or_encoders_that_are_not_there_are_refused(tmp_path):
    refused("cannot be opened", JointEncoders(str(tmp_path / "x"), JOINT_ENCODERS).__enter__)
    refused(r"its file needs \[\[encoders\]\]", JointEncoders, "x", ())


@given(st.lists(st.binary(max_size=20), max_size=20))
def test_no_bytes_break_a_parser_and_a_line_without_end_is_given_up(pieces):
    sensor = JointEncoders("none", JOINT_ENCODERS)
    for piece in pieces:
        sensor._take(piece)
    garbage, before = sensor.garbage, sensor.messages
    sensor._take(b"1" * 5000)
    assert not sensor._waiting
    assert sensor.garbage > garbage
    sensor._take(b"\n1_2_3\n")
    assert sensor.messages == before + 1


def read_into_a_full_disk(line, raised=None):
    def full(block):
        raise RecordingError("the disk is full")

    with JointEncoders(line.port, JOINT_ENCODERS) as encoders:
        encoders._zero = np.zeros(3)
        encoders.subscribe(full)
        line.send("1_2_3\n")
        reached(lambda: encoders.messages == 1)
        if raised is not None:
            raise raised


def test_what_a_listener_raises_is_raised_on_leaving(line):
    refused("the disk is full", read_into_a_full_disk, line)
    with pytest.raises(KeyError):  # what ended the block goes before
        read_into_a_full_disk(line, KeyError())


TOWARDS = np.array([e.direction * (1 if e.end == "upper" else -1) for e in JOINT_ENCODERS])


@pytest.fixture
def node():
    ros = LocalRos()
    encoders = JointEncoders("loop://", JOINT_ENCODERS, clock=ros.now)
    with EncoderNode(ros, encoders, ROBOT, "raven2") as made:
        yield ros, encoders, made


def say(ros, **state):
    message = ros.stamped("crtk_msgs/operating_state", ros.now())
    vars(message).update(state)
    ros.send("/arm1/operating_state", message)


def send(encoders, *rows):
    for row in rows:
        encoders._take(("_".join(map(str, row)) + "\n").encode())


def test_it_registers_while_the_arm_homes_and_publishes_from_the_drivers_zero(node):
    ros, encoders, made = node
    out = []
    ros.subscribe(TRUTH_TOPIC, "sensor_msgs/JointState", out.append)
    send(encoders, (0, 0, 0))
    assert not out
    say(ros, state="ENABLED", is_homed=False, is_busy=True)
    send(encoders, (0, 0, 0), 1000 * TOWARDS)
    say(ros, state="ENABLED", is_homed=False, is_busy=True)  # as it says all along
    send(encoders, -500 * TOWARDS)
    say(ros, state="ENABLED", is_homed=True, is_busy=False)
    send(encoders, -500 * TOWARDS)
    assert made.published == len(out) == 1
    fields = {"position": np.array([out[0].position])}
    columns = joint_state_columns(ROBOT, "truth", [], fields, PROFILES["raven2"])
    truth = [columns[f"truth/{joint}"][0] for joint in ROBOT.positioning]
    for encoder, position in zip(JOINT_ENCODERS, truth, strict=True):
        # The joint goes to its stop and 1500 counts away from it; the stop is where it is known.
        away = -1.0 if encoder.end == "upper" else 1.0
        assert position == pytest.approx(encoder.hard_stop + away * 1500 * encoder.resolution)
    assert out[0].header.stamp > 1e9
    say(ros, state="ENABLED", is_homed=False, is_busy=True)  # its zero is that no more
    send(encoders, (0, 0, 0))
    assert len(out) == 1


def test_a_homing_that_was_stopped_is_registered_anew(node):
    ros, encoders, made = node
    say(ros, state="ENABLED", is_homed=False, is_busy=True)
    send(encoders, 9000 * TOWARDS)  # before somebody stopped it
    say(ros, state="PAUSED", is_homed=False, is_busy=False)
    say(ros, state="ENABLED", is_homed=False, is_busy=True)
    send(encoders, (0, 0, 0), 1000 * TOWARDS)
    say(ros, state="ENABLED", is_homed=True, is_busy=False)
    assert encoders._zero == pytest.approx(1000 * TOWARDS)
    assert not made.published


def test_a_registration_that_fails_is_said_and_nothing_is_published(node, caplog):
    ros, encoders, made = node
    say(ros, state="ENABLED", is_homed=False, is_busy=True)
    send(encoders, (0, 0, 0), (0, 0, 0))
    with caplog.at_level(logging.WARNING):
        say(ros, state="ENABLED", is_homed=True, is_busy=False)
    assert "did not move during the homing" in caplog.text
    send(encoders, (5, 5, 5))
    assert not made.published
