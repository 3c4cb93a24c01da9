"""Tests of the random motion, and of nested loops."""

import numpy as np
import pytest

from truejoint.motion import nested_motion, random_motion, workspace_of
from truejoint.robots import get_robot

ROBOT, FORCEPS = get_robot("raven2", "left"), get_robot("forceps")
SPACE = workspace_of(ROBOT)
# uw-biorobotics/raven2_CRTK_Python_controller:python_controller/run_r2_random_joint_movement.py
SHRINK = np.array([np.deg2rad(5), np.deg2rad(10), 0.02])
CRAWL = np.array([np.deg2rad(0.2), np.deg2rad(0.2), 0.001])
SLOWEST = np.array([np.deg2rad(1.091), np.deg2rad(1.5), 0.0025])
FASTEST = np.array([np.deg2rad(3), np.deg2rad(4), 0.007])


@pytest.mark.parametrize("profile", ["cosine", "laboratory"])
@pytest.mark.parametrize("seed", range(2))
def test_turns_and_speeds_are_in_the_ranges(seed, profile):
    motion = random_motion(ROBOT, 1200.0, seed, profile=profile)
    assert motion.positions[0] == pytest.approx(SPACE.centre)
    assert motion.times[[0, -1]] == pytest.approx([0.0, 1200.0])
    for k, path in enumerate(motion.positions.T):
        speed = np.diff(path) / np.diff(motion.times)
        turns = np.flatnonzero(np.sign(speed[1:]) != np.sign(speed[:-1])) + 1
        assert len(turns) > 10
        to_edge = np.minimum(path - SPACE.lower[k], SPACE.upper[k] - path)
        assert (to_edge >= 0.0).all()
        to_edge = to_edge[turns]
        assert (to_edge <= SHRINK[k] * (1 + 1e-3)).all()
        peaks = [np.abs(part).max() for part in np.split(speed, turns)[1:-1]]
        assert min(peaks) >= SLOWEST[k] * 0.99
        assert max(peaks) <= FASTEST[k]
        # Draws fill their ranges, and turning points are spread as well.
        assert np.ptp(peaks) > 0.5 * (FASTEST[k] - SLOWEST[k])
        assert np.ptp(to_edge) > 0.5 * SHRINK[k]


def test_reversals_are_smooth():
    motion = random_motion(ROBOT, 600.0, 1, rate=100.0)
    acceleration = np.diff(motion.positions, n=2, axis=0) * 100.0**2
    # Half a cosine of width d and peak speed v accelerates by at most 2 v^2 / d.
    shortest = SPACE.extent / 2 - SHRINK
    bound = 2 * FASTEST**2 / shortest
    assert (np.abs(acceleration) <= bound * 1.1).all()


def integrated(target, peak, crawl, t):
    """One swing of a unit gain per second, by Euler steps as the laboratory's loop makes them."""
    dt, left, out = 2e-3, target, []
    for now in np.arange(0.0, t[-1] + dt, dt):
        out.append(target - left)
        left -= min(max(left, crawl), peak) * min(now / 2.4, 1.0) * dt
    return np.interp(t, np.arange(len(out)) * dt, out)


def test_the_laboratorys_profile_is_that_of_its_control_loop():
    motion = random_motion(ROBOT, 300.0, 1, rate=100.0, profile="laboratory")
    for k, path in enumerate(motion.positions.T):
        speed = np.abs(np.diff(path)) * 100.0
        turns = np.flatnonzero(np.diff(np.sign(np.diff(path)))) + 1
        begin, end = turns[1], turns[2]
        t = np.arange(end - begin) / 100.0
        peak = speed[begin:end].max()
        way = integrated(abs(path[end] - path[begin]), peak, CRAWL[k], t)
        # The turn itself lies between two samples.
        late = 0.02 * peak
        assert np.abs(np.abs(path[begin:end] - path[begin]) - way).max() < late
        assert (speed[begin:end] > 0.99 * peak).mean() > 0.5  # constant for most of the way


def test_same_seed_same_motion_and_a_longer_one_goes_on():
    short, long = random_motion(ROBOT, 100.0, 5), random_motion(ROBOT, 300.0, 5)
    assert np.array_equal(short.positions, random_motion(ROBOT, 100.0, 5).positions)
    assert np.array_equal(short.positions, long.positions[: len(short)])
    assert not np.array_equal(short.positions, random_motion(ROBOT, 100.0, 6).positions)


def test_lines_between_points_are_close_to_the_curve():
    coarse, fine = random_motion(ROBOT, 60.0, 3), random_motion(ROBOT, 60.0, 3, rate=1000.0)
    for k in range(3):
        drawn = np.interp(fine.times, coarse.times, coarse.positions[:, k])
        assert np.abs(drawn - fine.positions[:, k]).max() < (1e-6 if k == 2 else np.deg2rad(1e-3))


def test_any_robot_with_a_workspace_can_move_at_random():
    space, motion = FORCEPS.workspace, random_motion(FORCEPS, 120.0, 2)
    assert motion.joints == ("jaw",)
    assert (motion.positions >= space.lower).all()
    assert (motion.positions <= space.upper).all()
    peak = np.abs(np.diff(motion.positions[:, 0])).max() * 20.0
    assert 0.5 * space.speed[0] < peak <= space.speed[0] * (1 + 1e-9)


def test_it_covers_the_workspace_from_its_centre_in_its_time():
    motion = nested_motion(FORCEPS, rate=200.0)
    jaw, t = np.degrees(motion.positions[:, 0]), motion.times
    assert (jaw[0], t[-1]) == (0.0, 65.0)
    assert (jaw.min(), jaw.max()) == pytest.approx((-50.0, 50.0), abs=0.01)
    assert 18.0 < np.abs(np.gradient(jaw, t)).max() < 25.0


def test_it_holds_loops_of_three_sizes_in_every_third():
    jaw = np.degrees(nested_motion(FORCEPS, rate=200.0).positions[:, 0])
    turns = jaw[1:-1][np.diff(np.sign(np.diff(jaw))) != 0]
    size, middle = np.abs(np.diff(turns)), (turns[1:] + turns[:-1]) / 2
    for low, high in ((-50, -15), (-15, 15), (15, 50)):
        inside = size[(low < middle) & (middle < high)]
        assert ((inside > 5) & (inside < 12)).any()
        assert ((inside > 20) & (inside < 30)).any()
    assert (size > 99).sum() == 3


def test_a_longer_one_is_slower():
    short, long = (nested_motion(FORCEPS, duration) for duration in (65.0, 130.0))
    np.testing.assert_allclose(long.positions[::2], short.positions, atol=1e-12)
