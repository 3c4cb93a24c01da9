"""What holds for every robot, and how a robot is found by name."""

import subprocess
import sys

import numpy as np
import pytest

from truejoint.errors import RobotError
from truejoint.robots import arm_names, get_robot, robot_names, robot_of
from truejoint.robots.cable_mechanism import Forceps

ARMS = [*((name, "") for name in robot_names()), ("raven2", "right"), ("dvrk_psm", "psm2")]


@pytest.fixture(params=ARMS, ids=lambda pair: "-".join(filter(None, pair)))
def robot(request):
    return get_robot(*request.param)


def test_robot_carries_the_name_it_is_found_by(robot):
    assert get_robot(robot.name, robot.arm) is robot


def test_limits_are_in_si(robot):
    for joint in robot.joints:
        longest = 1.0 if joint.unit == "m" else 3 * np.pi  # a master's roll
        for limit in (joint.lower, joint.upper):
            assert abs(limit) <= longest or np.isinf(limit)


def test_kinematics_and_transmission_take_the_robots_joint_vector(robot):
    n = len(robot.joints)
    if robot.transmission is not None:
        assert robot.transmission.matrix.shape == (n, n)
    if robot.kinematics is not None:
        assert robot.kinematics.forward(robot.home).shape == (4, 4)
        assert robot.kinematics.jacobian(robot.home).shape == (6, n)


@pytest.mark.parametrize(
    ("name", "arm", "same_as"),
    [
        ("raven2", "", ("raven2", "left")),
        ("RAVEN2", "Gold", ("raven2", "left")),
        ("raven2", "green", ("raven2", "right")),
        (" dVRK_PSM", "PSM2 ", ("dvrk_psm", "psm2")),
    ],
)
def test_other_names_of_an_arm_find_it(name, arm, same_as):
    assert get_robot(name, arm) is get_robot(*same_as)


def test_every_name_of_an_arm_is_one_of_the_robot():
    for name in robot_names():
        assert all(get_robot(name, arm).name == name for arm in arm_names(name))
    assert arm_names("nothing") == ()
    assert get_robot("dvrk_psm").arm == "", "one without a name is not taken for a named one"


def test_a_robot_that_a_file_carries_is_the_one_of_its_name():
    values = get_robot("raven2", "right").to_dict()
    assert robot_of(values, "a recording") is get_robot("raven2", "right")
    other = {**values, "name": "mine"}
    assert robot_of(other, "a recording").to_dict()["name"] == "mine"
    with pytest.raises(RobotError, match="no robot called 'mine'"):
        get_robot("mine")
    forceps = get_robot("forceps").to_dict()
    forceps["mechanism"] = {"jaw_radius": 6e-3}
    del forceps["transmission"]
    held = robot_of(forceps, "a recording")
    assert Forceps.of(held.mechanism).jaw_radius == 6e-3
    assert held.joints == get_robot("forceps").joints
    with pytest.raises(RobotError, match=r"^a recording: dvrk_psm: has no arm called 'psm9'"):
        robot_of(get_robot("dvrk_psm").to_dict() | {"arm": "psm9"}, "a recording")
    with pytest.raises(RobotError, match=r"^a recording: 'joints' is missing"):
        robot_of({"name": "raven2"}, "a recording")


@pytest.mark.parametrize("name", ["", "raven", "os", "robot", "catalogue", "../raven2"])
def test_unknown_robot_is_refused_with_the_known_ones(name):
    with pytest.raises(
        RobotError, match=r"raven2, wrist, bros, .* kuka_kr300, or the path of a robot file"
    ) as error:
        get_robot(name)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("name", "arm", "advice"),
    [("raven2", "middle", "left, gold, right, green"), ("bros", "left", "leave the arm empty")],
)
def test_unknown_arm_is_refused_with_the_known_ones(name, arm, advice):
    with pytest.raises(RobotError, match=advice):
        get_robot(name, arm)


@pytest.mark.parametrize("given", [(3,), (None,), ("raven2", None)])
def test_what_is_no_name_is_refused(given):
    with pytest.raises(RobotError, match=f"robot {given[0]!r}, arm .*: give the robot's name"):
        get_robot(*given)


def test_robot_without_kinematics_does_not_import_the_compiler():
    code = (
        "import sys; from truejoint.robots import get_robot; get_robot('davinci_grasper'); "
        "sys.exit('numba' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0  # noqa: S603 - our own code
