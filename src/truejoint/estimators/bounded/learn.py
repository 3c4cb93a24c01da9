"""An estimator that is held to the range of what it was fitted to, and sees some features alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Final, Self

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import clone

from truejoint.array_types import Array
from truejoint.estimators import registry
from truejoint.estimators.base import Arrays, JointRegressor, Progress
from truejoint.estimators.bounded import run as bounded
from truejoint.estimators.family import LARGEST, Family, Params, Rule
from truejoint.estimators.polynomial.learn import Polynomial
from truejoint.estimators.wrapped import Regressor, joint_regressor

if TYPE_CHECKING:
    from truejoint.recordings import Recording
    from truejoint.robots import Robot

_ANY: Final = Rule(lambda _value: True, "anything")


@dataclass(eq=False, repr=False)
class Bounded(JointRegressor):
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

    training: ClassVar[Mapping[str, Rule]] = dict.fromkeys(("member", "beside"), _ANY)
    member: Regressor | str = registry.LINEAR
    columns: tuple[int, ...] | None = None
    beside: tuple[int, ...] = ()

    @property
    def name(self) -> str:
        """Name of the estimator."""
        return self._unfitted().name

    @property
    def family(self) -> Family:  # type: ignore[override]  # by its member
        """What runs it."""
        return bounded.FAMILY.of(self.model_params())

    def minimum_rows(self, n_features: int) -> int:
        """As many as the estimator needs."""
        return self._unfitted().minimum_rows(len(self.columns or ()) or n_features)

    def check_params(self) -> None:
        """Raise CalibrationError as the estimator does."""
        self._unfitted().check_params()

    def check_shape(self, n_features: int, n_outputs: int) -> None:
        """Raise CalibrationError for numbers of either that the estimator does not take."""
        self._unfitted().check_shape(len(self.columns or ()) or n_features, n_outputs)

    def for_recordings(self, recordings: Sequence[Recording]) -> Self:
        """Unfitted copy whose estimator knows what the recordings say of the robot."""
        return self.with_params(member=self._unfitted().for_recordings(recordings))

    def truth_beside(self) -> tuple[str, ...]:
        """Columns of known loads that the estimator takes."""
        return self._unfitted().truth_beside()

    def for_features(self, names: Sequence[str], robot: Robot, joints: Sequence[str]) -> Self:
        """Unfitted copy whose estimator knows the features that it sees."""
        inputs = names if self.columns is None else [names[place] for place in self.columns]
        return self.with_params(member=self._unfitted().for_features(inputs, robot, joints))

    def for_outputs(self, outputs: Sequence[int]) -> Self:
        """Unfitted copy for some of the outputs."""
        beside = tuple(self.beside[j] for j in outputs) if self.beside else ()
        return self.with_params(beside=beside)

    def model_params(self) -> Params:
        """Parameters of the family: the estimator's family and parameters, and what it sees."""
        fitted = vars(self)
        if "params_" in fitted:
            return dict(fitted["params_"])
        member = fitted.get("member_") or self._unfitted()
        described = ((member.family.name, dict(member.model_params()), ()),)
        n_features = int(fitted.get("n_features_in_", 1))
        return {"members": described, "columns": self.columns or tuple(range(n_features))}

    @classmethod
    def from_params(cls, params: Params) -> Self:
        """Make one of these parameters, to be run only."""
        made = cls()
        made.params_ = params
        return made

    def settled(self) -> Self:
        """Unfitted copy, of a settled estimator."""
        fitted = vars(self).get("member_")
        return self.with_params() if fitted is None else self.with_params(member=fitted.settled())

    def _learn(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        member, columns = self._unfitted(), self.columns or range(X.shape[1])
        inputs = np.ascontiguousarray(X[:, list(columns)])
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
        learnt = {f"0/{name}": array for name, array in self.member_.arrays_.items()}
        return {"lower": lower, "upper": upper, "slope": slope, "direct": direct, **learnt}

    def evaluate(self, X: Array, dt: ArrayLike | None = None) -> Array:
        """Predict (n, n_outputs) for finite rows `X` (n, k), also by what only works offline."""
        member = vars(self).get("member_")
        if member is None or member.family.row is not None:
            return super().evaluate(X, dt)
        inputs = X[:, list(self.columns or range(X.shape[1]))]
        held = np.clip(inputs, self.lower_, self.upper_)
        line = (inputs - held) @ self.slope_ + X @ self.direct_
        return np.asarray(member.evaluate(held, dt) + line)

    def _unfitted(self) -> JointRegressor:
        """Give an estimator of one's own."""
        named = registry.member(self.member) if isinstance(self.member, str) else self.member
        model: JointRegressor = clone(joint_regressor(named))
        return model
