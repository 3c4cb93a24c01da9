"""What to touch: dimples in reach, those that tell most, and from which sides."""

from dataclasses import replace

import numpy as np
import pytest
from tests.tip.test_fit import prior, rows_of
from tests.tip.touched_arm import ROBOT, Touched, fitted

from truejoint import Calibration
from truejoint.errors import CalibrationError
from truejoint.robots import get_robot
from truejoint.tip import Block, design_block
from truejoint.tip.plan import (
    Task,
    approach_sides,
    choose_touches,
    design_pose,
    learning,
    of_model,
    reachable,
)


@pytest.fixture(scope="module")
def block(first: Touched) -> Block:
    return replace(first.block, translation=first.translation + 0.005)


@pytest.fixture(scope="module")
def finding(model: Calibration, block: Block) -> Task:
    return of_model(model, design_pose(block, ROBOT), finds_block=True)


def test_sides_are_told_in_words(finding):
    stops = finding.plan(8)
    for stop in stops:
        rising = [f"{joint} rising" in stop.words for joint in ROBOT.positioning]
        assert rising == [side < 0 for side in stop.side]
    assert (np.sum([stop.side for stop in stops], axis=0) == 0).all()
    assert len({stop.dimple for stop in stops}) == 8


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


def test_a_plate_or_a_model_of_another_robot_is_refused(model, block, finding):
    with pytest.raises(CalibrationError, match="is for forceps"):
        design_pose(replace(block, robot="forceps"), ROBOT)
    pose = replace(design_pose(block, ROBOT), model_sha256="other")
    with pytest.raises(CalibrationError, match="with another calibration"):
        of_model(model, pose, finds_block=False)
    with pytest.raises(CalibrationError, match="30 touches of 24 dimples"):
        finding.plan(30)


def test_a_block_and_an_arm_of_which_nothing_is_known_are_planned(block):
    pose = design_pose(replace(block, references={"R1": np.zeros(3)}), ROBOT)
    stops = learning(ROBOT, pose, fitted()).plan(8)
    assert [stop.dimple for stop in stops[4:6]] == [stops[4].dimple] * 2  # the fifth twice
    assert len({stop.dimple for stop in stops}) == len(stops) - 1 == 8
    found = of_model(fitted(), pose, finds_block=True).plan(8)
    assert [stop.dimple for stop in found].count("R1") == 1
    with pytest.raises(CalibrationError, match="give one that was made on recordings of this arm"):
        learning(ROBOT, pose, replace(fitted(), machine=get_robot("raven2", "right")))


def determinant(rows, known, chosen) -> float:
    """Logarithm of the determinant of the parameters' information, term by term."""
    free = np.flatnonzero(known.free)
    equations = rows.equations(known.state)
    white = equations.whitened(rows.joint_sd, rows.point_sd).jacobian
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


def test_every_joint_comes_from_both_sides():
    sides = approach_sides(16, 3)
    assert (sides.sum(axis=0) == 0).all()
    assert (sides.T @ sides == 16 * np.eye(3)).all()
    assert np.abs(approach_sides(12, 3).sum(axis=0)).max() <= 4
