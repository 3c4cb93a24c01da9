"""A guided run: dimples in reach, each touch judged by those before it, stated errors that fall."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from tests.tip.touched_arm import ROBOT, Touched, fitted, touched

from truejoint import Calibration
from truejoint.errors import CalibrationError
from truejoint.robots import get_robot
from truejoint.tip import Block, design_block
from truejoint.tip.guide import (
    Guide,
    Stop,
    Verdict,
    design_pose,
    learning,
    of_model,
    reachable,
)


@pytest.fixture(scope="module")
def model() -> Calibration:
    return fitted()


@pytest.fixture(scope="module")
def first() -> Touched:
    return touched(24)


@pytest.fixture(scope="module")
def block(first: Touched) -> Block:
    return replace(first.block, translation=first.translation + 0.005)


def finding(model: Calibration, block: Block, count: int) -> Guide:
    pose = design_pose(block, ROBOT)
    return Guide(of_model(model, pose, finds_block=True), count)


def run(guide: Guide, block: Block, wrong: int = -1) -> tuple[list[Stop], list[Verdict]]:
    """Touch all that is asked for; the touch number `wrong` is in another dimple."""
    stops, seated, verdicts = [], [], []
    while (stop := guide.next_stop()) is not None:
        stops.append(stop)
        other = next(n for n in block.points if n not in (stop.dimple, *seated))
        seated.append(other if len(stops) == wrong else stop.dimple)
        made = touched(block=block, dimples=seated, seed=3)
        verdicts.append(guide.take(stop, made.touches.t[-1], made.recording))
    return stops, verdicts


@pytest.mark.parametrize("finds_block", [True, False])
def test_the_stated_error_falls_touch_by_touch(model, first, block, finds_block):
    pose = design_pose(block, ROBOT)
    if not finds_block:  # the block has been found
        known = {"translation": first.translation, "covariance": 1e-8 * np.eye(6)}
        pose = replace(pose, joint_sd=np.array([1e-3, 1e-3, 1e-4]), **known)
    task = of_model(model, pose, finds_block=finds_block)
    guide = Guide(task, 10)
    stops, verdicts = run(guide, block)
    assert len({stop.dimple for stop in stops}) == len(guide.touches()) == 10
    assert [v.tip_sd is None for v in verdicts] == [True] * 3 + [False] * 7
    sd = [v.tip_sd for v in verdicts[3:]]
    assert all(after < before * 1.05 for before, after in pairwise(sd))
    assert sd[-1] < 0.8 * sd[0]
    assert {v.off for v in verdicts} == {None}


def test_a_touch_that_does_not_fit_is_asked_for_once_more(model, block):
    guide = finding(model, block, 10)
    stops, verdicts = run(guide, block, wrong=6)
    assert len(stops) == 11
    assert verdicts[5].off > 2e-3
    assert [v.off for k, v in enumerate(verdicts) if k != 5] == [None] * 10
    assert stops[10].dimple == stops[5].dimple
    assert stops[10].is_again
    assert len(guide.touches()) == 10


def test_a_touch_while_the_arm_moves_is_refused_and_still_to_come(model, block):
    guide = finding(model, block, 6)
    stop = guide.next_stop()
    made = touched(block=block, dimples=[stop.dimple, "1" if stop.dimple != "1" else "2"])
    with pytest.raises(CalibrationError, match=r"moves by .* while dimple"):
        guide.take(stop, made.touches.t[0] + 0.2, made.recording)
    assert guide.next_stop() is stop
    assert guide.take(stop, made.touches.t[0], made.recording) == Verdict(1, None, None)


def test_sides_are_told_in_words(model, block):
    guide = finding(model, block, 8)
    sides = []
    while (stop := guide.next_stop()) is not None:
        rising = [f"{joint} rising" in stop.words for joint in ROBOT.positioning]
        assert rising == [side < 0 for side in stop.side]
        sides.append(stop.side)
        guide.skip(stop)
    assert (np.sum(sides, axis=0) == 0).all()


def test_only_dimples_in_reach_are_asked_for():
    made = design_block(ROBOT).block()
    pose = design_pose(made, ROBOT)
    names, joint = reachable(ROBOT, pose)
    assert names == tuple(made.points)
    tip = ROBOT.kinematics.forward(joint)[:, :3, 3]
    assert tip == pytest.approx(made.at(names) @ pose.rotation.T + pose.translation, abs=1e-8)
    away = replace(pose, translation=pose.translation + 1.0)
    with pytest.raises(CalibrationError, match="out of reach"):
        reachable(ROBOT, away)


def test_a_plate_or_a_model_of_another_robot_is_refused(model, block):
    with pytest.raises(CalibrationError, match="is for forceps"):
        design_pose(replace(block, robot="forceps"), ROBOT)
    pose = replace(design_pose(block, ROBOT), arm="right")
    with pytest.raises(CalibrationError, match="the model is of"):
        of_model(model, pose, finds_block=False)
    pose = replace(design_pose(block, ROBOT), model_sha256="other")
    with pytest.raises(CalibrationError, match="with another calibration"):
        of_model(model, pose, finds_block=False)
    with pytest.raises(CalibrationError, match="30 touches of 24 dimples"):
        finding(model, block, 30)


def test_a_guide_leads_an_arm_of_which_nothing_is_known(block):
    pose = design_pose(block, ROBOT)
    guide = Guide(learning(ROBOT, pose), 8)
    stops, verdicts = run(guide, block)
    assert len({stop.dimple for stop in stops}) == len(guide.touches()) == 8
    sd = [v.tip_sd for v in verdicts]
    assert sd[:3] == [None] * 3
    assert sd[7] < sd[3]
    helped = Guide(learning(ROBOT, pose, (fitted(),)), 5)
    _, judged = run(helped, block)
    assert judged[4].tip_sd < 0.5 * sd[4]
    with pytest.raises(CalibrationError, match="or a folder of 3 or more"):
        learning(ROBOT, pose, (replace(fitted(), machine=get_robot("raven2", "right")),))
