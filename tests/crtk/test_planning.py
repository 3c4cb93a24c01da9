"""Tests of truejoint.crtk.planning."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from truejoint.crtk import BLEND, BLOCK_DURATION, TimeLaw, time_law

RATE = 1000.0
SPEED = np.array([0.04, 0.05, 0.005])
ROUNDING = 1e-9


def moving_average(law, t):
    """The law by numerical quadrature of its own definition."""
    grid = t - BLEND * (np.arange(20000) + 0.5) / 20000
    lines = [np.interp(grid, law.times, knots) for knots in law.knots.T]
    return np.mean(lines, axis=1)


def random_law(seed, n=12):
    rng = np.random.default_rng(seed)
    return time_law(rng.uniform(-1, 1, (n, 3)) * [0.05, 0.1, 0.01], SPEED)


def test_law_is_the_moving_average_of_its_lines():
    law = random_law(0)
    for t in np.random.default_rng(1).uniform(0.0, law.duration, 20):
        assert law.at([t])[0] == pytest.approx(moving_average(law, t), abs=1e-7)


def test_rest_before_and_after_is_exact():
    law = random_law(2)
    ends = law.at([-1.0, 0.0, law.duration, law.duration + 5.0])
    assert np.array_equal(ends[:2], np.tile(law.knots[0], (2, 1)))
    assert np.allclose(ends[2:], law.knots[-1], rtol=0, atol=1e-16)


@given(arrays(float, (6, 3), elements=st.floats(-0.05, 0.05)))
def test_speed_acceleration_and_hull_are_bounded(knots):
    law = time_law(knots, SPEED)
    path = law.at(np.arange(0.0, law.duration + 2e-3, 1e-3))
    speed = np.diff(path, axis=0) * RATE
    acceleration = np.diff(speed, axis=0) * RATE
    assert (np.abs(speed) <= SPEED + 1e-8).all()
    assert (np.abs(acceleration) <= 2 * SPEED / BLEND + 1e-4).all()
    assert (path >= knots.min(axis=0) - ROUNDING).all()
    assert (path <= knots.max(axis=0) + ROUNDING).all()


def test_one_joint_is_always_at_its_cap_between_corners():
    law = time_law([[0, 0, 0], [0.2, 0.1, 0.0], [0.2, 0.1, 0.02]], SPEED)
    middle = (law.at([2.0 + 1e-3]) - law.at([2.0])) * RATE
    assert middle[0, 0] == pytest.approx(SPEED[0], rel=1e-6)
    assert law.times == pytest.approx([0.0, 0.2 / SPEED[0], 0.2 / SPEED[0] + 0.02 / SPEED[2]])


def test_a_corner_is_cut_by_at_most_an_eighth_or_a_quarter():
    corner = time_law([[0, 0, 0], [0.2, 0, 0], [0.2, 0.2, 0]], SPEED)
    turn = time_law([[0, 0, 0], [0.2, 0, 0], [0, 0, 0]], SPEED)
    t = np.arange(0.0, 20.0, 1e-3)
    cut = np.abs(corner.at(t) - [0.2, 0, 0]).max(axis=1).min()
    reached = turn.at(t)[:, 0].max()
    assert cut == pytest.approx(max(SPEED[:2]) * BLEND / 8, rel=0.2)
    assert 0.2 - reached == pytest.approx(SPEED[0] * BLEND / 4, rel=1e-3)


def test_blocks_join_to_the_whole_law():
    law = time_law([[0, 0, 0], [0.9, 0.3, 0.05]], SPEED)
    blocks = list(law.blocks(RATE))
    assert len(blocks) == 3
    assert max(len(block) for block in blocks) == BLOCK_DURATION * RATE
    whole = np.vstack(blocks)
    assert len(whole) == np.ceil(law.duration * RATE)
    assert np.array_equal(whole, law.at(np.arange(1, len(whole) + 1) / RATE))
    assert whole[-1] == pytest.approx([0.9, 0.3, 0.05], abs=1e-15)


def test_times_may_come_in_any_order():
    law = random_law(4)
    t = np.linspace(-1.0, law.duration + 1.0, 300)
    mixed = np.random.default_rng(0).permutation(len(t))
    assert np.array_equal(law.at(t[mixed]), law.at(t)[mixed])


def test_hours_keep_precision():
    # Six hours of swings: integrals grow to 10^3 rad s, set-points stay exact to 1e-10 rad.
    times = np.arange(0.0, 6 * 3600.0, 10.0)
    knots = np.column_stack([0.6 + 0.35 * (np.arange(len(times)) % 2)] * 3)
    law = TimeLaw(times, knots)
    t = times[-3] + 5.0
    assert law.at([t])[0] == pytest.approx(moving_average(law, t), abs=1e-10)


def test_standing_still_is_a_law_too():
    law = time_law([[0.1, 0.2, 0.3]] * 3, SPEED)
    assert np.array_equal(np.vstack(list(law.blocks(RATE)))[-1], [0.1, 0.2, 0.3])
    end = 1.0 + 5e-10
    assert time_law([[0.0], [end - 1e-12], [end]], [1.0]).knots[-1] == end  # the same instant
