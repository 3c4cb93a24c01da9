"""Ridge regression and boosted trees on plays and low-passes of every feature."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Final, Self

import numpy as np
from sklearn.base import clone

from truejoint.array_types import Array, Integers
from truejoint.errors import CalibrationError
from truejoint.estimators import registry
from truejoint.estimators.base import (
    Arrays,
    JointRegressor,
    Progress,
    constant_columns,
    scaling,
)
from truejoint.estimators.combination import Combination
from truejoint.estimators.coupled_play import identify_coupling
from truejoint.estimators.cross_validation import (
    BLOCKS,
    PenalisedFit,
    blocks,
    cross_validated,
    penalised,
)
from truejoint.estimators.gaussian_process import GaussianProcess
from truejoint.estimators.polynomial import TermsRegressor, polynomial_design
from truejoint.models import interactions, offset, play_bank
from truejoint.models.combination import members
from truejoint.models.family import Family, Params, is_integer

if TYPE_CHECKING:
    from truejoint.robots import Robot

SHARES: Final = (0.0, 0.3, 1.0)
"""Sizes tried of terms that are products, beside the others: less is penalised more."""

_CHUNK: Final = 4096  # rows that are held at a time as terms
_PRODUCTS: Final = 600  # terms that are products, at most
_LEAVES: Final = 31  # of a tree; half as many, and fewer trees, where each of more joints has trees
_FEW_JOINTS: Final = 2  # of its own, which a control loop walks through at every sample
_FEWER_TREES: Final = 70
_PLAYS: Final = (0.01, 0.02, 0.05, 0.1, 0.2, 0.35, 0.6, 0.9)
_TIME_CONSTANTS: Final = (0.05, 0.5, 2.0)  # [s]
_SHORT: Final = (0.1,)  # [s], which tells a Gaussian process how fast and which way
_NARROW: Final = 4
"""Of the plays where capstans turn. The wider ones, and low-passes, tell the direction of a zig-zag
of one speed just as well, and something else of any other motion."""
_IDENTIFIED: Final = 6_000  # rows that the search for a coupling sees, at most
_FAR: Final = 6.0  # standard deviations, beyond which a row is not fitted to
_NORMAL: Final = 0.6745  # median of a normal error's size, over its standard deviation
_MOST_FAR: Final = 0.05  # share of the rows that may be; more of them are no exceptions
_ROUNDS: Final = 5
_GAIN: Final = 0.05  # share of the error on blocks left out that plays which grow must take away


@dataclass(eq=False, repr=False)
class Ridge(TermsRegressor):
    """Ridge regression on features and products of them, its penalties cross-validated.

    For each output by itself, a penalty and how much more products are penalised are those of the
    least mean square on five parts of the rows that are left out in turn: blocks on end, or, where
    `dt` tells of fewer than five histories, a block of each.

    Parameters
    ----------
    first : int, optional
        Of the features, by which each of the first `crossed` is multiplied; by default all, or
        none where that makes more than 600 products.
    crossed : int, optional
        Features that are multiplied, `first` or more; by default as many as `first`.
    squared : int, optional
        Of the features, by whose squares they are multiplied too; by default none.
    trimmed : bool
        Whether it is fitted again without rows in which it errs by more than six standard
        deviations (by the median's size), where these are a twentieth at most. They are left to
        what learns the residual: a roll is ill conditioned where the wrist is bent by a right
        angle, and a few such rows bend the model everywhere.

    Attributes
    ----------
    penalties_ : ndarray, shape (n_outputs,)
        Chosen of `truejoint.estimators.cross_validation.PENALTIES`.
    shares_ : ndarray, shape (n_outputs,)
        Chosen of `SHARES`.
    errors_ : ndarray, shape (n_outputs,)
        Root mean square on the blocks that were left out, in standard deviations of the target.

    Examples
    --------
    >>> X = np.random.default_rng(0).normal(size=(500, 2))
    >>> Ridge().fit(X, X[:, 0] * X[:, 1]).predict([[2.0, 0.5]]).round(2)
    array([1.])
    """

    family: ClassVar[Family] = interactions.FAMILY
    first: int | None = None
    crossed: int | None = None
    squared: int = 0
    trimmed: bool = False

    def model_params(self) -> Params:
        """Parameters of the family: by default, the numbers for what it is fitted to."""
        k = int(vars(self).get("n_features_in_", 0))
        usual = k if k * (k + 1) // 2 <= _PRODUCTS else 0
        first = usual if self.first is None else self.first
        crossed = first if self.crossed is None else self.crossed
        return {"first": first, "crossed": crossed, "squared": self.squared}

    def minimum_rows(self, n_features: int) -> int:
        """Two rows for each input, which the penalty makes enough."""
        return max(100, 2 * n_features)

    def factors(self, n_features: int) -> Integers:
        """Features that each term multiplies (n_terms, 2), or 3 where there are `squared`."""
        return interactions.interaction_factors(n_features, **self.model_params())

    def _learn(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        factors = self.factors(X.shape[1])
        scales = scaling(X, y)
        mean, inverse_scale = scales["mean"], scales["inverse_scale"]
        scaled = (X - mean) * inverse_scale
        targets = (y - scales["target_mean"]) / scales["target_scale"]
        products = np.array([_products(scaled[b], targets[b], factors) for b in blocks(dt)])
        is_product = factors[:, 1] < X.shape[1]
        shares = SHARES if is_product.any() else SHARES[-1:]
        weights = [np.where(is_product, share, 1.0) for share in shares]
        found = cross_validated(products, weights, progress)
        self.shares_, self.penalties_ = np.array(shares)[found.weights], found.penalties
        self.errors_ = np.sqrt(np.maximum(found.errors, 0.0) / len(X))
        table = found.coefficients
        if self.trimmed:
            own = np.array(weights)[found.weights]
            table = _without_far(scaled, targets, factors, products.sum(axis=0), own, found)
        table = table * scales["target_scale"]
        return {
            "mean": mean,
            "inverse_scale": inverse_scale,
            "coef": np.ascontiguousarray(table[1:]),
            "intercept": table[0] + scales["target_mean"],
        }


def _products(scaled: Array, y: Array, factors: Integers) -> Array:
    """Give sums (m, m) of products of every two of: 1, the terms, the targets."""
    width = 1 + len(factors) + y.shape[1]
    total = np.zeros((width, width))
    for start in range(0, len(scaled), _CHUNK):
        rows = slice(start, start + _CHUNK)
        terms = polynomial_design(scaled[rows], factors)
        table = np.column_stack([np.ones(len(terms)), terms, y[rows]])
        total += table.T @ table
    return total


def _without_far(
    scaled: Array, y: Array, factors: Integers, products: Array, weights: Array, fit: PenalisedFit
) -> Array:
    """Coefficients (1 + n_terms, n_outputs), each output fitted again without rows far off.

    `products` (m, m) are the sums of `_products` over all rows, `weights` (n_outputs, n_terms)
    those of the terms; penalties stay.
    """
    table, n_terms = fit.coefficients.copy(), len(factors)
    before = np.zeros(y.shape, dtype=bool)
    for _ in range(_ROUNDS):
        left = np.abs(y - _linear(scaled, factors, table))
        far = left > _FAR / _NORMAL * np.median(left, axis=0)
        far &= far.mean(axis=0) <= _MOST_FAR
        for j in np.flatnonzero((far != before).any(axis=0)):
            rows = np.flatnonzero(far[:, j])
            kept = products - _products(scaled[rows], y[rows], factors)
            places = [*range(1 + n_terms), 1 + n_terms + j]
            table[:, j] = penalised(kept[np.ix_(places, places)], weights[j], fit.penalties[j])
        if (far == before).all():
            break
        before = far
    return table


def _linear(scaled: Array, factors: Integers, table: Array) -> Array:
    """Values (n, n_outputs) of coefficients (1 + n_terms, n_outputs), the constants first."""
    chunks = (scaled[i : i + _CHUNK] for i in range(0, len(scaled), _CHUNK))
    values = [table[0] + polynomial_design(own, factors) @ table[1:] for own in chunks]
    return np.concatenate(values)


@dataclass(eq=False, repr=False)
class RichPlay(JointRegressor):
    """A model on plays and low-passes of every feature: for joints whose error has a history.

    Half-widths are shares of half the range that a feature has in training, so nothing is to be
    chosen for a robot or a unit. A ridge regression on the features, plays and low-passes, and on
    their products with the features (the width of a loop grows with load), is learnt first.
    `calibrate` adds plays of measured positions whose widths grow with efforts (friction grows with
    the tension of a cable). Where joints are coupled, plays of all their positions together stand
    in place of the plays of each feature: the cables of one joint pull at the others, as in a
    wrist. Stiffness and friction are found first, see
    `truejoint.estimators.coupled_play.identify_coupling`. Where capstans turn, what errs once in
    each turn of one, as an eccentric one does, is seen by the cosine and sine of its angle.

    Parameters
    ----------
    learner : {"ridge", "trees", "gaussian_process"}
        The ridge regression alone, or with boosted trees on what it leaves; or a Gaussian process.
    couple : bool
        Whether there are plays of several joints together.
    positions : sequence of int, optional
        Places of the features that are positions of such joints, 2 to 12; by default the measured
        positions, or all where features have no names.
    shares : sequence of float
        Of friction that such plays have, in place of one play with all of it.
    turn : bool
        Whether the angles of capstans are seen.
    turns : sequence of sequence of float, optional
        By how much each capstan turns with each feature [rad over its unit]; `calibrate` takes
        those that the robot's transmission says of the joints' measured positions.
    plays : sequence of float, optional
        Half-widths of the plays of each feature, in half ranges of it; by default eight from 0.01
        to 0.9, the four smallest of them where capstans turn; where joints are coupled, or for a
        Gaussian process, none.
    time_constants : sequence of float, optional
        Of the low-passes [s]; by default 0.05, 0.5 and 2, for a Gaussian process 0.1, or none where
        capstans turn.
    rows : int
        Most rows that the model is fitted to, evenly spread; plays and low-passes see all.
    leading : int, optional
        By how many of the features, the first ones, everything is multiplied; by default the
        `squared`, or, without, all if that makes few enough products, else only features by
        features. Where capstans turn, up to the last feature that turns one, by each other.
    squared : int
        By the squares of how many of them, the first ones, everything is multiplied too.
    pairs : sequence of (int, int), optional
        Places of a feature, and of one that the widths of its further plays grow with, or shrink;
        by default, each measured position with the effort of its joint, or with those of cables;
        for a Gaussian process, or where capstans turn, none. They are left out unless the ridge
        regression errs by a twentieth less with them, on blocks of rows that are left out in turn.
    growing : sequence of float
        Largest half-widths of these plays, in half ranges of the feature.
    random_state : int, optional
        Seed of the trees; their own by default.

    Attributes
    ----------
    model_ : JointRegressor
        Fitted to what it sees.
    pairs_ : sequence of (int, int)
        Those of `pairs` that were not left out: all or none.
    coupled_ : sequence of int
        Places of the features that are coupled; none unless asked for.

    Examples
    --------
    >>> x = np.sin(np.arange(3000.0) / 200.0)[:, None]
    >>> slack = RichPlay().fit(x, np.sign(np.gradient(x[:, 0])))
    >>> bool(slack.score(x, np.sign(np.gradient(x[:, 0]))) > 0.9)
    True
    """

    family: ClassVar[Family] = play_bank.FAMILY
    least_rows: ClassVar[int] = 300
    learner: str = "ridge"
    couple: bool = False
    positions: tuple[int, ...] | None = None
    shares: tuple[float, ...] = (0.3, 1.0, 2.0)
    turn: bool = False
    turns: tuple[tuple[float, ...], ...] | None = None
    plays: tuple[float, ...] | None = None
    time_constants: tuple[float, ...] | None = None
    rows: int = 40_000
    leading: int | None = None
    squared: int = 0
    pairs: tuple[tuple[int, int], ...] | None = None
    growing: tuple[float, ...] = (0.05, 0.2, 0.6)
    random_state: int | None = None

    def for_features(self, names: Sequence[str], robot: Robot, joints: Sequence[str]) -> Self:
        """Unfitted copy whose pairs, positions and turns are those of the features called so."""
        usual = () if self.turn or self.learner == "gaussian_process" else loaded_pairs(names)
        pairs = usual if self.pairs is None else self.pairs
        positions = self.positions
        if self.couple and positions is None:
            positions = tuple(i for i, name in enumerate(names) if name.startswith("measured/"))
        turns = self.turns
        if self.turn and turns is None:
            turns = capstan_turns(names, robot, joints)
        return clone(self).set_params(  # type: ignore[no-any-return]  # sklearn: untyped
            pairs=pairs, positions=positions, turns=turns
        )

    def minimum_rows(self, n_features: int) -> int:
        """As many as what sees the plays needs; those that grow are left out where they harm."""
        seen = play_bank.n_constant(self._params(n_features), n_features)
        return max(self.least_rows, Ridge().minimum_rows(seen))

    def check_params(self) -> None:
        """Raise CalibrationError, naming the parameter and its rule, when one breaks it."""
        if not is_integer(self.rows, 1, 10**9):
            raise CalibrationError(f"rows is {self.rows!r:.60}; it must be an integer from 1")
        if not (self.leading is None or is_integer(self.leading, 0, _PRODUCTS)):
            raise CalibrationError(
                f"leading is {self.leading!r:.60}; it must be an integer from 0 to {_PRODUCTS}, or "
                "None"
            )
        if not is_integer(self.squared, 0, _PRODUCTS):
            raise CalibrationError(
                f"squared is {self.squared!r:.60}; it must be an integer from 0 to {_PRODUCTS}"
            )
        if self.learner == "gaussian_process" and (self.leading is not None or self.squared):
            raise CalibrationError(
                "leading and squared are of products, and a Gaussian process has none: leave them "
                "out"
            )
        for name, wanted in (("positions", "couple"), ("turns", "turn")):
            if getattr(self, name) and not getattr(self, wanted):
                raise CalibrationError(f"{name} are given; they take {wanted}=True as well")
        asked: dict[str, Any] = {"pairs": self._asked(), "coupled": ()}
        if self.couple and self.positions is not None:
            self._check_count(self.positions)
            asked["coupled"] = self.positions
        self.family.check_params({**self.model_params(), **asked})

    def model_params(self) -> Params:
        """Parameters of the family: its own, and the model's once there is one."""
        return self._params(int(vars(self).get("n_features_in_", 0)))

    def _params(self, n_features: int) -> Params:
        """Those for so many features."""
        names = ("learner", "couple", "growing", "shares", "turn")
        plays, times = self._usual()
        return {
            **{name: getattr(self, name) for name in names},
            "plays": plays if self.plays is None else self.plays,
            "time_constants": times if self.time_constants is None else self.time_constants,
            "pairs": vars(self).get("pairs_", self._asked()),
            "coupled": vars(self).get("coupled_", self._joined(n_features)),
            "turns": self.turns or () if self.turn else (),
            "members": vars(self).get("members_", _UNFITTED),
        }

    def _usual(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Half-widths of plays and time constants of low-passes where none are given."""
        if self.learner == "gaussian_process":
            return (), _SHORT
        if self.turn:
            return (() if self.couple else _PLAYS[:_NARROW]), ()
        return (() if self.couple else _PLAYS), _TIME_CONSTANTS

    @classmethod
    def from_params(cls, params: Params) -> Self:
        """Make one of these parameters; the model among them is to be run only."""
        own = {name: value for name, value in params.items() if name not in ("members", "coupled")}
        made = cls(**own, positions=params["coupled"] or None)
        made.members_, made.pairs_ = params["members"], params["pairs"]
        made.coupled_ = params["coupled"]
        return made

    def check_shape(self, n_features: int, n_outputs: int) -> None:
        """Take any number of either; raise CalibrationError for places of features not there.

        And where one joint alone, or more than there may be, would be coupled.
        """
        play_bank.check_places("pairs", self._asked(), n_features)
        joined = self._joined(n_features)
        play_bank.check_places("positions", [joined], n_features)
        if self.couple:
            self._check_count(joined)
        if self.turn and not self.turns:
            raise CalibrationError(
                f"{self.name} must know how capstans turn; take a robot whose transmission is in "
                "its file, and the measured positions of its joints as features, or give turns"
            )
        play_bank.check_turns(self.turns or (), n_features)

    def _check_count(self, joined: Sequence[int]) -> None:
        if not 2 <= len(joined) <= play_bank.MAX_COUPLED:
            raise CalibrationError(
                f"measured positions among the features: {len(joined)}; {self.name} couples 2 to "
                f"{play_bank.MAX_COUPLED}: give other features, or do not couple them"
            )

    def _joined(self, n_features: int) -> tuple[int, ...]:
        """Places of the features that are coupled; all where they have no names."""
        if not self.couple:
            return ()
        return tuple(range(n_features)) if self.positions is None else tuple(self.positions)

    def _asked(self) -> tuple[tuple[int, int], ...]:
        """Give the pairs that are asked for; none where features have no names."""
        return () if self.pairs is None else self.pairs

    def _learn(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        known = np.flatnonzero(self._known(y))
        kept = np.zeros(len(X), dtype=bool)
        kept[known[:: -(-len(known) // int(self.rows))]] = True
        low, high = X[known].min(axis=0), X[known].max(axis=0)
        varies = ~constant_columns(X[known])
        inverse = np.divide(2.0, high - low, out=np.zeros(len(low)), where=varies)
        arrays = {"centre": 0.5 * (low + high), "inverse_half_range": inverse}
        self.pairs_, self.coupled_ = self._asked(), self._joined(X.shape[1])
        params = self.model_params()
        if self.coupled_:
            arrays |= self._coupling(X, y, dt, arrays)
        seen = play_bank.expand_rows(params, arrays, X, dt, kept)
        crossed = play_bank.n_constant(params, X.shape[1])
        history = np.cumsum(dt == 0.0)
        starts = np.where(np.diff(history[kept], prepend=0) > 0, 0.0, 1.0)
        if self.learner != "gaussian_process" and history[-1] >= BLOCKS:
            starts[1:] = 1.0  # as many as a fit to all has, though one may be hidden from this
        if self.pairs_ and not self._gains(seen, crossed, X.shape[1], y[kept], starts):
            self.pairs_, seen = (), np.ascontiguousarray(seen[:, :crossed])
        unfitted = self._unfitted(X.shape[1], crossed, y.shape[1])
        self.model_ = unfitted.fit(seen, y[kept], progress, starts)
        self.members_ = ((self.model_.family.name, self.model_.model_params(), ()),)
        return arrays | {f"0/{name}": array for name, array in self.model_.arrays_.items()}

    def _coupling(self, X: Array, y: Array, dt: Array, arrays: Arrays) -> Arrays:
        """Coupling of joints, on some of the rows: the first of each history among them."""
        with_truth, fresh = self._known(y), dt == 0.0
        used = fresh.copy()
        for rows in (np.arange(len(X)), np.flatnonzero(with_truth)):
            used[rows[:: -(-len(rows) // _IDENTIFIED)]] = True
        alone = {**self.model_params(), "plays": (), "pairs": (), "coupled": ()}
        seen = play_bank.expand_rows(alone, arrays, X, dt, used)
        places, known = list(self.coupled_), with_truth[used]
        positions = np.ascontiguousarray(seen[:, places])
        products = interactions.interaction_factors(*3 * [len(places)])[len(places) :]
        explained = np.hstack([seen, polynomial_design(positions, products)])[known]
        found = identify_coupling(positions, fresh[used], known, explained, y[used][known])
        return vars(found)

    def _gains(self, seen: Array, crossed: int, n_features: int, y: Array, dt: Array) -> bool:
        """Whether a ridge regression errs less with what is `seen` beyond the first `crossed`."""
        products = self._products(n_features, crossed)
        log_errors = [
            np.log(np.maximum(Ridge(*products).fit(rows, y, dt=dt).errors_, 1e-12)).mean()
            for rows in (seen, seen[:, :crossed])
        ]
        return bool(log_errors[0] < log_errors[1] + math.log1p(-_GAIN))

    def adapted(self, X: Array, y: Array, dt: Array) -> tuple[Self, Array]:
        """Fitted copy, as `JointRegressor.adapted` says; of the ridge regression alone."""
        if self.learner != "ridge":
            return super().adapted(X, y, dt)
        known = self._known(y)
        seen = play_bank.expand_rows(self.model_params(), self.arrays_, X, dt, known)
        ((data, _),) = members(self.model_params(), self.arrays_)
        ridge = Ridge.from_data(data, seen.shape[1], y.shape[1])
        own, penalties = ridge.adapted(seen, y[known], np.zeros(len(seen)))
        return self.with_arrays({f"0/{name}": a for name, a in own.arrays_.items()}), penalties

    def _products(self, n_features: int, n_seen: int) -> tuple[int, int, int]:
        """By how many of what is seen, the first ones, how many are multiplied; by whose squares.

        Raises CalibrationError if there are too many products of what was asked for.
        """
        squared = min(int(self.squared), n_features)
        if self.turn and self.turns and self.leading is None and not squared:
            first = len(np.trim_zeros(np.any(self.turns, axis=0), "b"))
            if first**2 <= _PRODUCTS:
                return first, first, 0
        if self.leading is None and not squared:
            choices = [(n_features, n_seen), (n_features, n_features), (0, 0)]
            return (*next(pair for pair in choices if pair[0] * pair[1] <= _PRODUCTS), 0)
        leading = min(squared if self.leading is None else int(self.leading), n_features)
        asked = (leading + squared) * n_seen
        if asked > _PRODUCTS:
            raise CalibrationError(
                f"leading={self.leading} and squared={self.squared} make {asked} products of "
                f"{n_seen} features, plays and low-passes; at most {_PRODUCTS}: ask for fewer"
            )
        return leading, n_seen, squared

    def _unfitted(self, n_features: int, n_crossed: int, n_outputs: int) -> JointRegressor:
        """Model for so many features, what of them and their plays is multiplied, and joints."""
        if self.learner == "gaussian_process":
            return GaussianProcess()
        products = self._products(n_features, n_crossed)
        ridge = Ridge(*products, trimmed=self.learner == "trees")
        if self.learner == "ridge":
            return ridge
        trees = registry.member("boosted_trees")
        if n_outputs <= _FEW_JOINTS:
            trees.set_params(max_leaf_nodes=_LEAVES)
        else:
            n = min(trees.max_iter, _FEWER_TREES)
            trees.set_params(max_leaf_nodes=_LEAVES // 2, max_iter=n)
        return Combination((ridge, trees), None, self.random_state)


def loaded_pairs(names: Sequence[str]) -> tuple[tuple[int, int], ...]:
    """Places of measured positions, each with that of an effort that may widen its loop.

    Of its own joint or, where that has none, of the channels that are no measured joint, as the
    wires of a sheath. None where these are too many.
    """
    effort = {name.removeprefix("effort/"): i for i, name in enumerate(names)
              if name.startswith("effort/")}  # fmt: skip
    measured = {name.removeprefix("measured/"): i for i, name in enumerate(names)
                if name.startswith("measured/")}  # fmt: skip
    cables = [i for joint, i in effort.items() if joint not in measured]
    pairs = [
        (i, other)
        for joint, i in measured.items()
        for other in ([effort[joint]] if joint in effort else cables)
    ]
    return tuple(pairs) if len(pairs) <= play_bank.MAX_PAIRS else ()


def capstan_turns(
    names: Sequence[str], robot: Robot, joints: Sequence[str]
) -> tuple[tuple[float, ...], ...]:
    """Turn of each joint's capstan by each of the features called `names` [rad over its unit].

    By the robot's transmission, behind its gearboxes; of `joints` alone, those whose capstan is
    turned by measured positions that are all features.
    """
    if robot.transmission is None:
        return ()
    by_joint = robot.transmission.capstan_matrix[robot.index(joints)]
    place = {name.removeprefix("measured/"): i for i, name in enumerate(names)
             if name.startswith("measured/")}  # fmt: skip
    found = []
    for row in by_joint:
        used = {joint: turn for joint, turn in zip(robot.joint_names, row, strict=True) if turn}
        if set(used) <= set(place):
            turns = np.zeros(len(names))
            turns[[place[joint] for joint in used]] = list(used.values())
            found.append(tuple(turns.tolist()))
    return tuple(found)


_UNFITTED: Final[tuple[Any, ...]] = ((offset.FAMILY.name, {}, ()),)
