"""Tests of truejoint.robots.blocks."""

import numpy as np
import pytest

from truejoint.errors import CommandRefused
from truejoint.robots import get_robot
from truejoint.robots.blocks import checked_rows, checked_vector

ROBOT = get_robot("raven2", "left")
HOME = ROBOT.home


@pytest.mark.parametrize("value", [0.1, [0.1] * 6, [0.1] * 8, [[0.1] * 7], []])
def test_wrong_shape_is_refused(value):
    with pytest.raises(CommandRefused, match=r"servo_jp refused: got shape .* want 7 values"):
        checked_vector(ROBOT, value, "servo_jp")


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("joint", range(7))
def test_values_that_are_not_finite_are_refused_by_name(bad, joint):
    rows = np.tile(HOME, (5, 1))
    rows[3, joint] = bad
    name = ROBOT.joint_names[joint]
    with pytest.raises(CommandRefused, match=f"stream refused: {name} is {bad} at sample 3 of 5"):
        checked_rows(ROBOT, rows, "stream")
