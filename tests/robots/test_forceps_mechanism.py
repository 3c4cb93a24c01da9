import math

import numpy as np
import pytest

from truejoint.robots.forceps_mechanism import TABLE_1


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
