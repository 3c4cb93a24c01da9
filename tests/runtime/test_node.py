"""Tests of truejoint.runtime.node: a corrector between topics."""

import threading
from dataclasses import replace

import numpy as np
import pytest
from tests.local_ros import LocalRos
from tests.synthetic import build_recording

import truejoint
from truejoint.errors import RosError
from truejoint.robots import get_robot
from truejoint.runtime import Corrector, Status
from truejoint.runtime.node import CorrectorNode

ROBOT = get_robot("raven2")
OUT = "/arm1/corrected/measured_js"


@pytest.fixture(scope="module")
def recording():
    return build_recording(900)


@pytest.fixture(scope="module")
def model(recording):
    return truejoint.calibrate(recording, "linear")


class Line:
    """A node, what it puts out, and what it says."""

    def __init__(self, model, profile="raven2_mended", on_fault="hold", **options):
        self.ros, self.said, self.out = LocalRos(), [], []
        self.node = CorrectorNode(
            self.ros,
            [Corrector(model, on_fault=on_fault)],
            ROBOT,
            profile,
            say=self.said.append,
            **options,
        )
        self.ros.subscribe(OUT, "sensor_msgs/JointState", self.out.append)
        self.ros.awaited.add("/arm1/corrected/half_width")

    def home(self, is_homed=True):
        state = self.ros.stamped("crtk_msgs/OperatingState", 1.0)
        state.is_homed = is_homed
        self.ros.send("/arm1/operating_state", state)

    def feed(self, recording, rows):
        columns = {q: recording.columns(q, ROBOT.joint_names) for q in ("measured", "effort")}
        for row in rows:
            message = self.ros.stamped("sensor_msgs/JointState", float(recording.t[row]))
            message.name = [f"gold_{name}" for name in ROBOT.joint_names]
            message.position = tuple(columns["measured"][row].tolist())
            effort = ROBOT.transmission.joint_effort(columns["effort"][row])
            message.effort = tuple(effort.tolist())
            self.ros.send("/arm1/measured_js", message)


def test_it_puts_out_what_the_corrector_says_with_the_stamps_that_came(model, recording):
    line = Line(model, homing_id="h1")
    with line.node:
        line.home()
        line.feed(recording, range(len(recording)))
    corrector = Corrector(model)
    corrector.set_homing(True, "h1")
    trace = corrector.run(recording)
    assert [m.header.stamp for m in line.out] == recording.t.tolist()
    position = np.array([m.position for m in line.out])
    joints = [ROBOT.joint_names.index(name) for name in corrector.joints]
    assert position[:, joints] == pytest.approx(trace.position, abs=1e-9)
    others = [k for k in range(7) if k not in joints]
    measured = recording.columns("measured", ROBOT.joint_names)
    np.testing.assert_array_equal(position[:, others], measured[:, others])
    assert line.node.corrected == (trace.status == 0).sum() > 500
    width = line.ros.last["/arm1/corrected/half_width"]
    assert width.position == pytest.approx(trace.half_width[-1])
    assert line.ros.last["/arm1/corrected/status"].string == Status(int(trace.status[-1])).name


def test_a_robot_that_returns_has_another_thread_and_its_correction_goes_on(model, recording):
    lines = Line(model, homing_id="h1"), Line(model, homing_id="h1")
    for line, is_another in zip(lines, (False, True), strict=True):
        with line.node:
            line.home()
            line.feed(recording, range(5))
            rest = threading.Thread(target=line.feed, args=(recording, range(5, 20)))
            if is_another:  # while the first one lives on
                rest.start()
                rest.join()
            else:
                rest.run()
        assert line.node.corrected == 20
    assert [m.position for m in lines[1].out] == [m.position for m in lines[0].out]


def test_nothing_is_corrected_until_the_robot_is_homed_nor_after_another_homing(model, recording):
    line = Line(model)
    with line.node:
        line.feed(recording, range(5))
        line.home()
        line.feed(recording, range(5, 10))
        line.home(False)
        line.home(True)
        line.feed(recording, range(10, 15))
        line.node.run(0.0)
    assert line.node.corrected == 5
    assert line.ros.last["/arm1/corrected/status"].string == "HOMED_AGAIN"
    measured = recording.columns("measured", ROBOT.joint_names)
    assert line.out[0].position == measured[0].tolist()
    held = np.array(line.out[9].position) - measured[9]
    assert np.abs(held).max() > 1e-3
    np.testing.assert_allclose(line.out[-1].position, measured[14] + held, rtol=0, atol=1e-12)


