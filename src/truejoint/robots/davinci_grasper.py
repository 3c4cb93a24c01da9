"""The cable-driven jaw of a da Vinci EndoWrist Maryland grasper on a test bench."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

from truejoint.robots.robot import Joint, Robot

ARMS: Final[Mapping[str, str]] = {"": ""}

# MRDLab/mis-tool-characterization: README and the headers of the recordings.
DRIVER_COUNT: Final = 2 * math.pi / 8192
"""Turn of the instrument's driven spindle per count of its encoder [rad]."""
JAW_COUNT: Final = 2 * math.pi / 4000
"""Turn of the jaw per count of its encoder [rad]."""
MOTOR_COUNT: Final = 2 * math.pi / (4096 * 35)
"""Turn of the spindle per count of the motor's encoder, before the 35:1 gearbox [rad]."""
TORQUE_COUNT: Final = 3.9811e-5
"""Torque per count of either torque sensor [Nm]."""


def build(arm: str) -> Robot:
    """One jaw, hinged; its travel between the stops is not published."""
    return Robot("davinci_grasper", (Joint("jaw"),), arm)
