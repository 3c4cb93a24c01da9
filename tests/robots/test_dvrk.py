"""Arms of the dVRK against their geometry, published tables and recorded wrist positions."""

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


def test_an_endoscope_looks_down_the_tilted_cannula():
    ecm = get_robot("dvrk_ecm", "ecm")
    chain = ecm.kinematics
    depth = 0.1 - 0.3822 + 0.3829
    pose = chain.forward([0, 0, 0.1, 0])
    np.testing.assert_allclose(pose[:3, 3], [0, 0, -depth], atol=1e-15)
    np.testing.assert_allclose(pose[:3, 2], [0, 0, -1], atol=1e-15)  # along which it looks
    tilted = chain.crtk_from_base[:3, :3] @ pose[:3, 3]
    np.testing.assert_allclose(tilted, -depth * np.sqrt(0.5) * np.array([0, 1, 1]), atol=1e-15)
    profile = profile_of(ecm)
    assert profile.topic("ecm", "measured_js") == "/ECM/measured_js"
    assert [profile.joint(name) for name in ("yaw", "pitch", "insertion", "roll")] == [
        *ecm.joint_names
    ]


# alpha [deg], a, d [m] behind each axis, and where its angle is 0 [deg]: standard parameters, as
# jhu-dvrk/sawIntuitiveResearchKit:share/kinematic/mtml.json has them.
MASTER = [
    (90, 0, 0, -90), (0, 0.2794, 0, -90), (-90, 0.3645, 0, 90), (90, 0, 0.1506, 0),
    (-90, 0, 0, 0), (90, 0, 0, -90), (0, 0, 0, 90),
]  # fmt: skip


@pytest.mark.parametrize("arm", ["mtml", "mtmr"])
def test_a_master_is_its_table_of_standard_parameters(arm):
    robot = get_robot(f"dvrk_{arm}", arm)
    joint = np.random.default_rng(0).uniform(robot.lower, robot.upper)
    expected = np.eye(4)
    for (alpha, a, d, zero), q in zip(MASTER, joint, strict=True):
        c, s = np.cos(q + np.radians(zero)), np.sin(q + np.radians(zero))
        ca, sa = np.cos(np.radians(alpha)), np.sin(np.radians(alpha))
        expected = expected @ [
            [c, -s * ca, s * sa, a * c],
            [s, c * ca, -c * sa, a * s],
            [0, sa, ca, d],
            [0, 0, 0, 1],
        ]
    np.testing.assert_allclose(robot.kinematics.forward(joint), expected, atol=1e-15)
    profile = profile_of(robot)
    assert profile.topic(arm, "measured_js") == f"/{arm.upper()}/measured_js"
    assert [profile.joint(name) for name in robot.joint_names] == [*robot.joint_names]


def test_what_mirrors_in_the_masters_are_two_ranges():
    left, right = get_robot("dvrk_mtml", "mtml"), get_robot("dvrk_mtmr", "mtmr")
    np.testing.assert_allclose(left.lower[0], -right.upper[0])
    assert [n for n in range(7) if left.lower[n] != right.lower[n]] == [0, 3]
    assert left.upper[3] - left.lower[3] == pytest.approx(np.radians(290))
    assert right.upper[3] - right.lower[3] == pytest.approx(np.radians(300))
