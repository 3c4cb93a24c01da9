"""Tests of the calibration workspace."""

import numpy as np
import pytest

from truejoint.errors import RobotError
from truejoint.robots import Transmission, Workspace, get_robot, robot_names

BOX = Workspace(("a", "b"), np.array([-1.0, 0.1]), np.array([1.0, 0.3]), np.array([0.2, 0.01]))


def test_centre_and_extent():
    assert BOX.centre == pytest.approx([0.0, 0.2])
    assert BOX.extent == pytest.approx([2.0, 0.2])


def test_a_random_motion_defaults_to_a_tenth_of_the_range_and_the_upper_half_of_the_speed():
    np.testing.assert_allclose(BOX.swings, [[0.2, 0.02], [0.1, 0.005], [0.2, 0.01], [0.02, 0.001]])
    raven = get_robot("raven2").workspace
    np.testing.assert_array_equal(
        raven.swings, [raven.margin, raven.slowest, raven.fastest, raven.crawl]
    )


@pytest.mark.parametrize("name", [n for n in robot_names() if get_robot(n).workspace])
def test_every_workspace_lies_within_its_robots_limits(name):
    robot = get_robot(name)
    space = robot.workspace
    columns = robot.index(space.joints)
    margin, slowest, fastest, crawl = space.swings
    assert (robot.lower[columns] <= space.lower).all()
    assert (space.upper <= robot.upper[columns]).all()
    assert (2 * margin < space.extent).all()
    assert ((crawl > 0) & (crawl < slowest) & (slowest <= fastest)).all()
    top = np.array([robot.joints[column].max_speed for column in columns])
    assert ((space.speed > 0) & (space.speed < top)).all()


def test_lists_are_as_good_as_arrays():
    assert Workspace(("a",), [0.0], [1.0], [0.1]).extent == pytest.approx([1.0])
    assert Transmission([[2.0]]).motor_from_joint([3.0]) == pytest.approx([6.0])
    geared = Transmission(np.eye(2), np.array([2.0, 4.0]))
    assert geared.joint_effort([1.0, 1.0]) == pytest.approx([0.5, 0.25])


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (([0.0, 0.0], [1.0], [0.1]), r"lower is \[0.0, 0.0\]; want a finite number for each of a"),
        (([0.0], [np.inf], [0.1]), "upper is"),
        (([1.0], [0.0], [0.1]), "workspace.a: lower must be below upper"),
        (([0.0], [1.0], [0.0]), "speed above 0"),
        ((["low"], [1.0], [0.1]), "workspace: lower: could not convert"),
    ],
)
def test_a_workspace_that_is_none_is_refused(rows, said):
    with pytest.raises(RobotError, match=said):
        Workspace(("a",), *rows)
