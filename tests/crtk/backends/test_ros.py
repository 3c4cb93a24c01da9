"""Tests of truejoint.crtk.backends.ros against truejoint.crtk.server: both ends of the topics."""

import copy
import itertools
import logging
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest
from tests.crtk.instant_twin import InstantTwin, hear
from tests.crtk.stepped_ros import SteppedRos
from tests.local_ros import LocalRos

from truejoint.crtk import Arm, PacedBackend, StateBlock, cartesian
from truejoint.crtk.backends import ros
from truejoint.crtk.backends.ros import RosBackend
from truejoint.crtk.messages import JOINT_STATE, STRING_STAMPED
from truejoint.crtk.server import ArmServer, matrix_of
from truejoint.crtk.setpoint_follower import SetpointFollower, _Stream
from truejoint.errors import CommandRefused, MotionStopped, NotArrived, RobotError, RosError
from truejoint.recordings import Recorder
from truejoint.robots import get_robot

ROBOT = get_robot("raven2")
JOINTS = ROBOT.joint_names
CHANNELS = ROBOT.joint_channels
SHOULDER = np.eye(7)[0]
TOP_SPEED = np.array([joint.max_speed for joint in ROBOT.joints])
STATE = "/arm1/operating_state"
LONG = 60.0  # [s]
STILL, MOST_STILL = ros._STILL, ros._MOST_STILL


class Served:
    """An arm that is served on topics, with 200 states a second: more are for a robot alone."""

    def __init__(self, profile):
        self.ros, self.profile = LocalRos(), profile
        self.twin = InstantTwin()
        self.arm = Arm(PacedBackend(self.twin))
        self.server = ArmServer(self.arm, self.ros, profile, rate=200.0)

    def client(self, **options):
        return Arm(RosBackend(self.ros, ROBOT, self.profile, rate=250.0), **options)

    def say(self, name, kind="sensor_msgs/JointState", **values):
        message = self.ros.stamped(kind, self.ros.now())
        for key, value in values.items():
            setattr(message, key, value)
        self.ros.send(f"/arm1/{name}", message)
        return message

    def follow(self):
        """Wait for the end of the stream of set-points."""
        self.server._follower._stream.motion.wait(LONG)

    @contextmanager
    def move(self) -> Iterator[list[bool]]:
        """Wait for the end of what is asked within the block; whether it was busy, till now."""
        busy: list[bool] = []
        end = self.ros.subscribe(
            STATE, "crtk_msgs/OperatingState", lambda m: busy.append(m.is_busy)
        )
        yield busy
        self.ros.wait_for(STATE, lambda m: any(busy) and not m.is_busy)
        end()


@pytest.fixture(autouse=True)
def _patient(monkeypatch, hasty):
    """On a busy machine a thread that reports may be silent for long, above all if it compiles."""
    for name in ("SILENCE", "CONNECT_TIMEOUT"):
        monkeypatch.setattr(ros, name, LONG)
    for name in ("arm.SILENCE", "arm.TIMEOUT", "server._LOG"):
        monkeypatch.setattr(f"truejoint.crtk.{name}", LONG)
    monkeypatch.setattr(ros, "_SETTLING", LONG)
    for name in ("_STILL", "_MOST_STILL", "_IN_FLIGHT"):
        monkeypatch.setattr(ros, name, 2.0)
    go_on = RosBackend.flush.__defaults__[1]
    monkeypatch.setattr(RosBackend.flush, "__defaults__", (LONG, go_on))  # in place of 2 s
    monkeypatch.setattr("truejoint.crtk.server._LATE", 4.0)


@pytest.fixture(params=["raven2_mended"])
def served(request):
    made = Served(request.param)
    with made.arm, made.server:
        yield made


@pytest.fixture
def arm(served):
    with served.client() as client:
        client.enable()
        client.home()
        yield client


@pytest.mark.parametrize("served", ["raven2_mended", "raven2"], indirect=True)
def test_an_arm_over_ros_moves_and_reports_as_any_other(served, arm):
    goal = ROBOT.home + SHOULDER * 0.01
    arm.move_jp(goal).wait()
    served.ros.wait_for(
        "/ravenstate", lambda m: abs(m.jpos_d[0] - np.degrees(goal[0])) < 1e-4
    )  # RAVEN's own message, in degrees
    there = threading.Event()

    def look(block):
        if isinstance(block, StateBlock) and abs(block.measured[-1, 0] - goal[0]) < 5e-7:
            there.set()

    arm.subscribe(look)
    assert there.wait(LONG)
    now = arm.measured_js(LONG)
    assert now.name == JOINTS
    assert now.position == pytest.approx(goal, abs=1e-6)
    # Torque at the motors became effort on the joints, and so for both profiles.
    torque = np.full(7, 0.1)
    assert now.effort == pytest.approx(ROBOT.transmission.joint_effort(torque), rel=1e-5)
    assert arm.homing_id.startswith("homed at")
    arm.pause()
    assert arm.operating_state().state == "PAUSED"
    assert served.arm.operating_state().state == "PAUSED"


def test_a_paused_arm_goes_on_to_report(served, arm):
    arm.pause()
    assert np.diff([block.t[0] for block in hear(arm, 3)]).min() > 0.0


def test_a_move_is_stopped_by_pausing_at_the_robot(served, arm):
    motion = arm.move_jp(ROBOT.home + SHOULDER * 0.5)
    served.say("state_command", "crtk_msgs/StringStamped", string="pause")
    with pytest.raises((MotionStopped, CommandRefused), match="PAUSED"):
        motion.wait()


