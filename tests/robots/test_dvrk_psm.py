"""dVRK PSM against its geometry and against recorded wrist positions."""

import numpy as np
import pytest

from truejoint.crtk.messages import profile_of
from truejoint.robots import get_robot
from truejoint.robots.chain import SerialChain


@pytest.fixture
def chain():
    kinematics = get_robot("dvrk_psm").kinematics
    assert isinstance(kinematics, SerialChain)
    return kinematics


def test_straight_tool_hangs_below_the_remote_centre(chain):
    pose = chain.forward([0, 0, 0.1, 0, 0, 0, 0])
    depth = 0.1 - 0.4318 + 0.4162 + 0.0091
    np.testing.assert_allclose(pose[:3, 3], [0, 0, -depth], atol=1e-15)


@pytest.mark.parametrize("yaw", [-0.7, 0.0, 1.2])
def test_wrist_meets_the_remote_centre_where_the_lengths_cancel(chain, yaw):
    insertion = -chain.axes[2].d - chain.axes[3].d
    frames = chain.link_frames([yaw, 0.4, insertion, 0.2, 0.5, -0.1, 0])
    np.testing.assert_allclose(frames[4, :3, 3], 0, atol=1e-15)


def test_jaw_does_not_move_the_tool(chain):
    assert not chain.jacobian([0.1, 0.2, 0.1, 0.3, 0.4, 0.5, 0.6])[:, 6].any()


@pytest.mark.parametrize("motion", ["random", "peg_transfer"])
@pytest.mark.parametrize("kind", ["des", "act"])
def test_wrist_is_where_the_recording_says(chain, dataset_folder, motion, kind):
    folder = dataset_folder("dvrk_psm_berkeley") / motion
    joints = np.load(folder / f"q_{kind}.npy")
    recorded = np.load(folder / f"pos_{kind}.npy")
    frames = chain.link_frames(np.hstack([joints, np.zeros((len(joints), 1))]))
    np.testing.assert_allclose(frames[:, 4, :3, 3], recorded, atol=1e-9)


def test_the_si_arm_has_a_longer_shaft_and_reaches_further():
    first, si = get_robot("dvrk_psm", "psm1"), get_robot("dvrk_psm_si", "psm1")
    assert si.joint_names == first.joint_names
    below = [robot.kinematics.forward([0, 0, 0.1, 0, 0, 0, 0])[2, 3] for robot in (first, si)]
    assert below[1] - below[0] == pytest.approx(-(0.4670 - 0.4162))
    assert (si.upper[:3] > first.upper[:3]).all()
    assert si.lower[:2] == pytest.approx([-2.964, -1.265], abs=1e-4)
    assert profile_of(si).name == profile_of(first).name == "dvrk"
