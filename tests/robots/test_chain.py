"""Compiled kinematics against products of plain homogeneous matrices."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from truejoint.errors import RobotError
from truejoint.robots import get_robot
from truejoint.robots.chain import SerialChain, reach
from truejoint.robots.parts import Axis

angle = st.floats(-np.pi, np.pi)
length = st.floats(-0.5, 0.5)
axis = st.builds(Axis, angle, length, length, angle, st.sampled_from(["revolute", "prismatic"]))


@pytest.fixture(params=[("raven2", "left"), ("raven2", "right"), ("dvrk_psm", "")], ids="-".join)
def chain(request):
    kinematics = get_robot(*request.param).kinematics
    assert isinstance(kinematics, SerialChain)
    return kinematics


def matrix_of(axis, value):
    """Rx(alpha) Tx(a) Rz(theta) Tz(d), each factor written out."""
    turn_x, shift_x, turn_z, shift_z = (np.eye(4) for _ in range(4))
    turn_x[:3, :3] = Rotation.from_euler("x", axis.alpha).as_matrix()
    shift_x[0, 3] = axis.a
    prismatic = axis.kind == "prismatic"
    turn_z[:3, :3] = Rotation.from_euler("z", axis.theta + value * (not prismatic)).as_matrix()
    shift_z[2, 3] = axis.d + value * prismatic
    return turn_x @ shift_x @ turn_z @ shift_z


def frames_of(chain, joint):
    pose, frames = np.eye(4), []
    for axis, value in zip(chain.axes, chain.axis_from_joint @ joint, strict=True):
        pose = pose @ matrix_of(axis, value)
        frames.append(pose)
    return frames


@settings(max_examples=50, deadline=None)
@given(st.lists(axis, min_size=1, max_size=7), st.integers(0, 2**32 - 1))
def test_any_chain_is_the_product_of_its_matrices(axes, seed):
    random = np.random.default_rng(seed)
    chain = SerialChain(tuple(axes), random.normal(size=(len(axes), 3)))
    joint = random.normal(size=3)
    expected = frames_of(chain, joint)
    np.testing.assert_allclose(chain.forward(joint), expected[-1], atol=1e-12)
    np.testing.assert_allclose(chain.link_frames(joint), expected, atol=1e-12)


def test_robot_is_the_product_of_its_matrices(chain):
    joints = np.random.default_rng(1).uniform(-1, 1, (20, 7))
    for joint, pose in zip(joints, chain.forward(joints), strict=True):
        expected = frames_of(chain, joint)[-1]
        expected[:3, :3] = expected[:3, :3] @ chain.tool_rotation
        np.testing.assert_allclose(pose, expected, atol=1e-14)


def test_jacobian_is_the_derivative_of_the_pose(chain):
    joints = np.random.default_rng(3).uniform(-1, 1, (10, 7))
    step = 1e-6
    for joint, jacobian in zip(joints, chain.jacobian(joints), strict=True):
        ahead, behind = (
            chain.forward(joint + step * np.eye(7)),
            chain.forward(joint - step * np.eye(7)),
        )
        linear = (ahead[:, :3, 3] - behind[:, :3, 3]) / (2 * step)
        turn = ahead[:, :3, :3] @ behind[:, :3, :3].transpose(0, 2, 1)
        angular = Rotation.from_matrix(turn).as_rotvec() / (2 * step)
        np.testing.assert_allclose(jacobian, np.hstack([linear, angular]).T, atol=1e-8)


def test_any_leading_shape_is_kept(chain):
    joints = np.random.default_rng(4).uniform(-1, 1, (3, 2, 7))
    n_axes = len(chain.axes)
    assert chain.forward(joints).shape == (3, 2, 4, 4)
    assert chain.link_frames(joints).shape == (3, 2, n_axes, 4, 4)
    assert chain.jacobian(joints).shape == (3, 2, 6, 7)
    assert chain.forward(joints[:0]).shape == (0, 2, 4, 4)
    strided = np.asfortranarray(joints)[::2, 1]
    np.testing.assert_array_equal(chain.forward(strided), chain.forward(joints)[::2, 1])


@pytest.mark.parametrize("shape", [(), (6,), (7, 6), (8,)])
def test_wrong_number_of_joints_is_refused(chain, shape):
    for method in (chain.forward, chain.link_frames, chain.jacobian):
        with pytest.raises(RobotError, match="last dimension must be the 7 joints"):
            method(np.zeros(shape))


def test_missing_joint_spoils_only_what_it_moves(chain):
    joint = np.full(7, 0.3)
    joint[6] = np.nan
    frames = chain.link_frames(joint)
    assert np.isfinite(frames[:5]).all()
    moves_tool = chain.axis_from_joint[:, 6].any()
    assert np.isnan(chain.forward(joint)).any() == moves_tool


def test_a_chain_up_to_a_joint_ends_with_the_link_that_it_moves(chain):
    joint = np.linspace(0.2, 0.5, chain.axis_from_joint.shape[1])
    frames = frames_of(chain, joint)
    for k in range(5):
        np.testing.assert_allclose(chain.up_to(k).forward(joint), frames[k], atol=1e-12)
        assert chain.up_to(k).crtk_from_base is chain.crtk_from_base
        # A joint further out moves nothing of it.
        assert not chain.up_to(k).jacobian(joint)[:, k + 1 :].any()
    still = SerialChain(chain.axes[:2], np.eye(2, 3))
    with pytest.raises(RobotError, match="moves no axis"):
        still.up_to(2)


@pytest.mark.parametrize("name", ["raven2", "dvrk_psm"])
def test_the_tip_is_where_it_was_wanted(name):
    robot, rng = get_robot(name), np.random.default_rng(0)
    seed = robot.home.copy()
    seed[robot.index(robot.positioning[2:3])] += 0.05
    there = np.tile(seed, (5, 1))
    columns = robot.index(robot.positioning)
    there[:, columns[:2]] += rng.uniform(-0.2, 0.2, (5, 2))
    points = robot.kinematics.forward(there)[:, :3, 3]
    joint, reached = reach(robot.kinematics, columns[:3], points, seed)
    assert reached.all()
    assert robot.kinematics.forward(joint)[:, :3, 3] == pytest.approx(points, abs=2e-9)
    still = [k for k in range(len(seed)) if k not in columns[:3]]
    assert (joint[:, still] == seed[still]).all()


def test_points_out_of_reach_and_unknown_geometry_are_told():
    robot = get_robot("raven2")
    near = robot.kinematics.forward(robot.home)[:3, 3]
    shoulder_axis = np.array([0.0, 0.0, 0.1])
    columns = robot.index(robot.positioning)
    _, reached = reach(robot.kinematics, columns, [near, shoulder_axis], robot.home)
    assert reached.tolist() == [True, False]
    with pytest.raises(RobotError, match="kinematics of davinci_grasper"):
        get_robot("davinci_grasper").known_kinematics("points")
