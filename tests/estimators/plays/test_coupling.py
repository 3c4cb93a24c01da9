"""Joints whose cables pull at each other: their plays, what is found of them and its use."""

import numpy as np
import pytest
from tests.refusals import refused

from truejoint.estimators import Plays
from truejoint.estimators.plays.learn import identify_coupling
from truejoint.estimators.plays.run import SETTLED, coupled_play, coupled_play_rows
from truejoint.features.feature_set import play
from truejoint.robots import get_robot

COUPLING = np.array([[0.0, 0.8, 0.0], [0.45, 0.0, 0.0], [0.0, 0.0, 0.0]])
REACHES = np.array([0.1, 0.15, 0.05])


def wrist(seed: int, n: int = 1500) -> tuple[np.ndarray, np.ndarray]:
    """Positions (n, 3), from -1 to 1, of a robot that steps; how far its joints are from them."""
    rng = np.random.default_rng(seed)
    marks = rng.uniform(-1.0, 1.0, (n // 10 + 2, 3))
    at = np.arange(n) / 10
    wanted = np.column_stack([np.interp(at, np.arange(len(marks)), m) for m in marks.T])
    left = np.empty_like(wanted)
    coupled_play_rows(COUPLING, REACHES, np.arange(n) == 0, wanted, np.empty(3), left)
    return wanted, left + 0.01 * rng.normal(size=left.shape)


@pytest.mark.parametrize("seed", [0, 1])
def test_stiffness_and_friction_are_found(seed):
    wanted, left = wrist(seed)
    fresh, known = np.arange(len(wanted)) == 0, np.arange(len(wanted)) % 3 > 0
    coupling, reaches = identify_coupling(wanted, fresh, known, wanted[known], left[known])
    np.testing.assert_allclose(coupling, COUPLING, atol=0.12)
    np.testing.assert_allclose(reaches, REACHES, rtol=0.25)


def test_coupled_plays_know_on_other_motion_what_plays_of_each_joint_do_not():
    (wanted, left), (other, unseen) = wrist(0), wrist(1)
    dt = np.full(len(wanted), 0.4)
    errors = [
        np.std(unseen - Plays(couple=own).fit(wanted, left, dt=dt).predict(other, dt), axis=0)
        for own in (True, False)
    ]
    assert (errors[0][:2] < 0.5 * errors[1][:2]).all()
    assert errors[0][2] < 1.2 * errors[1][2]


def test_positions_are_those_that_are_measured():
    names = ("effort/a", "measured/a", "lowpass(measured/a, 0.1)", "measured/b")
    told = names, get_robot("raven2"), ("elbow",)
    assert Plays(couple=True).for_features(*told).positions == (1, 3)
    assert Plays(positions=(0, 2)).for_features(*told).positions == (0, 2)
    assert Plays().for_features(*told).positions is None


def test_other_features_are_not_coupled_and_count_all_the_same():
    wanted, left = wrist(0, 800)
    load = np.sin(np.arange(800) / 50.0)
    left = left + 0.3 * load[:, None]
    model = Plays(couple=True, positions=(1, 2, 3)).fit(np.column_stack([load, wanted]), left)
    assert model.coupled_ == (1, 2, 3)
    assert model.coupling_.shape == (3, 3)
    assert model.score(np.column_stack([load, wanted]), left) > 0.95


@pytest.mark.parametrize(
    ("how", "joints", "said"),
    [
        ({}, 1, "among the features: 1; coupled_play couples 2 to 12: give other features"),
        ({}, 13, "among the features: 13; coupled_play couples 2 to 12"),
        ({"positions": (0, 3)}, 3, "positions .*; it must be of features 0 to 2"),
        ({"positions": (0, 0)}, 3, "coupled is .*; it must be 2 to 12 measured positions"),
        ({"couple": "yes"}, 3, "couple is 'yes'; it must be one of False, True"),
    ],
)
def test_what_cannot_be_coupled_is_refused(how, joints, said):
    X = np.random.default_rng(0).normal(size=(1200, joints))
    refused(said, Plays(**{"learner": "trees", "couple": True, **how}).fit, X, X[:, 0])


FRICTION = np.array([0.1, 0.3, 0.05])


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
    coupled_play_rows(coupling, FRICTION[:k], fresh, wanted, np.empty(k), out)
    return out


def test_joints_that_do_not_pull_at_each_other_have_plays_of_their_own():
    wanted, fresh = motion(0, 3), np.arange(600) % 250 == 0
    found = deflections(np.zeros((3, 3)), wanted, fresh)
    for joint, reach in enumerate(FRICTION):
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
    pull, friction = -found @ stiff, FRICTION * own
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
        coupled_play(coupling, FRICTION, 0.5, i == 0, row, last, found)
        np.testing.assert_allclose(found, 0.5 * whole[i], atol=20 * SETTLED)
