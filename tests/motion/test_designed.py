"""Tests of the designed motion."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from truejoint.errors import TrajectoryError
from truejoint.motion import designed_motion, workspace_of
from truejoint.motion.designed import NOISE, curved_terms, expected_error, scaled_speed, terms
from truejoint.robots import get_robot

ROBOT = get_robot("raven2", "left")
SPACE = workspace_of(ROBOT)


@pytest.mark.parametrize("robot", ["raven2", "forceps"])
def test_it_keeps_to_time_range_and_speed(robot):
    target = get_robot(robot)
    space = workspace_of(target)
    motion = designed_motion(target, 90.0, seed=3)
    assert (motion.times[0], motion.times[-1]) == (0.0, 90.0)
    assert (motion.positions >= space.lower).all()
    assert (motion.positions <= space.upper).all()
    share = np.abs(np.diff(motion.positions, axis=0)) / np.diff(motion.times)[:, None]
    _, slowest, fastest, _ = space.swings
    assert (share <= fastest * (1.0 + 1e-9)).all()
    assert ((share >= slowest * (1.0 - 1e-9)).any(axis=1)).all()
    assert np.ptp((share / fastest).max(axis=1)) > 0.1  # speeds differ, as friction does with them
    motion.check_within(target)


def test_a_workspace_that_is_crossed_in_a_second_has_a_motion_yet():
    speeds = {"slowest": SPACE.extent / 1.1, "fastest": SPACE.extent / 1.05, "crawl": None}
    motion = designed_motion(ROBOT, 20.0, workspace=replace(SPACE, **speeds))
    assert motion.times[-1] == 20.0
    assert (np.diff(motion.times) < 1.1).all()
    speeds = {"slowest": SPACE.extent / 0.9, "fastest": SPACE.extent / 0.8, "crawl": None}
    with pytest.raises(TrajectoryError, match="crossed in less than 1 s"):
        designed_motion(ROBOT, 20.0, workspace=replace(SPACE, **speeds))


def test_a_longer_one_begins_with_the_shorter():
    short, long = (designed_motion(ROBOT, duration, seed=1) for duration in (60.0, 120.0))
    n = len(short) - 1  # the last line of the shorter ends with its time
    np.testing.assert_array_equal(short.positions[:n], long.positions[:n])
    np.testing.assert_array_equal(short.times[:n], long.times[:n])
    other = designed_motion(ROBOT, 60.0, seed=2)
    assert not np.array_equal(other.positions[1], short.positions[1])


def test_terms_are_orthonormal_over_the_workspace():
    degrees, spreads = curved_terms(2)
    nodes, weights = np.polynomial.legendre.leggauss(8)  # exact for the products
    z, w = np.array(list(itertools.product(nodes, repeat=2))), np.outer(weights, weights).ravel()
    low, high = np.array([1.0, 2.0]), np.array([3.0, 7.0])
    products = 0.0
    for direction in itertools.product((-1.0, 1.0), repeat=2):
        for pair, weight in zip(z, w, strict=True):
            speed = scaled_speed(low + (1.0 + pair) / 2.0 * (high - low), low, high)
            every = np.hstack(terms(z, np.array(direction), speed, degrees))
            products += weight * every.T @ (w[:, None] * every) / 64.0
    assert every.shape[1] == 7 + len(spreads)
    np.testing.assert_allclose(products, np.eye(every.shape[1]), atol=1e-12)


def test_the_expected_error_is_that_of_fits_to_drawn_errors():
    random = np.random.default_rng(0)
    degrees, spreads = curved_terms(2)
    z = random.uniform(-1.0, 1.0, (15, 2)) ** 3  # uneven
    signs, speed = np.sign(random.standard_normal((2, 15, 2)))
    linear, curved = terms(z, signs, speed, degrees)
    known = linear.T @ linear + NOISE**2 * np.eye(7)
    stated = expected_error(known, linear.T @ curved, spreads)
    draws = 40_000
    beta = random.standard_normal((7, draws))
    gamma = spreads[:, None] * random.standard_normal((len(spreads), draws))
    y = linear @ beta + curved @ gamma + NOISE * random.standard_normal((15, draws))
    wide = np.vstack([linear, NOISE * np.eye(7)])  # the prior as measurements of its own
    found = np.linalg.lstsq(wide, np.vstack([y, np.zeros((7, draws))]))[0]
    assert np.mean(np.sum((found - beta) ** 2, axis=0)) == pytest.approx(stated, rel=0.03)


def test_it_expects_less_error_than_a_back_and_forth():
    """What is chosen is better than the same number of lines along one diagonal."""
    motion = designed_motion(ROBOT, 60.0)
    diagonal = np.tile([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]], (len(motion) // 2, 1))
    degrees, spreads = curved_terms(3)

    def error(corners):
        shares = (np.arange(10)[:, None] + 0.5) / 10
        lines = corners[:-1, None] + shares * np.diff(corners, axis=0)[:, None]
        signs = np.sign(np.diff(corners, axis=0))[:, None]
        linear, curved = terms(lines, signs, np.zeros(3), degrees)
        linear, curved = linear.reshape(-1, 10), curved.reshape(len(linear) * 10, -1)
        known = linear.T @ linear + NOISE**2 * np.eye(10)
        return expected_error(known, linear.T @ curved, spreads)

    chosen = (motion.positions - SPACE.centre) / (SPACE.extent / 2.0)
    assert error(chosen) < 0.5 * error(diagonal)
