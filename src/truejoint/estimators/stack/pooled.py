"""What models of like instruments say of a new one: their mean, weighted as its truth says."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np

from truejoint.array_types import Array
from truejoint.estimators.base import Arrays, JointRegressor, Progress
from truejoint.estimators.family import EstimatorData, Family, evaluate
from truejoint.estimators.polynomial.learn import Polynomial
from truejoint.estimators.rules import ANYTHING, LARGEST, Params, Rule
from truejoint.estimators.stack import run as stack

_ROUNDS: Final = 5  # of weights and what they leave, in turn
_ALIKE: Final = 0.5  # [s] for which errors of a model resemble each other


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
        weights, slopes = map(np.array, zip(*(_weights(*o, count) for o in outputs), strict=True))
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


def _weights(
    predicted: Array, positions: Array, target: Array, count: float
) -> tuple[Array, float]:
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
