"""Joints that several cables turn, as data: instruments by number, files of one's own."""

import json
import math

import numpy as np
import pytest

from truejoint import schema
from truejoint.errors import RobotError
from truejoint.robots import Robot, get_robot
from truejoint.robots.cable_mechanism import CableMechanism, Forceps
from truejoint.simulation import make_twin

TOOL = """
name = "finger"

[[joints]]
name = "tip"
unit = "deg"
lower = -60
upper = 60

[mechanism.pins]
tip = { inertia = 1e-6, radius = 1e-3 }

[mechanism.motors]
drive = 9.75e-3

[[mechanism.cables]]
name = "pull"
motor = "drive"
moments = { tip = 4e-3 }
segments = [0.5, 0.5]
nodes = [{ wrap = 1.5 }]

[[mechanism.cables]]
name = "back"
spring = 656.6
moments = { tip = -4e-3 }
"""


@pytest.mark.parametrize(
    ("number", "pitch", "yaw", "opening"),
    [  # ActuatorToJointPosition of each file at discs of 0.1, 0.2, 0.5, multiplied out by hand
        ("400006", 0.10186, -0.08306 + 0.6089 * 0.7, 1.2177 * 0.3),
        ("420172", 0.1, -0.0630273 + 0.457982 * 0.7, 0.915964 * 0.3),
        ("420093", 0.1, -0.05068 - 0.5135 * 0.7, 0.5279 * 0.3),
        ("420230", 0.1, -0.0506756 + 0.513513 * 0.7, 0.527898 * 0.2 - 0.052789 * 5),
        ("raven_cadiere", 0.1, -0.07 + 0.35, 0.3),
    ],
)
def test_an_instrument_turns_as_its_file_says(number, pitch, yaw, opening):
    transmission = get_robot("wrist", number).transmission
    found, jaw1, jaw2 = transmission.joint_from_motor((0.1, 0.2, 0.5))
    assert found == pytest.approx(pitch)
    last_digit = 5e-5  # of the files
    assert 0.5 * (jaw1 + jaw2) == pytest.approx(yaw, abs=last_digit)
    assert jaw2 - jaw1 == pytest.approx(opening, abs=last_digit)


@pytest.mark.parametrize("number", ["420006", "420172", "420309", "raven_cadiere"])
def test_a_disc_of_one_jaw_presses_on_no_pin_of_the_other(number):
    mechanism = get_robot("wrist", number).mechanism
    assert np.count_nonzero(mechanism.moments, axis=0).tolist() == [6, 2, 2]


def test_a_mechanism_is_one_short_line_among_settings():
    said = repr(get_robot("wrist").mechanism)
    assert said == "<pitch, jaw1, jaw2 by 3 motors and 6 cables>"


@pytest.mark.parametrize(
    ("asked", "near"),
    [("4200061", "420006"), ("420171", "420172"), ("raven_needle", "raven_needle_driver")],
)
def test_an_unknown_instrument_names_the_nearest(asked, near):
    with pytest.raises(RobotError, match=f"no arm called '{asked}'; did you mean '{near}'"):
        get_robot("wrist", asked)


@pytest.fixture
def finger(tmp_path):
    path = tmp_path / "finger.toml"

    def changed(old, new):
        assert old in TOOL
        path.write_text(TOOL.replace(old, new))
        return path

    return changed


def test_a_file_of_ones_own_becomes_a_twin(finger):
    path = finger("", "")
    robot = get_robot(path)
    assert robot.transmission.matrix[0, 0] == pytest.approx(4.0 / 9.75)
    twin = make_twin(str(path), seed=1)
    assert twin.home().measured[-1, 0] == pytest.approx(0.0, abs=0.01)


def test_a_gear_turns_the_motor_faster_than_its_capstan(finger):
    geared = "drive = {{ radius = 9.75e-3, gear = {} }}"
    mechanism = get_robot(finger("drive = 9.75e-3", geared.format(35))).mechanism
    assert mechanism.coupling[0, 0] == pytest.approx(35.0 * 4.0 / 9.75)
    assert mechanism.radii == pytest.approx([9.75e-3 / 35.0])
    with pytest.raises(RobotError, match=r"motors.drive.gear is 0.5; want a number from 1"):
        get_robot(finger("drive = 9.75e-3", geared.format(0.5)))


@pytest.mark.parametrize("table", ["", "jaw_radius = 6e-3"])
def test_a_forceps_of_ones_own_becomes_a_twin(tmp_path, table):
    path = tmp_path / "mine.toml"
    path.write_text(f'name = "mine"\n[[joints]]\nname = "jaw"\n[mechanism]\n{table}\n')
    twin = make_twin(str(path), seed=1)
    assert twin.home().joint[-1, 0] == pytest.approx(0.0, abs=0.02)


def test_a_transmission_beside_the_cables_must_be_theirs(finger):
    with pytest.raises(RobotError, match="another than that of its cables; leave it out"):
        get_robot(finger('name = "finger"', 'name = "finger"\ntransmission = [[2.0]]'))


