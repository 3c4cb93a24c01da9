"""RAVEN-II kinematics against recorded poses, known poses and its own inverse."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from truejoint.errors import RobotError
from truejoint.recordings.datasets import read_dataset
from truejoint.robots import get_robot

SIDES = ["left", "right"]

# uw-biorobotics/raven2:params/raven_{gold,green}_crtk.yaml: joints after homing and the pose
# that the robot then reports, rounded by its authors.
HOMED = {
    "left": (
        [0.523, 1.584, 0.4002, 0.0715, 0.0950, 0.7537, 0.852],
        [0.0239, -0.0144, -0.0779],
        [-0.14, 0.636, 0.02, 0.76],
    ),
    "right": (
        [0.524, 1.583, 0.400, 0.0660, 0.0598, 0.736, 0.844],
        [0.0242, 0.0141, -0.0780],
        [0.12, 0.62, 0.07, 0.77],
    ),
}

fractions = st.lists(st.floats(0, 1), min_size=7, max_size=7).map(np.array)
nudges = st.lists(st.floats(-1, 1), min_size=7, max_size=7).map(np.array)


@pytest.fixture(params=SIDES)
def arm(request):
    return get_robot("raven2", request.param).kinematics


def within_limits(side, fraction):
    robot = get_robot("raven2", side)
    return robot.lower + fraction * (robot.upper - robot.lower)


def crtk_pose(side, joints):
    arm = get_robot("raven2", side).kinematics
    return arm.crtk_from_base @ arm.forward(joints)


def pose_away_from_singularities(kinematics, joint):
    """Pose of joints whose inverse exists: at the remote centre the shaft has no direction."""
    pose = kinematics.forward(joint)
    tool, jaw_axis = pose[:3, 3], pose[:3, 2]
    across = tool - (tool @ jaw_axis) * jaw_axis
    distance = np.linalg.norm(across)
    assume(distance > 1e-3)
    for bend in (-1, 1):  # neither way of bending the wrist puts it at the remote centre
        assume(np.linalg.norm(tool + bend * 0.013 * across / distance) > 1.5e-3)
    return pose


def test_tool_is_where_the_recording_says(dataset_folder):
    dataset_folder("raven2_motor_side")  # or skip
    (recording,) = read_dataset("raven2_motor_side", "ravenJoint_pose_recorder")
    kinematics, joints = recording.robot.kinematics, recording.robot.joint_names
    for quantity, tool in (("measured", "tool"), ("setpoint", "tool_setpoint")):
        found = kinematics.forward(recording.columns(quantity, joints))[:, :3, 3]
        assert np.abs(found - recording.columns(tool, "xyz")).max() < 2e-6


@pytest.mark.parametrize("side", SIDES)
def test_homed_arm_reports_the_known_crtk_pose(side):
    joints, position, quaternion = HOMED[side]
    pose = crtk_pose(side, joints)
    np.testing.assert_allclose(pose[:3, 3], position, atol=6e-4)
    off = Rotation.from_quat(quaternion).inv() * Rotation.from_matrix(pose[:3, :3])
    assert np.degrees(off.magnitude()) < 4


def test_arms_mirror_each_other():
    joints = np.random.default_rng(6).uniform([0.0, 0.8, 0.25], [1.5, 2.3, 0.55], (50, 3))
    joints = np.hstack([joints, np.zeros((50, 4))])
    left, right = (crtk_pose(side, joints)[:, :3, 3] for side in ("left", "right"))
    np.testing.assert_allclose(left * [1, -1, 1], right, atol=1e-12)


def test_shaft_passes_through_the_remote_centre(arm):
    joints = np.random.default_rng(7).uniform(-1, 1, (50, 7))
    wrist = arm.link_frames(joints)[:, 4]
    shaft = arm.link_frames(joints)[:, 2, :3, 2]
    np.testing.assert_allclose(np.cross(wrist[:, :3, 3], shaft), 0, atol=1e-14)
    np.testing.assert_allclose(
        np.linalg.norm(wrist[:, :3, 3], axis=1), np.abs(joints[:, 2] - 0.47), atol=1e-14
    )


def test_jaws_opening_together_leave_the_tool_in_place(arm):
    jacobian = arm.jacobian([0.5, 1.5, 0.4, 0.2, 0.3, 0.4, 0.1])
    np.testing.assert_allclose(jacobian[:, 5], -jacobian[:, 6])


@settings(max_examples=100, deadline=None)
@given(side=st.sampled_from(SIDES), fraction=fractions, nudge=nudges)
def test_inverse_recovers_the_joints_from_a_seed_nearby(side, fraction, nudge):
    kinematics = get_robot("raven2", side).kinematics
    joint = within_limits(side, fraction)
    pose = pose_away_from_singularities(kinematics, joint)
    assume(abs(joint[2] - 0.47) > 5e-3)  # nearer, the other side of the centre is as near
    seed = joint + nudge * [0.03, 0.03, 2e-4, 0.03, 0.03, 0.0, 0.0]
    found = kinematics.inverse(pose, seed)
    np.testing.assert_allclose(found, joint, atol=1e-8)


@pytest.mark.parametrize("beside", [[0, 0, 0, 2 * np.pi, 0, 0, 0], [0, 0, 0, 0, 0, 0.3, 0.3]])
def test_inverse_takes_turns_and_the_opening_of_the_jaws_from_the_seed(arm, beside):
    joint = np.array([0.5, 1.5, 0.4, np.radians(-179), 0.2, 0.4, 0.1])
    found = arm.inverse(arm.forward(joint), joint + beside)
    np.testing.assert_allclose(found, joint + beside, atol=1e-12)


def test_shaft_along_the_shoulder_is_refused_in_one_line(arm):
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("y", 10 - 90, degrees=True).as_matrix()
    pose[:3, 3] = 0.1 * pose[:3, 0]
    with pytest.raises(RobotError, match="mm cannot be reached from where") as error:
        arm.inverse(pose, [0.5, 1.5, 0.4, 0, 0, 0, 0])
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda pose: pose[:3], "must be 4 x 4 and finite"),
        (lambda pose: pose * np.nan, "must be 4 x 4 and finite"),
        (lambda pose: 2 * pose, "not a rigid transform"),
        (lambda pose: pose @ np.diag([1.0, 1, -1, 1]), "not a rigid transform"),
        (lambda pose: pose + np.eye(4, k=-3), "not a rigid transform"),
    ],
    ids=["shape", "nan", "scaled", "mirrored", "bottom"],
)
def test_pose_that_is_none_is_refused(arm, change, message):
    seed = np.array([0.5, 1.5, 0.4, 0, 0, 0, 0])
    pose = arm.forward(seed)
    with pytest.raises(RobotError, match=message):
        arm.inverse(change(pose), seed)
    for bad in (np.zeros(6), np.full(7, np.inf)):
        with pytest.raises(RobotError, match="joint positions"):
            arm.inverse(pose, bad)
