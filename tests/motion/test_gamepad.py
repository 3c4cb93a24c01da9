"""Tests of a gamepad, without one: through SDL's queue of events."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from truejoint.errors import CommandRefused
from truejoint.motion import teleoperation as gamepad
from truejoint.motion.teleoperation import TOOL_SPEED, Gamepad, Teleoperation
from truejoint.robots import get_robot


class FakeJog:
    """What a jog is told."""

    def __init__(self, robot):
        self.arm = type("FakeArm", (), {"robot": get_robot(robot)})
        self.speed = np.full(len(self.arm.robot.joints), 0.1)
        self.told = None

    def joints(self, velocity):
        self.told = "joints", velocity.tolist()

    def tool(self, twist):
        self.told = "tool", twist.tolist()

    def stop(self):
        self.told = "stop"


def pad(robot="raven2"):
    operator = Teleoperation(FakeJog(robot), step=3)
    return Gamepad(operator), operator.jog


def test_sticks_move_the_tool_in_proportion_and_rest_in_the_dead_zone():
    one, jog = pad()
    one.tell("axis", gamepad.LEFT_Y, -1.0, 0.0)
    assert jog.told == ("tool", [0.0, TOOL_SPEED[1], 0.0, 0.0, 0.0, 0.0])
    half = 0.5 * (1 - gamepad.DEAD_ZONE) + gamepad.DEAD_ZONE
    one.tell("axis", gamepad.LEFT_Y, -half, 0.1)
    assert jog.told[1][1] == pytest.approx(0.5 * TOOL_SPEED[1])
    for value in (-0.1, 0.1, float("nan")):
        one.tell("axis", gamepad.LEFT_Y, value, 0.2)
        assert jog.told == "stop"


def test_triggers_rest_at_minus_one_and_shut_and_open():
    one, jog = pad()
    one.tell("axis", gamepad.RIGHT_TRIGGER, -1.0, 0.0)
    assert jog.told == "stop"
    one.tell("axis", gamepad.RIGHT_TRIGGER, 1.0, 0.0)
    assert jog.told == ("joints", [0.0] * 5 + [0.1, 0.1])
    one.tell("axis", gamepad.LEFT_TRIGGER, 1.0, 0.0)
    assert jog.told == "stop"


def test_buttons_change_the_speed_stop_and_leave():
    one, jog = pad()
    one.tell("axis", gamepad.RIGHT_Y, 1.0, 0.0)
    one.tell("button", 4, 1.0, 0.1)
    one.tell("button", 4, 0.0, 0.2)
    assert jog.told[1][2] == pytest.approx(-0.5 * TOOL_SPEED[2])
    one.tell("button", 0, 1.0, 0.3)
    assert jog.told == "stop"
    assert not one.operator.is_over
    one.tell("axis", gamepad.RIGHT_Y, 0.99, 0.3)  # still held
    assert jog.told == "stop"
    one.tell("axis", gamepad.RIGHT_Y, 0.0, 0.3)
    one.tell("axis", gamepad.RIGHT_Y, 1.0, 0.3)
    assert jog.told[0] == "tool"
    one.tell("button", 30, 1.0, 0.4)
    one.tell("axis", 9, 1.0, 0.4)
    one.tell("button", 1, 1.0, 0.5)
    assert one.operator.is_over


def test_a_robot_without_kinematics_is_moved_joint_by_joint():
    one, jog = pad("forceps")
    one.tell("axis", gamepad.LEFT_X, -1.0, 0.0)
    assert jog.told == ("joints", [-0.1])


def test_events_come_through_the_queue_and_a_pad_that_goes_leaves(monkeypatch):
    pygame = pytest.importorskip("pygame")
    one, jog = pad()
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    if pygame.joystick.get_init():
        pygame.quit()
    with pytest.raises(CommandRefused, match="no gamepad is there"), one:
        pass
    monkeypatch.setattr(pygame.joystick, "get_count", lambda: 1)
    monkeypatch.setattr(
        pygame.joystick, "Joystick", lambda _: SimpleNamespace(get_instance_id=lambda: 7)
    )
    with one:
        pygame.event.post(pygame.event.Event(pygame.JOYAXISMOTION, axis=0, value=1.0))
        one.update(0.0)
        assert jog.told == ("tool", [TOOL_SPEED[0], 0.0, 0.0, 0.0, 0.0, 0.0])
        pygame.event.post(pygame.event.Event(pygame.JOYDEVICEREMOVED, instance_id=3))
        one.update(0.1)
        assert not one.operator.is_over  # another one
        assert not one.is_gone
        pygame.event.post(pygame.event.Event(pygame.JOYDEVICEREMOVED, instance_id=7))
        one.update(0.1)
    assert jog.told == "stop"
    assert one.operator.is_over
    assert one.is_gone