def test_one_who_looks_on_moves_nothing_and_leaves_the_arm_as_it_is(served, arm):
    with served.client(controls=False) as onlooker:
        assert onlooker.measured_js(LONG).position == pytest.approx(ROBOT.home)
        for command in (onlooker.disable, onlooker.hold, lambda: onlooker.move_jp(ROBOT.home)):
            with pytest.raises(CommandRefused, match="looks on"):
                command()
        assert arm.operating_state().state == "ENABLED"
        onlooker.pause()  # as anybody may
        assert arm.operating_state().state == "PAUSED"
        onlooker.resume()
    assert arm.operating_state().state == "ENABLED"


def test_an_arm_that_is_not_there_is_refused_with_those_that_are(served, monkeypatch):
    monkeypatch.setattr(ros, "CONNECT_TIMEOUT", 0.02)
    backend = RosBackend(served.ros, ROBOT, "crtk", namespace="/PSM1")
    with pytest.raises(RosError, match=r"/PSM1/operating_state .* arms report under /arm1: give"):
        Arm(backend)
    near = RosBackend(served.ros, ROBOT, "crtk", namespace="/arn1")
    with pytest.raises(RosError, match=r"under /arm1: did you mean '/arm1'\?"):
        Arm(near)
    with pytest.raises(RosError, match="no arm reports: start the node"):
        Arm(RosBackend(LocalRos(), ROBOT))
    with pytest.raises(RobotError, match="profile"):
        RosBackend(served.ros, ROBOT, "raven3")


def test_a_robot_that_falls_silent_is_noticed(served, arm, monkeypatch):
    monkeypatch.setattr(ros, "SILENCE", -1.0)
    with pytest.raises(CommandRefused, match=r"/arm1/operating_state has been silent"):
        arm.operating_state()
    monkeypatch.undo()


def test_a_subscriber_that_fails_pauses_the_arm(served, arm):
    def fail(block):
        raise ZeroDivisionError

    arm.subscribe(fail)
    served.ros.wait_for("/arm1/operating_state", lambda m: m.state == "PAUSED")


def test_a_subscriber_of_one_who_looks_on_pauses_nobody(served, arm, monkeypatch):
    def fail(block):
        raise ZeroDivisionError

    commands, said = [], threading.Event()
    monkeypatch.setattr(ros._log, "error", lambda *_: said.set())
    with served.client(controls=False) as onlooker:
        served.ros.subscribe(
            "/arm1/state_command", "crtk_msgs/StringStamped", lambda m: commands.append(m.string)
        )
        onlooker.pause()
        onlooker.resume()
        commands.clear()
        onlooker.subscribe(fail)
        assert said.wait(LONG)
    assert not commands


def test_one_who_looks_on_sees_the_moves_of_others(served, arm):
    blocks = []
    goal = ROBOT.home + SHOULDER * 0.01
    with served.client(controls=False) as onlooker:
        onlooker.subscribe(blocks.append)
        with served.move():  # busy, as CRTK says, until it is there
            served.say("move_jp", position=goal.tolist())
    way = [block.measured[0, 0] - ROBOT.home[0] for block in blocks]
    assert any(0.002 < gone < 0.008 for gone in way)


def test_a_robot_without_joints_leaves_no_topic_open(served, arm, monkeypatch):
    before = sum(map(len, served.ros.readers.values()))
    backend = RosBackend(served.ros, ROBOT, served.profile)
    start = backend._stream.start

    def start_soon():
        monkeypatch.setattr(ros, "CONNECT_TIMEOUT", 0.02)  # the state has been heard
        start()

    monkeypatch.setattr(backend._stream, "start", start_soon)
    monkeypatch.setattr(backend._stream, "_on_row", lambda *_: None)
    for _ in range(2):  # and it may be tried again
        monkeypatch.setattr(ros, "CONNECT_TIMEOUT", LONG)
        with pytest.raises(RosError, match="no message on /arm1/measured_js"):
            Arm(backend)
    assert sum(map(len, served.ros.readers.values())) == before


def test_it_answers_what_crtk_clients_ask(served, arm):
    # As crtk_python_client does: servo_jr, move_jp and move_cp with is_busy, hold, PoseStamped.
    step = SHOULDER * 1e-4
    served.say("servo_jr", position=step.tolist())
    served.ros.wait_for(
        "/arm1/setpoint_js", lambda m: np.allclose(m.position, ROBOT.home + step, atol=1e-9)
    )
    pose = copy.deepcopy(served.ros.wait_for("/arm1/measured_cp", lambda m: True))
    pose.pose.position.x += 1e-3
    with served.move():
        served.ros.send("/arm1/move_cp", pose)
    served.ros.wait_for(
        "/arm1/measured_cp", lambda m: abs(m.pose.position.x - pose.pose.position.x) < 1e-6
    )
    served.say("hold", "std_msgs/Empty")
    with served.move() as busy:
        served.say("move_jp", position=ROBOT.home.tolist())
        served.ros.wait_for(STATE, lambda m: any(busy))
        served.say("hold", "std_msgs/Empty")
    pose.pose.orientation.w = 3.0
    served.ros.send("/arm1/move_cp", pose)  # no turn: said in the log, and nothing moves
    assert arm.operating_state().state == "ENABLED"


NEAR = np.radians(0.15)


