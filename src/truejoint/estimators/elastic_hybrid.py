"""The filter of an elastic joint, and boosted trees that learn what it leaves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Final, Self

import numpy as np
from sklearn.base import clone

from truejoint.array_types import Array, Integers
from truejoint.estimators import registry
from truejoint.estimators.base import Arrays, Flags, Progress
from truejoint.estimators.conversion import added, tree_sum, trees_data
from truejoint.estimators.cross_validation import BLOCKS
from truejoint.estimators.elastic_joint import ElasticJointFilter, motion_of, run
from truejoint.estimators.wrapped import Regressor, WrappedRegressor
from truejoint.models import elastic_hybrid, play_bank
from truejoint.models.elastic_joint import ElasticJoint, output_terms
from truejoint.models.family import Family, Params

_ROWS: Final = 40_000  # that the trees are fitted to, at most
_JUDGED: Final = 10_000  # by which zeros are found, at most
_BELIEVED: Final = 0.8  # share of a zero that others' trees leave
_FILTERED: Final = 0.6  # share of the fit's time that the filter takes


@dataclass(eq=False, repr=False)
class ElasticJointHybrid(ElasticJointFilter):
    """`ElasticJointFilter`, and boosted trees that learn what it leaves.

    The mean of two sets of trees. Those of one see plays and low-passes of driver and torque. Each
    recording has a zero that no signal shows, and these trees would learn it by heart, by the load
    and speed that a recording has and no other; what they are fitted to is therefore less the
    `zeros` of the histories. Those of the other see what the filter estimates besides, its friction
    and load included. What it needs is what the filter needs; loads, and all deviations that
    `estimate` gives, are the filter's own.

    Examples
    --------
    >>> ElasticJointHybrid(elements=3).name
    'hybrid'
    """

    family: ClassVar[Family] = elastic_hybrid.FAMILY
    members: ClassVar[tuple[str, ...]] = (registry.BESIDE_FILTER,)
    """What an automatic choice tries on the same signals, so that a mean of both can be taken."""

    def model_params(self) -> Params:
        """Parameters of the family: the filter's, and sizes of the trees."""
        return {**super().model_params(), **self._sizes}

    @property
    def _sizes(self) -> Params:
        known: Params = vars(self).get("sizes_", dict.fromkeys(elastic_hybrid.SIZES, 1))
        return known

    @classmethod
    def from_params(cls, params: Params) -> Self:
        """Make one of these parameters, to be run only."""
        made = cls(**{n: v for n, v in params.items() if n not in elastic_hybrid.SIZES})
        made.sizes_ = {name: params[name] for name in elastic_hybrid.SIZES}
        return made

    def _learn(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        filtered = super()._learn(X, y, dt, lambda done: progress(_FILTERED * done))
        known = np.flatnonzero(self._known(y))
        kept = np.zeros(len(X), dtype=bool)
        kept[known[:: -(-len(known) // _ROWS)]] = True
        low, high = X[known].min(axis=0), X[known].max(axis=0)
        scales = {"centre": 0.5 * (low + high), "inverse_half_range": 2.0 / (high - low)}
        motion = motion_of(X, filtered["scales"], dt)
        states, _ = run(ElasticJoint.from_arrays(filtered), motion, float(filtered["scales"][3]))
        told = output_terms(motion.angle, states)[kept] @ filtered["outputs"].T
        seen, left = _sight(scales, X, dt, kept, states[kept], told), y[kept] - told
        plays = seen[:, : play_bank.n_seen(elastic_hybrid.BANK, elastic_hybrid.SIGNALS)]
        unfitted = registry.member("boosted_trees")
        zero = zeros(unfitted, plays, left, motion.history[kept])
        sums = []
        for j in range(y.shape[1]):
            targets = ((plays, left[:, j] - zero[:, j]), (seen, left[:, j]))
            both = [tree_sum(clone(unfitted).fit(*target)) for target in targets]
            sums.append(added([one.rescaled(0.0, 0.5) for one in both if one is not None]))
            progress(_FILTERED + (1.0 - _FILTERED) * (j + 1) / y.shape[1])
        trees = trees_data(sums, np.zeros(seen.shape[1]), np.ones(seen.shape[1]))
        self.sizes_ = dict(trees.params)
        return elastic_hybrid.joined(filtered, scales, trees.arrays)

    def _beyond(self, X: Array, dt: Array, states: Array, told: Array) -> Array:
        _, scales, data = elastic_hybrid.parts(self.model_params(), self.arrays_)
        seen = _sight(scales, X, dt, np.ones(len(X), dtype=bool), states, told)
        return WrappedRegressor.from_data(data, seen.shape[1], told.shape[1]).evaluate(seen)


def _sight(scales: Arrays, X: Array, dt: Array, kept: Flags, states: Array, told: Array) -> Array:
    """Give what trees see in rows `kept` (n,) of `X` (n, 2); states and outputs are of those."""
    plays = play_bank.expand_rows(elastic_hybrid.BANK, scales, X, dt, kept)
    return np.hstack([plays, states, told])


def zeros(model: Regressor, X: Array, y: Array, history: Integers) -> Array:
    """Zeros (n, n_outputs) of the histories of rows, which a model should not learn by heart.

    Of features `X` (n, k), targets `y` (n, n_outputs) and the number of each row's `history` (n,):
    four fifths of the mean of what clones of the model leave that are fitted to other histories, as
    the random intercepts of a mixed-effects forest (Hajjem, Bellavance and Larocque, Journal of
    Statistical Computation and Simulation 84, 2014), found once. They are 0 for an output whose
    errors on other histories are not less without them, as where each history is alone under its
    load, and where there are fewer than five.
    """
    some = slice(None, None, -(-len(y) // _JUDGED))
    names, own = np.unique(history[some], return_inverse=True)
    found = np.zeros((int(history.max()) + 1, y.shape[1]))
    if len(names) < BLOCKS:
        return found[history]
    X, y = X[some], y[some]
    part = (np.random.default_rng(0).permutation(len(names)) % BLOCKS)[own]
    left = y - _by_others(model, X, y, part)
    sums = np.column_stack([np.bincount(own, column) for column in left.T])
    zero = _BELIEVED * sums / np.bincount(own)[:, None]
    without = y - _by_others(model, X, y - zero[own], part)
    pays = np.mean(without**2, axis=0) < np.mean(left**2, axis=0)
    found[names] = np.where(pays, zero, 0.0)
    return found[history]


def _by_others(model: Regressor, X: Array, y: Array, part: Integers) -> Array:
    """Predict (n, n_outputs) each part of the rows by clones that are fitted to the others."""
    out = np.empty_like(y)
    for number in range(BLOCKS):
        own = part == number
        for j in range(y.shape[1]):
            out[own, j] = clone(model).fit(X[~own], y[~own, j]).predict(X[own])
    return out
