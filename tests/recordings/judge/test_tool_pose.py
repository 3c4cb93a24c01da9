"""The pose that a robot reports of its tool, beside where its joints put it."""

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from truejoint.crtk.cartesian import pose
from truejoint.recordings import Provenance, Recording, Track, diagnose, read_bag
from truejoint.recordings.datasets.store import data_folders
from truejoint.recordings.judge.link import judge_tool_pose
from truejoint.recordings.read.track import read_tool_poses
from truejoint.robots import get_robot
from truejoint.robots.chain import SerialChain

REAL = "dvrk_psm_jhu_bag/pitch_exp_traj_01_test_cropped.bag"
START = 1.7e9
BASE = Rotation.from_rotvec([0.2, -1.1, 0.4])


def moving(robot_name: str, arm: str = "", seconds: float = 4.0) -> tuple[Recording, np.ndarray]:
    """A recording of joints that move, and its joint vectors."""
    robot, t = get_robot(robot_name, arm), np.arange(0.0, seconds, 0.01)
    span = 0.1 * np.minimum(robot.upper - robot.lower, 3.0)
    phase = np.arange(len(robot.joints)) + np.outer(t, 1.0 + 0.3 * np.arange(len(robot.joints)))
    joint = robot.home + span * np.sin(phase)
    columns = {f"measured/{j.name}": joint[:, k] for k, j in enumerate(robot.joints)}
    units = {f"measured/{j.name}": j.unit for j in robot.joints}
    origin = Provenance(robot.name, robot.arm, start=START)
    return Recording(pd.DataFrame({"t": t} | columns), units, origin), joint


def reported(recording: Recording, joint: np.ndarray, **how: str) -> np.ndarray:
    robot = get_robot(recording.robot.name, how.get("arm", recording.robot.arm))
    return pose(robot.kinematics, joint)[:, :3, 3]


def judged(recording: Recording, position: np.ndarray):
    return judge_tool_pose(recording, Track(recording.t + START, position))


@pytest.mark.parametrize("name", ["raven2", "dvrk_psm"])
def test_a_robot_that_says_what_its_joints_say_is_well_whatever_its_base(name):
    recording, joint = moving(name)
    position = reported(recording, joint)
    assert judged(recording, position).level == "good"
    finding = judged(recording, BASE.apply(position) + np.array([0.2, 0.0, -0.1]))
    assert finding.level == "good"
    angle = np.degrees(BASE.magnitude())
    assert f"in a base frame turned by {angle:.3g} deg and shifted by (200.0, 0.0, -100.0) mm" in (
        finding.what
    )
    assert diagnose(recording, None, Track(recording.t + START, position)).by_heading()


def test_a_wrong_unit_and_a_wrong_arm_are_named():
    recording, joint = moving("raven2", "left")
    finding = judged(recording, 1e3 * BASE.apply(reported(recording, joint)))
    assert finding.level == "fail"
    assert "it reports mm" in finding.advice
    finding = judged(recording, reported(recording, joint, arm="right"))
    assert finding.level == "fail"
    assert "it is of the right arm: state --robot raven2:right" in finding.advice


@pytest.mark.parametrize(("axis", "shift"), [(5, [0.006, 0.0, 0.0]), (3, [0.0, 0.0, 0.01])])
def test_another_instrument_is_measured(axis, shift):
    recording, joint = moving("dvrk_psm")
    chain = recording.robot.kinematics
    assert isinstance(chain, SerialChain)
    longer = chain.link_frames(joint)[:, axis, :3, :3] @ shift
    finding = judged(recording, BASE.apply(chain.forward(joint)[:, :3, 3] + longer))
    assert finding.level == "fail"
    numbers = re.findall(r"axis (\d) is off by \((.*), (.*), (.*)\) mm", finding.advice)
    axis_said, x, y, z = map(float, numbers[0])
    assert axis_said == axis + 1
    assert [x, y, z] == pytest.approx(1e3 * np.array(shift), abs=0.2)


def test_what_nothing_explains_is_said_and_what_cannot_be_told_is_not():
    recording, joint = moving("dvrk_psm")
    position = reported(recording, joint)
    odd = position + 0.02 * np.sin(9.0 * recording.t)[:, None]
    assert "is the robot file (--robot) that of this arm" in judged(recording, odd).advice
    still = replace(recording, table=recording.table.assign(**{
        name: recording.table[name].iloc[0] for name in recording.table.columns if name != "t"
    }))  # fmt: skip
    assert judged(still, position) is None
    assert judge_tool_pose(recording, None) is None
    assert judge_tool_pose(recording, Track(recording.t, position)) is None  # of another time


def test_the_bag_of_a_real_arm_agrees():
    if not (bags := [f / REAL for f in data_folders() if (f / REAL).exists()]):
        pytest.skip(f"no {REAL} on this machine (TRUEJOINT_DATA)")
    bag = bags[0]
    recording = read_bag(bag, "dvrk_psm")
    finding = judge_tool_pose(recording, read_tool_poses(bag, recording))
    assert finding.level == "good"
    assert len(recording) > 3400
    assert recording.joints_of("setpoint") == recording.joints_of("effort") == recording.joints
    assert float(finding.what.split(" mm")[0].rpartition(" ")[2]) < 0.05
