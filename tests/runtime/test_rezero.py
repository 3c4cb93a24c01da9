"""Re-zeroing in the loop: the filter's equations, its honesty, and readings that are wrong."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

from truejoint.calibration.zero import CORRELATION_MARGIN
from truejoint.errors import CalibrationError
from truejoint.robots import get_robot
from truejoint.runtime import ReZero
from truejoint.runtime.rezero import DRIFT, PRIOR
from truejoint.tip import Block, BlockPose

SIZE, TIME, NOISE = np.array([2e-3, 1e-4]), np.array([4.0, 9.0]), np.array([3e-4, 2e-5])
STEP = np.array([1e-2, 1e-3])


def rezero(noise=NOISE, beginning_sd=np.zeros_like, **settings) -> ReZero:
    baseline = SimpleNamespace(residual=SIZE, correlation=TIME / CORRELATION_MARGIN,
                               step=STEP, beginning_sd=beginning_sd)  # fmt: skip
    calibration = SimpleNamespace(robot="raven2", arm="left", joints=("elbow", "insertion"),
                                  effort_baseline=baseline, metadata={})  # fmt: skip
    return ReZero(calibration, truth_sd=noise, **settings)


def kalman(t: np.ndarray, readings: np.ndarray, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Textbook Kalman filter of offset and local error of joint `k`; readings may be NaN."""
    x, P = np.zeros(2), np.diag([(PRIOR * SIZE[k]) ** 2, SIZE[k] ** 2])
    H, last, offsets, deviations = np.ones((1, 2)), t[0], [], []
    for now, reading in zip(t, readings, strict=True):
        keep = math.exp(-(now - last) / TIME[k])
        F = np.diag([1.0, keep])
        drift = (DRIFT * SIZE[k]) ** 2 / 3600 * (now - last)
        x, P = F @ x, F @ P @ F.T + np.diag([drift, (1 - keep**2) * SIZE[k] ** 2])
        last = now
        if np.isfinite(reading):
            S = H @ P @ H.T + NOISE[k] ** 2
            K = P @ H.T / S
            x = x + K[:, 0] * (reading - H @ x)
            A = np.eye(2) - K @ H
            P = A @ P @ A.T + K * NOISE[k] ** 2 @ K.T
        offsets.append(x[0])
        deviations.append(math.sqrt(P[0, 0]))
    return np.array(offsets), np.array(deviations)


def position(t: float) -> np.ndarray:
    """Where the joints are, which go twenty steps in a second."""
    return 20.0 * STEP * t


