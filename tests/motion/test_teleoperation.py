"""Tests of truejoint.motion.teleoperation: keys in, velocities out."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from truejoint.motion import Jog
from truejoint.motion.teleoperation import (
    HELD,
    SPEEDS,
    TOOL_SPEED,
    Teleoperation,
    key_events,
    key_map,
)
from truejoint.robots import get_robot


class HeardJog(Jog):
    """Keeps the twist that it was told last."""

    def tool(self, twist):
        self.twist = twist
        super().tool(twist)


@pytest.fixture
def keys(lagging_arm):
    return Teleoperation(HeardJog(lagging_arm))


def velocity(keys):
    return keys.jog._wanted(keys.jog.arm.robot.home)


@pytest.mark.parametrize(
    ("text", "events"),
    [
        ("12", [("1", "press"), ("2", "press")]),
        ("\x1b[49u", [("1", "press")]),
        ("\x1b[49;1:2u\x1b[49;1:3u", [("1", "repeat"), ("1", "release")]),
        ("\x1b[A\x1bOPq\x1b[?11u", [("q", "press")]),
        ("\x1b", [("\x1b", "press")]),
        ("", []),
    ],
)
def test_what_terminals_report(text, events):
    assert list(key_events(text)) == events


@given(st.text(max_size=40))
def test_any_text_gives_events_of_single_characters(text):
    for name, event in key_events(text):
        assert len(name) == 1
        assert event in ("press", "repeat", "release")


def test_every_joint_has_two_keys_and_no_key_two_meanings():
    for name in ("raven2", "dvrk_psm", "forceps", "kuka_kr300"):
        robot = get_robot(name)
        keys = key_map(robot)
        joints = [key for key in keys.values() if key.joints]
        for k, joint in enumerate(robot.joint_names[:8]):
            up = next(key for key in joints if key.action == f"{joint} +")
            down = next(key for key in joints if key.action == f"{joint} -")
            assert np.array_equal(up.joints, np.eye(len(robot.joints))[k])
            assert np.array_equal(down.joints, -np.array(up.joints))
        assert not set("9 +-=") & set(keys)


def test_a_key_moves_while_it_is_reported(keys):
    keys.tell("1", "press", 0.0)
    assert velocity(keys) == pytest.approx(np.eye(7)[0] * SPEEDS[1] * keys.jog.speed)
    keys.pass_time(HELD - 0.01)
    keys.tell("1", "press", HELD - 0.01)  # repeated by the terminal
    keys.pass_time(1.5 * HELD)
    assert velocity(keys)[0] > 0.0
    keys.pass_time(2.0 * HELD)
    assert not velocity(keys).any()


def test_where_the_terminal_tells_a_key_moves_until_it_is_let_go_of(keys):
    keys.tell("w", "press", 0.0)
    keys.pass_time(60.0, tells_release=True)
    assert velocity(keys)[1] < 0.0
    keys.tell("w", "release", 60.0)
    assert not velocity(keys).any()


def test_keys_add_up_and_the_kind_pressed_last_counts(keys):
    for name in "13p":
        keys.tell(name, "press", 0.0)
    share = SPEEDS[1] * keys.jog.speed
    assert velocity(keys) == pytest.approx(share * np.array([1, 0, 1, 0, 0, -1, -1]))
    keys.tell("d", "press", 0.1)
    assert keys.jog.twist == pytest.approx(-np.eye(6)[0] * SPEEDS[1] * TOOL_SPEED)
    keys.tell("d", "release", 0.1)
    assert velocity(keys) == pytest.approx(share * np.array([1, 0, 1, 0, 0, -1, -1]))
    keys.tell(" ", "press", 0.1)
    assert keys.held == ()
    assert not velocity(keys).any()


def test_speed_steps_and_leaving(keys):
    for _ in range(10):
        keys.tell("+", "press", 0.0)
    assert keys.share == 1.0
    for _ in range(10):
        keys.tell("-", "press", 0.0)
    assert keys.share == SPEEDS[0]
    keys.tell("1", "press", 0.0)
    keys.tell("?", "press", 0.0)
    assert keys.held == ("shoulder +",)
    keys.tell("9", "press", 0.0)
    assert keys.is_over
    assert not velocity(keys).any()