class Stepped(SteppedRos):
    """A robot whose shoulder is off by what it `hangs` [rad], with topics of `forces`.

    It takes the newest set-point but in a span of its time, and reports nothing in another [s].
    """

    def __init__(self, monkeypatch, rate, refusing=(0.0, 0.0), silent=(0.0, 0.0), hangs=0.0):
        self.hangs, self.refusing, self.silent = hangs, refusing, silent
        self.setpoint, self.refused, self.forces = ROBOT.home, [], {}
        super().__init__(monkeypatch, ROBOT, "/arm1", rate)
        monkeypatch.setattr(ros, "_STILL", STILL)
        monkeypatch.setattr(ros, "_MOST_STILL", MOST_STILL)

    def arm(self, **how):
        return super().arm("raven2_mended", **how)

    def shoulder(self, setpoint):
        """Where it is."""
        return setpoint - self.hangs

    def is_within(self, span):
        return span[0] <= self.t - 100.0 < span[1]

    def report(self):
        if not self.is_within(self.refusing):
            step = TOP_SPEED / self.rate
            self.setpoint = self.setpoint + np.clip(self.asked - self.setpoint, -step, step)
        if self.is_within(self.silent):
            return
        self.say_state()
        self.say_joints("/arm1/setpoint_js", self.setpoint)
        measured = [self.shoulder(self.setpoint[0]), *self.setpoint[1:]]
        self.say_joints("/arm1/measured_js", measured)
        for topic, values in self.forces.items():
            self.say_joints(topic, values)

    def take(self, message):
        super().take(message)
        if self.is_within(self.refusing):
            off = np.abs(self.asked - self.setpoint).max()
            self.refused += [self.t] if off > 0.8 * ros.TOLERANCE["rad"] else []


FORCES = {"/force_gauge": [0.4], "/force_cmd": [0.0, 0.0, 0.0, -2.8]}


def test_forces_are_recorded_beside_the_state(monkeypatch):
    robot = Stepped(monkeypatch, 250.0)
    robot.forces |= FORCES
    with robot.arm(beside=[*FORCES]) as arm, Recorder(arm, state_rate=np.inf) as recorder:
        robot.sleep(0.01)
        robot.forces["/force_gauge"] = [0.7]
        robot.sleep(0.01)
        recording = recorder.recording()
        assert recording.units["force/gauge"] == recording.units["force/command"] == "N"
        assert set(recording["force/command"]) == {-2.8}
        assert (recording["force/gauge"][0], recording["force/gauge"][-1]) == (0.4, 0.7)
        del robot.forces["/force_gauge"]
        monkeypatch.setattr(ros, "SILENCE", 0.5)
        robot.sleep(1.0)
        with pytest.raises(CommandRefused, match=r"/force_gauge has been silent for more than"):
            arm.operating_state()


@pytest.mark.parametrize(
    ("topic", "position", "said"),
    [
        ("/force_cmd", [1.0], "1 values; the force is value 4"),
        ("/arm1/setpoint_js", None, "cannot be recorded beside the state; these can: io/pot/"),
        ("/force_gauge", None, "no message on /force_gauge within"),
    ],
)
def test_what_cannot_be_recorded_beside_the_state_is_refused(monkeypatch, topic, position, said):
    robot = Stepped(monkeypatch, 250.0)
    robot.forces |= {topic: position} if position else {}
    monkeypatch.setattr(ros, "CONNECT_TIMEOUT", 0.02)
    with pytest.raises(RosError, match=said):
        robot.arm(beside=(topic,))


def test_a_joint_that_hangs_off_its_set_point_is_brought_there(monkeypatch):
    robot, sent = Stepped(monkeypatch, 1000.0, hangs=0.004), []
    robot.readers["/arm1/servo_jp"].append(lambda message: sent.append(message.position[0]))
    with robot.arm() as arm:
        for angle in (ROBOT.home[0] + 0.05, ROBOT.home[0], ROBOT.upper[0] - 0.004):
            goal = ROBOT.home + (angle - ROBOT.home[0]) * SHOULDER
            arm.move_jp(goal, TOP_SPEED).wait()
            assert np.abs(arm.measured_js().position - goal).max() < NEAR
            assert arm.setpoint_js().position == pytest.approx(goal, abs=NEAR)  # as asked
        assert np.abs(np.diff(sent)).max() <= TOP_SPEED[0] / arm.rate + 1e-9
        arm.pause()
        arm.resume()  # from where the robot stands
        robot.sleep(5e-3)
        assert arm.setpoint_js().position == pytest.approx(robot.setpoint, abs=1e-9)


def test_on_a_slow_link_a_joint_is_not_trimmed_twice(monkeypatch):
    """Its states come a tenth of a second late."""
    robot, asked = Stepped(monkeypatch, 200.0, hangs=0.004), []
    for name in ("_STILL", "_MOST_STILL"):
        monkeypatch.setattr(ros, name, 2.0)
    robot.readers["/arm1/servo_jp"].append(lambda message: asked.append(message.position[0]))
    subscribe = robot.subscribe

    def late(topic, kind, callback, **how):
        waiting = deque()

        def receive(message):
            waiting.append(message)
            if len(waiting) > 20:
                callback(waiting.popleft())

        return subscribe(topic, kind, receive if kind == JOINT_STATE else callback, **how)

    monkeypatch.setattr(robot, "subscribe", late)
    with robot.arm() as arm:
        arm.move_jp(ROBOT.home + 0.05 * SHOULDER).wait()
        robot.sleep(1.0)
    assert max(asked) < ROBOT.home[0] + 0.05 + 0.005


def test_what_ends_a_motion_has_been_said_by_the_arm(monkeypatch):
    """Or the joint would still be on its way for whoever asks after `wait`."""
    with Stepped(monkeypatch, 1000.0).arm() as arm:
        backend, is_ahead = arm._backend, []
        deliver = backend._deliver

        def look(listener, block):
            last = backend._measured
            is_ahead.append(np.array_equal(last, block.measured[-1, CHANNELS]))
            deliver(listener, block)

        monkeypatch.setattr(backend, "_deliver", look)
        arm.move_jp(ROBOT.home + 0.05 * SHOULDER).wait()
        assert not all(is_ahead)


def held(setpoint):
    """Where a shoulder is that cannot go on."""
    return min(setpoint, ROBOT.home[0] + 0.02)


