"""A guided run: dimples in reach, each touch judged by those before it, stated errors that fall."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise, permutations

import numpy as np
import pytest
from tests.tip.test_fit import prior, rows_of
from tests.tip.touched_arm import ROBOT, Touched, fitted, touched

from truejoint import Calibration
from truejoint.errors import CalibrationError
from truejoint.robots import get_robot
from truejoint.tip import Block, design_block
from truejoint.tip.fit import fit_rows
from truejoint.tip.guide import (
    Guide,
    Stop,
    Verdict,
    approach_sides,
    choose_touches,
    design_pose,
    learning,
    of_model,
    reachable,
    shortest_order,
)


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
    assert len({stop.dimple for stop in stops}) == 8
    assert len(guide.touches()) == 9  # the fifth twice
    assert stops[4].dimple == stops[5].dimple
    sd = [v.tip_sd for v in verdicts]
    assert sd[:3] == [None] * 3
    assert sd[7] < sd[3]
    helped = Guide(learning(ROBOT, pose, (fitted(),)), 5)
    _, judged = run(helped, block)
    assert judged[4].tip_sd < 0.7 * sd[4]
    with pytest.raises(CalibrationError, match="or a folder of 3 or more"):
        learning(ROBOT, pose, (replace(fitted(), machine=get_robot("raven2", "right")),))


def determinant(rows, known, chosen) -> float:
    """Logarithm of the determinant of the parameters' information, term by term."""
    free = np.flatnonzero(known.free)
    equations = rows.equations(known.state)
    whitening = equations.whitening(rows.joint_sd, rows.point_sd)
    white = whitening @ equations.by_parameter
    information = known.precision[np.ix_(free, free)].copy()
    for k in chosen:
        information += white[k][:, free].T @ white[k][:, free]
    return float(np.linalg.slogdet(information)[1])


def test_planned_touches_tell_more_than_random_ones():
    rows, known = rows_of(60), prior(pose_sd=0.1)
    chosen = choose_touches(rows, known, 10)
    assert len(set(chosen.tolist())) == 10
    rng = np.random.default_rng(0)
    planned = determinant(rows, known, chosen)
    assert planned > max(determinant(rows, known, rng.permutation(60)[:10]) for _ in range(50))
    sd = fit_rows(rows.rows(np.isin(np.arange(60), chosen)), known).sd
    some = fit_rows(rows.rows(np.arange(60) < 10), known).sd
    assert np.prod(sd[sd > 0]) < np.prod(some[some > 0])


def test_more_touches_than_dimples_are_refused():
    with pytest.raises(CalibrationError, match="12 touches of 9 dimples"):
        choose_touches(rows_of(9), prior(), 12)


def test_the_way_is_nearly_the_shortest():
    rng = np.random.default_rng(1)
    joint, speed = rng.uniform(size=(7, 3)), np.array([1.0, 2.0, 0.5])

    def way(order) -> float:
        return sum(float(np.max(np.abs(joint[a] - joint[b]) / speed)) for a, b in pairwise(order))

    found = shortest_order(joint, speed)
    assert sorted(found.tolist()) == list(range(7))
    assert found[0] == 0
    best = min(way((0, *rest)) for rest in permutations(range(1, 7)))
    assert way(found) <= 1.15 * best


def test_every_joint_comes_from_both_sides():
    sides = approach_sides(16, 3)
    assert (sides.sum(axis=0) == 0).all()
    assert (sides.T @ sides == 16 * np.eye(3)).all()
    assert np.abs(approach_sides(12, 3).sum(axis=0)).max() <= 4
