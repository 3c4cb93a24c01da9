"""Any regressor as an estimator of joints: by name, or with scikit-learn's `fit` and `predict`."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import clone
from sklearn.neural_network import MLPRegressor

from truejoint.array_types import Array
from truejoint.errors import CalibrationError, unknown
from truejoint.estimators.base import Arrays, JointRegressor, Progress, target_scaling
from truejoint.estimators.family import EstimatorData, Family, find_family
from truejoint.estimators.registry import OWN, PRESETS, estimator_names, plugged_in, registered
from truejoint.estimators.rules import ANYTHING, Rule
from truejoint.estimators.trees.learn import convert
from truejoint.plugins import call_plugin, load_plugin, origin

_COMPARED: Final = 1000  # most rows on which a regressor is compared with what it becomes
_FAMILY: Final = Family(
    "scikit_learn",
    rules={},
    shapes=lambda _params, _k, n_outputs: dict.fromkeys(
        ("target_mean", "target_scale"), (n_outputs,)
    ),
    offline=(
        "is run by scikit-learn (linear models, trees, forests, boosted trees and logistic "
        "networks are not)"
    ),
)
"""A regressor that does not become arrays: it predicts in the process that fitted it."""


class Regressor(Protocol):
    """Interface of scikit-learn's regressors, and of those of other packages that keep to it."""

    def fit(self, X: Any, y: Any, /) -> Any:
        """Fit to rows `X` (n, k) and targets `y` (n,) or (n, n_outputs)."""

    def predict(self, X: Any, /) -> Any:
        """Predict (n,) or (n, n_outputs) for rows `X` (n, k)."""


