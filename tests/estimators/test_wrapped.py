"""Regressors of scikit-learn: fitted, run, kept and refused."""

import doctest
import warnings
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn import ensemble, linear_model, preprocessing
from sklearn.base import BaseEstimator, RegressorMixin, clone
from sklearn.cluster import KMeans
from sklearn.compose import TransformedTargetRegressor
from sklearn.decomposition import PCA
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, WhiteKernel
from sklearn.kernel_ridge import KernelRidge
from sklearn.model_selection import GridSearchCV
from sklearn.multioutput import MultiOutputRegressor, RegressorChain
from sklearn.neighbors import KNeighborsRegressor
from sklearn.neural_network import MLPRegressor
from sklearn.pipeline import make_pipeline
from sklearn.svm import SVR
from sklearn.tree import DecisionTreeRegressor, ExtraTreeRegressor
from tests.refusals import refused
from tests.runtime import streams
from tests.runtime.registered import good_rows
from tests.synthetic import build_recording
from threadpoolctl import threadpool_limits

from truejoint.calibration import (
    Calibration,
    calibrate,
    find_zero,
    read_calibration,
    with_interval,
    write_calibration,
)
from truejoint.errors import TruejointError
from truejoint.estimators import Polynomial
from truejoint.estimators.polynomial.run import FAMILY as POLYNOMIAL
from truejoint.estimators.trees import run as tree_arrays
from truejoint.estimators.trees.learn import single_threshold
from truejoint.estimators.wrapped import WrappedRegressor
from truejoint.evaluation import evaluate
from truejoint.runtime import Corrector
from truejoint.runtime.check import check_calibration


def network(**settings) -> MLPRegressor:
    return MLPRegressor(hidden_layer_sizes=(6, 5), max_iter=20, random_state=0, **settings)


IN_THE_LOOP = {
    "trees": [
        DecisionTreeRegressor(random_state=0),
        DecisionTreeRegressor(max_leaf_nodes=20, random_state=0),  # grown best first
        ExtraTreeRegressor(random_state=0),
        ensemble.RandomForestRegressor(21, random_state=0),  # more than are walked through at once
        ensemble.ExtraTreesRegressor(5, random_state=0),
        ensemble.GradientBoostingRegressor(n_estimators=6),
        ensemble.GradientBoostingRegressor(n_estimators=3, init="zero", loss="huber"),
        ensemble.HistGradientBoostingRegressor(max_iter=6),
        ensemble.HistGradientBoostingRegressor(max_iter=6, loss="absolute_error"),
        MultiOutputRegressor(ensemble.GradientBoostingRegressor(n_estimators=4)),
        MultiOutputRegressor(ensemble.ExtraTreesRegressor(3, random_state=0)),
        make_pipeline(
            preprocessing.StandardScaler(), ensemble.RandomForestRegressor(3, random_state=0)
        ),
    ],
    "polynomial": [
        linear_model.LinearRegression(),
        linear_model.LinearRegression(fit_intercept=False),
        linear_model.Ridge(),
        linear_model.HuberRegressor(max_iter=1000),
        MultiOutputRegressor(linear_model.Lasso(0.01)),
        make_pipeline(preprocessing.StandardScaler(), linear_model.BayesianRidge()),
        GridSearchCV(linear_model.Ridge(), {"alpha": [0.1, 1.0]}, cv=2),
    ],
    "network": [make_pipeline(preprocessing.StandardScaler(), network(activation="logistic"))],
}
OFFLINE = [
    make_pipeline(preprocessing.StandardScaler(), network(activation="tanh")),
    make_pipeline(preprocessing.MinMaxScaler(), SVR()),
    make_pipeline(preprocessing.PolynomialFeatures(2), linear_model.Ridge()),
    make_pipeline(PCA(2), linear_model.LinearRegression()),
    make_pipeline(preprocessing.StandardScaler(), KernelRidge(kernel="rbf")),
    KNeighborsRegressor(algorithm="brute"),
    RegressorChain(linear_model.Ridge()),
    TransformedTargetRegressor(linear_model.Ridge(), transformer=preprocessing.StandardScaler()),
    GaussianProcessRegressor(RBF() + WhiteKernel(), optimizer=None),
    ensemble.StackingRegressor([("ridge", linear_model.Ridge()), ("svr", SVR())], cv=2),
]
LOOP = [(name, one) for name, several in IN_THE_LOOP.items() for one in several]
EVERY = [*LOOP, *(("scikit_learn", one) for one in OFFLINE)]
TEST = streams.recording(np.arange(0.0, 20.0, 1 / 30), seed=3)


