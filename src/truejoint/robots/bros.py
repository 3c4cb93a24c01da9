"""BROS: a two-joint haptic arm whose cables have a motor and a joint encoder each."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from truejoint.robots.robot import Joint, Robot, Transmission

ARMS: Final[Mapping[str, str]] = {"": ""}

# niekbeckers/bi-robot-setup, transmission ratio measured with joint encoders.
RATIOS: Final = (7.298, 7.331)
"""Motor turns per joint turn."""


def build(arm: str) -> Robot:
    """Two revolute joints without cable coupling; their limits are not published."""
    joints = (Joint("joint1"), Joint("joint2"))
    return Robot("bros", joints, arm, transmission=Transmission(np.diag(RATIOS)))
