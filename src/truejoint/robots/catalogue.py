"""Every robot by name."""

from __future__ import annotations

from functools import cache

from truejoint.errors import RobotError
from truejoint.robots.robot import Joint, Robot

_SINGLE_ARM = {
    "davinci_grasper": ("jaw",),
    "bros": ("joint1", "joint2"),
    "kuka_kr300": tuple(f"axis{i}" for i in range(1, 7)),
    "kflex": ("bend",),
}


def robot_names() -> tuple[str, ...]:
    """Names that `get_robot` knows."""
    return ("raven2", *_SINGLE_ARM)


@cache
def get_robot(name: str, arm: str = "") -> Robot:
    """Robot arm called `name`; raises RobotError naming the known ones."""
    if name == "raven2":
        names = ("shoulder", "elbow", "insertion", "roll", "wrist", "jaw1", "jaw2")
        joints = tuple(
            Joint(n, "prismatic" if n == "insertion" else "revolute") for n in names
        )
        channels = (*names[:3], "unused", *names[3:])
        return Robot("raven2", joints, arm or "left", channels, names[:3])
    if name in _SINGLE_ARM:
        return Robot(name, tuple(Joint(n) for n in _SINGLE_ARM[name]))
    raise RobotError(f"no robot called {name!r}; known: {', '.join(robot_names())}")
