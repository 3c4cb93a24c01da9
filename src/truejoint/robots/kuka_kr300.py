"""KUKA KR300 R2500: six axes with elastic gears, and second encoders on axes 1 to 3."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from truejoint.robots.robot import Joint, Robot

ARMS: Final[Mapping[str, str]] = {"": ""}

POSITIONING: Final = ("axis1", "axis2", "axis3")
"""Axes with a second encoder at the link (JonasWeigand/Robot_Identification)."""


def build(arm: str) -> Robot:
    """Six revolute axes; without limits, as the recordings count from where each one starts."""
    joints = tuple(Joint(f"axis{i}") for i in range(1, 7))
    return Robot("kuka_kr300", joints, arm, positioning=POSITIONING)
