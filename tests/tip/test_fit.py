"""Points of the tool in a frame of unknown pose: the rows, what they tell, and what they cannot."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from truejoint.errors import CalibrationError
from truejoint.robots import get_robot
from truejoint.tip.accuracy import restricted
from truejoint.tip.fit import TipPrior, TipRows, TipState, align, fit_rows

ROBOT = get_robot("raven2", "left")
COLUMNS = (0, 1, 2)
TRUE = TipState(
    np.array([0.02, -0.03, 1e-3, 0.05, -0.04, 2e-3]),
    Rotation.from_rotvec([0.4, -0.2, 0.9]).as_matrix(),
    np.array([0.05, -0.08, 0.02]),
)
"""Offset and own slope of each joint, and the pose."""


def rows_of(m: int = 30, seed: int = 0, state: TipState = TRUE, noise: float = 0.0) -> TipRows:
    """Touches all over the workspace whose points are where `state` has them, but for noise."""
    rng = np.random.default_rng(seed)
    space = ROBOT.workspace
    joint = np.tile(ROBOT.home, (m, 1))
    joint[:, :3] = rng.uniform(space.lower, space.upper, (m, 3))
    scaled = (joint[:, :3] - space.centre) / (space.extent / 2)
    basis = np.concatenate([np.tile(np.eye(3), (m, 1, 1)), scaled[:, :, None] * np.eye(3)], axis=2)
    rows = TipRows(ROBOT.kinematics, joint, COLUMNS, basis, np.zeros((m, 3)), 2e-4, np.zeros(7))
    point = rows.residual(state) / state.scale  # of points at the origin
    return replace(rows, point=point + noise * rng.standard_normal((m, 3)))


def prior(pose_sd: float = np.inf, zero_sd: float = 0.1) -> TipPrior:
    """Nothing known of slopes; zeros and pose as stated; marker and scale are given."""
    start = replace(TRUE, coefficients=np.zeros(6))
    sd = [zero_sd, zero_sd, 0.1 * zero_sd, *[np.inf] * 3]
    return TipPrior.of(start, sd, pose=pose_sd)


def test_a_row_is_the_tip_seen_from_the_frame():
    rows, state = rows_of(4), replace(TRUE, marker=np.array([0.01, -0.02, 0.03]), scale=1.01)
    for i in range(4):
        joint = rows.joint[i].copy()
        for k in range(3):
            half = (ROBOT.workspace.upper[k] - ROBOT.workspace.lower[k]) / 2
            way = (rows.joint[i, k] - ROBOT.workspace.lower[k] - half) / half
            joint[k] += state.coefficients[k] + state.coefficients[3 + k] * way
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = state.rotation, state.translation
        seen = np.linalg.inv(pose) @ ROBOT.kinematics.forward(joint) @ [*state.marker, 1.0]
        expected = seen[:3] - 1.01 * rows.point[i]
        assert rows.residual(state)[i] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("oriented", [False, True])
def test_the_jacobians_are_the_slopes_of_the_residual(oriented):
    rows, state = rows_of(5), replace(TRUE, marker=np.array([0.01, -0.02, 0.03]), scale=1.01)
    turns = Rotation.random(5, random_state=1).as_matrix()
    rows = replace(rows, orientation=turns if oriented else None)
    residual, jacobian, by_joint = rows.equations(state)
    assert residual[:, :3] == pytest.approx(rows.residual(state), abs=1e-15)
    for k in range(len(state.names)):
        step = np.zeros(len(state.names))
        step[k] = 1e-6
        ahead, behind = (rows.equations(state.moved(way)).residual for way in (step, -step))
        slope = (ahead - behind) / 2e-6
        assert jacobian[:, :3, k] == pytest.approx(slope[:, :3], abs=1e-8)
        assert state.moved(step).minus(state) == pytest.approx(step, abs=1e-12)
    assert by_joint[:, :, :3] == pytest.approx(jacobian[:, :, :3], abs=1e-12)


def test_a_linear_truth_comes_out_and_what_is_held_is_the_priors_wherever_the_fit_begins():
    elsewhere = TRUE.moved(np.full(len(TRUE.names), 1e-3))
    found = fit_rows(rows_of(), prior(pose_sd=0.0, zero_sd=np.inf), start=elsewhere)
    assert found.state.minus(TRUE) == pytest.approx(np.zeros(len(TRUE.names)), abs=1e-8)
    assert not found.left_out.any()


def test_of_an_unknown_pose_all_but_the_first_zero_comes_out():
    found = fit_rows(rows_of(), prior())
    expected = TRUE.coefficients.copy()
    expected[0] = 0.0  # the base turned about the first axis says the same
    assert found.state.coefficients == pytest.approx(expected, abs=1e-4)
    assert found.sd[0] == pytest.approx(0.1, rel=0.01)
    assert np.abs(found.residual).max() < 1e-6
    with pytest.raises(CalibrationError, match=r"leave open .*term 0"):
        fit_rows(rows_of(), prior(zero_sd=np.inf))


def test_what_it_states_of_itself_holds():
    squares, misfits, runs = 0.0, 0.0, 40
    for seed in range(runs):
        found = fit_rows(rows_of(12, seed, noise=2e-4), prior(pose_sd=0.0, zero_sd=np.inf))
        off = found.state.coefficients - TRUE.coefficients
        misfits += found.misfit
        squares += off @ np.linalg.solve(found.covariance[:6, :6], off)
    low, high = chi2.ppf([0.001, 0.999], 6 * runs)
    assert low < squares < high
    assert found.freedom == 3 * 12 - 6
    assert misfits / (runs * found.freedom) == pytest.approx(1.0, abs=0.15)


def test_errors_that_joints_keep_are_weighed_by_what_they_do_to_the_tip():
    rows = replace(rows_of(), joint_sd=np.array([2e-3, 1e-9, 1e-9, 0.0, 0.0, 0.0, 0.0]))
    found = fit_rows(rows, prior(pose_sd=0.0, zero_sd=np.inf))
    plain = fit_rows(rows_of(), prior(pose_sd=0.0, zero_sd=np.inf))
    assert found.sd[0] > 1.3 * plain.sd[0]
    assert found.sd[2] < 1.2 * plain.sd[2]


@pytest.mark.parametrize("known", [0.0, np.inf])
def test_touches_beside_their_dimple_and_exchanged_numbers_are_left_out(known):
    rows = rows_of(noise=2e-4)
    point = rows.point.copy()
    point[4] += [1.5e-3, -1e-3, 1e-3]
    point[[9, 17]] = point[[17, 9]]
    start = replace(prior(pose_sd=known), free=prior(pose_sd=known).free)
    found = fit_rows(replace(rows, point=point), start)
    assert np.flatnonzero(found.left_out).tolist() == [4, 9, 17]
    clean = fit_rows(rows.rows(~found.left_out), start)
    assert found.state.coefficients == pytest.approx(clean.state.coefficients, abs=1e-6)


def test_each_point_is_judged_by_the_others():
    rows = rows_of(8, noise=2e-4)
    found = fit_rows(rows, prior(pose_sd=0.0), gate=np.inf)
    others = np.arange(8) != 3
    without = fit_rows(rows.rows(others), prior(pose_sd=0.0), gate=np.inf)
    assert (found.weight == 1.0).all()  # else the weights differ a little
    left = rows.residual(without.state)[3]
    jacobian = rows.equations(without.state).by_parameter[3]
    spread = jacobian @ without.covariance @ jacobian.T + 4e-8 * np.eye(3)
    expected = np.sqrt(left @ np.linalg.solve(spread, left))
    assert found.distance[3] == pytest.approx(expected, rel=1e-3)


def test_points_of_another_plate_are_refused():
    rows = rows_of()
    with pytest.raises(CalibrationError, match="do not fit the others: are they all of this arm"):
        fit_rows(replace(rows, point=rows.point[::-1]), prior(pose_sd=0.0))
    few = rows_of(9, noise=2e-4)
    few.point[[2, 5]] += 0.02  # of so few the two that are dropped may be the good ones
    with pytest.raises(CalibrationError, match="2 of 9 points do not fit the others"):
        fit_rows(few, prior(pose_sd=0.0))


def test_points_lie_over_points():
    rows = rows_of(4)
    tip = rows.point @ TRUE.rotation.T + TRUE.translation
    rotation, translation = align(tip, rows.point)
    assert rotation == pytest.approx(TRUE.rotation, abs=1e-9)
    assert translation == pytest.approx(TRUE.translation, abs=1e-9)
    line = np.outer(np.arange(5.0), [1.0, 2.0, 3.0])
    for few in (rows.point[:2], line):
        with pytest.raises(CalibrationError, match="pose of their frame open"):
            align(few, few)


def test_numbers_that_cannot_be_are_refused():
    rows = rows_of(3)
    for wrong in ({"point_sd": 0.0}, {"joint": np.full((3, 7), np.nan)}):
        with pytest.raises(CalibrationError):
            replace(rows, **wrong)


def test_the_evidence_is_the_likelihood_of_the_points_under_prior_and_noise():
    little = replace(TRUE, coefficients=1e-3 * np.array([1.0, -2.0, 0.1, 0.5, 1.0, -0.2]))
    start = replace(TRUE, coefficients=np.zeros(6))
    rows = rows_of(8, 2, little, noise=2e-4)

    def both(sd: float, noise: float) -> tuple[float, float]:
        own = replace(rows, point_sd=noise)
        known = TipPrior.of(start, sd, pose=0.0)
        jacobian = own.equations(start).by_parameter[:, :, :6].reshape(24, 6)
        off = own.residual(start).ravel()
        covariance = sd**2 * jacobian @ jacobian.T + noise**2 * np.eye(24)
        likelihood = off @ np.linalg.solve(covariance, off) + np.linalg.slogdet(covariance)[1]
        found = fit_rows(own, known, gate=np.inf)
        assert (found.weight == 1.0).all()
        sds = [(noise, np.zeros(7))]
        ((evidence, _),) = restricted(own.equations(found.state), found, known, sds)
        return evidence, -0.5 * likelihood

    found = np.array([both(sd, noise) for sd, noise in ((1e-3, 3e-4), (1e-2, 3e-4), (2e-3, 4e-4))])
    assert np.diff(found[:, 0]) == pytest.approx(np.diff(found[:, 1]), abs=0.05)
