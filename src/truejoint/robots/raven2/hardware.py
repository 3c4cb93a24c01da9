"""RAVEN-II: both arms, and the numbers of their drives, homing, control and links.

Facts are from uw-biorobotics/raven2 (branch crtk) unless another source stands beside them.
"""

import math
from dataclasses import dataclass, replace
from functools import cache
from typing import Final

import numpy as np

from truejoint.array_types import Array
from truejoint.robots.parts import Transmission
from truejoint.robots.robot import Robot
from truejoint.toml_file import shipped_table

_DEG: Final = math.pi / 180.0

# Counts of a motor encoder per turn of the motor shaft (include/raven/motor.h).
ENCODER_COUNTS_PER_REV: Final = 4000
# Time [s] over which the homing speed builds up (src/raven/trajectory.cpp); at the hard stops until
# the encoders are registered; from there to the home pose along 1 - cos (src/raven/homing.cpp).
HOMING_RAMP: Final = 0.5
HOMING_SETTLE: Final = 0.2
HOMING_RETURN: Final = 2.5
# Gravity in frame 0 of either arm [m/s^2] (src/raven/init.cpp and grav_comp.cpp).
GRAVITY: Final = (-9.8, 0.0, 0.0)


@dataclass(frozen=True)
class Drive:
    """Motor, gearbox, cable transmission and servo control of one joint."""

    joint: str
    gear_ratio: float  # motor turns per capstan turn
    capstan_radius: float  # radius at which the capstan winds the cable [m]
    torque_constant: float  # motor torque per current [Nm/A]
    dac_per_amp: float  # DAC counts per ampere of the amplifier
    transmission_ratio: float  # motor angle per joint position [rad/rad, rad/m], without coupling
    dac_limit: int  # largest command [DAC counts] at the safety level MODERATE
    # Gains of the controller: capstan torque [Nm] per error of the motor angle [rad], of its speed
    # [rad/s], and of the error's integral [rad s].
    kp: float
    kd: float
    ki: float
    homing_speed: float  # towards the hard stop [rad/s or m/s]; the sign is the direction
    homing_dac: int  # command that counts as having met the hard stop [DAC counts]
    hard_stop: float  # joint position that homing assigns to the hard stop [rad or m]

    @property
    def torque_per_amp(self) -> float:
        """Torque at the capstan per motor current [Nm/A], without the arm's sign convention."""
        return self.torque_constant * self.gear_ratio

    @property
    def max_effort(self) -> float:
        """Largest torque command at the capstan [Nm], set by `dac_limit`."""
        return self.dac_limit / self.dac_per_amp * self.torque_per_amp

    @property
    def homing_effort(self) -> float:
        """Torque command at the capstan that ends the search for the hard stop [Nm]."""
        return self.homing_dac / self.dac_per_amp * self.torque_per_amp


# Radii in m and ratios: include/raven/defines.h. A pulley's effective radius includes half of
# its cable's diameter; the large capstan was measured with its cable on.
_CABLE_POSITIONING: Final = 1.19e-3 / 2
_CABLE_TOOL: Final = 0.61e-3 / 2
_CAPSTAN_LARGE: Final = 11.35e-3 / 2
_CAPSTAN_SMALL: Final = 4.7e-3 + _CABLE_TOOL
_TOOL_SPOOL: Final = 10.6e-3 + _CABLE_TOOL
_GEAR_LARGE: Final = 49.0 / 4.0
_GEAR_SMALL: Final = 26.0 / 7.0

# Radius at which the partial pulley of shoulder and elbow winds its cable [m].
SHOULDER_PULLEY_RADIUS: Final = 62.5e-3 + _CABLE_POSITIONING
ELBOW_PULLEY_RADIUS: Final = 40.85e-3 + _CABLE_POSITIONING
_ELBOW_REDUCTION: Final = (7.82e-3 + _CABLE_POSITIONING) / (5.60e-3 + _CABLE_POSITIONING)

