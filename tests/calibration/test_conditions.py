"""Conditions that a loop sees: rate of motion and turning points, against plain counts."""

from itertools import pairwise

import numpy as np
import pytest

from truejoint.calibration.conditions import (
    CELLS,
    COUNT,
    N_MOTION,
    N_RATE,
    PACE,
    PEAK,
    STEPS,
    TURNED,
    VALLEY,
    follow_motion,
    learn_motion,
)

STRIDE = 1.0 / STEPS


def follow(t, positions):
    """What is kept of the arm and of its joints after each row."""
    positions = np.asarray(positions, float).reshape(len(t), -1)
    n_joints = positions.shape[1]
    rate, motion, kept = np.zeros(N_RATE), np.zeros((N_MOTION, n_joints)), []
    stride, measured = np.full(n_joints, STRIDE), np.arange(n_joints)
    for i, row in enumerate(positions):
        follow_motion(i == 0, t[i], row, measured, stride, rate, motion)
        kept.append((rate.copy(), motion.copy()))
    return kept


def path(*points, speed=0.4, dt=0.01):
    """Stamps and positions on straight lines between points."""
    rows = [np.array(points[:1], float)]
    for begin, end in pairwise(points):
        rows.append(np.linspace(begin, end, max(2, round(abs(end - begin) / (speed * dt))))[1:])
    positions = np.concatenate(rows)
    return dt * np.arange(len(positions)), positions


@pytest.mark.parametrize("dt", [0.001, 0.01, 0.2])
def test_the_time_of_a_step_is_that_of_the_speed_at_any_rate(dt):
    t, positions = path(0.0, 1.0, 0.0, 1.0, speed=0.4, dt=dt)
    rate, _ = follow(t, positions)[-1]
    assert rate[PACE] == pytest.approx(STRIDE / 0.4, rel=0.15)
    assert rate[COUNT] == pytest.approx(3 * STEPS, rel=0.1)


def test_the_fastest_joint_is_the_arms_rate():
    t, fast = path(0.0, 1.0, 0.0, speed=0.4)
    (alone, _), (together, _) = follow(t, fast)[-1], follow(t, np.c_[0.1 * fast, fast])[-1]
    np.testing.assert_array_equal(alone, together)


def test_a_pause_is_one_step_and_a_start_after_a_pause_is_none():
    t, positions = path(0.0, 1.0, 0.0)
    before = follow(t, positions)[-1][0][PACE]
    k = len(t) // 2
    late = np.r_[0.0, t[1:] + 60.0]
    assert follow(late, positions)[-1][0][PACE] == pytest.approx(before, rel=0.05)
    held = np.r_[t[:k], t[k:] + 60.0]
    kept = [rate[PACE] for rate, _ in follow(held, positions)]
    assert before < max(kept[k:]) < 1.1 * before


def test_twice_the_speed_shows_within_a_range_of_travel():
    t, positions = path(*([0.0, 1.0] * 4))
    times = np.cumsum(np.where(np.arange(len(t)) < len(t) // 2, 0.01, 0.005))
    kept = np.array([rate[PACE] for rate, _ in follow(times, positions)])
    slow = kept[len(t) // 2 - 1]
    halved = np.flatnonzero(kept < 0.55 * slow)
    assert halved[halved > STEPS][0] < len(t) // 2 + len(t) / 7


def plain_turning_points(positions):
    """Last valley and peak after each row, by the whole past."""
    turns, heading, end, found = [], 0, positions[0], []
    low = high = positions[0]
    for position in positions:
        if heading * (position - end) > 0:
            end = position
        elif abs(position - end) > STRIDE:
            if heading:
                turns.append((heading, end))
                low, high = (low, end) if heading > 0 else (end, high)
            heading, end = (1 if position > end else -1), position
        low, high = min(low, position), max(high, position)
        found.append((low, high, len(turns)))
    return found


def test_turning_points_are_the_last_two_until_a_larger_swing_wipes_them_out():
    t, positions = path(0.5, 0.8, 0.2, 0.6, 0.4, 0.5, 0.45, 0.9, 0.1)
    kept = [motion[[VALLEY, PEAK, TURNED], 0] for _, motion in follow(t, positions)]
    np.testing.assert_array_equal(kept, plain_turning_points(positions))
    inner = kept[int(np.flatnonzero(positions == 0.45)[-1]) + 10]
    assert (inner[0], inner[1]) == (0.45, 0.5)
    wiped = kept[int(np.flatnonzero(positions == 0.9)[-1])]
    assert (wiped[0], wiped[1]) == (0.45, 0.9)
    assert not kept[10][2]


def test_noise_turns_nothing():
    rng = np.random.default_rng(0)
    t, positions = path(0.0, 1.0, 0.3, 0.7)
    kept = follow(t, positions + rng.uniform(-0.4, 0.4, len(t)) * STRIDE)
    assert abs(kept[-1][1][VALLEY, 0] - 0.3) < STRIDE


def test_swings_are_learnt_with_those_beside_them():
    t, positions = path(0.5, 1.0, 0.0, 1.0, 0.9, 0.95)
    learnt = learn_motion([t], [positions[:, None]], 1.0, np.zeros(1))
    swings = learnt["swings"].reshape(CELLS, CELLS)
    assert swings[0, CELLS - 1] == swings[1, CELLS - 2] == 1.0  # between the ends, and nearly
    assert swings[0, CELLS // 2] == swings[CELLS // 2, CELLS // 2] == 0.0
    assert learnt["pace_lower"] <= learnt["stride"][0] / 0.4 <= 1.1 * learnt["pace_upper"]


@pytest.mark.parametrize(("noise", "stride"), [(0.001, 1 / STEPS), (0.01, 0.04), (1.0, 1 / CELLS)])
def test_a_step_is_longer_than_noise_and_no_longer_than_a_cell(noise, stride):
    t, positions = path(0.0, 1.0, 0.0)
    learnt = learn_motion([t], [positions[:, None]], 1.0, np.array([noise]))
    assert learnt["stride"].tolist() == [stride]


def test_motion_too_short_for_a_rate_states_none():
    t, positions = path(0.0, 1.0)
    learnt = learn_motion([t[:40]], [positions[:40, None]], 1.0, np.zeros(1))
    short = learn_motion([t[:2]], [positions[:2, None]], 1.0, np.zeros(1))
    assert learnt["stride"][0] == np.ptp(positions[:40]) / STEPS
    assert (short["pace_lower"], short["pace_upper"]) == (0.0, 0.0)
    assert not short["swings"].any()