def test_a_move_whose_joint_is_held_says_how_far_off_it_is(monkeypatch):
    robot, go_on = Stepped(monkeypatch, 1000.0), RosBackend.flush.__defaults__[1]
    robot.shoulder = held
    monkeypatch.setattr(RosBackend.flush, "__defaults__", (0.2, go_on))
    with robot.arm() as arm:
        with pytest.raises(NotArrived, match=r"move_jp is over, but shoulder is 1.719 deg away"):
            arm.move_jp(ROBOT.home + 0.05 * SHOULDER).wait()
        assert arm.operating_state().state == "ENABLED"
        trim = robot.asked[0] - ROBOT.home[0] - 0.05
        assert 0.0 < trim <= ros.MOST_TRIM["rad"] + 1e-9


@pytest.mark.parametrize("who", ["this program", "another"])
def test_a_pause_does_not_wait_for_a_joint_that_is_held(monkeypatch, who):
    robot = Stepped(monkeypatch, 1000.0)
    robot.shoulder = held
    flush, waits = RosBackend.flush, threading.Event()
    monkeypatch.setattr(RosBackend, "flush", lambda *a, **how: waits.set() or flush(*a, **how))
    with robot.arm() as arm:
        motion = arm.move_jp(ROBOT.home + 0.05 * SHOULDER)
        assert waits.wait(LONG)
        if who == "another":
            robot.state = "PAUSED"
        else:
            arm.pause()
        with pytest.raises(CommandRefused, match="PAUSED"):
            motion.wait(LONG)


def test_a_homing_is_stopped_by_whoever_pauses(monkeypatch):
    robot = Stepped(monkeypatch, 250.0)
    with robot.arm() as arm:
        robot.readers["/arm1/state_command"] = [lambda _: setattr(robot, "state", "PAUSED")]
        with pytest.raises(MotionStopped, match="PAUSED; the arm is not homed"):
            arm.home()


@pytest.mark.parametrize(("rate", "most"), [(1000.0, 0.25), (200.0, 0.25), (100.0, 0.27)])
def test_a_robot_that_refuses_set_points_gets_no_new_ones_after_50_ms(monkeypatch, rate, most):
    """Who waits hears it a quarter of a second after the first, by the robot's clock."""
    robot = Stepped(monkeypatch, rate, (1.0, np.inf))
    with robot.arm() as arm:
        motion = arm.move_jp(ROBOT.home + 0.5 * SHOULDER)
        with pytest.raises(
            CommandRefused, match="does not take the set-points that are sent: shoulder stands"
        ):
            motion.wait()
        assert robot.t - robot.refused[0] <= most
        assert 30 < len(robot.refused) <= 50  # a millisecond each
        assert arm.operating_state().state == "PAUSED"
        assert arm.setpoint_js().position == pytest.approx(robot.setpoint, abs=1e-9)


@pytest.mark.parametrize(
    ("refusing", "silent"),
    [((1.0, 1.15), (1.0, 1.06)), ((1.0, 1.15), (0.0, 0.0)), ((1.0, 1.75), (1.05, 1.65))],
)
def test_a_link_that_stalls_has_time_to_take_set_points(monkeypatch, refusing, silent):
    """Also where the robot's messages go on: its computer may be late with what it reads.

    While it is not heard, nothing says that it refuses them.
    """
    monkeypatch.setattr(ros, "_IN_FLIGHT", 0.1)
    robot = Stepped(monkeypatch, 250.0, refusing, silent=silent)
    with robot.arm() as arm:
        arm.move_jp(ROBOT.home + 0.3 * SHOULDER).wait()
        robot.sleep(5e-3)  # the last one is taken by the next report
        assert robot.setpoint == pytest.approx(ROBOT.home + 0.3 * SHOULDER, abs=1e-6)
    assert len(robot.refused) < 100  # and meanwhile nothing new is sent


def test_a_set_point_that_is_lost_is_sent_again(monkeypatch):
    """Or a joint that friction holds would never be brought there."""
    monkeypatch.setattr(ros, "_IN_FLIGHT", 0.1)
    robot, goal = Stepped(monkeypatch, 1000.0, hangs=0.004), ROBOT.home + 0.02 * SHOULDER
    lost = []

    def lose(message):  # what is added after the move, for a while
        is_trim, while_t = message.position[0] > goal[0] + 1e-3, lost[0] if lost else robot.t
        if is_trim and robot.t < while_t + 0.05:
            lost.append(robot.t)
        else:
            robot.take(message)

    robot.readers["/arm1/servo_jp"] = [lose]
    with robot.arm() as arm:
        arm.move_jp(goal).wait()
        assert arm.measured_js().position == pytest.approx(goal, abs=NEAR)
    assert lost


def test_set_points_that_are_late_do_not_come_all_at_once(monkeypatch):
    """A robot that takes the newest one would leap: they follow each other no faster than 3/4."""
    robot, sent = Stepped(monkeypatch, 250.0), []
    robot.readers["/arm1/servo_jp"].append(lambda message: sent.append(robot.t))
    taken = RosBackend._is_taken

    def once_late(backend, go_on):
        if len(sent) == 100:
            robot.sleep(0.05)
        return taken(backend, go_on)

    monkeypatch.setattr(RosBackend, "_is_taken", once_late)
    with robot.arm() as arm:
        arm.move_jp(ROBOT.home + 0.3 * SHOULDER).wait()
    between = np.diff(sent[:1000])
    assert between[:90] == pytest.approx(1e-3)
    assert between[100:].min() >= 0.75e-3 - 1e-9
    assert between[100:250] == pytest.approx(0.75e-3)
    assert sent[900] - sent[0] == pytest.approx(0.9)  # and so they catch up


