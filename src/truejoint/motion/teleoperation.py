"""Keys that move an arm: how pressing and letting go becomes a velocity."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np

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
            self._held.clear()
        elif name == HOLD:
            self._held.clear()
        elif name in (FASTER, "=", SLOWER) and event == "press":
            change = -1 if name == SLOWER else 1
            self.step = min(max(self.step + change, 0), len(SPEEDS) - 1)
        elif name in self.keys:
            self._held.pop(name, None)  # the latest stands last
            self._held[name] = now + HELD
        self._move()

    def pass_time(self, now: float, *, tells_release: bool = False) -> None:
        """Let go of keys that have not been reported for long, unless the terminal tells."""
        over = [] if tells_release else [k for k, until in self._held.items() if now > until]
        for name in over:
            del self._held[name]
        if over:
            self._move()

    def _move(self) -> None:
        keys = [self.keys[name] for name in self._held]
        # Those of the kind pressed last.
        kind = [key for key in keys if bool(key.joints) == bool(keys[-1].joints)]
        shares = np.sum([key.joints or key.twist for key in kind], axis=0).clip(-1.0, 1.0)
        if not shares.any():
            self.jog.stop()
        elif keys[-1].joints:
            self.jog.joints(shares * self.share * self.jog.speed)
        else:
            self.jog.tool(shares * self.share * TOOL_SPEED)
