"""dVRK PSM: the patient-side manipulator of a da Vinci, with a Large Needle Driver."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np

from truejoint.robots.chain import Axis, SerialChain
from truejoint.robots.robot import Joint, Robot

ARMS: Final[Mapping[str, str]] = {"": "", "psm1": "psm1", "psm2": "psm2", "psm3": "psm3"}
"""The arms are alike; without a name it is not said which one it is."""

_DEG: Final = math.pi / 180.0

REMOTE_CENTRE_OFFSET: Final = -0.4318
"""Position of the insertion's zero along the shaft, from the remote centre [m]."""
SHAFT_LENGTH: Final = 0.4162
"""From the insertion's frame to the wrist's pitch axis [m]."""
WRIST_LENGTH: Final = 0.0091
"""From the wrist's pitch axis to its yaw axis [m]."""

# Names and limits: jhu-dvrk/sawIntuitiveResearchKit:share/kinematic/psm.json for the arm and
# share/tool/LARGE_NEEDLE_DRIVER_400006.json for the instrument.
JOINTS: Final = (
    Joint("outer_yaw", "revolute", -91 * _DEG, 91 * _DEG),
    Joint("outer_pitch", "revolute", -53 * _DEG, 53 * _DEG),
    Joint("outer_insertion", "prismatic", 0.0, 0.24),
    Joint("outer_roll", "revolute", -260 * _DEG, 260 * _DEG),
    Joint("outer_wrist_pitch", "revolute", -80 * _DEG, 80 * _DEG),
    Joint("outer_wrist_yaw", "revolute", -80 * _DEG, 80 * _DEG),
    Joint("jaw", "revolute", -40 * _DEG, 80 * _DEG),
)

# jhu-dvrk/sawIntuitiveResearchKit, the files above; the last axis is the wrist's yaw, where
# the instrument's jaws are hinged. The files round pi/2 to 1.5708.
_AXES: Final = (
    Axis(math.pi / 2, 0.0, 0.0, math.pi / 2),
    Axis(-math.pi / 2, 0.0, 0.0, -math.pi / 2),
    Axis(math.pi / 2, 0.0, REMOTE_CENTRE_OFFSET, 0.0, "prismatic"),
    Axis(0.0, 0.0, SHAFT_LENGTH, 0.0),
    Axis(-math.pi / 2, 0.0, 0.0, -math.pi / 2),
    Axis(-math.pi / 2, WRIST_LENGTH, 0.0, -math.pi / 2),
)

# "tooltip-offset" of the instrument's file.
_TOOL_ROTATION: Final = ((0.0, -1.0, 0.0), (0.0, 0.0, 1.0), (-1.0, 0.0, 0.0))


def build(arm: str) -> Robot:
    """Build the PSM called `arm`; every joint but the jaw is calibrated by default.

    The wrist's joints stray furthest from their commands (Hwang et al., IEEE RA-L 5(4), 2020), so
    that they count among those to be calibrated although they hardly place the tool.
    """
    names = tuple(joint.name for joint in JOINTS)
    chain = SerialChain(_AXES, np.eye(6, 7), tool_rotation=np.array(_TOOL_ROTATION))
    return Robot("dvrk_psm", JOINTS, arm, names, names[:6], None, chain)
