"""Tests of the zig-zags, in all directions and at all sparsities."""

import numpy as np
import pytest

from truejoint.errors import RobotError
from truejoint.motion import DIRECTIONS, nominal_duration, workspace_of, zigzag
from truejoint.motion.calibration_motions import zigzag_box
from truejoint.robots import Workspace, get_robot

ROBOT = get_robot("raven2", "left")
SPACE = workspace_of(ROBOT)
SPARSITIES = (1 / 2, 0.33, 1 / 4, 1 / 5, 1 / 6)
every_direction = pytest.mark.parametrize("direction", DIRECTIONS)

# Range of a joint as a share of the workspace's, by how many joints move (peng2024 II-B).
SHARE = {1: 1 / np.sqrt(3), 2: np.sqrt(2 / 3), 3: 1.0}


def lattice(path, direction):
    """Corners in coordinates of the box, 0 to 1 along stroke, row and layer."""
    shares = (path.positions - SPACE.centre) / SPACE.extent
    return np.linalg.solve(zigzag_box(direction), shares.T).T + 0.5


def moving(direction):
    return [int(part[1]) - 1 for part in direction.split("-")]


@every_direction
def test_every_box_has_the_same_volume_and_strokes_of_the_named_joints(direction):
    box = zigzag_box(direction)
    assert abs(np.linalg.det(box)) == pytest.approx(27**-0.5, rel=1e-13)
    assert set(np.flatnonzero(box[:, 0])) == set(moving(direction))
    assert (box[:, 0] >= 0).all()
    if len(moving(direction)) < 3:  # a turned cube
        assert 3.0 * box.T @ box == pytest.approx(np.eye(3), abs=1e-14)
    for arm in ("left", "right"):
        robot = get_robot("raven2", arm)
        zigzag(robot, direction).check_within(robot)


def test_three_joints_are_nearly_a_turned_cube():
    box = zigzag_box("J1-J2-J3")
    lengths = np.linalg.norm(box, axis=0)
    assert lengths == pytest.approx(np.full(3, 1.0133 / np.sqrt(3)), rel=1e-4)
    cosines = (box.T @ box)[np.triu_indices(3, 1)] / lengths[0] ** 2
    assert np.rad2deg(np.arccos(-np.abs(cosines))) == pytest.approx(98.8, abs=0.1)


def test_the_published_box_of_three_joints_is_the_laboratorys():
    # The constants that run_snake_generator.py of uw-biorobotics/raven2_CRTK_Python_controller
    # rescales with, up to the overshoot of its last steps.
    path = zigzag(ROBOT, "J1-J2-J3", 1 / 4, published=True)
    shares = (path.positions - SPACE.centre) / SPACE.extent
    extent = np.ptp(shares, axis=0)
    assert extent[[0, 2]] == pytest.approx([1.0, 1.0])
    assert extent[1] == pytest.approx((0.5 + 0.5 + np.sqrt(0.5)) / np.sqrt(3))
    steps = np.abs(np.diff(shares, axis=0))
    assert steps[0] == pytest.approx([0.8536 / 1.5, 0.5 / np.sqrt(3), 0.1464 / 1.5], abs=1e-4)
    assert len(path) == len(zigzag(ROBOT, "J1-J2-J3", 1 / 4))
    same = zigzag(ROBOT, "J2-J3", 1 / 4, published=True)
    assert np.array_equal(same.positions, zigzag(ROBOT, "J2-J3", 1 / 4).positions)


@pytest.mark.parametrize("sparsity", SPARSITIES)
@every_direction
def test_bounds_are_exact_and_the_lattice_even_complete_and_continuous(direction, sparsity):
    n = round(1 / sparsity)
    path = zigzag(ROBOT, direction, sparsity)
    low, high = path.positions.min(axis=0), path.positions.max(axis=0)
    share = np.full(3, SHARE[1])
    share[moving(direction)] = SHARE[len(moving(direction))]
    assert (low + high) / 2 == pytest.approx(SPACE.centre, rel=1e-14)
    assert high - low == pytest.approx(SPACE.extent * share, rel=1e-13)
    corners = lattice(path, direction)
    assert len(path) == 2 * (n + 1) ** 2
    assert path.meta["sparsity"] == 1 / n
    assert corners.min() == pytest.approx(0.0, abs=1e-13)
    assert corners.max() == pytest.approx(1.0, abs=1e-13)
    steps = np.diff(corners, axis=0)
    # Every second line is a whole stroke, every line between one step along one other edge.
    expected = np.zeros_like(steps)
    expected[0::2, 0] = np.where(np.arange(len(steps[0::2])) % 2 == 0, 1.0, -1.0)
    assert steps[0::2] == pytest.approx(expected[0::2], abs=1e-12)
    across = np.abs(steps[1::2])
    assert across.max(axis=1) == pytest.approx(np.full(len(across), 1 / n), abs=1e-12)
    assert (np.count_nonzero(across > 1e-9, axis=1) == 1).all()
    # Each grid line is passed once.
    strokes = {tuple(np.rint(point[1:] * n).astype(int)) for point in corners[0::2]}
    assert strokes == {(row, layer) for row in range(n + 1) for layer in range(n + 1)}
    assert len(corners[0::2]) == len(strokes)


def test_durations_at_the_nominal_caps():
    # Path length over speed cap for the single-direction trajectories of
    # uw-biorobotics/raven2_CRTK_Python_controller, which has them in 13052 to 57066 points.
    minutes = [nominal_duration(zigzag(ROBOT, "J1", n), ROBOT) / 60 for n in SPARSITIES]
    assert minutes == pytest.approx([2.3, 3.7, 5.5, 7.6, 10.1], abs=0.06)


def test_another_robot_moves_in_a_workspace_of_its_own():
    psm = get_robot("dvrk_psm")
    joints = psm.joint_names[:3]
    lower, upper = np.array([-0.5, -0.4, 0.1]), np.array([0.5, 0.4, 0.2])
    space = Workspace(joints, lower, upper, np.full(3, 0.1))
    path = zigzag(psm, "J1-J3", 0.5, workspace=space)
    assert path.joints == joints
    assert path.units == ("rad", "rad", "m")
    assert path.positions.mean(axis=0) == pytest.approx(space.centre)


def test_a_workspace_in_degrees_and_millimetres_is_refused():
    space = ROBOT.workspace
    scale = np.array([np.rad2deg(1.0), np.rad2deg(1.0), 1e3])
    shown = Workspace(space.joints, space.lower * scale, space.upper * scale, space.speed * scale)
    with pytest.raises(RobotError, match=r"beyond what the joint can: 0 to 1\.57"):
        zigzag(ROBOT, "J1", workspace=shown)