@pytest.mark.parametrize("speed", [0.02, 2.0])
def test_who_moves_the_arm_after_a_move_is_let_alone(monkeypatch, speed):
    monkeypatch.setattr(ros, "_IN_FLIGHT", 0.1)
    robot = Stepped(monkeypatch, 250.0, hangs=0.004)
    with robot.arm() as arm:
        arm.move_jp(ROBOT.home + 0.02 * SHOULDER).wait()
        robot.sleep(1.0)
        trimmed = robot.asked
        assert trimmed[0] > ROBOT.home[0] + 0.023
        for goal in (trimmed + 0.01 * SHOULDER, trimmed):  # and back to where it was
            start = robot.asked
            for share in np.linspace(0.0, 1.0, round(0.01 / speed * 1000.0) + 2)[1:]:
                robot.asked = asked = start + share * (goal - start)
                robot.sleep(1e-3)
                assert robot.asked is asked
            robot.hangs += 0.002
            robot.sleep(0.5)
            assert robot.asked is asked


@pytest.mark.parametrize(
    ("turn", "leaps", "said"),
    [
        (0.01, True, "another program moves the arm as well"),  # each has it for 10 ms
        (0.08, True, "does not take .* or who else moves it"),
        (0.01, False, "does not take .* or who else moves it"),
        (None, False, "does not take .* or who else moves it"),  # the other alone
    ],
)
def test_who_moves_the_arm_meanwhile_ends_the_motion(monkeypatch, turn, leaps, said):
    """However the other one moves it: its set-points need not stand still."""
    monkeypatch.setattr(ros, "_IN_FLIGHT", 0.1)
    robot, goal = Stepped(monkeypatch, 250.0), ROBOT.home + 0.5 * SHOULDER
    report, elbow = robot.report, np.eye(len(ROBOT.home))[1]

    def fought_for():
        since = robot.t - 101.1  # within a piece of the motion
        if since > 0.0 and (turn is None or since % (2.0 * turn) < turn):
            robot.asked = ROBOT.home + (0.05 + 0.02 * np.sin(since)) * elbow
        robot.setpoint = robot.asked if leaps else robot.setpoint
        report()

    robot.report = fought_for
    with robot.arm() as arm:
        motion = arm.move_jp(goal)
        with pytest.raises(CommandRefused, match=said):
            motion.wait()
        assert robot.t < 102.6


def at_rest(served, goal):
    """Wait until the set-point is at `goal` (n_joints,), and stays there."""
    served.ros.wait_for("/arm1/setpoint_js", lambda m: np.allclose(m.position, goal, atol=1e-9))
    served.follow()
    assert served.arm.setpoint_js(LONG).position == pytest.approx(goal, abs=1e-9)


def test_the_newest_set_point_wins_and_none_is_queued(served, arm):
    for k in range(400):  # 30 s away at top speed, were they all gone to
        served.say("servo_jp", position=(ROBOT.home + 0.2 * SHOULDER * (-1) ** k).tolist())
    goal = ROBOT.home + 0.01 * SHOULDER
    served.say("servo_jp", position=goal.tolist())
    at_rest(served, goal)


def test_what_comes_in_a_burst_takes_the_time_that_its_stamps_say(served):
    """A set-point for which others were passed over is gone to no faster than those."""
    stream = _Stream(ROBOT.home + 1e-4 * SHOULDER, 5.0)
    pieces = SetpointFollower(served.arm, print)._pieces(stream, ROBOT.home, "servo_jp")
    assert next(pieces)[:, 0] - ROBOT.home[0] == pytest.approx([1e-4])
    stream.goal, stream.t = ROBOT.home + 5e-4 * SHOULDER, 5.004
    rows = np.concatenate([next(pieces), next(pieces)])
    assert rows[:, 0] - ROBOT.home[0] == pytest.approx([2e-4, 3e-4, 4e-4, 5e-4])


def test_a_stream_that_is_behind_its_stamps_goes_on_at_the_speed_that_they_say(served):
    """So the next late set-point is no stop: what is behind by up to 10 ms stays."""
    stream, steps, at = _Stream(ROBOT.home + 1e-4 * SHOULDER, 5.001), [], 1e-4
    pieces = SetpointFollower(served.arm, print)._pieces(stream, ROBOT.home, "servo_jp")
    next(pieces)
    for newest in range(8, 400, 2):  # [ms] after the first
        stream.goal, stream.t = ROBOT.home + newest * 1e-4 * SHOULDER, 5.0 + 1e-3 * newest
        rows = next(pieces)[:, 0] - ROBOT.home[0]
        steps += np.diff(rows, prepend=at).tolist()
        at = rows[-1]
    assert steps == pytest.approx([1e-4] * len(steps))
    stream.goal, stream.t = ROBOT.home + 0.05 * SHOULDER, 5.5  # after a tenth of a second
    rows = np.concatenate([next(pieces)[:, 0] - ROBOT.home[0] for _ in range(19)])
    assert np.diff(rows, prepend=at) == pytest.approx([(0.05 - at) / 38] * 38)  # within 40 ms


def test_reports_that_come_late_are_stamped_as_they_were_due(served, monkeypatch):
    """And where the arm's own clock has lost time, its stamps follow."""
    server, now = ArmServer(served.arm, served.ros, served.profile), 0.0
    monkeypatch.setattr(served.ros, "now", lambda: now)
    late = np.where(np.arange(2000) % 7 < 3, 0.02, 0.0)
    late[1000:] += 0.12
    stamps = []
    for t, lag in zip(1e-3 * np.arange(2000), late, strict=True):
        now = 500.0 + t + lag
        stamps.append(server._stamp(t) - t)
    stamps = np.array(stamps)
    assert stamps[3:1000] == pytest.approx(500.0)
    assert stamps[1500:] == pytest.approx(500.12)
    assert np.diff(stamps[3:]).min() > -1e-9  # no stamp goes back