def plant(seed: int, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Offsets and readings (n, 2) drawn from the filter's own model."""
    rng = np.random.default_rng(seed)
    step = np.diff(t, prepend=t[0])
    drift = DRIFT * SIZE * np.sqrt(step[:, None] / 3600) * rng.normal(size=(len(t), 2))
    offset = 50 * SIZE * rng.normal(size=2) + np.cumsum(drift, axis=0)
    local = np.empty((len(t), 2))
    local[0] = SIZE * rng.normal(size=2)
    for i in range(1, len(t)):
        keep = np.exp(-step[i] / TIME)
        local[i] = keep * local[i - 1] + np.sqrt(1 - keep**2) * SIZE * rng.normal(size=2)
    return offset, offset + local + NOISE * rng.normal(size=(len(t), 2))


def bursts() -> np.ndarray:
    """Ten seconds of truth at 10 Hz, three times, ten minutes apart."""
    return np.concatenate([start + np.arange(0.0, 10.0, 0.1) for start in (0.0, 600.0, 1200.0)])


def test_it_is_the_textbook_filter():
    t = bursts()
    _, readings = plant(3, t)
    readings[40:60, 1] = np.nan
    filter_ = rezero()
    expected = [kalman(t, readings[:, k], k) for k in range(2)]
    for i in range(len(t)):
        filter_.update(t[i], position(t[i]), position(t[i]) + readings[i])
        for k in range(2):
            assert filter_.offset[k] == pytest.approx(expected[k][0][i], abs=1e-7 * SIZE[k] * 1e3)
            assert filter_.sd[k] == pytest.approx(expected[k][1][i], rel=1e-4)


def test_what_it_states_of_itself_holds():
    t, runs = bursts(), 60
    squares = np.zeros(2)
    for seed in range(runs):
        offset, readings = plant(seed, t)
        filter_ = rezero()
        for i in range(len(t)):
            filter_.update(t[i], position(t[i]), position(t[i]) + readings[i])
        squares += ((filter_.offset - offset[-1]) / filter_.sd) ** 2
    low, high = chi2.ppf([0.005, 0.995], runs)
    assert ((squares > low) & (squares < high)).all()


def test_ten_seconds_are_not_a_hundred_independent_readings():
    filter_ = rezero()
    for t in np.arange(0.0, 10.0, 0.1):
        filter_.update(t, position(t), position(t))
    assert (filter_.sd > 0.5 * SIZE).all()
    assert (filter_.sd < 0.95 * SIZE).all()


def test_a_rest_is_one_reading_however_long_it_lasts():
    filter_, places = rezero(), np.array([0.5 * STEP, np.zeros(2)])  # within a step
    for i in range(600):
        filter_.update(0.1 * i, places[i % 2], places[i % 2] + SIZE)
        if i == 0:
            first = filter_.sd.copy()
    assert filter_.offset == pytest.approx(SIZE, rel=1e-2)
    assert filter_.sd == pytest.approx(first, rel=0.02)  # the truth's noise is averaged
    unseen = rezero()
    unseen.update(0.0, np.zeros(2), SIZE)
    for t in np.arange(0.1, 60.0, 0.1):  # it goes there and back, with no truth meanwhile
        unseen.update(t, position(min(t, 60.0 - t)), [math.nan, math.nan])
    unseen.update(60.0, np.zeros(2), SIZE)
    assert (unseen.sd < 0.8 * first).all()


def test_before_any_truth_it_knows_nothing():
    filter_ = rezero()
    filter_.advance(5.0)
    assert filter_.offset.tolist() == [0.0, 0.0]
    assert np.isinf(filter_.sd).all()
    filter_.update(6.0, [0.0, 0.0], [0.01, math.nan])
    assert filter_.offset[0] == pytest.approx(0.01, rel=1e-4)
    assert np.isinf(filter_.sd[1])
    before = filter_.sd[0]
    filter_.advance(4000.0)
    assert filter_.sd[0] > before
    filter_.reset()
    assert np.isinf(filter_.sd).all()


def test_single_wrong_readings_are_left_out():
    t = bursts()
    _, readings = plant(5, t)
    clean, dirty = rezero(), rezero()
    for i in range(len(t)):
        here = position(t[i])
        clean.update(t[i], here, here + readings[i])
        wrong = readings[i] + (1.0 if i % 10 == 9 else 0.0)
        dirty.update(t[i], here, here + wrong)
        if i % 10 == 9:
            assert dirty.rejected.tolist() == [1.0, 1.0]
    assert (np.abs(clean.offset - dirty.offset) < clean.sd).all()


def test_a_jump_that_lasts_is_believed_after_ten_readings():
    filter_ = rezero()
    for t in np.arange(0.0, 10.0, 0.1):
        filter_.update(t, np.zeros(2), np.zeros(2))
    jump = 100 * SIZE
    for count in range(1, 13):
        filter_.update(10.0 + 0.1 * count, np.zeros(2), jump)
        near = np.abs(filter_.offset - jump) < 2 * SIZE
        assert near.tolist() == [count >= 10] * 2
    assert (filter_.sd < 2 * SIZE).all()


def test_readings_that_go_back_in_time_or_are_no_numbers_change_nothing():
    filter_ = rezero()
    filter_.update(5.0, np.zeros(2), SIZE)
    before = filter_.offset.copy(), filter_.sd.copy()
    for t, truth in ((4.0, [1.0, 1.0]), (math.nan, [1.0, 1.0]), (5.0, [math.nan, math.inf])):
        filter_.update(t, np.zeros(2), truth)
        assert (filter_.offset.tolist(), filter_.sd.tolist()) == (
            before[0].tolist(), before[1].tolist(),
        )  # fmt: skip


def test_a_reading_that_is_too_old_is_no_reading_after_a_motion():
    stated = rezero(beginning_sd=lambda in_motion: 1.0 / (1.0 + in_motion))
    stated.update(0.0, np.zeros(2), SIZE)
    for t in np.arange(0.5, 10.5, 0.5):
        stated.update(t, position(t), [math.nan, math.nan])
    stated.update(4.0, position(4.0), position(4.0) + SIZE)
    stated.update(10.0, position(10.0), [math.nan, math.nan])
    assert stated.sd == pytest.approx(1.0)
    stated.update(10.0, position(10.0), position(10.0) + SIZE)
    assert stated.sd == pytest.approx(1.0 / 11.0)


def test_garbage_leaves_it_finite():
    filter_ = rezero()
    rng = np.random.default_rng(0)
    t = 0.0
    for _ in range(20_000):
        t += rng.choice([0.0, 1e-6, 0.1, 1e5, -3.0])
        truth = rng.choice([0.0, 1e-3, -1e6, 1e6, math.nan, math.inf], 2)
        filter_.update(t, rng.normal(size=2), truth)
        assert np.isfinite(filter_.offset).all()
        assert not np.isnan(filter_.sd).any()


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"noise": -1.0}, "truth_sd"),
        ({"noise": [1.0, 2.0, 3.0]}, "truth_sd"),
        ({"noise": math.nan}, "truth_sd"),
        ({"drift": math.inf}, "drift"),
    ],
)
def test_senseless_settings_are_refused(settings, said):
    with pytest.raises(CalibrationError, match=said):
        rezero(**settings)


