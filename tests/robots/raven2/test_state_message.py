import numpy as np
import pytest

from truejoint.recordings.read import raven_csv
from truejoint.robots import get_robot
from truejoint.robots.raven2.hardware import ENCODER_COUNTS_PER_REV, drives
from truejoint.robots.raven2.state_message import state_message
from truejoint.simulation.raven2 import Raven2Twin

COUNT = 2 * np.pi / ENCODER_COUNTS_PER_REV


@pytest.fixture(scope="module")
def message():
    """Ten rows of a moving twin, what it recorded, and the rest of the message."""
    twin = Raven2Twin(seed=3)
    twin.home()
    robot = twin.robot
    path = robot.home + 0.02 * np.sin(np.arange(200) / 40.0)[:, None] * [1, 1, 0.1, 1, 1, 1, -1]
    block = twin.run(path)
    columns = {name: values[100:110] for name, values in block.columns().items()}
    t = block.t[100:110]
    return robot, t, columns, state_message(robot, t, columns, twin.encoder_zero)


@pytest.mark.parametrize("arm", ["left", "right"])
def test_the_whole_message_of_an_arm_has_the_names_of_its_files(message, arm):
    _, _, columns, more = message
    robot = get_robot("raven2", arm)
    read = {name for name in raven_csv._state(robot) if name != "t"}
    assert {*columns, *more} - {"state/time"} == read
    assert len({*columns, *more}) == 122


def test_counts_and_torques_are_those_of_the_motors(message):
    robot, _, columns, more = message
    for drive, joint in zip(drives("left"), robot.joint_names, strict=True):
        counts = more[f"encoder/{joint}"] - more[f"encoder_offset/{joint}"]
        assert counts * COUNT == pytest.approx(columns[f"motor/{joint}"], abs=0.51 * COUNT)
        torque = more[f"dac/{joint}"] * drive.torque_per_amp / drive.dac_per_amp
        assert torque == pytest.approx(columns[f"effort/{joint}"], abs=1e-9)
    goal = np.column_stack([columns[f"setpoint/{joint}"] for joint in robot.joint_names])
    motors = np.column_stack([more[f"motor_setpoint/{joint}"] for joint in robot.joint_names])
    assert motors @ np.linalg.inv(robot.transmission.matrix).T == pytest.approx(goal)


def test_the_tool_moves_as_the_jacobian_says(message):
    robot, _, columns, more = message
    q, v = (
        np.column_stack([columns[f"{name}/{joint}"] for joint in robot.joint_names])
        for name in ("measured", "velocity")
    )
    step = 1e-6
    before, after = (robot.kinematics.forward(q + side * step * v) for side in (-1, 1))
    for k, axis in enumerate("xyz"):
        assert more[f"tool/{axis}"] == pytest.approx(robot.kinematics.forward(q)[:, k, 3])
        speed = (after - before)[:, k, 3] / (2 * step)
        assert more[f"jacobian_velocity/{axis}"] == pytest.approx(speed, abs=1e-7)
    turn = (after[:, :3, :3] - before[:, :3, :3]) / (2 * step)
    turned = turn @ robot.kinematics.forward(q)[:, :3, :3].transpose(0, 2, 1)
    for name, (row, column) in {"rx": (2, 1), "ry": (0, 2), "rz": (1, 0)}.items():
        assert more[f"jacobian_velocity/{name}"] == pytest.approx(turned[:, row, column], abs=1e-6)
