"""The one-jaw cable-driven forceps of yan2020."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

from truejoint.robots.robot import Joint, Robot

ARMS: Final[Mapping[str, str]] = {"": ""}

_LIMIT: Final = math.radians(60.0)
# yan2020 states no limits; its reference motions (equations 27 and 28) stay within 52 deg.
JOINTS: Final = (Joint("jaw", "revolute", -_LIMIT, _LIMIT),)


def build(arm: str) -> Robot:
    """One jaw, pulled open by a motor's cable and shut by a spring's (yan2020, section II-B)."""
    return Robot("forceps", JOINTS, arm)