def label(value) -> str:
    return str(value)[:60].replace("\n", "")


@pytest.fixture(autouse=True)
def _one_thread():
    # Threads that wait for each other on busy cores take a hundred times as long.
    with threadpool_limits(1), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


@pytest.fixture(scope="module")
def data():
    rng = np.random.default_rng(0)
    X = rng.normal(size=(300, 3)) * [1.0, 1e-3, 50.0] + [0.0, 7.0, -100.0]
    y = np.column_stack([X[:, 0] - 0.02 * X[:, 2], 1e-3 * X[:, 0] ** 2])
    return X, y + rng.normal(0, 1e-5, y.shape)


@pytest.mark.parametrize(
    ("family", "regressor", "n_outputs"),
    [*((*one, 2) for one in EVERY), *((*one, 1) for one in EVERY[::4])],
    ids=label,
)
def test_it_predicts_what_scikit_learn_does(family, regressor, n_outputs, data):
    X, y = data[0], data[1][:, :n_outputs]
    if n_outputs == 1 and not isinstance(regressor, (MultiOutputRegressor, RegressorChain)):
        y = y[:, 0]
    model = WrappedRegressor(regressor).fit(X, y)
    assert model.family.name == family
    mean, scale = y.mean(axis=0), y.std(axis=0)
    scaled = (y - mean) / scale
    rows = X + 0.01 * X.std(axis=0)
    together = n_outputs == 1 or model.parts_[0].predict(X).ndim > 1
    targets = [scaled] if together else scaled.T
    columns = [clone(regressor).fit(X, target).predict(rows) for target in targets]
    expected = columns[0] if together else np.column_stack(columns)
    np.testing.assert_allclose((model.predict(rows) - mean) / scale, expected, rtol=0, atol=1e-11)


@cache
def fitted(regressor) -> Calibration:
    """Calibration by one of `LOOP`, of 20 s."""
    return streams.trained(regressor, recordings=[streams.recording(TEST.t)])


@pytest.mark.parametrize(("family", "regressor"), LOOP, ids=label)
def test_a_file_gives_it_back_and_the_loop_runs_it_bit_for_bit(family, regressor, tmp_path):
    calibration = fitted(regressor)
    path = tmp_path / "model.safetensors"
    write_calibration(calibration, path)
    again = read_calibration(path)
    assert again.correct(TEST).tobytes() == calibration.correct(TEST).tobytes()
    last = regressor.steps[-1][1] if hasattr(regressor, "steps") else regressor
    assert again.estimator == calibration.estimator == type(last).__name__
    assert again.model.data.family == family
    assert good_rows(calibration, TEST, calibration.correct(TEST), most=300) == 300


def test_one_that_scikit_learn_runs_is_judged_like_any_other():
    model = calibrate(build_recording(900), OFFLINE[1], joints=["elbow"])
    test = build_recording(400, 1)
    scores = evaluate({model.estimator: [model]}, [test]).scores
    rmse = scores[scores.joint == "elbow"].set_index("estimator").rmse.to_dict()
    assert set(rmse) == {"raw", "offset", "linear", "poly2", model.estimator}
    assert rmse[model.estimator] < 0.8 * rmse["offset"]
    assert check_calibration(model, test).joints[0].rmse == pytest.approx(rmse[model.estimator])
    unseen = [build_recording(200, seed, homing_id=f"h{seed}") for seed in range(2, 11)]
    _, lower, upper = with_interval(model, unseen).correct_with_interval(test)
    assert (upper > lower).all()
    moved = model.at(find_zero(model, test))
    np.testing.assert_allclose(
        np.ptp(moved.correct(test) - model.correct(test), axis=0), 0.0, atol=1e-12
    )


def test_parameters_are_kept_and_told():
    forest = ensemble.RandomForestRegressor(3, max_depth=2)
    fitted = calibrate(streams.recording(np.arange(0.0, 60.0, 1 / 30)), forest, random_state=7)
    assert "max_depth=2, n_estimators=3, random_state=7" in fitted.metadata["settings"]
    assert forest.random_state is None
    assert int(fitted.model.data.params["n_trees"]) == 3


def test_one_that_runs_by_scikit_learn_is_refused_by_the_loop_and_by_the_writer(tmp_path):
    calibration = streams.trained(ensemble.AdaBoostRegressor(n_estimators=2))
    assert np.isfinite(calibration.correct(TEST)).all()
    said = "run by scikit-learn .* cannot run in a loop; it corrects recordings only"
    path = tmp_path / "model.safetensors"
    refused(said, write_calibration, calibration, path)
    with pytest.raises(TruejointError, match=said):
        Corrector(calibration)
    assert not path.exists()


