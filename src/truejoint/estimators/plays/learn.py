"""Models on plays and low-passes of every feature, and on plays of a forceps' motor and cables."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Self

import numpy as np
from scipy.optimize import least_squares

from truejoint.array_types import Array, Mask
from truejoint.errors import CalibrationError
from truejoint.estimators import registry, rules
from truejoint.estimators.base import Arrays, JointRegressor, Progress, constant_columns
from truejoint.estimators.family import Family
from truejoint.estimators.gp.learn import GaussianProcess
from truejoint.estimators.jaw.learn import JawEstimator
from truejoint.estimators.jaw.signals import MOTOR, RESET
from truejoint.estimators.plays import run as play_bank
from truejoint.estimators.polynomial.learn import (
    BLOCKS,
    MOST_PRODUCTS,
    Polynomial,
    polynomial_design,
)
from truejoint.estimators.polynomial.run import FAMILY as POLYNOMIAL
from truejoint.estimators.polynomial.run import interaction_factors, of_degree
from truejoint.estimators.rules import Params, Rule
from truejoint.estimators.stack.learn import Stack
from truejoint.robots import Robot

JAW_PENALTY: Final = 1e-5
_FIRST_REACH: Final = 0.1  # half-width of each play where the search starts, in half ranges
_REACHES: Final = (0.002, 1.5)  # least and largest
_STRONGEST: Final = 0.98  # pull of the others on a joint over its own stiffness, along any motion
_STIFFNESS: Final = 2.0  # logarithm of a joint's stiffness over another's, at most
_PRIOR: Final = 0.02  # weight of joints that do not pull at each other and are equally stiff
_RIDGE: Final = 1e-3  # on plays of variance 1
_TRIALS: Final = 12
_STEP: Final = 0.02  # of a parameter, for a slope
_LEAVES: Final = 31  # of a tree; half as many, and fewer trees, where each of more joints has trees
_FEW_JOINTS: Final = 2  # of its own, which a control loop walks through at every sample
_FEWER_TREES: Final = 70
PLAYS: Final = (0.01, 0.02, 0.05, 0.1, 0.2, 0.35, 0.6, 0.9)
TIME_CONSTANTS: Final = (0.05, 0.5, 2.0)  # [s]
_SHORT: Final = (0.1,)  # [s], which tells a Gaussian process how fast and which way
_NARROW: Final = 4
"""Of the plays where capstans turn. The wider ones, and low-passes, tell the direction of a zig-zag
of one speed just as well, and something else of any other motion."""
_IDENTIFIED: Final = 6_000  # rows that the search for a coupling sees, at most


@dataclass(eq=False, repr=False)
class Plays(JointRegressor):
    """A model on plays and low-passes of every feature: for joints whose error has a history.

    Half-widths are shares of half the range that a feature has in training, so nothing is to be
    chosen for a robot or a unit. A ridge regression on the features, plays and low-passes, and on
    their products with the features (the width of a loop grows with load), is learnt first; where
    these would be more than 600, only features are multiplied by features.
    If joints are coupled, plays of all their positions together stand
    in place of the plays of each feature: the cables of one joint pull at the others, as in a
    wrist. Stiffness and friction are found first, see
    `truejoint.estimators.plays.learn.identify_coupling`. If capstans turn, what errs once in
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
        Time constants of the low-passes [s]; by default 0.05, 0.5 and 2, for a Gaussian process
        0.1, or none where capstans turn.
    rows : int
        Most rows that the model is fitted to, evenly spread; plays and low-passes see all.
    random_state : int, optional
        Seed of the trees; their own by default.

    Attributes
    ----------
    model_ : JointRegressor
        Fitted to what it sees.
    coupled_ : sequence of int
        Places of the features that are coupled; none unless asked for.

    Examples
    --------
    >>> x = np.sin(np.arange(3000.0) / 200.0)[:, None]
    >>> slack = Plays().fit(x, np.sign(np.gradient(x[:, 0])))
    >>> bool(slack.score(x, np.sign(np.gradient(x[:, 0]))) > 0.9)
    True
    """

    family: ClassVar[Family] = play_bank.FAMILY
    least_rows: ClassVar[int] = 300
    training: ClassVar[Mapping[str, Rule]] = {
        "positions": rules.optional(
            Rule(lambda value: isinstance(value, tuple | list), "places of features")
        ),
        "rows": rules.integer(1, 10**9),
        "random_state": rules.RANDOM_STATE,
    }
    learner: str = "ridge"
    couple: bool = False
    positions: tuple[int, ...] | None = None
    turn: bool = False
    turns: tuple[tuple[float, ...], ...] | None = None
    plays: tuple[float, ...] | None = None
    time_constants: tuple[float, ...] | None = None
    rows: int = 40_000
    random_state: int | None = None

    def for_features(self, names: Sequence[str], robot: Robot, joints: Sequence[str]) -> Self:
        """Unfitted copy whose positions and turns are those of the features called so."""
        changed: dict[str, Any] = {}
        if self.couple and self.positions is None:
            places = (i for i, name in enumerate(names) if name.startswith("measured/"))
            changed["positions"] = tuple(places)
        if self.turn and self.turns is None:
            changed["turns"] = capstan_turns(names, robot, joints)
        return self.with_params(**changed)

    def minimum_rows(self, n_features: int) -> int:
        """As many as what sees the plays needs."""
        n_inputs = play_bank.n_seen(self._asked(n_features), n_features)
        return max(self.least_rows, Polynomial(ridge=True).minimum_rows(n_inputs))

    def check_params(self) -> None:
        """Raise CalibrationError, naming the parameter and its rule, when one breaks it."""
        rules.check_rules(self.name, self.training, self.get_params(deep=False))
        for name, wanted in (("positions", "couple"), ("turns", "turn")):
            if getattr(self, name) and not getattr(self, wanted):
                raise CalibrationError(f"{name} are given; they take {wanted}=True as well")
        self.family.check_params(self._asked(0))

    def model_params(self) -> Params:
        """Parameters of the family: its own, and the model's once there is one."""
        fitted = vars(self)
        params = self._asked(int(fitted.get("n_features_in_", 0)))
        return {name: fitted.get(f"{name}_", value) for name, value in params.items()}

    def _asked(self, n_features: int) -> Params:
        """Parameters of the family for so many features, before it is fitted."""
        is_process = self.learner == "gaussian_process"
        plays = () if is_process or self.couple else PLAYS[: _NARROW if self.turn else None]
        times = _SHORT if is_process else () if self.turn else TIME_CONSTANTS
        coupled = tuple(range(n_features) if self.positions is None else self.positions)
        return {
            "plays": plays if self.plays is None else self.plays,
            "time_constants": times if self.time_constants is None else self.time_constants,
            "coupled": coupled if self.couple else (),
            "turns": self.turns or () if self.turn else (),
            "members": ((POLYNOMIAL.name, of_degree(0), ()),),
            **{name: getattr(self, name) for name in ("learner", "couple", "turn")},
        }

    @classmethod
    def from_params(cls, params: Params) -> Self:
        """Make one of these parameters; the model among them is to be run only."""
        usual = {name: params[name] for name in params if name not in ("members", "coupled")}
        made = cls(positions=params["coupled"] or None, **usual)
        for name in ("coupled", "members"):
            setattr(made, f"{name}_", params[name])
        return made

    def check_shape(self, n_features: int, n_outputs: int) -> None:
        """Raise CalibrationError for places of features not there, and for joints that do not fit.

        One joint alone cannot be coupled, nor more than there may be, nor can an unknown capstan
        turn.
        """
        params = self._asked(n_features)
        play_bank.check_features(params, n_features)
        n_coupled = len(params["coupled"])
        if self.couple and not 2 <= n_coupled <= play_bank.MAX_COUPLED:
            raise CalibrationError(
                f"measured positions among the features: {n_coupled}; {self.name} couples 2 to "
                f"{play_bank.MAX_COUPLED}: give other features, or do not couple them"
            )
        if self.turn and not self.turns:
            raise CalibrationError(
                f"{self.name} must know how capstans turn; take a robot whose transmission is in "
                "its file, and the measured positions of its joints as features, or give turns"
            )

    def _learn(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        with_truth = np.flatnonzero(self._known(y))
        chosen = np.zeros(len(X), dtype=bool)
        chosen[with_truth[:: -(-len(with_truth) // int(self.rows))]] = True
        arrays = feature_scales(X[with_truth])
        params = self._asked(X.shape[1])
        self.coupled_ = params["coupled"]
        if self.coupled_:
            arrays |= self._coupling(X, y, dt, params, arrays)
        inputs = play_bank.expand_rows(params, arrays, X, dt, chosen)
        history = np.cumsum(dt == 0.0)
        starts = np.where(np.diff(history[chosen], prepend=0) > 0, 0.0, 1.0)
        if self.learner != "gaussian_process" and history[-1] >= BLOCKS:
            starts[1:] = 1.0  # as many as a fit to all has, though one may be hidden from this
        unfitted = self._unfitted(X.shape[1], inputs.shape[1], y.shape[1])
        self.model_ = unfitted.fit(inputs, y[chosen], progress, starts)
        self.members_ = ((self.model_.family.name, self.model_.model_params(), ()),)
        return arrays | {f"0/{name}": array for name, array in self.model_.arrays_.items()}

    def _coupling(self, X: Array, y: Array, dt: Array, params: Params, arrays: Arrays) -> Arrays:
        """Coupling of joints, on some of the rows: the first of each history among them."""
        with_truth, fresh = self._known(y), dt == 0.0
        used = fresh.copy()
        for rows in (np.arange(len(X)), np.flatnonzero(with_truth)):
            used[rows[:: -(-len(rows) // _IDENTIFIED)]] = True
        alone = {**params, "plays": (), "coupled": ()}
        inputs = play_bank.expand_rows(alone, arrays, X, dt, used)
        places, has_target = list(params["coupled"]), with_truth[used]
        positions = np.ascontiguousarray(inputs[:, places])
        products = interaction_factors(*3 * [len(places)])[len(places) :]
        explained = np.hstack([inputs, polynomial_design(positions, products)])[has_target]
        targets = y[used][has_target]
        found = identify_coupling(positions, fresh[used], has_target, explained, targets)
        return dict(zip(("coupling", "reaches"), found, strict=True))

    def _products(self, n_features: int, n_seen: int) -> tuple[int, int]:
        """By how many of what is seen, the first ones, how many are multiplied.

        By all features, where that makes few enough products; where capstans turn, up to the last
        feature that turns one, by each other.
        """
        choices = [(n_features, n_seen), (n_features, n_features), (0, 0)]
        if self.turns:
            n_turned = len(np.trim_zeros(np.any(self.turns, axis=0), "b"))
            choices.insert(0, (n_turned, n_turned))
        return next(pair for pair in choices if pair[0] * pair[1] <= MOST_PRODUCTS)

    def _unfitted(self, n_features: int, n_seen: int, n_outputs: int) -> JointRegressor:
        """Model for so many features, what is seen of them, and joints."""
        if self.learner == "gaussian_process":
            return GaussianProcess()
        products = self._products(n_features, n_seen)
        ridge = Polynomial(2, True, *products, trimmed=self.learner == "trees")
        if self.learner == "ridge":
            return ridge
        trees = registry.member("boosted_trees")
        leaves, n_trees = _LEAVES, trees.max_iter
        if n_outputs > _FEW_JOINTS:
            leaves, n_trees = _LEAVES // 2, min(n_trees, _FEWER_TREES)
        trees.set_params(max_leaf_nodes=leaves, max_iter=n_trees)
        return Stack((ridge, trees), None, self.random_state)


def feature_scales(X: Array) -> Arrays:
    """Middle and inverse half range (k,) of each feature in rows `X` (n, k); 0 for a constant."""
    low, high = X.min(axis=0), X.max(axis=0)
    varies = ~constant_columns(X)
    inverse = np.divide(2.0, high - low, out=np.zeros(len(low)), where=varies)
    return {"centre": 0.5 * (low + high), "inverse_half_range": inverse}


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
    places = [f"measured/{joint}" for joint in robot.joint_names]
    is_place = np.array([[name == place for name in names] for place in places])
    unmeasured = by_joint[:, ~is_place.any(axis=1)].any(axis=1)
    return tuple(map(tuple, (by_joint @ is_place)[~unmeasured].tolist()))


def identify_coupling(
    positions: Array, fresh: Mask, has_target: Mask, explained: Array, targets: Array
) -> tuple[Array, Array]:
    """Find the coupling whose plays explain most of the targets: variable projection.

    Stiffness (k, k) and half-widths (k,), in units of the positions, are given as
    `truejoint.estimators.plays.run.coupled_play` takes them. Stiffness is symmetric and positive,
    so that a few pulls settle all joints. `positions` (n, k), in half ranges and the order of time,
    are where motors want the joints; a history starts in rows that are `fresh` (n,); the others
    are of rows that `has_target` (n,): what else is `explained` (n_targets, m) of the `targets`
    (n_targets, n_outputs). What is linear in that and the plays is solved for at every trial.
    """
    k = positions.shape[1]
    pairs = np.triu_indices(k, 1)
    n_pairs = len(pairs[0])
    basis, _ = np.linalg.qr(np.column_stack([np.ones(len(explained)), _scaled(explained)]))
    residual = _scaled(targets - basis @ (basis.T @ targets), targets.std(axis=0))
    plays, last = np.empty_like(positions), np.empty(k)

    def coupling(parameters: Array) -> tuple[Array, Array]:
        shared, stiffness, reaches = np.split(parameters - 1.0, [n_pairs, n_pairs + k])
        pulls = np.zeros((k, k))
        pulls[pairs] = shared
        pulls += pulls.T
        pulls *= min(1.0, _STRONGEST / max(-float(np.linalg.eigvalsh(pulls)[0]), 1e-9))
        root = np.exp(0.5 * stiffness)
        return pulls * root / root[:, None], _FIRST_REACH * np.exp(reaches)

    def residuals(parameters: Array) -> Array:
        play_bank.coupled_play_rows(*coupling(parameters), fresh, positions, last, plays)
        columns = plays[has_target]
        columns = _scaled(columns - basis @ (basis.T @ columns))
        inner = columns.T @ columns / len(columns) + _RIDGE * np.eye(k)
        weights = np.linalg.solve(inner, columns.T @ residual / len(columns))
        misfit = (residual - columns @ weights) / np.sqrt(len(columns))
        return np.concatenate([misfit.ravel(), _PRIOR * (parameters[: n_pairs + k] - 1.0)])

    # About 1, as steps are shares of a parameter and some are 0 where the search starts.
    widest = np.log(np.array(_REACHES) / _FIRST_REACH)
    low, high = (
        1.0 + np.repeat([sign, sign * _STIFFNESS, end], [n_pairs, k, k])
        for sign, end in zip((-1.0, 1.0), widest, strict=True)
    )
    start = np.ones(n_pairs + 2 * k)
    search = least_squares(
        residuals, start, bounds=(low, high), diff_step=np.full_like(start, _STEP), x_scale=0.3,
        max_nfev=_TRIALS,
    )  # fmt: skip
    return coupling(search.x)


def _scaled(columns: Array, sizes: Array | None = None) -> Array:
    """Columns (n, m) over their `sizes` (m,), by default their deviations; 0 where that is 0."""
    sizes = columns.std(axis=0) if sizes is None else sizes
    return np.divide(columns, sizes, out=np.zeros_like(columns), where=sizes > 1e-12)


@dataclass(eq=False, repr=False, kw_only=True)
class JawPlays(JawEstimator):
    """Ridge regression on plays of one or two signals of a forceps, and on their products.

    The reset cable's end follows the jaw but for the slider's friction: from it alone the estimate
    hardly feels a load. The motor's side differs by the jaw's friction and by the load that
    stretches the drive cable: from both sides it is the most accurate of all without a load, and
    wrong under one. With the motor alone it is what the strategy without
    sensors of yan2020, II-B, can reach.

    Parameters
    ----------
    signals : tuple of str
        One or two of ``motor/jaw``, ``cable/drive`` (both ``x1``) and ``cable/reset`` (``x2``).
    plays : tuple of float
        Half-widths of the plays of each signal, in half ranges of it.
    penalty : float
        Ridge on the standardised terms.

    Examples
    --------
    >>> JawPlays(signals=("cable/reset",)).name
    'play_reset'
    """

    family: ClassVar[Family] = play_bank.JAW_BANK
    training: ClassVar[Mapping[str, Rule]] = {"penalty": rules.number(0.0, 1e12)}
    signals: tuple[str, ...] = (MOTOR, RESET)
    plays: tuple[float, ...] = play_bank.JAW_WIDTHS
    penalty: float = JAW_PENALTY

    def _learn_jaw(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        return fit_jaw_bank(tuple(self.plays), self.penalty, X, y, dt)


def fit_jaw_bank(
    widths: tuple[float, ...], penalty: float, X: Array, y: Array, dt: Array
) -> Arrays:
    """Fit `jaw_bank` to the rows `X` (n, k) whose `y` (n,) is known; `dt` (n,) is of all.

    The penalty is fixed: on a motion of one amplitude, cross-validation would choose one that is
    too small for any other.
    """
    has_truth = np.isfinite(y)
    params, arrays = play_bank.jaw_bank(widths, X.shape[1]), feature_scales(X[has_truth])
    inputs = play_bank.expand_rows(params, arrays, X, dt, has_truth)
    ((_, terms, _),) = params["members"]
    model = Polynomial(**terms, penalty=penalty).fit(inputs, y[has_truth])
    return {**arrays, **{f"0/{name}": array for name, array in model.arrays_.items()}}
