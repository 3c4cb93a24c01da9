"""A simulated tracker errs as it says."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from truejoint.robots import get_robot
from truejoint.simulation.tracker import SimulatedTracker


def test_readings_are_the_markers_place_but_for_what_it_says() -> None:
    robot = get_robot("raven2", "left")
    t = np.arange(0.0, 100.0, 0.01)
    joint = np.tile(robot.home, (len(t), 1))
    joint[:, 1] += 0.2 * np.sin(0.1 * t)
    base, marker = np.eye(4), np.eye(4)
    base[:3, :3], base[:3, 3] = Rotation.from_rotvec([0.1, 0.2, 0.3]).as_matrix(), (1.0, 2.0, 3.0)
    marker[:3, 3] = 0.0, 0.0, 0.02
    tracker = SimulatedTracker(2e-4, 3e-3, rate=50.0, delay=0.1, lost=0.1, strays=0.02)
    stamps, position, turns = tracker.see(robot.kinematics, t, joint, base, marker, seed=3)
    assert stamps[0] == pytest.approx(0.1)
    assert np.median(np.diff(stamps)) == pytest.approx(0.02)
    lost = np.isnan(position).any(axis=1)
    assert 0.02 < lost.mean() < 0.25
    rows = np.searchsorted(t, stamps - 0.1 - 1e-9)
    true = np.array([base @ robot.kinematics.forward(joint[row]) @ marker for row in rows])
    off = position[~lost] - true[~lost, :3, 3]
    near = np.abs(off).max(axis=1) < 2e-3
    assert (~near).mean() == pytest.approx(0.02, abs=0.01)
    assert off[near].std() == pytest.approx(2e-4, rel=0.05)
    assert turns is not None
    wobble = Rotation.from_matrix(true[:, :3, :3]).inv() * Rotation.from_quat(turns)
    assert wobble.as_rotvec().std() == pytest.approx(3e-3, rel=0.05)
    again = tracker.see(robot.kinematics, t, joint, base, marker, seed=3)
    np.testing.assert_array_equal(position, again[1])