def test_a_set_point_that_is_far_is_gone_to_at_top_speed_and_that_is_said(served, arm, caplog):
    steps = []
    served.arm.subscribe(lambda block: steps.append(block.setpoint[:, 0]))
    with caplog.at_level(logging.WARNING):
        served.say("servo_jp", position=(ROBOT.home + 0.1 * SHOULDER).tolist())
        served.say("state_command", STRING_STAMPED, string="go_home")  # which stops nothing
        at_rest(served, ROBOT.home + 0.1 * SHOULDER)
    most = np.abs(np.diff(np.concatenate(steps))).max()
    assert most == pytest.approx(ROBOT.joints[0].max_speed / served.arm.rate, rel=0.05)
    far, unknown = sorted(caplog.messages)
    assert far.startswith("/arm1/servo_jp: a set-point is further away than the joints can go")
    assert unknown.startswith("/arm1/state_command: state command 'go_home' refused: unknown")


def test_servo_and_move_pre_empt_each_other(served, arm):
    served.say("move_jp", position=(ROBOT.home + 0.3 * SHOULDER).tolist())
    served.ros.wait_for(STATE, lambda m: m.is_busy)
    goal = served.arm.setpoint_js(LONG).position + 0.02 * SHOULDER
    served.say("servo_jp", position=goal.tolist())
    at_rest(served, goal)
    with served.move() as busy:
        served.say("servo_jp", position=(goal + 0.3 * SHOULDER).tolist())
        served.say("move_jp", position=ROBOT.home.tolist())
        served.ros.wait_for(STATE, lambda m: any(busy))
        served.say("move_jp", position=(ROBOT.home + 0.01 * SHOULDER).tolist())
    served.ros.wait_for(
        "/arm1/setpoint_js", lambda m: np.allclose(m.position, ROBOT.home + 0.01 * SHOULDER)
    )


OFFERED = "a simulated arm does not offer it"
REFUSED = (
    ("servo_jp", [0.0] * 6, "want 7 values"),
    ("servo_jp", [np.nan, *ROBOT.home[1:]], "nan"),
    ("servo_jp", ROBOT.home + 100.0, "outside its range"),
    ("servo_jr", [100.0, *[0.0] * 6], "outside its range"),
    ("servo_jr", [0.0], "want 7 values"),
    ("servo_jv", [], "want 7 values"),
    ("move_jp", ROBOT.home + 100.0, "outside its range"),
    ("move_jr", [np.nan] * 7, "nan"),
    ("jaw/move_jp", [0.1, 0.1], "want the opening"),
    ("interpolate_jp", [np.inf] * 7, "inf"),
    *((name, [], f"{name} refused: {OFFERED}") for name in ("free", "servo_jf", "jaw/servo_jf")),
)


def test_commands_that_are_refused_change_nothing(served, arm, caplog):
    goal = ROBOT.home + 0.06 * SHOULDER
    with caplog.at_level(logging.WARNING), served.move() as busy:
        served.say("move_jp", position=goal.tolist())
        served.ros.wait_for(STATE, lambda m: any(busy))
        for name, values, _ in REFUSED:
            kind = "std_msgs/Empty" if name == "free" else JOINT_STATE
            for _ in range(3):  # a stream of them
                served.say(name, kind, position=list(values), velocity=list(values))
    assert served.arm.setpoint_js(LONG).position == pytest.approx(goal, abs=1e-9)
    for text, (name, _, why) in zip(caplog.messages, REFUSED, strict=True):
        assert text.startswith(f"/arm1/{name}: ")
        assert why in text
    assert arm.operating_state().state == "ENABLED"


@pytest.mark.parametrize("prefix", ["", "gold_"])
def test_a_set_point_whose_joints_stand_in_another_order_is_refused(served, arm, caplog, prefix):
    message = served.ros.stamped(JOINT_STATE, served.ros.now())
    message.position = (ROBOT.home + 1e-4 * SHOULDER).tolist()
    for order in (slice(None), slice(None, None, -1)):
        message.name = [prefix + name for name in JOINTS[order]]
        with caplog.at_level(logging.WARNING):
            served.ros.send("/arm1/servo_jp", message)
        assert len(caplog.messages) == (order.step is not None)
    assert "servo_jp refused: values go by their place, for shoulder, elbow" in caplog.text


def test_the_jaws_have_topics_of_their_own(served, arm):
    # As dvrk_python's psm asks (jhu-dvrk/dvrk_python:src/dvrk/psm.py): one position, the opening.
    jaws = ROBOT.index(ROBOT.grasper)
    there = ROBOT.home + 0.02 * (np.eye(7)[jaws[1]] - np.eye(7)[jaws[0]])  # the tool turned
    with served.move():
        served.say("move_jp", position=there.tolist())
    with served.move():
        served.say("jaw/move_jp", position=[1.5])
    opened = there + 0.5 * (1.5 - there[jaws].sum()) * np.isin(np.arange(7), jaws)
    assert served.arm.setpoint_js(LONG).position == pytest.approx(opened, abs=1e-9)
    for name in ("jaw/measured_js", "jaw/setpoint_js"):
        said = served.ros.wait_for(f"/arm1/{name}", lambda m: abs(m.position[0] - 1.5) < 1e-9)
        assert (list(said.name), len(said.position)) == (["jaw"], 1)
    served.say("jaw/servo_jp", position=[1.501])
    at_rest(served, opened + 0.0005 * np.isin(np.arange(7), jaws))


