"""Touched dimples: where the block stands, the zero that touches give, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from tests.tip.test_fit import TRUE, rows_of
from tests.tip.touched_arm import ROTATION, Touched, touched

from truejoint import Calibration
from truejoint.errors import CalibrationError
from truejoint.tip import Block, BlockPose, find_block, zero_by_touch
from truejoint.tip.touch import fit_block

HOMING = (0.002, 0.006, -3e-4)


@pytest.fixture(scope="module")
def pose(model: Calibration, first: Touched) -> BlockPose:
    return find_block(model, first.recording, first.touches, first.block)[0]


def test_the_pose_of_the_first_day_is_where_the_block_stands(pose, first):
    turn = np.linalg.norm(pose.rotation.T @ ROTATION - np.eye(3)) / np.sqrt(2)
    sd = np.sqrt(np.diag(pose.covariance))
    assert turn < 4 * sd[:3].max() < 0.02
    assert (np.abs(pose.translation - first.translation) < 4 * sd[3:]).all()
    assert pose.scale == pytest.approx(1.0, abs=4 * pose.scale_sd)
    assert (pose.robot, pose.arm, pose.homing_id) == ("raven2", "left", "1")


def test_a_print_that_is_small_is_found(model, first):
    nominal = {n: p / 0.995 for n, p in first.block.points.items()}
    block = Block("unmeasured", "raven2", nominal, 0.08)
    found = find_block(model, first.recording, first.touches, block)[0]
    assert found.scale == pytest.approx(0.995, abs=4 * found.scale_sd)
    assert found.scale_sd < 2.5e-3
    measured = replace(block, measured=0.995 * 0.08)
    held = find_block(model, first.recording, first.touches, measured)[0]
    assert held.scale == pytest.approx(0.995, abs=3 * measured.scale_sd)


def test_touches_after_a_homing_give_its_zero(model, pose, first):
    today = touched(8, 5, offset=HOMING, block=first.block, homing_id="2")
    zero, found = zero_by_touch(model, today.recording, today.touches, pose)
    again = model.at(zero)
    assert (np.abs(again.offset - HOMING) < 4 * found.sd[:3]).all()
    assert (found.sd[:3] < [2e-3, 2e-3, 3e-4]).all()
    assert (zero.source, zero.homing_id, zero.rows) == ("touch", "2", 8)
    # A block that has moved by as much, which touches do not tell from a homing, is in what it may
    # be off by.
    assert zero.details["unnoticed_move"] > 1e-3
    assert (zero.deviation > 2.0 * found.sd[:3]).any()
    assert again.origin.homing_ids == ("2",)
    for name in model.baselines:
        assert again.offsets[name] == pytest.approx(again.offset)


def test_errors_beyond_the_trainings_are_seen(model, first):
    stated, factors = np.array([1e-3, 1e-3, 1e-4]), []
    for seed in range(5):
        rows = rows_of(30, seed, noise=2e-4)
        joint_sd = np.append(stated, np.zeros(4))
        rows = replace(rows, basis=rows.basis[:, :, :0], joint_sd=joint_sd)
        off = 4.0 * stated * np.random.default_rng(seed).standard_normal((30, 3))
        joint = rows.joint.copy()
        joint[:, :3] += TRUE.coefficients[:3] + off
        block = Block("test", "raven2", {"1": np.zeros(3)}, 0.08, 0.08)
        found = fit_block(replace(rows, joint=joint), block)
        factors.append(found.rows.corrected_sd[0] / stated[0])
        assert found.rows.corrected_sd == pytest.approx(factors[-1] * stated)
    assert 2.8 <= np.median(factors) <= 5.6


def test_a_badly_seated_touch_is_left_out_and_named(model, pose, first):
    today = touched(8, 5, offset=HOMING, block=first.block)
    dimple = list(today.touches.dimple)
    other = next(n for n in first.block.points if n not in dimple)
    dimple[3] = other
    wrong = replace(today.touches, dimple=tuple(dimple))
    zero, found = zero_by_touch(model, today.recording, wrong, pose)
    again = model.at(zero)
    assert zero.details["left_out"] == [other]
    assert (np.abs(again.offset - HOMING) < 4 * found.sd[:3]).all()


@pytest.mark.parametrize("shift", [[0.01, 0, 0], [0, 0, 0.01], [0.1, 0.1, 0]])
def test_a_block_that_has_moved_is_refused(model, pose, first, shift):
    today = touched(10, 5, block=first.block)
    there = replace(pose, translation=pose.translation + shift)
    with pytest.raises(
        CalibrationError, match=r"do not (fit|settle)|block (has )?moved|leave open"
    ):
        zero_by_touch(model, today.recording, today.touches, there)


def test_touches_that_cannot_be_are_refused(model, pose, first):
    with pytest.raises(CalibrationError, match="the model is of"):
        zero_by_touch(model, first.recording, first.touches, replace(pose, arm="right"))
    with pytest.raises(CalibrationError, match="with another calibration"):
        zero_by_touch(model, first.recording, first.touches, replace(pose, model_sha256="other"))
    few = touched(2, block=first.block)
    with pytest.raises(CalibrationError, match="2 different dimples"):
        zero_by_touch(model, few.recording, few.touches, pose)
    with pytest.raises(CalibrationError, match="takes 6 or more"):
        find_block(model, few.recording, few.touches, first.block)
    strange = replace(first.touches, dimple=("99", *first.touches.dimple[1:]))
    with pytest.raises(CalibrationError, match="has no dimple '99'"):
        zero_by_touch(model, first.recording, strange, pose)
    late = replace(first.touches, t=tuple(t + 100.0 for t in first.touches.t))
    with pytest.raises(CalibrationError, match="is it their recording"):
        zero_by_touch(model, first.recording, late, pose)
    early = replace(first.touches, t=tuple(t + 0.3 for t in first.touches.t[:-1]),
                    dimple=first.touches.dimple[:-1])  # fmt: skip
    with pytest.raises(CalibrationError, match=r"moves by .* while dimple"):
        zero_by_touch(model, first.recording, early, pose)
    bare = replace(model, effort_baseline=None)
    with pytest.raises(CalibrationError, match="how large its errors are"):
        zero_by_touch(bare, first.recording, first.touches, pose)
    with pytest.raises(CalibrationError, match="above 0"):
        zero_by_touch(model, first.recording, first.touches, pose, touch_sd=0.0)
