import numpy as np
import pytest

from truejoint.recordings.table.stream import direction, gaps, velocity


def test_velocity_of_a_ramp_is_its_slope_whatever_the_stamps() -> None:
    t = np.cumsum(np.random.default_rng(0).uniform(0.005, 0.02, 300))
    rate = velocity(t, np.column_stack((3.0 * t, -0.5 * t)))
    np.testing.assert_allclose(rate, np.tile([3.0, -0.5], (300, 1)), atol=1e-9)


def test_encoder_steps_do_not_show_as_changes_of_direction() -> None:
    t = np.arange(5000) / 1000
    position = np.floor(np.sin(0.5 * t) / 0.001) * 0.001
    rising = direction(t, position)[100:2900]
    assert (rising == 1).mean() > 0.99
    assert not (rising == -1).any()


def test_direction_tells_up_down_and_standing() -> None:
    t = np.arange(600) / 100
    position = np.concatenate((t[:200], np.full(200, t[199]), t[199] - t[:200]))
    way = direction(t, position)
    assert (way[20:180] == 1).all()
    assert (way[220:380] == 0).all()
    assert (way[420:580] == -1).all()


def test_a_joint_that_never_moves_stands() -> None:
    assert not direction(np.arange(10.0), np.ones(10)).any()


def test_gaps_are_found_where_steps_are_long() -> None:
    t = np.delete(np.arange(100.0), [*range(30, 40), 70])
    np.testing.assert_array_equal(gaps(t), [29])


def test_slow_rates_use_neighbours() -> None:
    t = np.arange(10) * 0.5
    assert velocity(t, t**2)[4] == pytest.approx((t[5] ** 2 - t[3] ** 2) / (t[5] - t[3]))
