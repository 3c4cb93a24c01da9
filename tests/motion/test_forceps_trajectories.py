import math

import numpy as np
import pytest

from truejoint.motion.forceps_trajectories import (
    DURATION,
    RAMP,
    calibration_trajectory,
    verification_trajectory,
)
from truejoint.robots import get_robot


def after_ramp(trajectory):
    late = trajectory.times >= RAMP
    return trajectory.times[late], trajectory.positions[late, 0]


def test_the_calibration_motion_is_equation_27():
    t, jaw = after_ramp(calibration_trajectory())
    np.testing.assert_allclose(jaw, -50 * math.pi / 180 * np.sin(0.3 * t), atol=1e-12)
    assert np.degrees(np.abs(jaw).max()) == pytest.approx(50.0, abs=1e-4)


def test_the_verification_motion_is_equation_28_as_printed():
    t, jaw = after_ramp(verification_trajectory())
    degrees = (
        -30 * np.sin(0.3 * t)
        - 15 * np.sin(0.5 * t)
        - 10 * np.sin(0.2 * t)
        - 10 * np.sin(0.2 * t)
        - 10 * np.sin(t)
    )
    np.testing.assert_allclose(np.degrees(jaw), degrees, atol=1e-10)
    assert np.abs(degrees).max() == pytest.approx(51.2, abs=0.1)
    speed = np.abs(np.gradient(degrees, t)).max()
    assert 25.0 < speed < 30.5
    assert np.count_nonzero(np.diff(np.sign(np.diff(degrees)))) == 18


@pytest.mark.parametrize("make", [calibration_trajectory, verification_trajectory])
def test_they_swell_from_rest_and_last_a_common_period(make):
    trajectory = make()
    assert trajectory.positions[0, 0] == 0.0
    speed = np.gradient(trajectory.positions[:, 0], trajectory.times)
    assert abs(speed[0]) < 1e-5
    assert np.degrees(np.abs(np.gradient(speed, trajectory.times)).max()) < 90.0
    assert trajectory.times[-1] == pytest.approx(DURATION + RAMP, abs=1e-3)
    trajectory.check_within(get_robot("forceps"))
    shorter = make(10.0)
    np.testing.assert_array_equal(shorter.positions, trajectory.positions[: len(shorter)])
