"""RAVEN-II: joints, limits, cable transmission and kinematics of both arms."""

import math
from functools import cache
from typing import Final

import numpy as np

from truejoint.robots.chain import SerialChain
from truejoint.robots.parts import Axis, Joint, Transmission, Workspace
from truejoint.robots.raven2 import hardware
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

# Link twists, shaft and wrist: uw-biorobotics/raven2:include/raven/r2_kinematics.h, described
# in the University of Washington technical report UWEETR-2012-0006.
LINK1_TWIST: Final = math.radians(75.0)
LINK2_TWIST: Final = math.radians(52.0)
SHAFT_OFFSET: Final = -0.47  # from the insertion's zero to the wrist along the shaft [m]
WRIST_LENGTH: Final = 0.013  # from wrist axis to jaw axis of the 10 mm RAVEN grasper [m]

# Angle of the first two axes where the joint reads zero:
# uw-biorobotics/raven2:src/raven/r2_kinematics.cpp (joint2theta).
_SHOULDER_ZERO: Final = {"left": math.radians(205.0), "right": math.radians(25.0)}
_ELBOW_ZERO: Final = {"left": math.pi, "right": 0.0}

# Rotation of frame 0 in the frame of the CRTK topics:
# uw-biorobotics/raven2:src/raven/crtk_motion_api.cpp (branch crtk).
_CRTK_ROTATION: Final = {
    "left": ((0.0, -1.0, 0.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0)),
    "right": ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)),
}

# Columns: shoulder elbow insertion roll wrist jaw1 jaw2; the last axis is the direction in which
# the closed jaws would point (r2_kinematics.cpp: half the difference of the jaws).
_AXIS_FROM_JOINT: Final = np.vstack([np.eye(5, 7), [0, 0, 0, 0, 0, -0.5, 0.5]])


@cache
def build(side: str) -> Robot:
    """Give the arm of a side."""
    arm = side, CHANNELS, POSITIONING, _transmission(side), kinematics(side)
    return Robot(
        "raven2", JOINTS, *arm, effort="motor", workspace=WORKSPACE, grasper=("jaw1", "jaw2"),
        encoders=hardware.JOINT_ENCODERS,
    )  # fmt: skip


def _transmission(arm: str) -> Transmission:
    """Cables of an arm, coupled; its state message has the torques behind the gearboxes.

    Source: uw-biorobotics/raven2:src/raven/inv_cable_coupling.cpp, for the 10 mm RAVEN grasper
    with its first jaw's motor reversed (OPPOSE_GRIP).
    """
    shoulder, elbow, insertion, roll, wrist, jaw1, jaw2 = range(7)
    # Motion of the cables, in joint units, that each joint's motor has to follow.
    cable = np.eye(7)
    cable[elbow, shoulder] = hardware.ELBOW_PER_SHOULDER
    cable[insertion, shoulder] = hardware.INSERTION_PER_SHOULDER
    cable[insertion, elbow] = hardware.INSERTION_PER_ELBOW
    drives = hardware.drives(arm)
    ratios = np.array([drive.transmission_ratio for drive in drives])
    motor = ratios[:, None] * cable
    side = 1.0 if arm == "left" else -1.0
    tool = side * hardware.TOOL_MOTOR_PER_INSERTION_MOTOR * motor[insertion]
    motor[[roll, wrist, jaw1, jaw2]] += np.outer([1.0, 1.0, -1.0, 1.0], tool)
    return Transmission(motor, tuple(drive.gear_ratio for drive in drives))


def kinematics(arm: str) -> SerialChain:
    """Kinematics of the left (gold) or the right (green) arm.

    Joint vectors are shoulder, elbow, insertion, roll, wrist, jaw1, jaw2 [rad, insertion m]; poses
    are those of the tool in frame 0, whose origin is the remote centre of motion.

    Source: uw-biorobotics/raven2:src/raven/r2_kinematics.cpp, UWEETR-2012-0006.
    """
    left = arm == "left"
    quarter = math.pi / 2 if left else -math.pi / 2
    axes = (
        Axis(0.0 if left else math.pi, 0.0, 0.0, _SHOULDER_ZERO[arm]),
        Axis(LINK1_TWIST, 0.0, 0.0, _ELBOW_ZERO[arm]),
        Axis(math.pi - LINK2_TWIST if left else LINK2_TWIST, 0.0, 0.0, quarter, "prismatic"),
        Axis(0.0, 0.0, SHAFT_OFFSET, 0.0),
        Axis(math.pi / 2, 0.0, 0.0, -math.pi / 2),
        Axis(math.pi / 2, WRIST_LENGTH, 0.0, 0.0),
    )
    crtk_from_base = np.eye(4)
    crtk_from_base[:3, :3] = _CRTK_ROTATION[arm]
    return SerialChain(axes, _AXIS_FROM_JOINT, crtk_from_base)
