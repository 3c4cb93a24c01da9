"""Tests of truejoint.motion.trajectory."""

import numpy as np
import pytest

from truejoint.errors import TrajectoryError
from truejoint.motion import Trajectory
from truejoint.robots import get_robot

ROBOT = get_robot("raven2", "left")
JOINTS, UNITS = ("shoulder", "elbow", "insertion"), ("rad", "rad", "m")
INSIDE = np.array([[0.5, 1.2, 0.35], [0.6, 1.3, 0.40]])


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"joints": ("a", "a", "b")}, "distinct names"),
        ({"joints": ("t", "a", "b")}, "not t"),
        ({"joints": ("a,b", "c", "d")}, "letters, digits and _"),
        ({"joints": (), "units": (), "positions": np.empty((2, 0))}, "distinct names"),
        ({"units": ("rad", "rad")}, "one for each joint"),
        ({"units": ("rad", "rad", "mm")}, "must be 'rad' or 'm'"),
        ({"positions": INSIDE[:1]}, "at least 2 rows"),
        ({"positions": INSIDE[:, :2]}, r"shape \(2, 2\)"),
        ({"positions": INSIDE * [1, np.nan, 1]}, "elbow is nan in row 0"),
        ({"times": np.array([0.0])}, "one for each row"),
        ({"times": np.array([0.0, np.inf])}, "finite"),
        ({"times": np.array([1.0, 1.0])}, "row 1 has 1 s after 1 s"),
    ],
)
def test_malformed_trajectories_are_refused(change, match):
    values = {"joints": JOINTS, "units": UNITS, "positions": INSIDE} | change
    with pytest.raises(TrajectoryError, match=match):
        Trajectory(**values)


@pytest.mark.parametrize(("joint", "row"), [(0, 0), (1, 1), (2, 1)])
@pytest.mark.parametrize("side", [-1, 1])
def test_leaving_the_limits_is_refused_in_peoples_units(joint, row, side):
    positions = INSIDE.copy()
    edge = ROBOT.upper if side > 0 else ROBOT.lower
    positions[row, joint] = edge[joint]
    Trajectory(JOINTS, UNITS, positions).check_within(ROBOT)
    positions[row, joint] += side * 1e-6
    unit = "mm" if joint == 2 else "deg"
    with pytest.raises(TrajectoryError, match=f"{JOINTS[joint]} spans .* {unit}, outside"):
        Trajectory(JOINTS, UNITS, positions).check_within(ROBOT)


def test_other_units_are_refused():
    with pytest.raises(TrajectoryError, match="insertion is in rad, but raven2"):
        Trajectory(JOINTS, ("rad",) * 3, INSIDE).check_within(ROBOT)
