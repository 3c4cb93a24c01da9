"""Estimators made of others: a weighted sum, or one after the other, held to a range if asked.

And the mean of models of like instruments, weighted as the truth of a new one says.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Self

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import clone

from truejoint.array_types import Array, Integers
from truejoint.errors import CalibrationError
from truejoint.estimators import registry
from truejoint.estimators.base import Arrays, JointRegressor, Progress, share_of
from truejoint.estimators.family import EstimatorData, Family, evaluate
from truejoint.estimators.polynomial.learn import Polynomial
from truejoint.estimators.rules import ANYTHING, LARGEST, RANDOM_STATE, Params, Rule
from truejoint.estimators.stack import run as stack
from truejoint.estimators.wrapped import Regressor, joint_regressor
from truejoint.recordings import Recording
from truejoint.robots import Robot

Places = Sequence[int]

_ROUNDS: Final = 5  # of weights of models and what they leave, in turn
_ALIKE: Final = 0.5  # [s] for which errors of a model resemble each other


@dataclass(eq=False, repr=False)
class Stack(JointRegressor):
    """Sum of estimators: by `weights`, or each fitted to what those before it leave.

    With weights, it is what Breiman calls stacked regressions (Machine Learning 24, 1996), the
    choice of one estimator for each joint included; they come from errors on rows that the members
    were not fitted to, see `truejoint.calibration.Automatic`. Without weights it is one step of
    boosting: the first member explains what it can, and the next its residual.

    A member that `sees` some features alone may be held to the range that it was fitted to: beyond,
    its prediction stays as it was at the end; only a line goes on. A physical filter knows how to
    go on by itself: one with its own features is not held to their range.

    Parameters
    ----------
    members : sequence of Regressor or str
        Unfitted, each with a row, or names: truejoint's own and ``boosted_trees``; by default the
        linear model, then boosted trees. If one takes its own features, as a physical filter does,
        all see these: what the filter leaves can then be learnt.
    weights : sequence of sequence of float, optional
        A row for each member, a column for each output. A member is fitted to those outputs alone
        for which it has a weight other than 0, one without any is left out.
    random_state : int, optional
        Seed of the members; their own by default.
    sees : sequence of sequence of int, optional
        Places of the features that each member sees; by default all see all, and none is held. One
        that only works offline may then stand alone.
    held : sequence of bool, optional
        Whether each member that `sees` is held to the range of its features; by default all are.
    beside : sequence of sequence of int, optional
        For each member that `sees`, the place of a feature for each output, or none. Its
        predictions are added to that feature, such as the measured position of a true one.

    Attributes
    ----------
    members_ : list of JointRegressor
        Fitted, of those that have a weight.

    Examples
    --------
    >>> X = np.linspace(-1.0, 1.0, 200)[:, None]
    >>> model = Stack().fit(X, X[:, 0] + (X[:, 0] > 0.5))
    >>> model.name, [member.name for member in model.members_]
    ('linear_trees', ['linear', 'HistGradientBoostingRegressor'])
    >>> model.predict([[0.2], [0.8]]).round(1)
    array([0.2, 1.8])
    >>> held = Stack(("poly2_ridge",), sees=((0,),)).fit(X, X[:, 0] + np.abs(X[:, 0]))
    >>> alone = get_estimator("poly2_ridge").fit(X, X[:, 0] + np.abs(X[:, 0]))
    >>> bool(held.predict([[0.5]]) == alone.predict([[0.5]]))
    True
    >>> bool(held.predict([[3.0]]) < alone.predict([[3.0]]))
    True
    """

    fitted_params: ClassVar[Params] = {"members": (), "columns": ()}
    training: ClassVar[Mapping[str, Rule]] = {
        "random_state": RANDOM_STATE,
        **dict.fromkeys(("sees", "held", "beside"), ANYTHING),
    }
    members: Sequence[Regressor | str] = (registry.LINEAR, "boosted_trees")
    weights: Sequence[Sequence[float]] | None = None
    random_state: int | None = None
    sees: Sequence[Places] | None = None
    held: Sequence[bool] | None = None
    beside: Sequence[Places] | None = None

    @property
    def family(self) -> Family:  # type: ignore[override]  # by its members
        """Family that runs it; raises CalibrationError if a member cannot be one."""
        return stack.FAMILY.of(self.model_params())

    @property
    def name(self) -> str:
        """Name of the preset; of a member that stands alone and is held to its range, that one."""
        alone = self.sees is not None and len(self.members) == 1
        return self._unfitted()[0].name if alone else super().name

    def minimum_rows(self, n_features: int) -> int:
        """As many as the most demanding member needs."""
        return max(m.minimum_rows(len(places)) for m, places in self._seeing(n_features))

    def check_params(self) -> None:
        """Raise CalibrationError if a member cannot be one, or what is given is not theirs."""
        unfitted = self._unfitted()
        for member in unfitted:
            member.check_params()
        super().check_params()
        given = (self.sees, self.held, self.beside)
        selections = [value for value in given if value is not None]
        if selections and (self.sees is None or {*map(len, selections)} != {len(unfitted)}):
            raise CalibrationError(
                f"sees, held and beside of a stack are given for other members than its "
                f"{len(unfitted)}; give sees, or more of them, for each"
            )
        if self.sees is not None and self.weights is None and len(unfitted) > 1:
            raise CalibrationError("a stack whose members see some features alone takes weights")
        physical = [(member.name, member.family.inputs(member.model_params()))
                    for member in unfitted if member.family.inputs]  # fmt: skip
        if self.sees is None and len({inputs for _, inputs in physical}) > 1:
            raise CalibrationError(
                f"{' and '.join(name for name, _ in physical)} take features of their own, not the "
                "same, and cannot be combined; fit each alone"
            )
        if self.weights is not None:
            weights = np.zeros(0)
            with suppress(TypeError, ValueError):  # of words, or of rows that are not as long
                weights = np.asarray(self.weights, dtype=np.float64)
            good = weights.ndim == 2 and len(weights) == len(unfitted)
            if not (good and np.isfinite(weights).all() and weights.any(axis=0).all()):
                raise CalibrationError(
                    f"weights of a stack have shape {weights.shape}; give a finite one for "
                    f"each of {len(unfitted)} members and each output, not all 0 for an output"
                )

    def check_shape(self, n_features: int, n_outputs: int) -> None:
        """Raise CalibrationError for numbers of either that a member does not take."""
        if self.weights is not None and np.shape(self.weights)[1] != n_outputs:
            raise CalibrationError(
                f"weights of a stack are for {np.shape(self.weights)[1]} outputs; it must be "
                f"{n_outputs}"
            )
        stack.columns_of(self.model_params(), n_features)
        for member, places in self._seeing(n_features):
            member.check_shape(len(places), n_outputs)

    def for_recordings(self, recordings: Sequence[Recording]) -> Self:
        """Unfitted copy whose members know what the recordings say; raises as they do."""
        return self._of([member.for_recordings(recordings) for member in self._unfitted()])

    def truth_beside(self) -> tuple[str, ...]:
        """Columns of known loads that members take, each once."""
        return tuple(dict.fromkeys(n for member in self._unfitted() for n in member.truth_beside()))

    def for_features(self, names: Sequence[str], robot: Robot, joints: Sequence[str]) -> Self:
        """Unfitted copy whose members know features and joints; raises as they do."""
        seeing = self._seeing(len(names))
        return self._of([m.for_features([names[p] for p in at], robot, joints) for m, at in seeing])

    def _of(self, informed: list[JointRegressor]) -> Self:
        """Unfitted copy of other members; of those that it has, names too, where they are alike."""
        ours, theirs = ((_described(m), [*map(repr, m)]) for m in (self._unfitted(), informed))
        return self.with_params(**({} if ours == theirs else {"members": tuple(informed)}))

    def model_params(self) -> Params:
        """Parameters of the family: each member's family, parameters and outputs, what it sees."""
        if fitted := vars(self).get("fitted_params_"):
            return dict(fitted)
        return {"members": _described(self._unfitted()), "columns": _tuples(self.sees)}

    @classmethod
    def from_params(cls, params: Params) -> Self:
        """Unfitted estimator of the parameters of its family, to be run only."""
        regressor = super().from_params(params)
        if cls().model_params() != params:
            regressor.members = ()
        return regressor

    @property
    def data(self) -> EstimatorData:
        """The fitted estimator as data; CalibrationError if a member did not become arrays."""
        for member in vars(self).get("members_", ()):
            _ = member.data
        return super().data

    def evaluate(self, X: Array, dt: ArrayLike | None = None) -> Array:
        """Predict (n, n_outputs) for finite rows `X` (n, k), also by what only works offline."""
        members = vars(self).get("members_", ())
        if all(member.family.row is not None for member in members):
            return super().evaluate(X, dt)
        inputs = X[:, self.sees[0]]  # type: ignore[index]  # it stands alone
        held = np.clip(inputs, self.lower_, self.upper_)
        line = (inputs - held) @ self.slope_ + X @ self.direct_
        return np.asarray(members[0].evaluate(held, dt) + line)

    def _learn(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        weights = np.ones((len(self.members), y.shape[1]))
        if self.weights is not None:
            weights = np.array(self.weights, dtype=np.float64)
        unfitted, used = self._unfitted(), np.flatnonzero(weights.any(axis=1)).tolist()
        residuals, loads, limits = y.copy(), self.truth_beside(), list[Arrays]()
        self.members_: list[JointRegressor] = []
        arrays: Arrays = {"weights": weights[weights != 0.0]}
        for number, place in enumerate(used):
            outputs, member = np.flatnonzero(weights[place]), clone(unfitted[place])
            if self.random_state is not None:
                seeds = [p for p in member.get_params() if p.split("__")[-1] == "random_state"]
                member.set_params(**dict.fromkeys(seeds, self.random_state))
            rows = np.flatnonzero(np.isfinite(residuals).all(axis=1) | member.family.remembers)
            inputs, targets = X[rows], residuals[rows]
            if self.sees is not None:
                beside = self.beside[place] if self.beside else ()
                seen = self.sees[place]
                limits.append(_limits(member, inputs, targets, seen, beside, outputs))
                if self.held is not None and not self.held[place]:
                    limits[-1] |= _no_range(len(seen))
                targets = targets - inputs @ limits[-1]["direct"]
                inputs = np.ascontiguousarray(inputs[:, seen])
            steps = dt[rows] if member.family.remembers else None  # as it is fitted alone
            taken = self._loads[rows][:, [loads.index(name) for name in member.truth_beside()]]
            report = share_of(progress, number, len(used))
            member.fit(inputs, targets[:, outputs], report, steps, taken)
            if self.sees is None or len(used) > 1:
                member.memory()  # refuses what only works offline
            if self.weights is None and number + 1 < len(used):
                residuals -= member.evaluate(X, dt)
            self.members_.append(member)
            arrays |= {f"{number}/{name}": array for name, array in member.arrays_.items()}
        sees = None if self.sees is None else [self.sees[place] for place in used]
        members = _described(self.members_, weights[used])
        self.fitted_params_ = {"members": members, "columns": _tuples(sees)}
        if limits:
            arrays |= {name: np.concatenate([each[name] for each in limits]) for name in limits[0]}
        return arrays

    def _unfitted(self) -> list[JointRegressor]:
        if not isinstance(self.members, list | tuple):
            raise CalibrationError(
                f"members of a stack are {self.members!r:.60}; give a list of estimators"
            )
        members = (registry.member(m) if isinstance(m, str) else m for m in self.members)
        return [joint_regressor(member) for member in members]

    def _seeing(self, n_features: int) -> list[tuple[JointRegressor, Places]]:
        """Unfitted members, each with the places of the features that it sees."""
        unfitted = self._unfitted()
        every = [range(n_features)] * len(unfitted)
        return list(zip(unfitted, every if self.sees is None else self.sees, strict=True))


def _limits(
    member: JointRegressor, X: Array, y: Array, places: Places, beside: Places, outputs: Integers
) -> Arrays:
    """Range of the features that a member sees, line beyond it, and what it comes on top of."""
    slope, direct = np.zeros((len(places), y.shape[1])), np.zeros((X.shape[1], y.shape[1]))
    if len(beside):
        direct[np.asarray(beside)[outputs], outputs] = 1.0
    targets = (y - X @ direct)[:, outputs]
    has_truth = np.isfinite(targets).all(axis=1)
    inputs = X[has_truth][:, places]
    limits = _no_range(len(places))
    if member.family.inputs is None:
        limits = {"lower": inputs.min(axis=0), "upper": inputs.max(axis=0)}
        if member.name == registry.LINEAR:
            line = Polynomial(1, ridge=False).fit(inputs, targets[has_truth])
            slope[:, outputs] = line.arrays_["coef"] * line.arrays_["inverse_scale"][:, None]
    return {**limits, "slope": slope, "direct": direct}


def _no_range(n_features: int) -> Arrays:
    return {"lower": np.full(n_features, -LARGEST), "upper": np.full(n_features, LARGEST)}


def _tuples(places: Sequence[Places] | None) -> Any:
    """Places as a family keeps them, which refuses what are none."""
    return tuple(tuple(at) if isinstance(at, Sequence) else at for at in places or ())


def _described(members: Sequence[JointRegressor], weights: Array | None = None) -> Any:
    """Family, parameters and outputs of each member, as a family of them keeps these."""
    rows = np.zeros((len(members), 0)) if weights is None else weights
    return tuple(
        (member.family.name, dict(member.model_params()), tuple(np.flatnonzero(row).tolist()))
        for member, row in zip(members, rows, strict=True)
    )


@dataclass(frozen=True, eq=False)
class Expert:
    """A fitted estimator of another instrument."""

    data: EstimatorData
    columns: tuple[int, ...]  # places of the features that it takes
    direct: Array  # (n_features, n_outputs), what each feature adds to its prediction

    def predict(self, X: Array, dt: Array) -> Array:
        """Predict (n, n_outputs) for rows `X` (n, n_features), `dt` (n,) [s] apart."""
        kind, n_outputs = self.data.kind, self.direct.shape[1]
        memory = kind.memory(self.data, len(self.columns), n_outputs)
        inputs = np.ascontiguousarray(X[:, self.columns])
        return np.asarray(evaluate(kind, memory, inputs, dt, n_outputs) + X @ self.direct)


@dataclass(eq=False, repr=False)
class Pooled(JointRegressor):
    """Weighted mean of fitted `experts`, a slope and an offset: what few seconds of truth can tell.

    A mean of experts whose weights are normal about equal ones, with a deviation that is as large
    for all of them together (empirical Bayes with the experts as samples of the prior). The slope
    over the feature of each output in `positions` is normal about that mean's, with the standard
    error that the mean of the experts' slopes has; the offset is free. Errors of rows within half a
    second count as one. At most nine experts.
    """

    fitted_params: ClassVar[Params] = {"members": (), "columns": ()}
    training: ClassVar[Mapping[str, Rule]] = {"experts": ANYTHING, "positions": ANYTHING}
    experts: Sequence[Expert] = ()
    positions: Sequence[int] = ()

    def __repr__(self) -> str:
        return f"Pooled({len(self.experts)} experts)"

    @property
    def name(self) -> str:
        """Name in tables."""
        return "pooled"

    @property
    def family(self) -> Family:  # type: ignore[override]  # by its members
        """What runs it."""
        return stack.FAMILY.of(self.model_params())

    def model_params(self) -> Params:
        """Parameters of the family: the experts, and an offset beside them."""
        n_features, n_outputs = self.experts[0].direct.shape
        offset = Polynomial(0, ridge=False)
        kinds = [(expert.data.family, expert.data.params) for expert in self.experts]
        kinds.append((offset.family.name, offset.model_params()))
        every = tuple(range(n_outputs))
        return {
            "members": tuple((family, dict(params), every) for family, params in kinds),
            "columns": (*(e.columns for e in self.experts), tuple(range(n_features))),
        }

    def _learn(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        labelled = self._known(y)
        predicted = np.stack([expert.predict(X, dt) for expert in self.experts], axis=2)
        outputs = zip(
            predicted[labelled].transpose(1, 0, 2),
            X[labelled][:, self.positions].T,
            y[labelled].T,
            strict=True,
        )
        count = max(dt.sum() / _ALIKE, 1.0)
        weights, slopes = map(np.array, zip(*(_weigh(*o, count) for o in outputs), strict=True))
        rest = y - np.einsum("njk,jk->nj", predicted, weights) - slopes * X[:, self.positions]
        offset = Polynomial(0, ridge=False).fit(X[labelled], rest[labelled])
        members = [*(expert.data.arrays for expert in self.experts), offset.arrays_]
        n_columns = sum(map(len, self.model_params()["columns"]))
        n_features, n_outputs = X.shape[1], y.shape[1]
        scale = np.zeros((n_features, n_outputs))
        scale[self.positions, range(n_outputs)] = slopes
        progress(1.0)
        return {
            "weights": np.append(weights.T.ravel(), np.ones(n_outputs)),
            "lower": np.full(n_columns, -LARGEST),
            "upper": np.full(n_columns, LARGEST),
            "slope": np.zeros((n_columns, n_outputs)),
            "direct": np.concatenate([*(expert.direct for expert in self.experts), scale]),
            **{f"{i}/{name}": a for i, each in enumerate(members) for name, a in each.items()},
        }


def _weigh(predicted: Array, positions: Array, target: Array, count: float) -> tuple[Array, float]:
    """Weights (k,) of predictions (n, k), whose sum is 1, and the slope over positions (n,).

    There are `count` independent errors.
    """
    k = predicted.shape[1]
    mean = predicted.mean(axis=1)
    spread = predicted - mean[:, None]
    spread, rest = spread - spread.mean(axis=0), target - mean
    rest, moved = rest - rest.mean(), positions - positions.mean()
    slopes = moved @ spread / max(moved @ moved, np.finfo(float).tiny)
    deviation = np.sqrt(slopes @ slopes / max(k * (k - 1), 1))
    terms = np.column_stack([spread, deviation * moved])
    prior = np.append(np.full(k, float(k)), 1.0)
    change, variance = np.zeros(k + 1), rest.var()
    for _ in range(_ROUNDS):
        if variance > 0.0:
            share = count / (len(rest) * variance)
            precision = share * terms.T @ terms + np.diag(prior)
            change = np.linalg.solve(precision, share * terms.T @ rest)
            variance = np.mean((rest - terms @ change) ** 2)
    weights = 1.0 / k + change[:k] - change[:k].mean()
    return np.asarray(weights), float(deviation * change[k])
