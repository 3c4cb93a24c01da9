"""Tests of truejoint.motion.trajectory."""

from functools import partial

import numpy as np
import pytest

from truejoint.errors import TrajectoryError
from truejoint.motion import Trajectory, designed_motion, nested_motion, random_motion, zigzag
from truejoint.motion.forceps_trajectories import sine_trajectory
from truejoint.robots import get_robot

ROBOT, FORCEPS, KUKA = (get_robot(name) for name in ("raven2", "forceps", "kuka_kr300"))
JOINTS, UNITS = ("shoulder", "elbow", "insertion"), ("rad", "rad", "m")
INSIDE = np.array([[0.5, 1.2, 0.35], [0.6, 1.3, 0.40]])


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"joints": ("a", "a", "b")}, "distinct names"),
        ({"joints": ("t", "a", "b")}, "not t"),
        ({"joints": ("a,b", "c", "d")}, "letters, digits and _"),
        ({"joints": (), "units": (), "positions": np.empty((2, 0))}, "distinct names"),
        ({"units": ("rad", "rad")}, "for each joint a unit"),
        ({"units": ("rad", "rad", "mm")}, "a unit, 'rad' or 'm'"),
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


@pytest.mark.parametrize(
    ("make", "arguments", "match"),
    [
        *((zigzag, (ROBOT, "J1", sparsity), r"sparsity .* must be within")
          for sparsity in (0.0, -0.25, 1.01, 0.019, np.nan, np.inf)),
        *((zigzag, (ROBOT, direction), "known: J1, J2, J3, J1-J2")
          for direction in ("J4", "J2-J1", "shoulder", "")),
        (zigzag, (KUKA, "J1"), "no calibration workspace is known for kuka_kr300"),
        *((random_motion, (ROBOT, duration), "must be within") for duration in (0.0, np.nan, 1e6)),
        (partial(random_motion, rate=0.5), (ROBOT, 60.0), "must be within"),
        (random_motion, (ROBOT, 60.0, -1), "seed is -1"),
        (partial(random_motion, profile="sine"), (ROBOT,), "no profile called 'sine'; did you"),
        (random_motion, (KUKA,), "no calibration workspace is known for kuka_kr300"),
        *((nested_motion, (FORCEPS, duration), "must be within") for duration in (5.0, np.nan)),
        (partial(nested_motion, rate=0.0), (FORCEPS,), "must be within"),
        (nested_motion, (ROBOT,), "has 3: use a zig-zag"),
        *((designed_motion, (ROBOT, duration), "must be within") for duration in (5, np.nan, 1e6)),
        (designed_motion, (ROBOT, 150.0, -1), "seed is -1"),
        (designed_motion, (KUKA,), "no calibration workspace"),
        *((sine_trajectory, (((0.1, 1.0),), duration), "must be within")
          for duration in (0.0, np.nan, 1e6)),
        *((sine_trajectory, (tones,), "at least one, all finite")
          for tones in ((), ((np.nan, 1.0),))),
    ],
)  # fmt: skip
def test_a_motion_that_cannot_be_is_refused(make, arguments, match):
    with pytest.raises(TrajectoryError, match=match):
        make(*arguments)
