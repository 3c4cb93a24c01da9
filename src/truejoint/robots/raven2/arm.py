"""RAVEN-II: both arms, of the table beside this file and the cables of its hardware."""

from dataclasses import replace
from functools import cache

import numpy as np

from truejoint.robots.parts import Transmission
from truejoint.robots.raven2 import hardware
from truejoint.robots.robot import Robot
from truejoint.toml_file import shipped_table


@cache
def build(side: str) -> Robot:
    """Give the arm of a side."""
    table = shipped_table(__package__, "arm.toml")
    about = {key: value for key, value in table.items() if key not in ("left", "right")}
    about |= {"name": "raven2", "arm": side, "kinematics": {**table["kinematics"], **table[side]}}
    return replace(Robot.from_dict(about), transmission=_transmission(side))


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
