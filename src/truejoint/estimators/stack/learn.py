"""Estimators made of others: a weighted sum, or one after the other, and one held to a range."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import clone

from truejoint.array_types import Array
from truejoint.errors import CalibrationError
from truejoint.estimators import registry
from truejoint.estimators.base import Arrays, JointRegressor, Progress, share_of
from truejoint.estimators.family import (
    ANYTHING,
    LARGEST,
    RANDOM_STATE,
    Family,
    Params,
    Rule,
    integer,
    optional,
)
from truejoint.estimators.polynomial.learn import Polynomial
from truejoint.estimators.stack import run as stack
from truejoint.estimators.wrapped import Regressor, joint_regressor

if TYPE_CHECKING:
    from truejoint.recordings import Recording
    from truejoint.robots import Robot


class Combination(JointRegressor):
    """Base of what is made of other estimators, and needs what they need."""

    runs: ClassVar[Family]  # what runs it, but for what its members decide

    @property
    def family(self) -> Family:  # type: ignore[override]  # by its members
        """What runs it; raises CalibrationError if a member cannot be one."""
        return self.runs.of(self.model_params())

    @abstractmethod
    def _unfitted(self) -> list[JointRegressor]:
        """Members of one's own; raises CalibrationError if they are none."""

    @abstractmethod
    def _of(self, informed: list[JointRegressor]) -> Self:
        """Unfitted copy of other members."""

    def _columns(self, n_features: int) -> Sequence[int]:
        """Places of the features that members see."""
        return range(n_features)

    def minimum_rows(self, n_features: int) -> int:
        """As many as the most demanding member needs."""
        k = len(self._columns(n_features))
        return max(member.minimum_rows(k) for member in self._unfitted())

    def check_params(self) -> None:
        """Raise CalibrationError if a member cannot be one."""
        for member in self._unfitted():
            member.check_params()
        super().check_params()

    def check_shape(self, n_features: int, n_outputs: int) -> None:
        """Raise CalibrationError for numbers of either that a member does not take."""
        for member in self._unfitted():
            member.check_shape(len(self._columns(n_features)), n_outputs)

    def for_recordings(self, recordings: Sequence[Recording]) -> Self:
        """Unfitted copy whose members know what the recordings say; raises as they do."""
        return self._of([member.for_recordings(recordings) for member in self._unfitted()])

    def truth_beside(self) -> tuple[str, ...]:
        """Columns of known loads that members take, each once."""
        return tuple(dict.fromkeys(n for member in self._unfitted() for n in member.truth_beside()))

    def for_features(self, names: Sequence[str], robot: Robot, joints: Sequence[str]) -> Self:
        """Unfitted copy whose members know features and joints; raises as they do."""
        inputs = [names[place] for place in self._columns(len(names))]
        return self._of([m.for_features(inputs, robot, joints) for m in self._unfitted()])