def test_a_silent_one_publishes_no_position_in_doubt(model, recording):
    line = Line(model, on_fault="silent")
    with line.node:
        line.feed(recording, range(5))
        line.home()
        line.feed(recording, range(5, 8))
    assert len(line.out) == 3
    assert line.ros.last["/arm1/corrected/status"].string == "OK"


def test_its_status_alone_tells_that_the_robot_is_silent(model, recording):
    line = Line(model)
    with line.node:
        line.home()
        line.feed(recording, range(3))
        heard = line.node._heard
        line.node._watch(heard + 0.35)
        assert line.ros.last["/arm1/corrected/status"].string == "OK"
        line.node._watch(heard + 0.45)
        assert line.ros.last["/arm1/corrected/status"].string == "SILENT"
        line.feed(recording, [3])
        assert line.ros.last["/arm1/corrected/status"].string == "OK"


def test_it_says_what_it_waits_for_what_is_lacking_and_when_a_topic_stops(
    model, recording, monkeypatch
):
    line = Line(model)
    report = line.node._report
    with line.node:
        report()
        line.feed(recording, [0])
        report()
        line.home()
        line.feed(recording, [1, 2])
        report()
        monkeypatch.setattr("truejoint.runtime.node.SILENCE", -1.0)
        report()
        short = line.ros.stamped("sensor_msgs/JointState", 50.0)
        short.position = [0.0]
        line.ros.send("/arm1/measured_js", short)
        report()
        level = line.ros.last["/diagnostics"].status[0].level
    told = "waiting for /arm1/measured_js, which nobody writes: no arm reports: start the node"
    assert told in line.said[0]
    assert "waiting for /arm1/operating_state" in line.said[1]
    assert line.said[2] == "correcting /arm1/measured_js"
    assert "is silent" in line.said[3]
    assert "/arm1/measured_js: 1 positions without names" in line.said[4]
    assert level == 2


def test_motion_unlike_the_trainings_is_said_and_corrected_all_the_same(model, recording):
    slow = replace(recording, table=recording.table.assign(t=3.0 * recording.t))
    line = Line(model, homing_id="h1")
    with line.node:
        line.home()
        line.feed(slow, range(len(slow)))
        line.node._report()
        diagnostics = line.ros.last["/diagnostics"].status[0]
    assert "the arm moves slower than in training" in line.said[-1]
    assert line.said[-1].startswith("correcting /arm1/measured_js, but")
    assert diagnostics.level == 1
    assert line.node.corrected > 800


def test_a_model_whose_signals_no_topic_has_is_refused_by_name(recording):
    model = truejoint.calibrate(build_recording(600), "linear", features=["effort/elbow"])
    line = Line(model)
    with line.node:
        line.home()
        message = line.ros.stamped("sensor_msgs/JointState", 1.0)
        message.position = ROBOT.home.tolist()
        line.ros.send("/arm1/measured_js", message)
        line.node._report()
    assert "/arm1/measured_js has no effort/elbow" in line.said[-1]
    assert not line.out


def test_a_message_that_lacks_a_signal_is_named_and_not_corrected(model, recording):
    line = Line(model, homing_id="h1")
    with line.node:
        line.home()
        line.feed(recording, range(3))
        message = line.ros.stamped("sensor_msgs/JointState", float(recording.t[3]))
        message.name, message.position = [f"gold_{ROBOT.joint_names[-1]}"], [0.1]
        line.ros.send("/arm1/measured_js", message)
        line.node._report()
    assert "/arm1/measured_js has no " in line.said[-1]
    assert len(line.out) == 3


def test_topics_are_given_up_where_one_cannot_be_made(model, monkeypatch):
    line = Line(model)
    make = line.ros.publisher

    def publisher(topic, kind, *, latched=False):
        if topic == "/diagnostics":
            raise RosError("not installed")
        return make(topic, kind, latched=latched)

    monkeypatch.setattr(line.ros, "publisher", publisher)
    with pytest.raises(RosError), line.node:
        pass
    assert not line.ros.kinds


def test_of_ravens_state_it_makes_a_joint_state(model, recording):
    line = Line(model, "raven2", homing_id="h1")
    with line.node:
        line.home()
        state = line.ros.stamped("raven_2/raven_state", 7.0)
        state.jpos = np.degrees([*recording.columns("measured", ROBOT.channels)[5], *[0.0] * 8])
        line.ros.send("/ravenstate", state)
    assert line.out[0].name == list(ROBOT.joint_names)
    assert line.out[0].header.stamp == 7.0
