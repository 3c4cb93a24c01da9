import math

import numpy as np
import pytest

from truejoint.errors import RobotError
from truejoint.robots import Robot
from truejoint.robots.forceps_mechanism import TABLE_1, ForcepsMechanism


def test_one_turn_of_the_wheel_takes_the_cable_around_it_once():
    turn = 2 * math.pi * 35.0
    assert TABLE_1.drive_from_motor(turn) == pytest.approx(2 * math.pi * 9.75e-3)
    assert turn / TABLE_1.motor_per_jaw == pytest.approx(2 * math.pi * 9.75 / 4.0)


def test_one_motor_count_is_six_millidegrees_at_the_jaw():
    count = 2 * math.pi / 4000
    assert math.degrees(count / TABLE_1.motor_per_jaw) == pytest.approx(0.00627, abs=1e-5)


def test_motor_turns_with_the_jaw():
    jaw = np.linspace(-1.0, 1.0, 11)
    np.testing.assert_allclose(TABLE_1.motor_from_jaw(jaw) / TABLE_1.motor_per_jaw, jaw, atol=1e-15)


def test_what_is_not_stated_is_table_1s():
    stated = ForcepsMechanism.from_dict({"jaw_radius": 6e-3})
    assert (stated.jaw_radius, stated.gear_ratio) == (6e-3, 35.0)


def test_a_robot_carries_it():
    plain = {"name": "mine", "joints": [{"name": "jaw"}], "mechanism": {"gear_ratio": 50}}
    robot = Robot.from_dict(plain)
    assert robot.mechanism == ForcepsMechanism.from_dict({"gear_ratio": 50})
    assert Robot.from_dict(robot.to_dict()).mechanism == robot.mechanism
    with pytest.raises(RobotError, match="mine: mechanism is 3; want a table"):
        Robot.from_dict({**plain, "mechanism": 3}, "mine")


@pytest.mark.parametrize(
    ("name", "value", "rule"),
    [
        ("jaw_radius", -4e-3, "above 0"),
        ("wheel_radius", math.nan, "above 0"),
        ("gear_ratio", 0.5, "1 or more"),
        ("spring_stiffness", "stiff", "above 0"),
        ("cable", 1.0, "not known"),
    ],
)
def test_a_mechanism_that_cannot_be_is_refused(name, value, rule):
    with pytest.raises(RobotError, match=f"mechanism: .*{name}.*{rule}"):
        ForcepsMechanism.from_dict({name: value})