@dataclass(eq=False, repr=False)
class Stack(Combination):
    """Sum of estimators: by `weights`, or each fitted to what those before it leave.

    With weights, it is what Breiman calls stacked regressions (Machine Learning 24, 1996), the
    choice of one estimator for each joint included; they come from errors on rows that the members
    were not fitted to, see `truejoint.calibration.Automatic`. Without weights it is one step of
    boosting: the first member explains what it can, and the next its residual.

    Parameters
    ----------
    members : sequence of Regressor or str
        Unfitted, each with a row, or names: truejoint's own and ``boosted_trees``; by default the
        linear model, then boosted trees. Where one takes features of its own, as a physical filter
        does, all see these: what the filter leaves can then be learnt.
    weights : sequence of sequence of float, optional
        A row for each member, a column for each output. A member is fitted to those outputs alone
        for which it has a weight other than 0, one without any is left out.
    random_state : int, optional
        Seed of the members; their own by default.
    rows : int, optional
        Most rows that members without a memory are fitted to, evenly spread; by default all.

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
    """

    runs: ClassVar[Family] = stack.FAMILY
    fitted_params: ClassVar[Params] = {"members": ()}
    training: ClassVar[Mapping[str, Rule]] = {
        "random_state": RANDOM_STATE,
        "rows": optional(integer(1, 10**9)),
    }
    members: Sequence[Regressor | str] = (registry.LINEAR, "boosted_trees")
    weights: Sequence[Sequence[float]] | None = None
    random_state: int | None = None
    rows: int | None = None

    def check_params(self) -> None:
        """Raise CalibrationError if a member cannot be one, or the weights are not theirs."""
        super().check_params()
        unfitted = self._unfitted()
        physical = [(member.name, member.family.inputs(member.model_params()))
                    for member in unfitted if member.family.inputs]  # fmt: skip
        if len({inputs for _, inputs in physical}) > 1:
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
        super().check_shape(n_features, n_outputs)

    def _of(self, informed: list[JointRegressor]) -> Self:
        """Unfitted copy of other members; of those that it has, names too, where they are alike."""
        members = self._unfitted()
        same = (_described(informed), [*map(repr, informed)]) == (
            _described(members), [*map(repr, members)]
        )  # fmt: skip
        return self.with_params(**({} if same else {"members": tuple(informed)}))

    def model_params(self) -> Params:
        """Parameters of the family: each member's family, parameters and outputs."""
        return dict(vars(self).get("fitted_params_") or _described(self._unfitted()))

    @classmethod
    def from_params(cls, params: Params) -> Self:
        """Unfitted estimator of the parameters of its family, to be run only."""
        made = super().from_params(params)
        if cls().model_params() != params:
            made.members = ()
        return made

    def settled(self) -> Self:
        """Unfitted copy, of settled members."""
        fitted = vars(self).get("members_")
        if fitted is None or all(isinstance(member, str) for member in self.members):
            return super().settled()
        return self.with_params(
            members=tuple(member.settled() for member in fitted),
            weights=None if self.weights is None else self._used(),
        )

    def _learn(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        unfitted, n = self._unfitted(), y.shape[1]
        weights = np.ones((len(unfitted), n))
        if self.weights is not None:
            weights = np.array(self._used(), dtype=np.float64)
            unfitted = [m for m, row in zip(unfitted, self.weights, strict=True) if np.any(row)]
        self.members_ = []
        arrays: Arrays = {"weights": weights[weights != 0.0]}
        residuals, loads = y.copy(), self.truth_beside()
        for number, (model, member_weights) in enumerate(zip(unfitted, weights, strict=True)):
            outputs = np.flatnonzero(member_weights)
            member = model.for_outputs(outputs.tolist())
            if self.random_state is not None:
                seeds = [p for p in member.get_params() if p.split("__")[-1] == "random_state"]
                member.set_params(**dict.fromkeys(seeds, self.random_state))
            rows = np.flatnonzero(np.isfinite(residuals).all(axis=1) | member.family.remembers)
            if self.rows is not None and not member.family.remembers:
                rows = rows[:: -(-len(rows) // int(self.rows))]
            steps = dt[rows] if member.family.remembers else None  # as it is fitted alone
            taken = [loads.index(name) for name in member.truth_beside()]
            member.fit(
                X[rows], residuals[rows][:, outputs], share_of(progress, number, len(unfitted)),
                steps, self._loads[rows][:, taken],
            )  # fmt: skip
            member.memory()  # refuses what only works offline
            if self.weights is None and number + 1 < len(unfitted):
                residuals -= member.evaluate(X, dt)
            self.members_.append(member)
            arrays |= {f"{number}/{name}": array for name, array in member.arrays_.items()}
        self.fitted_params_ = _described(self.members_, weights)
        return arrays

    def _unfitted(self) -> list[JointRegressor]:
        if not isinstance(self.members, list | tuple):
            raise CalibrationError(
                f"members of a stack are {self.members!r:.60}; give a list of estimators"
            )
        return [_regressor(member) for member in self.members]

    def _used(self) -> tuple[tuple[float, ...], ...]:
        """Weights of the members that have any."""
        return tuple(tuple(map(float, row)) for row in self.weights or () if np.any(row))


@dataclass(eq=False, repr=False)
class Bounded(Combination):
    """An estimator that sees some features alone, and no further out than it was fitted to.

    Beyond, its prediction stays as it was at the end; only a line goes on. A physical filter knows
    how to go on by itself: one that takes features of its own is not held to their range.

    Parameters
    ----------
    member : Regressor or str
        Unfitted, with a row, or one of truejoint's names.
    columns : sequence of int, optional
        Places of the features that it sees; by default all.
    beside : sequence of int
        Place of a feature for each output that its predictions come on top of, such as the measured
        position where the true one is predicted; by default none.

    Attributes
    ----------
    member_ : JointRegressor
        Fitted.

    Examples
    --------
    >>> X = np.linspace(-1.0, 1.0, 200)[:, None]
    >>> bounded = Bounded("poly2_ridge").fit(X, X[:, 0] + np.abs(X[:, 0]))
    >>> alone = get_estimator("poly2_ridge").fit(X, X[:, 0] + np.abs(X[:, 0]))
    >>> bool(bounded.predict([[0.5]]) == alone.predict([[0.5]]))
    True
    >>> bool(bounded.predict([[3.0]]) < alone.predict([[3.0]]))
    True
    """

    runs: ClassVar[Family] = stack.BOUNDED
    fitted_params: ClassVar[Params] = {"members": (), "columns": ()}
    training: ClassVar[Mapping[str, Rule]] = dict.fromkeys(("member", "beside"), ANYTHING)
    member: Regressor | str = registry.LINEAR
    columns: tuple[int, ...] | None = None
    beside: tuple[int, ...] = ()

    @property
    def name(self) -> str:
        """Name of the estimator."""
        return self._unfitted()[0].name

    def for_outputs(self, outputs: Sequence[int]) -> Self:
        """Unfitted copy for some of the outputs."""
        beside = tuple(self.beside[j] for j in outputs) if self.beside else ()
        return self.with_params(beside=beside)

    def model_params(self) -> Params:
        """Parameters of the family: the estimator's family and parameters, and what it sees."""
        columns = tuple(self._columns(int(vars(self).get("n_features_in_", 1))))
        fitted = vars(self).get("fitted_params_")
        return dict(fitted or {**_described(self._unfitted()), "columns": columns})

    def settled(self) -> Self:
        """Unfitted copy, of a settled estimator."""
        return self._of([self.member_.settled()]) if "member_" in vars(self) else self.with_params()

    def _learn(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        (member,) = self._unfitted()
        columns = tuple(self._columns(X.shape[1]))
        inputs = np.ascontiguousarray(X[:, columns])
        direct = np.zeros((X.shape[1], y.shape[1]))
        direct[list(self.beside), range(len(self.beside))] = 1.0
        targets = y - X @ direct
        has_truth = np.isfinite(targets).all(axis=1)
        slope = np.zeros((inputs.shape[1], y.shape[1]))
        if member.family.inputs is not None:
            lower, upper = np.full((2, inputs.shape[1]), [[-LARGEST], [LARGEST]])
        else:
            lower, upper = inputs[has_truth].min(axis=0), inputs[has_truth].max(axis=0)
            if member.name == registry.LINEAR:
                line = Polynomial(1, ridge=False).fit(inputs[has_truth], targets[has_truth])
                slope = line.arrays_["coef"] * line.arrays_["inverse_scale"][:, None]
        self.member_ = member.fit(inputs, targets, progress, dt, self._loads)
        self.fitted_params_ = {**_described([self.member_]), "columns": columns}
        learnt = {f"0/{name}": array for name, array in self.member_.arrays_.items()}
        return {"lower": lower, "upper": upper, "slope": slope, "direct": direct, **learnt}

    def evaluate(self, X: Array, dt: ArrayLike | None = None) -> Array:
        """Predict (n, n_outputs) for finite rows `X` (n, k), also by what only works offline."""
        member = vars(self).get("member_")
        if member is None or member.family.row is not None:
            return super().evaluate(X, dt)
        inputs = X[:, list(self._columns(X.shape[1]))]
        held = np.clip(inputs, self.lower_, self.upper_)
        line = (inputs - held) @ self.slope_ + X @ self.direct_
        return np.asarray(member.evaluate(held, dt) + line)

    def _columns(self, n_features: int) -> Sequence[int]:
        return self.columns or range(n_features)

    def _unfitted(self) -> list[JointRegressor]:
        return [_regressor(self.member)]

    def _of(self, informed: list[JointRegressor]) -> Self:
        return self.with_params(member=informed[0])


def _regressor(member: Regressor | str) -> JointRegressor:
    """Unfitted estimator of one or its name; raises CalibrationError if it is none."""
    named = registry.member(member) if isinstance(member, str) else member
    model: JointRegressor = clone(joint_regressor(named))
    return model


def _described(members: Sequence[JointRegressor], weights: Array | None = None) -> Params:
    """Parameters of the family: family, parameters and outputs of each member."""
    rows = np.zeros((len(members), 0)) if weights is None else weights
    return {
        "members": tuple(
            (member.family.name, dict(member.model_params()), tuple(np.flatnonzero(row).tolist()))
            for member, row in zip(members, rows, strict=True)
        )
    }
