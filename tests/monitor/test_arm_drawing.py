"""Tests of truejoint.monitor.arm_drawing."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from truejoint.crtk.cartesian import pose
from truejoint.errors import RobotError
from truejoint.monitor.arm_drawing import ArmDrawing, can_draw
from truejoint.robots import get_robot
from truejoint.robots.robot import read_robot

DRAWN = ["raven2", "dvrk_psm"]
TWO_LINKS = """
name = "two_links"
joints = [{ name = "a", unit = "deg" }, { name = "b", unit = "deg" }]
[kinematics]
unit = "deg"
axes = [{ d = 0.2 }, { alpha = 90, a = 0.3, d = 0.1 }]
"""


def _rows(robot, seed=0):
    rng = np.random.default_rng(seed)
    return robot.home + rng.uniform(-0.1, 0.1, (5, len(robot.joints)))


@pytest.mark.parametrize("name", DRAWN)
def test_the_last_ball_is_the_tool(name):
    robot = get_robot(name)
    rows = _rows(robot)
    drawing = ArmDrawing(robot).at(rows)
    assert drawing.balls[:, -1] == pytest.approx(pose(robot.kinematics, rows)[:, :3, 3], abs=1e-12)


@pytest.mark.parametrize("name", DRAWN)
def test_arcs_run_about_the_remote_centre_from_joint_to_joint(name):
    robot = get_robot(name)
    drawing = ArmDrawing(robot).at(_rows(robot))
    arcs = drawing.tubes[:, :16]  # two links of eight pieces
    radius = np.linalg.norm(arcs, axis=-1)
    assert radius == pytest.approx(np.full(radius.shape, radius[0, 0, 0]))
    assert arcs[:, 1:8, 0] == pytest.approx(arcs[:, :7, 1])
    assert arcs[:, [0, 8], 0] == pytest.approx(drawing.balls[:, :2])
    assert arcs[:, 15, 1] == pytest.approx(drawing.balls[:, 2])
    carriage, shaft_end = drawing.balls[0, 2], drawing.tubes[0, 16, 0]
    assert np.cross(carriage, shaft_end) == pytest.approx(np.zeros(3), abs=1e-9)


def test_links_of_raven_are_as_long_as_they_are():
    robot = get_robot("raven2")
    balls = ArmDrawing(robot).at([robot.home]).balls[0]
    unit = balls[:3] / np.linalg.norm(balls[:3], axis=1)[:, None]
    angles = np.degrees(np.arccos((unit[:-1] * unit[1:]).sum(axis=1)))
    assert angles == pytest.approx([75.0, 52.0])


def test_a_link_goes_along_its_lengths(tmp_path):
    (tmp_path / "robot.toml").write_text(TWO_LINKS)
    robot = read_robot(tmp_path / "robot.toml")
    drawing = ArmDrawing(robot).at([[0.0, 0.5]])
    lengths = np.linalg.norm(np.diff(drawing.tubes[0], axis=1)[:, 0], axis=1)
    assert lengths == pytest.approx([0.0, 0.2, 0.3, 0.1, 0.0])
    assert drawing.tubes[0, 1:, 0] == pytest.approx(drawing.tubes[0, :-1, 1])


def test_jaws_open_by_the_sum_of_their_joints():
    robot = get_robot("raven2")
    shut, opened = robot.home.copy(), robot.home.copy()
    shut[-2:], opened[-2:] = 0.0, [0.4, 0.3]
    tubes = ArmDrawing(robot).at([shut, opened]).tubes[:, -2:]
    a, b = (tubes[:, :, 1] - tubes[:, :, 0]).transpose(1, 0, 2)
    cosine = (a * b).sum(axis=1) / np.linalg.norm(a, axis=1) ** 2
    assert np.arccos(np.clip(cosine, -1, 1)) == pytest.approx([0.0, 0.7])


def test_each_jaw_of_a_wrist_points_where_its_joint_is():
    robot = get_robot("wrist", "420006")
    rows = np.radians([[0.0, 0.0, 0.0], [0.0, -10.0, 20.0], [30.0, -10.0, 20.0]])
    drawing = ArmDrawing(robot).at(rows)
    fingers = drawing.tubes[:, -2:, 1] - drawing.tubes[:, -2:, 0]
    lengths = np.linalg.norm(fingers, axis=-1)
    np.testing.assert_allclose(lengths, 0.01)  # the arm of a push at the tip about the jaws
    shut, apart, bent = fingers / lengths[..., None]
    np.testing.assert_allclose(shut, [[0, 0, 1], [0, 0, 1]], atol=1e-12)  # along the shaft
    turned = np.degrees(np.arccos(np.clip(apart[:, 2], -1.0, 1.0)))
    np.testing.assert_allclose(sorted(turned), [10.0, 20.0])
    # Bent, they are turned about the axis of the pitch, 9.1 mm before theirs.
    np.testing.assert_allclose(apart[0] @ apart[1], bent[0] @ bent[1], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(drawing.balls[2, -1] - [0.0, 0.0, 0.03]), 9.1e-3)


@pytest.mark.parametrize("name", DRAWN)
def test_cylinders_lie_on_their_tubes(name):
    robot = get_robot(name)
    drawing = ArmDrawing(robot).at(_rows(robot))
    drawing.tubes[0, 0] = [[0, 0, 0], [0, 0, -0.2]]  # against its own axis: half a turn
    positions, wxyz, scales = drawing.cylinders()
    turn = Rotation.from_quat(np.roll(wxyz, -1, axis=-1).reshape(-1, 4))
    along = turn.apply([0.0, 0.0, 1.0]).reshape(positions.shape) * scales[..., 2:]
    assert positions + 0.5 * along == pytest.approx(drawing.tubes[..., 1, :], abs=2e-5)
    assert positions - 0.5 * along == pytest.approx(drawing.tubes[..., 0, :], abs=2e-5)


def test_without_kinematics_nothing_is_drawn():
    robot = get_robot("forceps")
    assert not can_draw(robot)
    with pytest.raises(RobotError, match="not known: nothing to draw"):
        ArmDrawing(robot)