SHOULDER_RATIO: Final = SHOULDER_PULLEY_RADIUS / _CAPSTAN_LARGE * _GEAR_LARGE
ELBOW_RATIO: Final = ELBOW_PULLEY_RADIUS * _ELBOW_REDUCTION / _CAPSTAN_LARGE * _GEAR_LARGE
INSERTION_RATIO: Final = _GEAR_LARGE / _CAPSTAN_LARGE
_TOOL_RATIO: Final = _TOOL_SPOOL / _CAPSTAN_SMALL * _GEAR_SMALL
# The last factors were found by observation on the robot, says defines.h.
ROLL_RATIO: Final = _TOOL_RATIO * 120.0 / 180.0
WRIST_RATIO: Final = _TOOL_RATIO * 200.0 / 180.0
JAW_RATIO: Final = _TOOL_RATIO * 100.0 / 90.0

# Cable coupling (include/raven/fwd_cable_coupling.h): how far a joint moves when a joint nearer
# to the base moves while its own motor stands still.
_ELBOW_PER_SHOULDER: Final = 0.14545
_INSERTION_PER_SHOULDER: Final = 0.0077973826  # m/rad
_INSERTION_PER_ELBOW: Final = 0.008077387  # m/rad
# Turn of a tool's motor that keeps its joint still while the insertion's motor turns by 1.
_TOOL_MOTOR_PER_INSERTION_MOTOR: Final = (_GEAR_SMALL / _CAPSTAN_SMALL) / INSERTION_RATIO


def drives(arm: str) -> tuple[Drive, ...]:
    """Drives of the seven joints of an arm, in the robot's joint order.

    Sources: include/raven/defines.h and motor.h, src/raven/init.cpp, homing.cpp and tools.cpp,
    params/r2params.yaml of uw-biorobotics/raven2.
    """
    # Maxon RE40 with the high-current, RE30 with the low-current amplifier.
    large = (_GEAR_LARGE, _CAPSTAN_LARGE, 0.0603, 2730.0)
    small = (_GEAR_SMALL, _CAPSTAN_SMALL, 0.0538, 5461.0)
    kd = 0.012 if arm == "left" else 0.010  # of the insertion
    # Ratio, DAC limit; gains; homing speed, command and hard stop.
    return (
        Drive("shoulder", *large, SHOULDER_RATIO, 2500, 0.3, 0.008, 0.0, -10 * _DEG, 2100, 0.0),
        Drive("elbow", *large, ELBOW_RATIO, 2500, 0.3, 0.008, 0.0, 10 * _DEG, 2100, 137.5 * _DEG),
        Drive("insertion", *large, INSERTION_RATIO, 2000, 0.15, kd, 0.0, 0.02, 1600, 0.562),
        Drive("roll", *small, ROLL_RATIO, 3000, 0.09, 0.001, 0.05, 80 * _DEG, 1900, 330 * _DEG),
        Drive("wrist", *small, WRIST_RATIO, 3000, 0.05, 0.0, 0.05, 40 * _DEG, 2100, 100 * _DEG),
        Drive("jaw1", *small, JAW_RATIO, 3800, 0.05, 0.0, 0.05, 40 * _DEG, 2250, 120 * _DEG),
        Drive("jaw2", *small, JAW_RATIO, 3800, 0.05, 0.0, 0.05, 40 * _DEG, 2250, 120 * _DEG),
    )


def links(arm: str) -> tuple[Array, Array]:
    """Masses (3,) [kg] and centres of mass (3, 3) [m] of the links that the first joints move.

    Each centre is in the frame of its own axis. Source: src/raven/grav_comp.cpp.
    """
    side = 1.0 if arm == "left" else -1.0
    shoulder = side * 0.0065, side * 0.09775, side * -0.13771
    elbow, insertion = (-0.002, -0.18274, side * -0.23053), (0.0, 0.0, 0.0)
    return np.array([0.494, 0.750, 0.231]), np.array([shoulder, elbow, insertion])


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
    cable[elbow, shoulder] = _ELBOW_PER_SHOULDER
    cable[insertion, shoulder] = _INSERTION_PER_SHOULDER
    cable[insertion, elbow] = _INSERTION_PER_ELBOW
    ratios = np.array([drive.transmission_ratio for drive in drives(arm)])
    motor = ratios[:, None] * cable
    side = 1.0 if arm == "left" else -1.0
    tool = side * _TOOL_MOTOR_PER_INSERTION_MOTOR * motor[insertion]
    motor[[roll, wrist, jaw1, jaw2]] += np.outer([1.0, 1.0, -1.0, 1.0], tool)
    return Transmission(motor, tuple(drive.gear_ratio for drive in drives(arm)))
