"""The filter of an elastic joint, and boosted trees that learn what it leaves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import clone

from truejoint.array_types import Array, Integers
from truejoint.errors import CalibrationError
from truejoint.estimators import registry
from truejoint.estimators.base import Arrays, Progress
from truejoint.estimators.family import EstimatorData, Family, Params
from truejoint.estimators.filtered import run_filter
from truejoint.estimators.hybrid import joined
from truejoint.estimators.motor_side.learn import ElasticJointFilter, JointEstimate
from truejoint.estimators.motor_side.run import HYBRID_ROWS
from truejoint.estimators.plays.learn import feature_scales
from truejoint.estimators.polynomial.learn import BLOCKS
from truejoint.estimators.trees.learn import TreeSum, added, tree_sum, trees_data
from truejoint.estimators.trees.run import FAMILY as TREES
from truejoint.estimators.wrapped import Regressor

_PLAYS: Final[Params] = {
    "plays": (0.01, 0.02, 0.05, 0.1, 0.2, 0.35, 0.6, 0.9),  # half-widths, in half ranges
    "time_constants": (0.05, 0.5, 2.0),  # of low-passes [s]
}
"""What the trees see of the signals, driver and torque."""
_ROWS: Final = 40_000  # that the trees are fitted to, at most
_JUDGED: Final = 10_000  # by which zeros are found, at most
_BELIEVED: Final = 0.8  # share of a zero that others' trees leave
_ASKED: Final = 0.15  # share of what is seen that a split of the torque's trees may ask for
_FILTERED: Final = 0.6  # share of the fit's time that the filter takes


@dataclass(eq=False, repr=False)
class ElasticJointHybrid(ElasticJointFilter):
    """`ElasticJointFilter`, and boosted trees that learn what it leaves.

    The mean of two sets of trees. Those of one see plays and low-passes of driver and torque. Each
    recording has a zero that no signal shows, and these trees would learn it by heart, by the load
    and speed that a recording has and no other; what they are fitted to is therefore less the
    `zeros` of the histories. Those of the other see what the filter estimates besides, its friction
    and load included. The jaw's torque, where it is learnt, has one set, which sees as much; each
    split may ask for a few features alone, drawn at random, as in a random forest (Breiman, Machine
    Learning 45, 2001), since the load by itself would tell the recordings apart. What it needs is
    what the filter needs; loads, and all deviations that `estimate` gives, are the filter's own.

    Examples
    --------
    >>> ElasticJointHybrid(elements=3).name
    'hybrid'
    """

    family: ClassVar[Family] = HYBRID_ROWS
    members: ClassVar[tuple[str, ...]] = (registry.BESIDE_FILTER,)
    """What an automatic choice tries on the same signals, so that a mean of both can be taken."""

    _FOUND: ClassVar[Params] = {
        **ElasticJointFilter._FOUND, **_PLAYS,
        "model": (TREES.name, dict.fromkeys(TREES.rules, 1), ()),
    }  # fmt: skip

    def _learn(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        filtered = super()._learn(X, y, dt, lambda done: progress(_FILTERED * done))
        with_truth = np.flatnonzero(self._known(y))
        chosen = np.zeros(len(X), dtype=bool)
        chosen[with_truth[:: -(-len(with_truth) // _ROWS)]] = True
        filtered |= feature_scales(X[with_truth])
        data = EstimatorData(self.family.name, self.model_params(), filtered)
        torque = tuple(self.family.beside(self.model_params()))
        run = run_filter(self.family.memory(data, 2, 1), X, dt, torque)
        inputs, outputs = run.sighted[chosen], np.hstack([run.outputs, run.beside[:, 0]])[chosen]
        residual, history = self._targets(y, dt)[chosen] - outputs, np.cumsum(dt == 0.0)[chosen]
        unfitted = registry.member("boosted_trees")
        plays = inputs[:, : -run.x.shape[1] - 1]
        zero = zeros(unfitted, plays, residual[:, :1], history)[:, 0]
        both = ((plays, residual[:, 0] - zero), (inputs, residual[:, 0]))
        sums = [added([_fitted(unfitted, *pair).rescaled(0.0, 0.5) for pair in both])]
        progress(_FILTERED + 0.8 * (1.0 - _FILTERED))
        unfitted.set_params(max_features=_ASKED)
        for torque in residual.T[1:]:
            rows = np.isfinite(torque)
            sums.append(_fitted(unfitted, inputs[rows], torque[rows]))
        progress(1.0)
        trees = trees_data(sums, np.zeros(inputs.shape[1]), np.ones(inputs.shape[1]))
        self.found_ = {**self.found_, "model": (TREES.name, trees.params, ())}
        return joined(filtered, trees.arrays)

    def estimate(
        self, X: Array, dt: ArrayLike | None = None, *, smoothed: bool = False
    ) -> JointEstimate:
        """Angle, torque and load, as the filter tells them, with what the trees add.

        Raises CalibrationError where it is to be `smoothed`: the trees know what the filter leaves,
        and on smoothed states they err more than on its own.
        """
        if smoothed:
            raise CalibrationError(
                f"{self.name}: its trees know what the filter leaves, not a smoother; smooth with "
                f"{ElasticJointFilter().name}, or take smoothed=False"
            )
        return super().estimate(X, dt)


def _fitted(unfitted: Regressor, X: Array, y: Array) -> TreeSum:
    """Trees of a clone that is fitted to rows `X` (n, k) and targets `y` (n,)."""
    trees = tree_sum(clone(unfitted).fit(X, y))
    assert trees is not None  # noqa: S101  # boosted trees are one
    return trees


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
    names, place = np.unique(history[some], return_inverse=True)
    zero_of = np.zeros((int(history.max()) + 1, y.shape[1]))
    if len(names) < BLOCKS:
        return zero_of[history]
    X, y = X[some], y[some]
    part = (np.random.default_rng(0).permutation(len(names)) % BLOCKS)[place]
    residual = y - _by_others(model, X, y, part)
    sums = np.column_stack([np.bincount(place, column) for column in residual.T])
    zero = _BELIEVED * sums / np.bincount(place)[:, None]
    without = y - _by_others(model, X, y - zero[place], part)
    pays = np.mean(without**2, axis=0) < np.mean(residual**2, axis=0)
    zero_of[names] = np.where(pays, zero, 0.0)
    return zero_of[history]


def _by_others(model: Regressor, X: Array, y: Array, part: Integers) -> Array:
    """Predict (n, n_outputs) each part of the rows by clones that are fitted to the others."""
    out = np.empty_like(y)
    for number in range(BLOCKS):
        rows = part == number
        for j in range(y.shape[1]):
            out[rows, j] = clone(model).fit(X[~rows], y[~rows, j]).predict(X[rows])
    return out
