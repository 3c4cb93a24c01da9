"""Fields of RAVEN-II's state message that a recorder does not keep, computed from those it keeps.

Fields and their meaning: uw-biorobotics/raven2:msg/raven_state.msg and src/raven/local_io.cpp; the
message has them of both arms, here are those of one.
"""

import math
from collections.abc import Mapping
from typing import Final

import numpy as np

from truejoint.array_types import Array
from truejoint.robots.raven2.hardware import ENCODER_COUNTS_PER_REV, drives
from truejoint.robots.robot import Robot

COMMAND_RATE: Final = 500.0
"""Commands a second of the laboratory's controller (peng2024, IV-A)."""

_COUNT: Final = 2.0 * math.pi / ENCODER_COUNTS_PER_REV
_OPERATING: Final = 3.0  # run level with the pedal down
_AXES: Final = ("x", "y", "z")
_ENTRIES: Final = tuple(f"{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3))


def state_message(
    robot: Robot, t: Array, recorded: Mapping[str, Array], encoder_zero: Array
) -> dict[str, Array]:
    """Columns (n,) of the state message by the names that the reader of its files gives them.

    Motor set-points, encoder counts and offsets, DAC counts, tool pose and set-point, what the
    robot makes of its Jacobian, run levels, sequence number and time. As on the robot,
    ``jacobian_force`` repeats the velocity, and what is of the unused channel is zero.

    The robot is an arm of a RAVEN-II, `t` (n,) the time since it was switched on [s], and
    `encoder_zero` (7,) has the zeros of the motor encoders after the homing [rad]. `recorded` has
    ``measured``, ``velocity``, ``effort``, ``setpoint`` and ``motor`` of every joint (n,) in SI.
    """
    names = robot.joint_names

    def of(quantity: str) -> Array:
        return np.column_stack([recorded[f"{quantity}/{name}"] for name in names])

    assert robot.transmission is not None and robot.kinematics is not None  # noqa: S101, PT018
    arm_drives = drives(robot.arm)
    steps = np.array([drive.torque_per_amp / drive.dac_per_amp for drive in arm_drives])
    offset = np.rint(np.asarray(encoder_zero) / _COUNT)
    measured, setpoint = of("measured"), of("setpoint")
    by_channel = {
        "motor_setpoint": setpoint @ robot.transmission.matrix.T,
        "encoder": np.rint(of("motor") / _COUNT + offset),
        "encoder_offset": np.broadcast_to(offset, measured.shape),
        "dac": np.rint(of("effort") / steps),
    }
    columns: dict[str, Array] = {}
    for quantity, values in by_channel.items():
        table = np.zeros((len(t), len(robot.channels)))
        table[:, robot.joint_channels] = values
        columns |= _columns(quantity, robot.channels, table)
    for ending, joint in (("", measured), ("_setpoint", setpoint)):
        pose = robot.kinematics.forward(joint)
        columns |= _columns(f"tool{ending}", _AXES, pose[:, :3, 3])
        columns |= _columns(f"rotation{ending}", _ENTRIES, pose[:, :3, :3].reshape(-1, 9))
    columns["grasp_setpoint/jaw"] = setpoint[:, robot.index(robot.grasper)].sum(axis=1)
    jacobian = robot.kinematics.jacobian(measured)
    moving = np.einsum("nij,nj->ni", jacobian, of("velocity"))
    for name in ("jacobian_velocity", "jacobian_force"):
        columns |= _columns(name, (*_AXES, "rx", "ry", "rz"), moving)
    constant = {"arm/type": 0.0, "state/run_level": _OPERATING, "state/sub_level": 0.0}
    columns |= {name: np.full(len(t), value) for name, value in constant.items()}
    return {**columns, "state/last_seq": np.floor(t * COMMAND_RATE), "state/time": np.asarray(t)}


def _columns(quantity: str, names: tuple[str, ...], values: Array) -> dict[str, Array]:
    return {f"{quantity}/{name}": values[:, k] for k, name in enumerate(names)}