def test_a_twist_moves_the_tool(served, arm, caplog):
    def twist(**linear):
        message = served.ros.stamped("geometry_msgs/TwistStamped", served.ros.now())
        for axis, value in linear.items():
            setattr(message.twist.linear, axis, value)
        served.ros.send("/arm1/servo_cv", message)
        served.follow()

    before = cartesian.pose(ROBOT.kinematics, ROBOT.home)
    twist(x=0.02)
    moved = cartesian.pose(ROBOT.kinematics, served.arm.setpoint_js(LONG).position) - before
    assert moved[0, 3] == pytest.approx(0.02 / served.arm.rate, rel=0.01)
    assert np.abs(moved - moved[0, 3] * np.eye(4)[[0]].T @ np.eye(4)[[3]]).max() < 1e-8
    place = served.arm.setpoint_js(LONG).position
    straight = place - ROBOT.home
    twist(x=1e3)  # at the joints' top speed, in the same direction
    way = served.arm.setpoint_js(LONG).position - place
    assert 0.99 / served.arm.rate < np.max(np.abs(way) / TOP_SPEED) < 0.051
    assert way @ straight > 0.999 * np.linalg.norm(way) * np.linalg.norm(straight)
    with caplog.at_level(logging.WARNING):
        twist(x=np.nan)
    assert "servo_cv refused: twist [nan" in caplog.text


def test_a_set_point_that_was_sent_before_a_move_does_not_end_it(served, arm, caplog):
    late = served.ros.stamped("sensor_msgs/JointState", served.ros.now())
    late.position = (ROBOT.home + 0.3 * SHOULDER).tolist()
    goal = ROBOT.home + 0.02 * SHOULDER
    with caplog.at_level(logging.WARNING), served.move() as busy:
        served.say("move_jp", position=goal.tolist())
        served.ros.wait_for(STATE, lambda m: any(busy))
        served.ros.send("/arm1/servo_jp", late)
    assert "is older than another" in caplog.text
    assert served.arm.setpoint_js(LONG).position == pytest.approx(goal, abs=1e-9)


def test_set_points_of_the_past_are_passed_over(served, arm, caplog):
    message = served.say("servo_jp", position=(ROBOT.home + 1e-3 * SHOULDER).tolist())
    at_rest(served, ROBOT.home + 1e-3 * SHOULDER)
    for late in (1e-3, 5.0, -5.0):
        old = copy.deepcopy(message)
        old.header.stamp -= late
        old.position = (ROBOT.home + 2e-3 * SHOULDER).tolist()
        with caplog.at_level(logging.WARNING):
            served.ros.send("/arm1/servo_jp", old)
    assert "is older than another, or its stamp is off by more than 4 s" in caplog.text
    assert served.arm.setpoint_js(LONG).position == pytest.approx(ROBOT.home + 1e-3 * SHOULDER)
    # A stamp of the future shuts nobody out: the next one counts.
    served.say("servo_jp", position=(ROBOT.home + 3e-3 * SHOULDER).tolist())
    at_rest(served, ROBOT.home + 3e-3 * SHOULDER)


def ask(served, name, **request):
    response = SimpleNamespace(
        cp=copy.deepcopy(served.ros.message("geometry_msgs/PoseStamped").pose),
        jp=[], result=None, message="",
    )  # fmt: skip
    served.ros.services[f"/arm1/{name}"](SimpleNamespace(**request), response)
    return response


def test_kinematics_are_asked_as_services(served):
    there = ask(served, "forward_kinematics", jp=ROBOT.home.tolist())
    assert there.result
    assert matrix_of(SimpleNamespace(pose=there.cp)) == pytest.approx(
        cartesian.pose(ROBOT.kinematics, ROBOT.home)
    )
    back = ask(served, "inverse_kinematics", cp=there.cp, jp=ROBOT.home + 0.01 * SHOULDER)
    assert back.result
    again = ask(served, "local/forward_kinematics", jp=back.jp)
    assert matrix_of(SimpleNamespace(pose=again.cp)) == pytest.approx(
        matrix_of(SimpleNamespace(pose=there.cp)), abs=1e-8
    )
    few = ask(served, "forward_kinematics", jp=[0.0] * 3)
    assert (few.result, "forward_kinematics" in few.message) == (False, True)
    there.cp.position.z -= 9.0
    far = ask(served, "inverse_kinematics", cp=there.cp, jp=ROBOT.home)
    assert (far.result, far.jp) == (False, [])
    assert far.message
    there.cp.orientation.w = 3.0
    assert "is no turn" in ask(served, "inverse_kinematics", cp=there.cp, jp=ROBOT.home).message


def test_where_the_services_types_are_missing_one_line_says_so(monkeypatch, caplog):
    def serve(*_):
        raise RosError("ROS's messages crtk_msgs/QueryForwardKinematics are not installed")

    monkeypatch.setattr(LocalRos, "serve", serve)
    served = Served("raven2_mended")
    with caplog.at_level(logging.WARNING), served.arm, served.server:
        assert "/arm1/measured_js" in served.server.topics
    assert [r.getMessage().partition(":")[0] for r in caplog.records] == [
        "no kinematics as services"
    ]


def test_jacobians_are_published_row_by_row(served, arm):
    message = served.ros.wait_for("/arm1/jacobian", lambda m: True)
    rows = cartesian.jacobian(ROBOT.kinematics, ROBOT.home)
    assert [(d.label, d.size, d.stride) for d in message.layout.dim] == [
        ("rows", 6, 42),
        ("columns", 7, 7),
    ]
    assert np.reshape(message.data, (6, 7)) == pytest.approx(rows, abs=1e-6)
    assert served.ros.last["/arm1/trajectory_j/ratio"].data == 1.0
    assert served.ros.wait_for("/arm1/body/measured_cf", lambda m: True).header.stamp == 0.0


def test_velocities_hold_until_the_next_and_are_limited(served, arm):
    served.say("servo_jv", velocity=(1e3 * SHOULDER).tolist())
    most = ROBOT.joints[0].max_speed / served.arm.rate
    at_rest(served, ROBOT.home + most * SHOULDER)


