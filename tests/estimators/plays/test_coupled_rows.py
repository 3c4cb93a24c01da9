"""Plays of joints that pull at each other, against the conditions that define them."""

from __future__ import annotations

import numpy as np
import pytest

from truejoint.estimators.plays.run import SETTLED, coupled_play, coupled_play_rows
from truejoint.features.kernels import play

REACHES = np.array([0.1, 0.3, 0.05])


def motion(seed: int, joints: int, n: int = 600) -> np.ndarray:
    """Motion (n, joints) that turns now and then."""
    steps = np.random.default_rng(seed).normal(size=(n // 20, joints))
    return np.cumsum(np.repeat(steps, 20, axis=0), axis=0) * 0.02


def stiffness(seed: int) -> np.ndarray:
    """Symmetric, positive (3, 3)."""
    root = np.random.default_rng(seed).normal(size=(3, 3))
    return root @ root.T + 0.5 * np.eye(3)


def deflections(coupling: np.ndarray, wanted: np.ndarray, fresh: np.ndarray) -> np.ndarray:
    out = np.empty_like(wanted)
    k = wanted.shape[1]
    coupled_play_rows(coupling, REACHES[:k], fresh, wanted, np.empty(k), out)
    return out


def test_joints_that_do_not_pull_at_each_other_have_plays_of_their_own():
    wanted, fresh = motion(0, 3), np.arange(600) % 250 == 0
    found = deflections(np.zeros((3, 3)), wanted, fresh)
    for joint, reach in enumerate(REACHES):
        last = 0.0
        for i, value in enumerate(wanted[:, joint]):
            last = play(reach, bool(fresh[i]), value, last)
            assert found[i, joint] == pytest.approx(last - value, abs=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_friction_holds_each_joint_or_it_slides_the_way_it_is_pulled(seed):
    """Stiffness times deflection is the cables' pull; it is friction's where a joint slides."""
    stiff = stiffness(seed)
    own = np.diag(stiff)
    wanted, fresh = motion(seed, 3), np.arange(600) == 0
    found = deflections(stiff / own[:, None] - np.eye(3), wanted, fresh)
    pull, friction = -found @ stiff, REACHES * own
    near = 20 * SETTLED * own
    assert (np.abs(pull) <= friction + near).all()
    moved = np.diff(wanted + found, axis=0)
    slid = np.abs(moved) > 5 * SETTLED
    assert slid.sum() > 100
    assert (~slid).sum() > 100
    held = np.sign(moved) * friction
    np.testing.assert_array_less(np.abs(pull[1:] - held)[slid], np.tile(near, (599, 1))[slid])


def test_less_friction_is_a_play_of_smaller_motion():
    coupling = stiffness(1) / np.diag(stiffness(1))[:, None] - np.eye(3)
    wanted = motion(2, 3)
    whole = deflections(coupling, wanted, np.arange(600) == 0)
    last, found = np.empty(3), np.empty(3)
    for i, row in enumerate(0.5 * wanted):
        coupled_play(coupling, REACHES, 0.5, i == 0, row, last, found)
        np.testing.assert_allclose(found, 0.5 * whole[i], atol=20 * SETTLED)
