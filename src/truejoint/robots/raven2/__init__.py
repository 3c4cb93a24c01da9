"""RAVEN-II, the cable-driven surgical research robot: both arms, and its hardware's numbers."""

from truejoint.robots.raven2.arm import CHANNELS as CHANNELS
from truejoint.robots.raven2.arm import build as build
from truejoint.robots.raven2.hardware import ENCODER_COUNTS_PER_REV as ENCODER_COUNTS_PER_REV
from truejoint.robots.raven2.hardware import GRAVITY as GRAVITY
from truejoint.robots.raven2.hardware import HOMING_RAMP as HOMING_RAMP
from truejoint.robots.raven2.hardware import HOMING_RETURN as HOMING_RETURN
from truejoint.robots.raven2.hardware import HOMING_SETTLE as HOMING_SETTLE
from truejoint.robots.raven2.hardware import JOINT_ENCODERS as JOINT_ENCODERS
from truejoint.robots.raven2.hardware import Drive as Drive
from truejoint.robots.raven2.hardware import drives as drives
from truejoint.robots.raven2.hardware import links as links
from truejoint.robots.raven2.kinematics import Raven2Kinematics as Raven2Kinematics
from truejoint.robots.raven2.kinematics import kinematics as kinematics