class Mean(RegressorMixin, BaseEstimator):
    """A user's own; `answer` is what it predicts, of the rows."""

    def __init__(self, answer=None):
        self.answer = answer

    def fit(self, X, y):
        if self.answer == "raise":
            raise RuntimeError("no luck\ntoday")
        self.coef_, self.intercept_ = np.zeros(X.shape[1]), np.mean(y)
        return self

    def predict(self, X):
        good = np.full(len(X), self.intercept_)
        if self.answer == "nan":
            good[-1] = np.nan
        return {"short": good[1:], "wide": np.ones((len(X), 4)), "text": ["a"]}.get(
            self.answer, np.square(good + 1.0) if self.answer == "own" else good
        )


class Plain:
    """With fit and predict, and nothing of scikit-learn."""

    def fit(self, X, y):
        self.coef_, self.intercept_ = np.linalg.lstsq(X, y)[0], 0.0

    def predict(self, X):
        return X @ self.coef_


def test_a_linear_model_of_the_users_own_runs_in_the_loop(data):
    for own in (Mean(), Plain()):
        model = WrappedRegressor(own).fit(*data)
        assert model.family.name == "polynomial"
        assert model.name == type(own).__name__


@pytest.mark.parametrize(
    ("estimator", "said"),
    [
        (3, "3 is no estimator; give a name, or a regressor"),
        (preprocessing.StandardScaler(), "is no estimator"),
        (
            make_pipeline(preprocessing.StandardScaler(), preprocessing.StandardScaler()),
            "is no estimator",
        ),
        (ensemble.RandomForestRegressor, r"is a class; .* as RandomForestRegressor\(\)"),
        (linear_model.LogisticRegression(), "is a classifier; give a regressor"),
        (KMeans(), "is a clusterer; give a regressor"),
        (Mean("raise"), "Mean cannot be fitted: RuntimeError: no luck today"),
        (linear_model.Ridge(alpha=-1.0), "Ridge cannot be fitted: InvalidParameterError: .*alpha"),
        (Mean("nan"), "Mean predicts nan in row .*; it must predict finite numbers"),
        (Mean("short"), r"Mean predicts an array \(\d+, 1\) for \d+ rows; .* 1 numbers for each"),
        (Mean("wide"), r"Mean predicts an array \(\d+, 4\)"),
        (Mean("text"), "Mean cannot predict: ValueError: could not convert"),
    ],
    ids=label,
)
def test_what_is_no_use_is_refused_in_one_line(estimator, said):
    refused(said, streams.trained, estimator)


def test_too_large_a_forest_is_refused(monkeypatch):
    monkeypatch.setattr("truejoint.estimators.trees.learn.MAX_NODES", 100)
    refused("more than the 100 .* set min_samples_leaf", streams.trained,
            ensemble.RandomForestRegressor(2))  # fmt: skip


@given(st.floats(-1e30, 1e30), st.integers(-3, 3))
def test_thresholds_are_compared_as_scikit_learn_does(threshold, ulps):
    bound = single_threshold(np.array([threshold]))[0]
    x = bound
    for _ in range(abs(ulps)):
        x = np.nextafter(x, np.inf if ulps > 0 else -np.inf)
    assert (float(np.float32(x)) <= threshold) == (x <= bound)


def test_bounds_of_both_sides_agree():
    assert tree_arrays.MAX_NODES * 8 * 4 < 200 * 2**20


def test_the_documented_example_holds(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    page = Path(__file__).parents[2] / "docs" / "estimators.md"
    failed, tried = doctest.testfile(str(page), module_relative=False)
    assert tried > 5
    assert not failed


class Mine(Polynomial):
    """Learns in a way of its own what a family of truejoint runs."""

    def _learn(self, X, y, dt, progress):
        return super()._learn(X, 2.0 * y, dt, progress)


def test_a_class_of_the_users_own_on_a_known_family_is_kept(tmp_path):
    calibration = streams.trained(Mine())
    path = tmp_path / "model.safetensors"
    write_calibration(calibration, path)
    assert read_calibration(path).correct(TEST).tobytes() == calibration.correct(TEST).tobytes()


def test_a_family_that_nobody_could_find_again_is_not_written(tmp_path):
    own = type("Own", (Polynomial,), {"family": replace(POLYNOMIAL, name="own")})
    calibration = streams.trained(own())
    assert np.isfinite(calibration.correct(TEST)).all()
    refused("no estimator family 'own'", write_calibration, calibration, tmp_path / "m.safetensors")
