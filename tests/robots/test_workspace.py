"""Tests of the calibration workspace."""

import numpy as np
import pytest

from truejoint.robots import Workspace, get_robot, robot_names

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
