"""RAVEN-II, the cable-driven surgical research robot: both arms, and its hardware's numbers."""

from truejoint.robots.raven2.arm import ARMS, CHANNELS, JOINTS, POSITIONING, WORKSPACE, build
from truejoint.robots.raven2.hardware import (
    CONTROL_PERIOD,
    CRTK_MAX_INCREMENT_ANGLE,
    CRTK_MAX_INCREMENT_INSERTION,
    ENCODER_COUNTS_PER_REV,
    GRAVITY,
    HOMING_RAMP,
    HOMING_RETURN,
    HOMING_SETTLE,
    JOINT_ENCODERS,
    Drive,
    JointEncoder,
    Link,
    drives,
    links,
)
from truejoint.robots.raven2.kinematics import Raven2Kinematics, kinematics

__all__ = [
    "ARMS",
    "CHANNELS",
    "CONTROL_PERIOD",
    "CRTK_MAX_INCREMENT_ANGLE",
    "CRTK_MAX_INCREMENT_INSERTION",
    "ENCODER_COUNTS_PER_REV",
    "GRAVITY",
    "HOMING_RAMP",
    "HOMING_RETURN",
    "HOMING_SETTLE",
    "JOINTS",
    "JOINT_ENCODERS",
    "POSITIONING",
    "WORKSPACE",
    "Drive",
    "JointEncoder",
    "Link",
    "Raven2Kinematics",
    "build",
    "drives",
    "kinematics",
    "links",
]
