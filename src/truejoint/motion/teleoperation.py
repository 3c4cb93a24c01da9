"""Keys and a gamepad that move an arm: how pressing and letting go becomes a velocity."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal, Self

import numpy as np

from truejoint.array_types import Array
from truejoint.errors import CommandRefused
from truejoint.extras import require
from truejoint.motion.jog import Jog
from truejoint.robots import Robot

HELD: Final = 0.2
"""A key that a terminal reports is taken to be held for so long [s]; it says nothing of letting
go, but repeats a held key within a fraction of this."""
SPEEDS: Final = (0.1, 0.25, 0.5, 1.0)
"""Shares of the speed caps to step through."""

Event = Literal["press", "repeat", "release"]
_TYPED: Final = re.compile(
    r"\x1b\[(?P<code>\d+)(?::\d*)*(?:;\d*(?::(?P<event>\d))?)?u"
    r"|(?P<other>\x1b[\[O][0-?]*[ -/]*[@-~]?)|.",
    re.DOTALL,
)
_KITTY_EVENTS: Final[Mapping[str, Event]] = {"1": "press", "2": "repeat", "3": "release"}
# Joint keys are those of uw-biorobotics/raven2_CRTK_Python_controller
# (python_controller/utils_r2_keyboard_controller.py): a row up, the row below down.
_JOINT_KEYS: Final = tuple(zip("12345678", "qwertyui", strict=True))
_TOOL_KEYS: Final = tuple(zip("asxfgh", "dzcvbn", strict=True))
_TOOL_AXES: Final = ("x", "y", "z", "turn about x", "turn about y", "turn about z")
FASTER, SLOWER, HOLD, LEAVE = "+", "-", " ", "9"
_LEAVING: Final = (LEAVE, "\x1b", "\x03", "\x04")


@dataclass(frozen=True)
class Key:
    """What one key does."""

    name: str  # the character
    action: str  # in words
    joints: tuple[float, ...] = ()  # direction as shares of the caps; empty for a key of the tool
    twist: tuple[float, ...] = ()  # direction of the tool, as shares of `TOOL_SPEED`


TOOL_SPEED: Final = np.array([0.02, 0.02, 0.02, 0.3, 0.3, 0.3])
"""Speeds of the tool at a share of 1 [m/s, rad/s]."""


def key_map(robot: Robot) -> dict[str, Key]:
    """Keys that move a robot, by character: a pair for each joint, the tool and the grasper."""
    n = len(robot.joints)
    rows = zip(robot.joint_names, _JOINT_KEYS, np.eye(n), strict=False)
    pairs = [(pair, (f"{joint} +", f"{joint} -"), "joints", row) for joint, pair, row in rows]
    if robot.grasper:
        row = np.zeros(n)
        row[robot.index(robot.grasper)] = 1.0
        pairs.append((("o", "p"), ("open", "shut"), "joints", row))
    if robot.kinematics is not None:
        for axis, pair, row in zip(_TOOL_AXES, _TOOL_KEYS, np.eye(6), strict=True):
            pairs.append((pair, (f"tool {axis} +", f"tool {axis} -"), "twist", row))
    return {
        name: Key(name, action, **{kind: tuple((sign * row).tolist())})
        for names, actions, kind, row in pairs
        for name, action, sign in zip(names, actions, (1.0, -1.0), strict=True)
    }


def key_events(text: str) -> Iterator[tuple[str, Event]]:
    """Keys that a terminal reports, and whether each is pressed, repeated or let go of.

    Plain characters are pressed; a terminal with kitty's keyboard protocol tells the three apart.
    Other escape sequences are passed over.
    """
    for match in _TYPED.finditer(text):
        code, event = match["code"], match["event"]
        if code is None and not match["other"]:
            yield match[0], "press"
        elif code is not None and int(code) < 0x110000:
            yield chr(int(code)), _KITTY_EVENTS.get(event or "1", "press")


@dataclass(eq=False)
class Teleoperation:
    """Turns keys into the velocities of a `Jog`.

    A key moves while it is held: until it is let go of where the terminal says so, else for 0.2 s
    after it was last reported. Of joint and tool keys those pressed last count.
    """

    jog: Jog
    step: int = 1  # of `SPEEDS`
    is_over: bool = False  # whether a key has ended it
    _held: dict[str, float] = field(default_factory=dict)  # until when [s]

    def __post_init__(self) -> None:
        self.keys = key_map(self.jog.arm.robot)
        self._pushed = np.zeros(len(self.jog.arm.robot.joints)), np.zeros(6)

    @property
    def held(self) -> tuple[str, ...]:
        """What the keys that are held do."""
        return tuple(self.keys[name].action for name in self._held)

    @property
    def share(self) -> float:
        """Share of the speed caps that is used."""
        return SPEEDS[self.step]

    def tell(self, name: str, event: Event, now: float) -> None:
        """Take in a key at the time `now` [s]; one without a meaning does nothing."""
        if event == "release":
            self._held.pop(name, None)
        elif name in _LEAVING:
            self.is_over = True
            self._let_go()
        elif name == HOLD:
            self._let_go()
        elif name in (FASTER, "=", SLOWER) and event == "press":
            change = -1 if name == SLOWER else 1
            self.step = min(max(self.step + change, 0), len(SPEEDS) - 1)
        elif name in self.keys:
            self._held.pop(name, None)  # the latest stands last
            self._held[name] = now + HELD
        self._move()

    def push(self, joints: Array, twist: Array) -> None:
        """Move by a stick: shares (n_joints,) of the joints' caps, else (6,) of the tool's speed.

        They hold until the next ones; keys that are held go before them.
        """
        self._pushed = joints, twist
        self._move()

    def pass_time(self, now: float, *, tells_release: bool = False) -> None:
        """Let go of keys that have not been reported for long, unless the terminal tells."""
        over = [] if tells_release else [k for k, until in self._held.items() if now > until]
        for name in over:
            del self._held[name]
        if over:
            self._move()

    def _let_go(self) -> None:
        self._held.clear()
        self._pushed = np.zeros_like(self._pushed[0]), np.zeros(6)

    def _move(self) -> None:
        joints, twist = self._pushed
        if self._held:  # those of the kind pressed last
            keys = [self.keys[name] for name in self._held]
            kind = [key for key in keys if bool(key.joints) == bool(keys[-1].joints)]
            shares = np.sum([key.joints or key.twist for key in kind], axis=0).clip(-1.0, 1.0)
            joints, twist = (shares, np.zeros(6)) if keys[-1].joints else (0.0 * joints, shares)
        if joints.any():
            self.jog.joints(joints * self.share * self.jog.speed)
        elif twist.any():
            self.jog.tool(twist * self.share * TOOL_SPEED)
        else:
            self.jog.stop()


DEAD_ZONE: Final = 0.15
"""Share of its way that a stick may be off its middle at rest."""

# Numbers of axes and buttons as SDL 2 has them for the pads that Linux calls Xbox.
LEFT_X, LEFT_Y, LEFT_TRIGGER, RIGHT_X, RIGHT_Y, RIGHT_TRIGGER = range(6)
_STICK_TWIST: Final = ((LEFT_X, 0, 1.0), (LEFT_Y, 1, -1.0), (RIGHT_Y, 2, -1.0), (RIGHT_X, 5, 1.0))
_STICK_JOINTS: Final = ((LEFT_X, 1.0), (LEFT_Y, -1.0), (RIGHT_X, 1.0), (RIGHT_Y, -1.0))
_BUTTONS: Final = {0: HOLD, 1: LEAVE, 4: SLOWER, 5: FASTER, 7: LEAVE}


class Gamepad:
    """The first gamepad of this computer, from entering to leaving.

    The left stick moves the tool along x and y, the right one along z and about it, the triggers
    shut and open the grasper, the shoulder buttons change the speed, A stops until all are let go
    of, B and Start leave. Of a robot whose kinematics are not known, the sticks move its first four
    joints. A pad that is unplugged (`is_gone`) stops the arm and leaves. On entering raises
    TruejointError without pygame, CommandRefused if no gamepad is there.
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
            if value and number in _BUTTONS:
                self._is_stopped |= _BUTTONS[number] == HOLD
                self.operator.tell(_BUTTONS[number], "press", now)
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
            for k, (axis, sign) in enumerate(_STICK_JOINTS[: len(joints)]):
                joints[k] += sign * axes[axis]
        else:
            for axis, k, sign in _STICK_TWIST:
                twist[k] = sign * axes[axis]
        self.operator.push(joints, twist)
