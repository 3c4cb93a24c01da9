"""A gamepad that moves an arm: sticks for the tool, triggers for the grasper."""

from __future__ import annotations

import math
import os
from typing import Any, Final, Literal, Self

import numpy as np

from truejoint.errors import CommandRefused
from truejoint.extras import require
from truejoint.motion.teleoperation import FASTER, HOLD, LEAVE, SLOWER, Teleoperation

DEAD_ZONE: Final = 0.15
"""Share of its way that a stick may be off its middle at rest."""

# Numbers of axes and buttons as SDL 2 has them for the pads that Linux calls Xbox.
LEFT_X, LEFT_Y, LEFT_TRIGGER, RIGHT_X, RIGHT_Y, RIGHT_TRIGGER = range(6)
_TWIST: Final = ((LEFT_X, 0, 1.0), (LEFT_Y, 1, -1.0), (RIGHT_Y, 2, -1.0), (RIGHT_X, 5, 1.0))
_JOINTS: Final = ((LEFT_X, 1.0), (LEFT_Y, -1.0), (RIGHT_X, 1.0), (RIGHT_Y, -1.0))
_KEYS: Final = {0: HOLD, 1: LEAVE, 4: SLOWER, 5: FASTER, 7: LEAVE}


class Gamepad:
    """The first gamepad of this computer, from entering to leaving.

    The left stick moves the tool along x and y, the right one along z and about it, the triggers
    shut and open the grasper, the shoulder buttons change the speed, A stops until all are let go
    of, B and Start leave.
    Of a robot whose kinematics are not known, the sticks move its first four joints.

    Parameters
    ----------
    operator : Teleoperation
        What is told.

    Attributes
    ----------
    is_gone : bool
        Whether it was unplugged, which stops the arm and leaves.

    Raises
    ------
    TruejointError
        If pygame is not installed.
    CommandRefused
        On entering, if no gamepad is there.

    Examples
    --------
    >>> from truejoint.motion.gamepad import Gamepad
    >>> pad = Gamepad(truejoint.motion.teleoperation.Teleoperation(truejoint.motion.Jog(arm)))
    >>> pad.tell("axis", 0, 1.0, 0.0)
    """

    def __init__(self, operator: Teleoperation) -> None:
        self.operator: Final = operator
        self._axes = np.zeros(6)
        self._is_stopped = False  # until sticks and triggers are at rest
        self._pygame: Any = None
        self.is_gone = False

    def __enter__(self) -> Self:
        os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
        pygame = require("pygame", "gamepad", "a gamepad")
        # Events come through a window's queue: one that nobody sees.
        os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
        os.environ.setdefault("SDL_JOYSTICK_ALLOW_BACKGROUND_EVENTS", "1")
        pygame.display.init()
        pygame.joystick.init()
        if pygame.joystick.get_count() == 0:
            pygame.quit()
            raise CommandRefused("no gamepad is there; connect one, or leave --gamepad out")
        self._pad = pygame.joystick.Joystick(0)
        self._pad_id = self._pad.get_instance_id()
        self._pygame = pygame
        return self

    def __exit__(self, *_: object) -> None:
        self._pygame.quit()

    def update(self, now: float) -> None:
        """Tell what has changed since the last time, at `now` [s]; a pad that is gone leaves."""
        pygame = self._pygame
        for event in pygame.event.get():
            if event.type == pygame.JOYAXISMOTION:
                self.tell("axis", event.axis, float(event.value), now)
            elif event.type in (pygame.JOYBUTTONDOWN, pygame.JOYBUTTONUP):
                self.tell("button", event.button, event.type == pygame.JOYBUTTONDOWN, now)
            elif event.type == pygame.JOYDEVICEREMOVED and event.instance_id == self._pad_id:
                self.is_gone = True
                self.tell("button", 1, 1.0, now)  # as if it had been told to leave

    def tell(self, kind: Literal["axis", "button"], number: int, value: float, now: float) -> None:
        """Take in a change at `now` [s]: an axis [-1, 1], or a button (1 down, 0 up).

        One without a meaning does nothing.
        """
        if kind == "button":
            if value and number in _KEYS:
                self._is_stopped |= _KEYS[number] == HOLD
                self.operator.tell(_KEYS[number], "press", now)
        elif number < len(self._axes) and math.isfinite(value):
            rests = number in (LEFT_TRIGGER, RIGHT_TRIGGER)  # at -1
            self._axes[number] = (value + 1.0) / 2.0 if rests else value
            self._push()

    def _push(self) -> None:
        axes = np.clip(self._axes, -1.0, 1.0)
        axes = np.sign(axes) * np.maximum(np.abs(axes) - DEAD_ZONE, 0.0) / (1.0 - DEAD_ZONE)
        self._is_stopped &= bool(axes.any())
        if self._is_stopped:  # a stick that is held trembles
            return
        robot = self.operator.jog.arm.robot
        joints, twist = np.zeros(len(robot.joints)), np.zeros(6)
        if robot.grasper:
            joints[robot.index(robot.grasper)] = axes[RIGHT_TRIGGER] - axes[LEFT_TRIGGER]
        if robot.kinematics is None:
            for k, (axis, sign) in enumerate(_JOINTS[: len(joints)]):
                joints[k] += sign * axes[axis]
        else:
            for axis, k, sign in _TWIST:
                twist[k] = sign * axes[axis]
        self.operator.push(joints, twist)
