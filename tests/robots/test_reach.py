"""Joints that place the tip: they do, the others stay, and what is out of reach is said to be."""

from __future__ import annotations

import numpy as np
import pytest

from truejoint.errors import RobotError
from truejoint.robots import get_robot
from truejoint.robots.chain import reach


@pytest.mark.parametrize("name", ["raven2", "dvrk_psm"])
def test_the_tip_is_where_it_was_wanted(name):
    robot, rng = get_robot(name), np.random.default_rng(0)
    seed = robot.home.copy()
    seed[robot.index(robot.positioning[2:3])] += 0.05
    there = np.tile(seed, (5, 1))
    columns = robot.index(robot.positioning)
    there[:, columns[:2]] += rng.uniform(-0.2, 0.2, (5, 2))
    points = robot.kinematics.forward(there)[:, :3, 3]
    joint, reached = reach(robot, points, seed, robot.positioning[:3])
    assert reached.all()
    assert robot.kinematics.forward(joint)[:, :3, 3] == pytest.approx(points, abs=2e-9)
    still = [k for k in range(len(seed)) if k not in columns[:3]]
    assert (joint[:, still] == seed[still]).all()


def test_points_out_of_reach_and_unknown_geometry_are_told():
    robot = get_robot("raven2")
    near = robot.kinematics.forward(robot.home)[:3, 3]
    shoulder_axis = np.array([0.0, 0.0, 0.1])
    _, reached = reach(robot, [near, shoulder_axis], robot.home)
    assert reached.tolist() == [True, False]
    with pytest.raises(RobotError, match="kinematics of davinci_grasper"):
        reach(get_robot("davinci_grasper"), [near], [0.0])