def plain():
    mechanism = get_robot("wrist").mechanism
    values = json.loads(json.dumps(schema.plain(mechanism)))
    for key in ("pins", "motors", "arms"):  # as a file has them
        values[key] = {row.pop("name"): row for row in values[key]}
    values["motors"] = {name: row["radius"] for name, row in values["motors"].items()}  # 1:1 gears
    return values


def spoilt(*path, value):
    values = plain()
    at = values
    for key in path[:-1]:
        at = at[key]
    at[path[-1]] = value
    return values


@pytest.mark.parametrize(
    ("values", "told"),
    [
        (spoilt("cables", 0, "motor", value=""), "'pitch_a' ends nowhere; give it a motor"),
        (spoilt("cables", 0, "moments", value={}), "'pitch_a' ends nowhere: it turns no joint"),
        (spoilt("cables", 0, "spring", value=9.0), "ends at a motor and at a spring; keep one"),
        (spoilt("cables", 0, "motor", value="pich"), "no motor called 'pich'; did you mean"),
        (spoilt("cables", 1, "moments", value={"pitch": 9e-3}), "different moments; what one gets"),
        (spoilt("cables", 0, "moments", value={"yaw": 1e-3}), "no joint called 'yaw'"),
        (spoilt("cables", 0, "moments", value={"pitch": math.nan}), "moments.pitch is nan; want"),
        (spoilt("cables", 0, "segments", value=[0.5, 0.2, 0.2]), "segments add up to 0.9"),
        (spoilt("cables", 0, "segments", value=[1.0]), "1 segments and 2 nodes; want one segment"),
        (spoilt("cables", 0, "sign", value=2), "sign is 2; want 1 or -1"),
        (spoilt("cables", 1, "name", value="pitch_a"), "'pitch_a' stands twice; keep one"),
        (spoilt("cables", 0, "nodes", 0, "wrap", value=-1.0), "wrap is -1.0; want a number from 0"),
        (spoilt("cables", 0, "spring", value=-9.0), "spring is -9.0; want a number from 0"),
        (spoilt("pins", value=[{"name": "a"}, {"name": "a"}]), "pins: 'a' stands twice"),
        (spoilt("cables", value=[]), "cables has 0 entries; want 1 to 64"),
        (spoilt("motors", "spare", value=1e-3), "motor 'spare' winds up no cable"),
        (spoilt("motors", "pitch", value=-1.0), "pitch.radius is -1.0; want a number from 1e-12"),
        (spoilt("pins", "pitch", "inertia", value=0.0), "inertia is 0.0; want a number from 1e-12"),
        (spoilt("contact", "stiffness", value=0), "stiffness is 0; want a number above 0"),
        (spoilt("arms", "pitch", value={"nose": 1.0}), "no joint called 'nose'"),
    ],
)
def test_what_cannot_be_is_refused(values, told):
    with pytest.raises(RobotError, match=told) as error:
        schema.read(CableMechanism, values, "mechanism", RobotError)
    assert "\n" not in str(error.value)


def test_a_coupling_that_cannot_be_inverted_is_refused():
    values = plain()
    for cable in values["cables"][2:4]:  # the first jaw's cables turn the pitch alone
        cable["moments"] = {"pitch": cable["sign"] * 2e-3}
    with pytest.raises(RobotError, match="3 motors to 3 joints cannot be inverted"):
        schema.read(CableMechanism, values, "mechanism", RobotError)


def test_cables_turn_the_joints_in_their_order_and_no_slide():
    values, mechanism = get_robot("wrist").to_dict(), plain()
    mechanism["pins"] = {name: mechanism["pins"][name] for name in ("jaw1", "pitch", "jaw2")}
    with pytest.raises(RobotError, match="pins jaw1, pitch, jaw2; want one for each joint, in ord"):
        Robot.from_dict({**values, "mechanism": mechanism})
    values["joints"][0] |= {"kind": "prismatic"}
    with pytest.raises(RobotError, match="joint 'pitch' is prismatic; cables here turn revolute"):
        Robot.from_dict(values)


TABLE_1 = Forceps()


def test_a_forceps_is_a_mechanism_of_two_cables():
    turn, count = 2 * math.pi * 35.0, 2 * math.pi / 4000  # of the wheel, of the motor's encoder
    assert turn / TABLE_1.motor_per_jaw == pytest.approx(2 * math.pi * 9.75 / 4.0)
    assert math.degrees(count / TABLE_1.motor_per_jaw) == pytest.approx(0.00627, abs=1e-5)
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
        ("jaw_radius", -4e-3, "jaw_radius is .*from 0.001 to 0.02"),
        ("wheel_radius", math.nan, "wheel_radius is .*from 0.001 to 0.1"),
        ("gear_ratio", 0.5, "gear_ratio is .*from 1 to 1000"),
        ("spring_stiffness", "stiff", "spring_stiffness is .*from 10 to 10000"),
        ("cable", 1.0, "no key called"),
    ],
)
def test_a_forceps_that_cannot_be_is_refused(name, value, rule):
    with pytest.raises(RobotError, match=f"mechanism: {rule}"):
        schema.read(Forceps, {name: value}, "mechanism", RobotError)
