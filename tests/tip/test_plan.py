"""Planned touches tell more than others, are near each other, and come from both sides."""

from __future__ import annotations

from itertools import combinations, pairwise, permutations

import numpy as np
import pytest
from tests.tip.test_fit import prior, rows_of

from truejoint.errors import CalibrationError
from truejoint.tip.fit import fit_rows
from truejoint.tip.guide import approach_sides, choose_touches, shortest_order


def determinant(rows, known, chosen) -> float:
    """Logarithm of the determinant of the parameters' information, term by term."""
    free = np.flatnonzero(known.free)
    equations = rows.equations(known.state)
    whitening = equations.whitening(rows.joint_sd, rows.point_sd)
    white = whitening @ equations.by_parameter
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
    sd = fit_rows(rows.rows(np.isin(np.arange(60), chosen)), known).sd
    some = fit_rows(rows.rows(np.arange(60) < 10), known).sd
    assert np.prod(sd[sd > 0]) < np.prod(some[some > 0])


def test_of_few_the_greedy_choice_is_nearly_the_best():
    rows, known = rows_of(9, 3), prior(pose_sd=0.0)
    best = max(determinant(rows, known, pick) for pick in combinations(range(9), 3))
    worst = min(determinant(rows, known, pick) for pick in combinations(range(9), 3))
    found = determinant(rows, known, choose_touches(rows, known, 3))
    assert found > best - 0.15 * (best - worst)


def test_more_touches_than_dimples_are_refused():
    with pytest.raises(CalibrationError, match="12 touches of 9 dimples"):
        choose_touches(rows_of(9), prior(), 12)


def test_the_way_is_nearly_the_shortest():
    rng = np.random.default_rng(1)
    joint, speed = rng.uniform(size=(7, 3)), np.array([1.0, 2.0, 0.5])

    def way(order) -> float:
        return sum(float(np.max(np.abs(joint[a] - joint[b]) / speed)) for a, b in pairwise(order))

    found = shortest_order(joint, speed)
    assert sorted(found.tolist()) == list(range(7))
    assert found[0] == 0
    best = min(way((0, *rest)) for rest in permutations(range(1, 7)))
    assert way(found) <= 1.15 * best


def test_every_joint_comes_from_both_sides():
    sides = approach_sides(16, 3)
    assert (sides.sum(axis=0) == 0).all()
    assert (sides.T @ sides == 16 * np.eye(3)).all()
    assert np.abs(approach_sides(12, 3).sum(axis=0)).max() <= 4
