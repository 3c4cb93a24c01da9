import math

import pytest

from truejoint import schema
from truejoint.errors import RobotError
from truejoint.robots import Robot, get_robot
from truejoint.robots.cable_mechanism import Forceps

TABLE_1 = Forceps()


def test_one_turn_of_the_wheel_takes_the_cable_around_it_once():
    turn = 2 * math.pi * 35.0
    assert turn / TABLE_1.motor_per_jaw == pytest.approx(2 * math.pi * 9.75 / 4.0)


def test_one_motor_count_is_six_millidegrees_at_the_jaw():
    count = 2 * math.pi / 4000
    assert math.degrees(count / TABLE_1.motor_per_jaw) == pytest.approx(0.00627, abs=1e-5)


def test_a_forceps_is_a_mechanism_of_two_cables():
    mechanism = get_robot("forceps").mechanism
    assert Forceps.of(mechanism) == TABLE_1
    assert mechanism.coupling.tolist() == [[TABLE_1.motor_per_jaw]]
    assert mechanism.radii[0] == pytest.approx(9.75e-3 / 35.0)
    for mechanism in (None, get_robot("wrist").mechanism):
        with pytest.raises(RobotError, match="the mechanism is not a forceps'; want one joint"):
            Forceps.of(mechanism)


def test_a_robot_file_states_what_differs_from_table_1():
    values = {"name": "mine", "joints": [{"name": "j"}], "mechanism": {"gear_ratio": 50}}
    robot = Robot.from_dict(values)
    assert Forceps.of(robot.mechanism) == TABLE_1._replace(gear_ratio=50.0)
    again = Robot.from_dict(robot.to_dict())
    assert again.to_dict() == robot.to_dict()
    assert Forceps.of(again.mechanism) == Forceps.of(robot.mechanism)
    with pytest.raises(RobotError, match="mine: mechanism is 3; want a table"):
        Robot.from_dict({**values, "mechanism": 3}, "mine")


@pytest.mark.parametrize(
    ("name", "value", "rule"),
    [
        ("jaw_radius", -4e-3, "from 0.001 to 0.02"),
        ("wheel_radius", math.nan, "from 0.001 to 0.1"),
        ("gear_ratio", 0.5, "from 1 to 1000"),
        ("spring_stiffness", "stiff", "from 10 to 10000"),
        ("cable", 1.0, "no key called"),
    ],
)
def test_a_mechanism_that_cannot_be_is_refused(name, value, rule):
    with pytest.raises(
        RobotError,
        match=f"mechanism: .*{rule}" if name == "cable" else f"mechanism: {name} is .*{rule}",
    ):
        schema.read(Forceps, {name: value}, "mechanism", RobotError)