def test_the_state_is_said_on_change_and_ten_times_a_second(served, arm):
    stamps = []
    end = served.ros.subscribe(STATE, "crtk_msgs/OperatingState", stamps.append)
    served.ros.wait_for(STATE, lambda m: len(stamps) > 5)
    end()
    times = np.array([m.header.stamp for m in stamps])
    assert np.diff(times).min() > 0.09


def test_the_end_of_a_stream_is_not_in_the_way_of_unhoming(served, arm):
    served.say("servo_jp", position=(ROBOT.home + 1e-4 * SHOULDER).tolist())
    served.say("state_command", "crtk_msgs/StringStamped", string="unhome")
    served.ros.wait_for(STATE, lambda m: not m.is_homed)


@pytest.fixture
def quirky(monkeypatch):
    # Nobody commands from the arm's own thread, which must not wait for itself.
    monkeypatch.setattr("truejoint.crtk.setpoint_follower._ENDING", LONG)
    made = Served("raven2")
    with made.arm, made.server:
        made.arm.enable()
        made.arm.home()
        yield made


def test_ravens_controller_sends_more_values_than_joints_or_one(quirky):
    # uw-biorobotics/raven2_CRTK_Python_controller:python_controller/raven_py_controller.py sends
    # fifteen; uw-biorobotics/raven2, branch crtk, takes seven or more, or one.
    sent = [1e-4, *[0.0] * 14], [1e-4], [1e-4, *[0.0] * 6, *[np.nan] * 8]
    for count, values in enumerate(sent, 1):
        quirky.say("servo_jr", position=list(values))
        quirky.follow()
        setpoint = quirky.arm.setpoint_js(LONG).position
        assert setpoint == pytest.approx(ROBOT.home + count * 1e-4 * SHOULDER, abs=1e-9)


def test_a_set_point_that_comes_as_a_stream_ends_is_not_lost(quirky, monkeypatch):
    ending, asked = threading.Event(), threading.Event()

    def flush(*_, **__):
        ending.set()
        assert asked.wait(LONG)
        return ""

    monkeypatch.setattr(quirky.arm._backend, "flush", flush)
    quirky.say("servo_jr", position=(1e-4 * SHOULDER).tolist())
    assert ending.wait(LONG)
    over = quirky.server._follower._stream.motion.over
    wait = over.wait
    monkeypatch.setattr(over, "wait", lambda timeout=None: asked.set() or wait(timeout))
    quirky.say("servo_jr", position=(1e-4 * SHOULDER).tolist())
    quirky.follow()
    setpoint = quirky.arm.setpoint_js(LONG).position
    assert setpoint == pytest.approx(ROBOT.home + 2e-4 * SHOULDER, abs=1e-9)


def test_each_key_of_ravens_controller_moves_its_joint(quirky):
    # A key is a burst of a hundred increments: 3 deg/s, 3 deg/s, 10 mm/s, else 10 deg/s, each for
    # 1 ms (python_controller/run_r2_keyboard_controller.py).
    speed, before = np.array([*np.deg2rad([3.0, 3.0]), 0.01, *np.deg2rad([10.0] * 4)]), ROBOT.home
    for joint, sign in itertools.product(range(7), (1.0, -1.0)):
        step = np.zeros(15)
        step[joint] = sign * speed[joint] * 1e-3
        for _ in range(100):
            quirky.say("servo_jr", position=step.tolist())
        quirky.follow()
        after = quirky.arm.setpoint_js(LONG).position
        np.testing.assert_allclose(after - before, 100 * step[:7], rtol=0, atol=1e-9)
        before = after


def test_of_an_increment_that_is_none_one_line_tells_and_nothing_moves(quirky, caplog):
    with caplog.at_level(logging.WARNING):
        for values in ([1e-4] * 6, [np.nan, *[0.0] * 14], []):
            quirky.say("servo_jr", position=list(values))
    # The first and the last are one line but for their numbers.
    assert ["servo_jr" in line for line in caplog.messages] == [True] * 2
    assert quirky.arm.setpoint_js(LONG).position == pytest.approx(ROBOT.home)
    assert quirky.arm.operating_state().state == "ENABLED"


def test_its_grasper_has_topics_of_its_own(quirky):
    # measured_js has the opening and the jaws: uw-biorobotics/raven2, branch crtk.
    end = quirky.ros.subscribe("/grasp1/measured_js", "sensor_msgs/JointState", lambda m: None)
    message = quirky.ros.stamped("sensor_msgs/JointState", quirky.ros.now())
    message.position = [0.02]
    quirky.ros.send("/grasp1/servo_jr", message)
    quirky.follow()
    opened = ROBOT.home + 0.01 * np.isin(JOINTS, ["jaw1", "jaw2"])
    assert quirky.arm.setpoint_js(LONG).position == pytest.approx(opened, abs=1e-9)
    said = quirky.ros.wait_for("/grasp1/measured_js", lambda m: True).position
    assert said[0] == pytest.approx(said[1] + said[2])
    end()


def test_with_its_quirks_it_publishes_as_ravens_software_does(quirky):
    kinds = quirky.ros.kinds
    assert kinds["/arm2/measured_js"] == "sensor_msgs/JointState"  # the left arm's
    assert kinds["/arm2/measured_cp"] == "geometry_msgs/TransformStamped"
    assert kinds["/arm1/operating_state"] == "crtk_msgs/operating_state"
    said = quirky.ros.wait_for("/arm2/measured_js", lambda m: True)
    assert said.name[0] == "green_shoulder"
    assert list(said.effort) == [0.0] * 7
    state = quirky.ros.wait_for("/ravenstate", lambda m: m.runlevel == 3)
    assert state.jpos[2] == pytest.approx(np.degrees(ROBOT.home[2]))  # metres, in "degrees"
    assert state.tau[0] == pytest.approx(0.1)