def test_shapes_and_a_missing_baseline_are_refused():
    with pytest.raises(CalibrationError, match="must hold 2 joints"):
        rezero().update(0.0, [0.0], [0.0])
    bare = SimpleNamespace(robot="raven2", arm="left", joints=("elbow",), effort_baseline=None)
    with pytest.raises(CalibrationError, match="does not say how large its errors are"):
        ReZero(bare)


def touched_block(**change) -> tuple[BlockPose, np.ndarray, SimpleNamespace]:
    """Block with eight dimples, where all joints of the arm are in each, and a calibration."""
    robot, rng = get_robot("raven2", "left"), np.random.default_rng(4)
    joint = np.tile(robot.home, (8, 1))
    joint[:, :3] = rng.uniform(robot.workspace.lower, robot.workspace.upper, (8, 3))
    tip = robot.kinematics.forward(joint)[:, :3, 3]
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    points = {str(k): p for k, p in enumerate((tip - tip[0]) @ turn)}
    plate = Block("block", "raven2", points, 0.08, 0.08)
    pose = {
        "block": plate, "robot": "raven2", "arm": "left", "rotation": turn, "translation": tip[0],
        "covariance": np.diag([1e-14] * 6), "scale": 1.0, "scale_sd": 1e-7,
    }  # fmt: skip
    baseline = SimpleNamespace(residual=np.array([1e-3, 1e-3, 1e-4]),
                               correlation=np.full(3, 2.0), step=np.full(3, 1e-4),
                               beginning_sd=np.zeros_like)  # fmt: skip
    calibration = SimpleNamespace(robot="raven2", arm="left", effort_baseline=baseline,
                                  joints=("shoulder", "elbow", "insertion"))  # fmt: skip
    return BlockPose(**pose | change), joint, calibration


def test_touches_of_a_bolted_block_give_the_offset():
    block, joint, calibration = touched_block()
    offset, rng = np.array([0.004, -0.006, 3e-4]), np.random.default_rng(7)
    filter_ = ReZero(calibration)
    for k in range(8):
        error = rng.standard_normal(3) * calibration.effort_baseline.residual
        measured = joint[k].copy()
        measured[:3] += 0.01  # what the calibration corrects
        filter_.touch(
            10.0 * k, joint[k, :3] - offset + error, measured, str(k), block, touch_sd=5e-5
        )
    assert (np.abs(filter_.offset - offset) < 4 * filter_.sd).all()
    assert (filter_.sd < 0.6 * calibration.effort_baseline.residual).all()
    filter_.touch(90.0, joint[0, :3] - offset, joint[0], "5", block)  # another dimple's number
    assert (np.abs(filter_.offset - offset) < 4 * filter_.sd).all()
    assert filter_.rejected.max() == 1.0


def test_a_touch_is_as_sure_as_tip_and_pose_are():
    sure, joint, calibration = touched_block()
    vague = touched_block(covariance=np.diag([1e-2] * 6))[0]
    found = []
    for block, sd in ((sure, 1e-6), (sure, 2e-4), (vague, 2e-4)):
        filter_ = ReZero(calibration)
        filter_.touch(0.0, joint[3, :3], joint[3], "3", block, touch_sd=sd)
        found.append(filter_.sd.copy())
        assert filter_.offset == pytest.approx(np.zeros(3), abs=1e-9)
    assert found[0] == pytest.approx(calibration.effort_baseline.residual, rel=0.1)
    assert (found[1] > found[0]).all()
    assert (found[2] > 10 * found[1]).all()


def test_touches_that_do_not_tell_the_joints_are_refused():
    block, joint, calibration = touched_block()
    filter_ = ReZero(calibration)
    for touch, said in (
        ((0.0, joint[0, :3], joint[0], "77", block), "has no dimple"),
        ((0.0, joint[0, :2], joint[0], "1", block), "must hold 3"),
        ((0.0, joint[0, :3], joint[0], "1", touched_block(arm="right")[0]), "the block is"),
    ):
        with pytest.raises(CalibrationError, match=said):
            filter_.touch(*touch)
    with pytest.raises(CalibrationError, match="must be finite"):
        filter_.touch(0.0, joint[0, :3], joint[0] * np.nan, "1", block)
    with pytest.raises(CalibrationError, match="touch_sd"):
        filter_.touch(0.0, joint[0, :3], joint[0], "1", block, touch_sd=0.0)
    turns = touched_block()[2]
    turns.joints = ("shoulder", "elbow", "roll")  # which turns about the tip, or nearly
    with pytest.raises(CalibrationError, match="each in its own way"):
        ReZero(turns).touch(0.0, joint[0, [0, 1, 3]], joint[0], "1", block)
    calibration.joints = ("shoulder", "elbow")
    calibration.effort_baseline.residual = SIZE
    calibration.effort_baseline.correlation = TIME
    calibration.effort_baseline.step = STEP
    with pytest.raises(CalibrationError, match="three joints"):
        ReZero(calibration).touch(0.0, joint[0, :2], joint[0], "1", block)
    assert np.isinf(filter_.sd).all()
