"""Tests of truejoint.crtk.backends.ros against truejoint.crtk.server: both ends of the topics."""

import copy
import logging
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from tests.crtk.instant_twin import InstantTwin
from tests.local_ros import LocalRos

from truejoint.crtk import Arm, PacedBackend, StateBlock
from truejoint.crtk.backends import ros
from truejoint.crtk.backends.ros import RosBackend
from truejoint.crtk.server import ArmServer
from truejoint.errors import CommandRefused, MotionStopped, RobotError, RosError
from truejoint.robots import get_robot

ROBOT = get_robot("raven2")
JOINTS = ROBOT.joint_names
SHOULDER = np.eye(7)[0]
STATE = "/arm1/operating_state"
LONG = 60.0  # [s]


class Served:
    """An arm that is served on topics."""

    def __init__(self, profile):
        self.ros, self.profile = LocalRos(), profile
        self.twin = InstantTwin()
        self.arm = Arm(PacedBackend(self.twin))
        self.server = ArmServer(self.arm, self.ros, profile)

    def client(self, **options):
        return Arm(RosBackend(self.ros, ROBOT, self.profile), **options)

    def say(self, name, kind="sensor_msgs/JointState", **values):
        message = self.ros.stamped(kind, self.ros.now())
        for key, value in values.items():
            setattr(message, key, value)
        self.ros.send(f"/arm1/{name}", message)
        return message

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
def _patient(monkeypatch):
    """On a busy machine a thread that reports may be silent for long, above all if it compiles."""
    for name in ("SILENCE", "CONNECT_TIMEOUT"):
        monkeypatch.setattr(ros, name, LONG)
    monkeypatch.setattr("truejoint.crtk.arm.SILENCE", LONG)


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
    blocks, enough = [], threading.Event()

    def keep(block):
        if isinstance(block, StateBlock):
            blocks.append(block)
            if len(blocks) == 3:
                enough.set()

    arm.subscribe(keep)
    assert enough.wait(20.0)
    assert np.diff([block.t[0] for block in blocks]).min() > 0.0


def test_a_move_is_stopped_by_pausing_at_the_robot(served, arm):
    motion = arm.move_jp(ROBOT.home + SHOULDER * 0.5)
    served.say("state_command", "crtk_msgs/StringStamped", string="pause")
    with pytest.raises((MotionStopped, CommandRefused), match="PAUSED"):
        motion.wait()


def test_a_homing_is_stopped_by_whoever_pauses(served, monkeypatch):
    begun = threading.Event()

    def homing():
        begun.set()
        while True:  # until it is stopped
            yield served.twin.run(ROBOT.home[None])

    monkeypatch.setattr(served.twin, "homing", homing)
    with served.client() as arm:
        arm.enable()
        failed = []

        def home():
            try:
                arm.home()
            except MotionStopped as stopped:
                failed.append(str(stopped))

        thread = threading.Thread(target=home)
        thread.start()
        assert begun.wait(20.0)
        arm.pause()
        thread.join(20.0)
    assert "PAUSED; the arm is not homed" in failed[0]


def test_one_who_looks_on_moves_nothing_and_leaves_the_arm_as_it_is(served, arm):
    with served.client(controls=False) as onlooker:
        assert onlooker.measured_js(LONG).position == pytest.approx(ROBOT.home)
        for command in (onlooker.pause, onlooker.hold, lambda: onlooker.move_jp(ROBOT.home)):
            with pytest.raises(CommandRefused, match="looks on"):
                command()
    assert arm.operating_state().state == "ENABLED"


def test_an_arm_that_is_not_there_is_refused_with_those_that_are(served, monkeypatch):
    monkeypatch.setattr(ros, "CONNECT_TIMEOUT", 0.02)
    backend = RosBackend(served.ros, ROBOT, "crtk", namespace="/PSM1")
    with pytest.raises(RosError, match=r"/PSM1/operating_state .* arms report under /arm1"):
        Arm(backend)
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
        onlooker.subscribe(fail)
        assert said.wait(20.0)
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
    monkeypatch.setattr(backend._stream, "_receive", lambda *_: None)
    for _ in range(2):  # and it may be tried again
        monkeypatch.setattr(ros, "CONNECT_TIMEOUT", LONG)
        with pytest.raises(RosError, match="no message on /arm1/measured_js"):
            Arm(backend)
    assert sum(map(len, served.ros.readers.values())) == before


@pytest.mark.parametrize(
    ("name", "field"),
    [("servo_jp", "position"), ("servo_jr", "position"), ("servo_jv", "velocity")],
)
def test_the_server_refuses_what_an_arm_refuses_and_says_so(served, arm, caplog, name, field):
    before = served.arm.setpoint_js(LONG).position
    with caplog.at_level(logging.WARNING):
        served.say(name, **{field: (ROBOT.home + 100.0).tolist()})
        served.say(name, **{field: [0.0]})
    texts = [record.getMessage() for record in caplog.records]
    assert any("is outside its range" in text or "would step" in text for text in texts)
    assert any("7 values" in text for text in texts)
    assert served.arm.setpoint_js(LONG).position == pytest.approx(before)
    assert arm.operating_state().state == "ENABLED"


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


def test_with_its_quirks_it_publishes_as_ravens_software_does():
    served = Served("raven2")
    with served.arm, served.server:
        assert served.ros.kinds["/arm2/measured_js"] == "sensor_msgs/JointState"  # the left arm's
        assert served.ros.kinds["/arm2/measured_cp"] == "geometry_msgs/TransformStamped"
        assert "/arm1/operating_state" in served.ros.kinds
        served.arm.enable()
        served.arm.home()
        said = served.ros.wait_for("/arm2/measured_js", lambda m: True)
        assert said.name[0] == "green_shoulder"
        assert list(said.effort) == [0.0] * 7
        state = served.ros.wait_for("/ravenstate", lambda m: m.runlevel == 3)
        assert state.jpos[2] == pytest.approx(np.degrees(ROBOT.home[2]))  # metres, in "degrees"
        assert state.tau[0] == pytest.approx(0.1)
