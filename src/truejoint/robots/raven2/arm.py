"""RAVEN-II: joints, limits and cable transmission of both arms."""

from __future__ import annotations

import math
from functools import cache
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from truejoint.robots.parts import Joint, Transmission, Workspace
from truejoint.robots.raven2 import hardware
from truejoint.robots.raven2.kinematics import kinematics
from truejoint.robots.robot import Robot

# Order within the arm's half of a ``ravenstate`` message
# (uw-biorobotics/raven2:include/raven/defines.h).
CHANNELS: Final = ("shoulder", "elbow", "insertion", "unused", "roll", "wrist", "jaw1", "jaw2")
POSITIONING: Final = ("shoulder", "elbow", "insertion")

_DEG: Final = math.pi / 180.0
# Fastest setpoint that the CRTK interface of the robot accepts.
_MAX_TURN: Final = hardware.CRTK_MAX_INCREMENT_ANGLE / hardware.CONTROL_PERIOD
_MAX_INSERTION: Final = hardware.CRTK_MAX_INCREMENT_INSERTION / hardware.CONTROL_PERIOD

# Software limits and home pose: uw-biorobotics/raven2:include/raven/defines.h (shoulder, elbow,
# insertion) and src/raven/tools.cpp (10 mm RAVEN grasper); the same for both arms.
JOINTS: Final = (
    Joint("shoulder", "revolute", 0.0, 90 * _DEG, 30 * _DEG, _MAX_TURN),
    Joint("elbow", "revolute", 45 * _DEG, 135 * _DEG, 90 * _DEG, _MAX_TURN),
    Joint("insertion", "prismatic", 0.23, 0.56, 0.40, _MAX_INSERTION),
    Joint("roll", "revolute", -182 * _DEG, 182 * _DEG, 0.0, _MAX_TURN),
    Joint("wrist", "revolute", -70 * _DEG, 70 * _DEG, 0.0, _MAX_TURN),
    Joint("jaw1", "revolute", -105 * _DEG, 105 * _DEG, 45 * _DEG, _MAX_TURN),
    Joint("jaw2", "revolute", -105 * _DEG, 105 * _DEG, 45 * _DEG, _MAX_TURN),
)

# Files of uw-biorobotics/raven2_CRTK_Python_controller: ranges, traj_generator/
# run_snake_generator.py; speed caps, python_controller/run_r2_trajectory_follow.py; how a random
# motion swings, python_controller/run_r2_random_joint_movement.py.
WORKSPACE: Final = Workspace(
    joints=POSITIONING,
    lower=np.array([20 * _DEG, 55 * _DEG, 0.33]),
    upper=np.array([60 * _DEG, 110 * _DEG, 0.42]),
    speed=np.array([2.182 * _DEG, 3 * _DEG, 5e-3]),
    margin=np.array([np.deg2rad(5.0), np.deg2rad(10.0), 0.02]),
    slowest=np.array([np.deg2rad(1.091), np.deg2rad(1.5), 0.0025]),
    fastest=np.array([np.deg2rad(3.0), np.deg2rad(4.0), 0.007]),
    crawl=np.array([np.deg2rad(0.2), np.deg2rad(0.2), 0.001]),
)


@cache
def build(side: Literal["left", "right"]) -> Robot:
    """Give the arm of a side."""
    arm = side, CHANNELS, POSITIONING, _transmission(side), kinematics(side)
    return Robot(
        "raven2", JOINTS, *arm, effort="motor", workspace=WORKSPACE, grasper=("jaw1", "jaw2"),
        encoders=hardware.JOINT_ENCODERS,
    )  # fmt: skip


def _transmission(arm: Literal["left", "right"]) -> Transmission:
    """Cables of an arm; its state message has the torques at the capstans, behind the gearboxes."""
    gear = tuple(drive.gear_ratio for drive in hardware.drives(arm))
    return Transmission(_motor_from_joint(arm), gear)


def _motor_from_joint(arm: Literal["left", "right"]) -> NDArray[np.float64]:
    """Motor angle per joint position (7, 7) [rad/rad, rad/m], with cable coupling.

    Source: uw-biorobotics/raven2:src/raven/inv_cable_coupling.cpp, for the 10 mm RAVEN grasper
    with its first jaw's motor reversed (OPPOSE_GRIP).
    """
    shoulder, elbow, insertion, roll, wrist, jaw1, jaw2 = range(7)
    # Motion of the cables, in joint units, that each joint's motor has to follow.
    cable = np.eye(7)
    cable[elbow, shoulder] = hardware.ELBOW_PER_SHOULDER
    cable[insertion, shoulder] = hardware.INSERTION_PER_SHOULDER
    cable[insertion, elbow] = hardware.INSERTION_PER_ELBOW
    ratios = np.array([drive.transmission_ratio for drive in hardware.drives(arm)])
    motor = ratios[:, None] * cable
    side = 1.0 if arm == "left" else -1.0
    tool = side * hardware.TOOL_MOTOR_PER_INSERTION_MOTOR * motor[insertion]
    motor[[roll, wrist, jaw1, jaw2]] += np.outer([1.0, 1.0, -1.0, 1.0], tool)
    return motor
