"""K-FLEX: one bending joint at the end of a tendon-sheath mechanism."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from truejoint.robots.robot import Joint, Robot

ARMS: Final[Mapping[str, str]] = {"": ""}


def build(arm: str) -> Robot:
    """One bending joint (nhoyh/hysteresis_compensation_ROS); its limits are not published."""
    return Robot("kflex", (Joint("bend"),), arm)