@dataclass(eq=False, repr=False)
class WrappedRegressor(JointRegressor):
    """A regressor of scikit-learn, or of another package that keeps to its interface.

    It is fitted to targets less their mean, over their standard deviation. A parameter therefore
    such as the `epsilon` of `sklearn.svm.SVR` means the same for a joint in rad and one in m. One
    that predicts a single output is fitted to each joint alone. Its learnt values become arrays of
    a family of ours if one computes the same (linear models, trees, forests, boosted trees,
    logistic networks, each also behind a scaler), and then runs in the loop and in C. Anything else
    is run by scikit-learn, on recordings only, and cannot be written to a model file.

    Parameters
    ----------
    regressor : Regressor
        Unfitted; clones of it are fitted.

    Attributes
    ----------
    parts_ : list of Regressor
        Clone fitted to all outputs, or one for each; absent where it is of a file and became
        arrays.
    fitted_params_ : dict
        Parameters of the family that it became.

    Examples
    --------
    >>> from sklearn.tree import DecisionTreeRegressor
    >>> X = np.arange(6.0)[:, None]
    >>> model = WrappedRegressor(DecisionTreeRegressor(max_depth=1)).fit(X, X[:, 0] > 2)
    >>> model.family.name, model.predict([[2.4], [2.6]])
    ('trees', array([0., 1.]))
    """

    family: ClassVar[Family] = _FAMILY
    training: ClassVar[Mapping[str, Rule]] = {"regressor": ANYTHING}
    regressor: Any = None

    @property
    def name(self) -> str:
        """Class of the regressor or, of a pipeline, of its last step; the family once loaded."""
        return self.family.name if self.regressor is None else type(_last(self.regressor)).__name__

    def minimum_rows(self, n_features: int) -> int:
        """Ten rows for each feature, and ten."""
        return 10 * (n_features + 1)

    def check_params(self) -> None:
        """Raise CalibrationError if it is no regressor."""
        regressor = self.regressor
        if isinstance(regressor, type):
            raise CalibrationError(
                f"{regressor.__name__} is a class; give an estimator made from it, as "
                f"{regressor.__name__}()"
            )
        # Some have a method only once they are fitted; their classes have it before.
        kinds = type(regressor), type(_last(regressor))
        wrong = ""
        if not all(hasattr(kind, name) for kind in kinds for name in ("fit", "predict")):
            wrong = "no estimator; give a name, or a regressor with fit and predict"
        elif (kind := getattr(_tags(regressor), "estimator_type", None)) not in (None, "regressor"):
            wrong = f"a {kind}; give a regressor"
        if wrong:  # scikit-learn takes a millisecond to describe a regressor
            raise CalibrationError(f"{repr(regressor)[:60].splitlines()[0]} is {wrong}")

    def evaluate(self, X: Array, dt: ArrayLike | None = None) -> Array:
        """Predict (n, n_outputs) for finite rows `X` (n, k); CalibrationError if it cannot."""
        if self.family.row is not None:
            return super().evaluate(X, dt)
        return self.arrays_["target_mean"] + self.arrays_["target_scale"] * self._predict(X)

    @classmethod
    def from_data(cls, data: EstimatorData, n_features: int, n_outputs: int) -> Self:
        """Fitted estimator of its data, of any family; raises as `JointRegressor.from_data`."""
        find_family(data.family).check(data, n_features, n_outputs)
        estimator = cls()
        estimator.n_features_in_, estimator.n_outputs_ = n_features, n_outputs
        estimator.single_output_ = False
        estimator._take(data)
        estimator.memory()
        return estimator

    @property
    def data(self) -> EstimatorData:
        """The fitted estimator as data; CalibrationError if it did not become arrays."""
        if self.family is _FAMILY:
            raise CalibrationError(
                f"{self.name} {_FAMILY.offline} and cannot run in a loop; it corrects recordings "
                "only, and a model file cannot hold it"
            )
        return super().data

    def _learn(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        mean, scale = target_scaling(y)
        self._fit_parts(X, (y - mean) / scale, progress)
        rows = np.ascontiguousarray(X[:: -(-len(X) // _COMPARED)])
        answers, shape = self._predict(rows), (X.shape[1], len(mean))
        try:
            data = convert(self.parts_, shape[0], mean, scale)
            if data is not None:
                find_family(data.family).check(data, *shape)
                self._take(data)
                residuals = (self.evaluate(rows) - mean) / scale - answers
                limit = 1e-9 * (1.0 + np.abs(answers) + np.abs(mean / scale))
                if (np.abs(residuals) <= limit).all():
                    return self.arrays_
        except CalibrationError as error:
            raise CalibrationError(f"{self.name}: {error}") from None
        self.family = _FAMILY  # type: ignore[misc]  # as `_take`
        self.fitted_params_ = dict[str, Any]()
        return {"target_mean": mean, "target_scale": scale}

    def _fit_parts(self, X: Array, y: Array, progress: Progress) -> None:
        """Fit one clone to all columns of `y` (n, n_outputs) or, if it takes one, a clone each."""
        takes = getattr(_tags(self.regressor), "target_tags", None)
        together = getattr(takes, "multi_output", False) or isinstance(
            _last(self.regressor), MLPRegressor
        )  # whose tags deny it
        alone = y.shape[1] == 1 and getattr(takes, "single_output", True)
        targets = [y] if together and not alone else list(y.T)
        self.parts_ = []
        for number, target in enumerate(targets):
            part = clone(self.regressor, safe=False)
            with _of_others(f"{self.name} cannot be fitted"):
                part.fit(X, target)
            self.parts_.append(part)
            progress((number + 1) / len(targets))

    def _take(self, data: EstimatorData) -> None:
        """Become what is run by the family of `data`."""
        self.family = find_family(data.family)  # type: ignore[misc]  # known once it is fitted
        self.fitted_params_, self.arrays_ = dict(data.params), dict(data.arrays)

    def _predict(self, X: Array) -> Array:
        """Predict (n, n_outputs) by the parts themselves."""
        name = type(self.parts_[0]).__name__
        with _of_others(f"{name} cannot predict"):
            columns = [np.asarray(part.predict(X), dtype=np.float64) for part in self.parts_]
        columns = [column[:, None] if column.ndim == 1 else column for column in columns]
        shapes, n = [column.shape for column in columns], self.n_outputs_ // len(columns)
        if shapes != [(len(X), n)] * len(columns):
            raise CalibrationError(
                f"{name} predicts an array {shapes[0]} for {len(X)} rows; it must give {n} numbers "
                "for each"
            )
        predicted = np.concatenate(columns, axis=1)
        if not np.isfinite(predicted).all():
            row, column = np.argwhere(~np.isfinite(predicted))[0]
            raise CalibrationError(
                f"{name} predicts {predicted[row, column]} in row {row}, output {column}; it must "
                "predict finite numbers"
            )
        return predicted


def joint_regressor(estimator: Regressor) -> JointRegressor:
    """Estimator of ours as it is, anything else wrapped; raises CalibrationError if it is none."""
    if isinstance(estimator, JointRegressor):
        return estimator
    wrapped = WrappedRegressor(estimator)
    wrapped.check_params()
    return wrapped


def get_estimator(name: str) -> JointRegressor:
    """Unfitted estimator called `name`; raises CalibrationError naming the known ones.

    Examples
    --------
    >>> get_estimator("poly2").degree
    2
    """
    if name not in estimator_names():
        raise CalibrationError(unknown("estimator", name, estimator_names()))
    if name in OWN:
        return joint_regressor(registered(name))
    point = plugged_in()[name]
    regressor = call_plugin(point, load_plugin(point, type))
    try:
        return joint_regressor(regressor)
    except CalibrationError as error:
        raise CalibrationError(f"{origin(point)}: {error}") from None


def candidates() -> list[JointRegressor]:
    """Unfitted estimators that an automatic choice tries.

    Examples
    --------
    >>> [estimator.name for estimator in candidates()][:2]
    ['offset', 'linear']
    """
    return [get_estimator(name) for name, preset in PRESETS.items() if preset.is_tried]


def class_of(family: str) -> type[JointRegressor]:
    """Class of estimators whose family is called so: one by name, or what runs any family."""
    presets = (preset for preset in PRESETS.values() if preset.family == family)
    return next((preset.kind for preset in presets), WrappedRegressor)


@contextmanager
def _of_others(what: str) -> Iterator[None]:
    """Say in one line, as CalibrationError, what code of others may raise: anything."""
    try:
        yield
    except Exception as error:
        line = " ".join(f"{type(error).__name__}: {error}".split())
        raise CalibrationError(f"{what}: {line[:300]}") from error


def _last(regressor: Any) -> Any:
    return (getattr(regressor, "steps", None) or [[regressor]])[-1][-1]


def _tags(regressor: Any) -> Any:
    return getattr(regressor, "__sklearn_tags__", lambda: None)()
