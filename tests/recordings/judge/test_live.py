"""The doctor of a live link says what it says of a bag of the same messages, and of the link."""

import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.local_ros import LocalRos
from tests.recordings.judge.faults import by_heading, changed, of_quantity, stuck
from tests.recordings.refusals import refused
from tests.recordings.said import PROFILE, START, STATE, SaidRos, told_session

from truejoint.crtk.messages import (
    JOINT_STATE,
    OPERATING_STATE,
    RAVEN_STATE,
    RAVEN_TOPIC,
    TRUTH_TOPIC,
    raven_state_fields,
)
from truejoint.recordings import DataCheck, Finding, Recording, diagnose, read_bag, write_bag
from truejoint.recordings.judge import live
from truejoint.recordings.judge.live import LiveLink

pytest.importorskip("rosbags", reason="rosbags is not installed (truejoint[ros])")


@pytest.fixture(scope="module")
def session() -> Recording:
    return told_session()


def link_to(ros: SaidRos) -> LiveLink:
    return LiveLink(ros, "raven2", profile=PROFILE.name, state=STATE)


def judged(ros: SaidRos, recording: Recording, **how: Any) -> DataCheck:
    with link_to(ros) as link:
        ros.say_all(recording, **how)
    return link.diagnose()


def spoilt(session: Recording) -> Recording:
    """A session without efforts, whose truth stands still, and of which messages were lost."""
    ill = changed(of_quantity(session, "effort", np.zeros_like), truth__elbow=stuck(300, 700))
    return ill.rows(np.r_[:400, 440:900])


def test_it_says_what_the_doctor_says_of_a_bag(session, tmp_path):
    recording = spoilt(session)
    live = judged(SaidRos(), recording)
    write_bag(recording, tmp_path / "a.bag", profile=PROFILE.name)
    bag = read_bag(tmp_path / "a.bag", "raven2", profile=PROFILE.name, state=STATE)
    link, *verdicts = live.by_heading()
    assert link == Finding("good", "link", link.what, "")
    assert re.search(STATE + r" 2\d\.\d* Hz, here 0 ms after its stamp", link.text)
    found = diagnose(bag)
    assert [(v.level, v.name) for v in verdicts] == [(v.level, v.name) for v in found.by_heading()]
    for name, level in {"effort": "fail", "frozen signal": "fail", "lost messages": "warn"}.items():
        heard, read = by_heading(live)[name], by_heading(found)[name]
        assert heard.level == level
        assert heard.text.replace("in live", "in a.bag") == read.text


def test_a_homing_amid_the_rows_and_stamps_that_repeat_or_are_none_are_told(session):
    ros = SaidRos()
    ros.publisher("/arm1/operating_state", OPERATING_STATE)
    with link_to(ros) as link:
        for after, is_homed in ((-1.0, True), (10.0, False), (12.0, True)):
            message = ros.stamped(OPERATING_STATE, START + after)
            message.is_homed = is_homed
            ros.send("/arm1/operating_state", message)
        ros.say_all(session)
        message = ros.last[STATE]
        for _ in range(20):
            ros.send(STATE, message)
        message.header.stamp = 0.0
        ros.send(STATE, message)
    amid = int(((session.t >= 10.0) & (session.t < 12.0)).sum())
    assert len(link.recordings()[0]) == len(session) - amid
    told = by_heading(link.diagnose())
    assert told["homing"].level == told["stamps"].level == "fail"
    assert told["homing"].text.startswith(f"{amid} rows of homing, after 10.0 s")
    assert "20 times state: repeated time stamp" in told["stamps"].text
    assert f"1 times {STATE}: stamp of 0" in told["stamps"].text


def test_an_arm_that_never_says_that_it_is_homed_is_taken_as_it_is(session):
    ros = SaidRos()
    ros.publisher("/arm1/operating_state", OPERATING_STATE)
    with link_to(ros) as link:
        ros.send("/arm1/operating_state", ros.stamped(OPERATING_STATE, START))
        ros.say_all(session)
    assert len(link.recordings()[0]) == len(session)


def test_a_topic_that_stops_is_named(session):
    verdict = judged(SaidRos(), session, until={TRUTH_TOPIC: 20.0}).by_heading()[0]
    assert verdict.level == "fail"
    silent = session.t[-1] - session.t[session.t <= 20.0][-1]
    assert f"{TRUTH_TOPIC} stopped {silent:.1f} s before the end" in verdict.text
    assert "network" in verdict.advice


def test_stamps_of_another_clock_are_told(session):
    ros = SaidRos()
    ros.late = 2.5
    verdict = judged(ros, session).by_heading()[0]
    assert verdict.level == "warn"
    assert "here 2.5e+03 ms after its stamp" in verdict.text
    assert "clocks" in verdict.advice


def test_ravens_own_state_is_judged_with_both_arms(session):
    ros = SaidRos()
    ros.publisher(RAVEN_TOPIC, RAVEN_STATE)
    columns = {str(name): c.to_numpy() for name, c in session.table.items() if name != "t"}
    fields = raven_state_fields(session.robot, columns)
    with LiveLink(ros) as link:  # the robot is told by its state
        for row, t in enumerate(session.t.tolist()):
            message = ros.stamped(RAVEN_STATE, START + t)
            message.runlevel = 3
            for name, values in fields.items():
                setattr(message, name, values[row])
            ros.send(RAVEN_TOPIC, message)
        ros.say_all(session)
    found, other = link.recordings()
    assert found.robot.arm == "left"
    assert other is not None
    assert other.robot.arm == "right"
    assert not other.column("measured/elbow").any()
    np.testing.assert_allclose(
        found.column("measured/elbow"), session.column("measured/elbow"), rtol=1e-6
    )
    assert by_heading(link.diagnose())["arm"].level == "good"


def test_what_cannot_be_judged_is_one_line(session):
    refused("nobody says anything of joints; start the robot", LiveLink(LocalRos()).__enter__)
    ros = SaidRos()
    refused(r"live: which robot is it .* there are /arm1/measured", LiveLink(ros).__enter__)
    with LiveLink(ros, "raven2", profile=PROFILE.name) as link:
        pass
    refused(f"{STATE}: nothing came on it: is the robot homed", link.diagnose)
    with link:
        ros.send(STATE, ros.stamped(JOINT_STATE, 0.0))
    refused("mean nothing: is the robot homed", link.diagnose)
    ros.publisher(RAVEN_TOPIC, RAVEN_STATE)
    with link:
        ros.say_all(session)
        message = ros.stamped(RAVEN_STATE, START + 100.0)
        del message.tau
        ros.send(RAVEN_TOPIC, message)
    with LiveLink(ros, "raven2", state=RAVEN_TOPIC) as link:
        ros.send(RAVEN_TOPIC, message)
    refused("version of raven_2/raven_state has no field 'tau'", link.diagnose)
    refused("no topic '/x'; there are", LiveLink(ros, "raven2", truth="/x").__enter__)


def test_of_a_long_listening_the_latest_messages_count(monkeypatch):
    monkeypatch.setattr(live, "KEPT", 300)
    heard = live.Heard("/joint_states", JOINT_STATE)
    message = SimpleNamespace(name=["jaw"], position=[0.1], velocity=[], effort=[])
    for t in range(1, 1001):
        heard.take(float(t), float(t), message)
    assert heard.times[[0, -1], 0].tolist() == [701.0, 1000.0]
    ((_, _, stamps, fields, _),) = heard.lots()
    assert len(stamps) == len(fields["position"]) == 300
