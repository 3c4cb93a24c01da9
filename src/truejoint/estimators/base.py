"""What every estimator has: scikit-learn's interface, and a `Family` that runs what it learnt."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from functools import cache
from typing import Any, ClassVar, Final, Self

import joblib
import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator, RegressorMixin, clone
from sklearn.utils.validation import check_is_fitted, validate_data

from truejoint.array_types import Array, Mask
from truejoint.errors import CalibrationError
from truejoint.estimators import registry
from truejoint.estimators.family import EstimatorData, Family, evaluate
from truejoint.estimators.rules import Params, Rule, check_rules
from truejoint.layout import Memory
from truejoint.recordings import Recording
from truejoint.robots import Robot
from truejoint.threads import one_thread

Arrays = dict[str, Array]
Progress = Callable[[float], None]

_REGULAR: Final = 5e-3  # [s], 200 Hz
_LEARNT: Final = ContextVar[dict[str, dict[str, Any]] | None]("_LEARNT", default=None)


@contextmanager
def shared_fits() -> Iterator[None]:
    """Context in which what was fitted to the same rows with the same parameters is not again."""
    np.empty(30 << 20, np.uint8)  # freed, it makes malloc keep what trees free
    token = _LEARNT.set({})
    try:
        yield
    finally:
        _LEARNT.reset(token)


def untold(_fraction: float) -> None:
    """Progress that nobody asked for."""


def share_of(progress: Progress, place: int, n_parts: int) -> Progress:
    """Progress of one of a few parts, as `progress` of them all."""
    return lambda share: progress((place + share) / n_parts)


class JointRegressor(RegressorMixin, BaseEstimator, ABC):  # type: ignore[misc]  # sklearn: untyped
    """Base of the estimators: a subclass names its family, and learns the family's arrays.

    Rows of a family that remembers are in the order of time. Beside them goes `dt` (n,): the time
    since the row before [s], 0 where a history starts. A target that is NaN is then unknown: its
    row is seen, but not fitted to.

    Attributes
    ----------
    arrays_ : dict of str to ndarray
        Learnt arrays, float64, by the names of `Family.shapes`; each is also an attribute, with
        an underscore behind its name.

    Examples
    --------
    >>> isinstance(truejoint.estimators.get_estimator("linear"), JointRegressor)
    True
    """

    family: ClassVar[Family]  # what runs it
    least_rows: ClassVar[int] = 10
    rows_per_feature: ClassVar[int] = 0
    training: ClassVar[Mapping[str, Rule]] = {}  # rules of parameters that its family is not told
    fitted_params: ClassVar[Params] = {}  # parameters of its family alone, as before a fit
    partial: ClassVar[bool] = False  # a target that is NaN is left out, its row's others are not

    @classmethod
    @cache
    def _get_param_names(cls) -> Any:  # scikit-learn reads them from the signature each time
        return super()._get_param_names()

    @property
    def name(self) -> str:
        """Name in tables and on the command line."""
        return registry.name_of(self)

    def fit(
        self,
        X: ArrayLike,
        y: ArrayLike,
        progress: Progress | None = None,
        dt: ArrayLike | None = None,
        loads: ArrayLike | None = None,
    ) -> Self:
        """Fit to rows `X` (n, k) and targets `y` (n,) or (n, n_outputs).

        `progress` is called with the fraction done, 0 to 1; rows are 5 ms apart where there is no
        `dt`, and `loads` (n, m), what `truth_beside` names, are 0 where they are not given. Raises
        CalibrationError if a parameter breaks its rule, or the rows cannot tell what is to be
        learnt, and ValueError if a shape or a value is wrong.
        """
        self.check_params()
        takes_nan = self.partial or self.family.remembers
        takes_nan = takes_nan and isinstance(y, np.ndarray) and y.dtype.kind == "f"
        unknown = np.isnan(y) if takes_nan else np.False_
        inputs, targets = validate_data(
            self, X, np.where(unknown, 0.0, y) if np.any(unknown) else y,
            dtype=np.float64, order="C", multi_output=True, y_numeric=True,
        )  # fmt: skip
        self.family.check_size(self.model_params(), inputs.shape[1])
        targets = np.asarray(np.where(unknown, np.nan, targets), dtype=np.float64)
        self.single_output_ = targets.ndim == 1
        targets = targets.reshape(len(targets), -1)
        self.n_outputs_ = targets.shape[1]
        self.check_shape(inputs.shape[1], self.n_outputs_)
        # One thread: blocks of a few thousand rows are too small to share. Two threads on two busy
        # cores were 6 times slower than one for a polynomial and 12 times for a network.
        names, n = self.truth_beside(), len(inputs)
        self._loads = np.zeros((n, len(names))) if loads is None else np.array(loads, np.float64)
        if self._loads.shape != (n, len(names)):
            raise CalibrationError(
                f"{self.name}: loads have shape {self._loads.shape}; give {(n, len(names))}: "
                f"{', '.join(names) or 'it takes none'}"
            )
        steps, learnt, key = self.time_steps(dt, n), _LEARNT.get(), ""
        if learnt is not None:
            asked = type(self), self.get_params(deep=False), self.single_output_
            with suppress(Exception):  # a regressor of others that cannot be written
                key = joblib.hash((asked, inputs, targets, steps, self._loads), "sha1")
        if learnt is not None and key in learnt:
            self.__dict__.update(learnt[key])
        else:
            with one_thread():
                self.arrays_ = self._learn(inputs, targets, steps, progress or untold)
        del self._loads
        if learnt is not None and key:
            learnt[key] = dict(vars(self))
        return self

    def predict(self, X: ArrayLike, dt: ArrayLike | None = None) -> Array:
        """Predict (n, n_outputs) for rows `X` (n, k), or (n,) if it was fitted to a 1-D target."""
        check_is_fitted(self)
        inputs = validate_data(self, X, dtype=np.float64, order="C", reset=False)
        outputs = self.evaluate(inputs, dt)
        return outputs[:, 0] if self.single_output_ else outputs

    def evaluate(self, X: Array, dt: ArrayLike | None = None) -> Array:
        """Predict (n, n_outputs) for finite, C-ordered rows `X` (n, k), without checks."""
        steps = self.time_steps(dt, len(X))
        return evaluate(self.family, self.memory(), X, steps, self.n_outputs_)

    def memory(self) -> Memory:
        """Memory of the row before the first row."""
        return self.family.memory(self.data, int(self.n_features_in_), int(self.n_outputs_))

    @property
    def identified(self) -> dict[str, tuple[float, float, str]]:
        """Quantities of the robot that it found while it was fitted: value, deviation, unit."""
        return {}

    @property
    def data(self) -> EstimatorData:
        """The fitted estimator as data."""
        return EstimatorData(self.family.name, self.model_params(), self.arrays_)

    def model_params(self) -> Params:
        """Parameters of the family: its own, and those that a fit finds."""
        params = self.get_params(deep=False).items()
        asked = {name: value for name, value in params if name not in self.training}
        return {**asked, **vars(self).get("fitted_params_", self.fitted_params)}

    @classmethod
    def from_params(cls, params: Params) -> Self:
        """Unfitted estimator of the parameters of its family, to be run only."""
        made = cls(**{n: value for n, value in params.items() if n not in cls.fitted_params})
        if cls.fitted_params:
            made.fitted_params_ = {name: params[name] for name in cls.fitted_params}
        return made

    @classmethod
    def from_data(cls, data: EstimatorData, n_features: int, n_outputs: int) -> Self:
        """Fitted estimator of its data; predicts bit for bit as the one it came from.

        Raises CalibrationError if a parameter or an array is unknown, missing, or breaks a rule.
        """
        data.kind.check(data, n_features, n_outputs)
        estimator = cls.from_params(data.params)
        estimator.arrays_, estimator.single_output_ = dict(data.arrays), False
        estimator.n_features_in_, estimator.n_outputs_ = n_features, n_outputs
        estimator.memory()
        return estimator

    def with_params(self, **changed: Any) -> Self:
        """Unfitted copy with some other parameters."""
        copy: Self = clone(self).set_params(**changed)
        return copy

    def minimum_rows(self, n_features: int) -> int:
        """Fewest rows that `calibrate` accepts to fit this estimator to."""
        return max(self.least_rows, self.rows_per_feature * n_features)

    @abstractmethod
    def _learn(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        """Learn from checked rows `X` (n, k), `y` (n, n_outputs) and `dt` (n,).

        Meanwhile `self._loads` (n, m) are those that `truth_beside` names.
        """

    def check_params(self) -> None:
        """Raise CalibrationError, naming the parameter and its rule, when one breaks it."""
        if self.training:
            check_rules(self.name, self.training, self.get_params(deep=False))
        if (family := self.family).specialise is None:  # `Family.of` has checked the others
            family.check_params(self.model_params())

    def check_shape(self, n_features: int, n_outputs: int) -> None:
        """Raise CalibrationError for numbers of either that the estimator does not take."""
        self.family.shapes(self.model_params(), n_features, n_outputs)

    def for_recordings(self, _recordings: Sequence[Recording]) -> Self:
        """Unfitted copy that knows what the recordings say of the robot.

        Raises CalibrationError when they cannot serve to fit it.
        """
        return self.with_params()

    def truth_beside(self) -> tuple[str, ...]:
        """Columns of known loads, 0 where there are none, that `fit` takes as `loads`, (n, k)."""
        return ()

    def for_features(self, _names: Sequence[str], _robot: Robot, _joints: Sequence[str]) -> Self:
        """Unfitted copy that knows its features, and the robot's joints that it is to correct.

        Raises CalibrationError when these cannot serve it.
        """
        return self.with_params()

    def time_steps(self, dt: ArrayLike | None, n: int) -> Array:
        """Time (n,) since the row before [s], checked; rows 5 ms apart where it is not given."""
        times = np.full(n, _REGULAR) if dt is None else np.array(dt, dtype=np.float64)
        if times.shape != (n,) or not (np.isfinite(times) & (times >= 0.0)).all():
            raise CalibrationError(
                f"{self.name}: time steps have shape {times.shape}; give {n} times since the row "
                "before [s], not negative, 0 where a history starts"
            )
        times[:1] = 0.0
        return times

    def _known(self, y: Array) -> Mask:
        """Rows (n,) of `y` (n, n_outputs) that are known; CalibrationError if they are too few."""
        labelled = np.asarray(np.isfinite(y).all(axis=1))
        if labelled.sum() < self.least_rows:
            raise CalibrationError(
                f"{self.name}: {int(labelled.sum())} rows with a known position; it needs "
                f"{self.least_rows}"
            )
        return labelled

    def __getattr__(self, name: str) -> Any:
        arrays: Mapping[str, Array] = vars(self).get("arrays_", {})
        if name.endswith("_") and name[:-1] in arrays:
            return arrays[name[:-1]]
        raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.target_tags.multi_output = True
        return tags


def labelled_parts(y: Array) -> list[tuple[Any, Any]]:
    """Rows and columns of targets `y` (n, k) that are known together; each column where one lacks.

    Raises CalibrationError if a column is known nowhere.
    """
    labelled = ~np.isnan(y)
    if labelled.all():
        return [(slice(None), slice(None))]
    if not labelled.any(axis=0).all():
        raise CalibrationError("a target is known in no row; leave that output out")
    return [(rows, slice(k, k + 1)) for k, rows in enumerate(labelled.T)]


def standardisation(X: Array) -> tuple[Array, Array]:
    """Mean and inverse standard deviation (k,) of the columns of `X` (n, k), 0 for constants."""
    deviation = X.std(axis=0)
    inverse = np.zeros_like(deviation)
    np.divide(1.0, deviation, out=inverse, where=~constant_columns(X))
    return X.mean(axis=0), inverse


def target_scaling(y: Array) -> tuple[Array, Array]:
    """Mean and standard deviation (k,) of known targets `y` (n, k), 1 for those of constants."""
    parts = [y[rows, columns] for rows, columns in labelled_parts(y)]
    mean, inverse = np.hstack([standardisation(part) for part in parts])
    deviation = np.hstack([part.std(axis=0) for part in parts])
    return mean, np.where(inverse > 0, deviation, 1.0)


def scaling(X: Array, y: Array) -> Arrays:
    """Give what scales features and targets, by the names under which models keep it."""
    features = zip(("mean", "inverse_scale"), standardisation(X), strict=True)
    return dict([*features, *zip(("target_mean", "target_scale"), target_scaling(y), strict=True)])


def constant_columns(X: Array) -> Mask:
    """Which columns (k,) of `X` (n, k) are constant but for rounding (1e-9 of their value)."""
    low, high = X.min(axis=0), X.max(axis=0)
    least = np.maximum(1e-9 * np.maximum(np.abs(low), np.abs(high)), 1e-150)
    return np.asarray(~(high - low > least))
