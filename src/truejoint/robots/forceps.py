"""The one-jaw cable-driven forceps of yan2020."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np

from truejoint.robots.robot import Joint, Robot
from truejoint.robots.workspace import Workspace

ARMS: Final[Mapping[str, str]] = {"": ""}

_LIMIT: Final = math.radians(60.0)
# yan2020 states no limits; its reference motions (equations 27 and 28) stay within 52 deg.
JOINTS: Final = (Joint("jaw", "revolute", -_LIMIT, _LIMIT),)

_RANGE: Final = math.radians(50.0)
WORKSPACE: Final = Workspace(
    ("jaw",), np.array([-_RANGE]), np.array([_RANGE]), speed=np.array([0.3 * _RANGE])
)
"""Range and top speed of the calibration motion, equation (27)."""


def build(arm: str) -> Robot:
    """One jaw, pulled open by a motor's cable and shut by a spring's (yan2020, section II-B)."""
    return Robot("forceps", JOINTS, arm, workspace=WORKSPACE)
