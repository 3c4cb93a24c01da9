"""Several estimators as one: what it predicts, keeps, runs and refuses."""

from functools import cache
from unittest.mock import patch

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.svm import SVR
from sklearn.tree import DecisionTreeRegressor
from tests.estimators.motor_side.test_motor_side import recording as grasper_recording
from tests.export.library import exported, needs_compiler
from tests.export.library import good_rows as good_rows_in_c
from tests.refusals import refused
from tests.runtime.registered import drawn, good_rows
from tests.runtime.streams import recording, trained

from truejoint.calibration import Calibration, calibrate, read_calibration, write_calibration
from truejoint.estimators import (
    GRU,
    ElasticJointFilter,
    JawFilter,
    NeuralNetwork,
    Plays,
    Polynomial,
    Stack,
    get_estimator,
)
from truejoint.estimators.family import EstimatorData
from truejoint.estimators.gp.learn import GaussianProcess
from truejoint.estimators.network.learn import SequenceNetwork
from truejoint.estimators.polynomial.run import of_degree
from truejoint.estimators.stack.run import FAMILY
from truejoint.estimators.wrapped import class_of
from truejoint.features.feature_set import time_steps
from truejoint.robots import get_robot

NETWORK = NeuralNetwork(hidden_layer_sizes=(5,), epochs=2)
MEMORY = GRU(units=5, epochs=2)
STEPS = Stack((Polynomial(1), DecisionTreeRegressor(max_depth=3)))
WEIGHTS = ((1.0, 0.2), (0.0, 0.3), (0.0, 0.1), (0.0, 0.0), (0.0, 0.4))
EVERY_KIND = (Polynomial(1), NETWORK, MEMORY, Polynomial(), STEPS)
UNSEEN = recording(np.arange(0.0, 20.0, 1 / 30), seed=5)


@cache
def model() -> Calibration:
    """Two joints: the linear model for one, four of all kinds for the other."""
    return learnt(Stack(EVERY_KIND, WEIGHTS))


def learnt(estimator) -> Calibration:
    with patch.object(SequenceNetwork, "_train", drawn):
        return trained(estimator)


def data(members, weights=(1.0,)) -> EstimatorData:
    k = np.zeros(2)
    own = {"mean": k, "inverse_scale": k, "coef": np.zeros((0, 1)), "intercept": np.zeros(1)}
    arrays = {"weights": np.array(weights), **{f"0/{name}": a for name, a in own.items()}}
    return EstimatorData("stack", {"members": members, "columns": ()}, arrays)


def test_it_is_the_weighted_mean_of_its_members_and_unused_ones_are_not_in_it():
    alone = [learnt(clone(one)).correct(UNSEEN) for one in EVERY_KIND]
    expected = np.einsum("mnj,mj->nj", np.array(alone), np.array(WEIGHTS))
    found = model().correct(UNSEEN)
    np.testing.assert_array_equal(found[:, 0], alone[0][:, 0])
    # Networks that are fitted to one joint are others than those of both.
    np.testing.assert_allclose(found[:, 1], expected[:, 1], rtol=0, atol=5e-3)
    families = [family for family, *_ in model().model.model_params()["members"]]
    assert families == ["polynomial", "network", "network.gru", "stack"]


def test_it_steps_and_is_read_back_with_the_same_bits(tmp_path):
    whole = model().correct(UNSEEN)
    write_calibration(model(), tmp_path / "m.safetensors")
    read = read_calibration(tmp_path / "m.safetensors")
    np.testing.assert_array_equal(read.correct(UNSEEN), whole)
    assert read.model.name == "stack"
    assert good_rows(tmp_path / "m.safetensors", UNSEEN, whole) > 300


@needs_compiler
def test_it_is_printed_to_c_with_the_same_bits(tmp_path):
    library = exported(tmp_path, model())
    assert good_rows_in_c(library, model(), UNSEEN) > 300
    source = (library.folder / "m.c").read_text()
    for row in ("polynomial_row(", "network_row(", "gru_row(", "trees_row("):
        assert source.count(f"static void {row}") >= 1


def test_without_weights_each_member_is_fitted_to_what_is_left():
    X = np.linspace(-1.0, 1.0, 400)[:, None]
    y = 2.0 * X[:, 0] + (X[:, 0] > 0.3)
    steps = Stack((Polynomial(1), DecisionTreeRegressor(max_depth=6))).fit(X, y)
    linear = Polynomial(1).fit(X, y)
    assert np.abs(steps.predict(X) - y).max() < 0.3 < np.abs(linear.predict(X) - y).max()
    np.testing.assert_array_equal(steps.members_[0].predict(X).ravel(), linear.predict(X))


def test_what_has_no_memory_is_fitted_as_it_is_alone():
    """A process that is told of two histories would give each a zero of its own."""
    X = np.linspace(-1.0, 1.0, 400)[:, None]
    y = X[:, 0] ** 2 + np.repeat([0.3, -0.2], 200)
    process, dt = GaussianProcess(points=20), np.where(np.arange(400) % 200 == 0, 0.0, 1.0)
    alone, told = clone(process).fit(X, y), clone(process).fit(X, y, dt=dt)
    both = Stack((process,)).fit(X, y, dt=dt)
    np.testing.assert_array_equal(both.members_[0].weights_, alone.weights_)
    assert np.abs(told.weights_ - alone.weights_).max() > 1e-3


def test_a_seed_goes_to_the_members():
    X = np.random.default_rng(0).normal(size=(400, 2))
    nets = [Stack((NETWORK,), random_state=s).fit(X, X[:, 0]) for s in (3, 3, 4)]
    first, same, other = (net.predict(X[:5]) for net in nets)
    np.testing.assert_array_equal(first, same)
    assert (first != other).all()


@pytest.mark.parametrize(
    ("members", "weights", "said"),
    [
        ((Polynomial(1),), ((1.0, 0.0),), "not all 0 for an output"),
        ((Polynomial(1),), ((1.0, 1.0), (0.0, 1.0)), "for each of 1 members"),
        ((Polynomial(1),), ((float("nan"), 1.0),), "give a finite one"),
        ((Polynomial(1),), "half each", "give a finite one"),
        ((Polynomial(1),) * 2, ((1.0,), (1.0, 1.0)), "give a finite one"),
        ((Polynomial(1),), ((1.0,) * 3,), "are for 3 outputs"),
        ((JawFilter(), ElasticJointFilter()), None, "features of their own"),
        ((SVR(),), None, "cannot run in a loop"),
        ((Polynomial(1),) * 11, None, "1 to 10 members"),
        ((), None, "1 to 10 members"),
    ],
)  # fmt: skip
def test_what_makes_no_combination_is_refused(members, weights, said):
    X = np.random.default_rng(0).normal(size=(60, 2))
    refused(said, Stack(members, weights).fit, X, X)


@pytest.mark.parametrize(
    ("members", "said"),
    [
        ((("polynomial", of_degree(0), (1,)),), "outputs .1.; it must be each of 1"),
        ((("oracle", {}, (0,)),), "oracle"),
        ((("polynomial", {"degree": 3}, (0,)),), "polynomial has parameters"),
        ((("polynomial", of_degree(0), (0, 0)),), "1 to 10 members"),
        ((("polynomial", of_degree(0), ([],)),), "1 to 10 members"),
        ((("polynomial", {}),), "1 to 10 members"),
    ],
)
def test_damaged_members_of_a_file_are_refused(members, said):
    refused(said, Stack.from_data, data(members), 2, 1)


def test_sums_within_sums_have_an_end():
    members = (("polynomial", of_degree(0), (0,)),)
    for depth in range(1, 40):
        assert FAMILY.rules["members"].holds(members) == (depth <= 4)
        members = (("stack", {"members": members}, (0,)),)


def test_other_members_make_another_family_of_it():
    changed = Stack().set_params(members=(MEMORY, "linear"))
    assert changed.family.remembers
    assert changed.family.counts_samples
    assert not Stack().family.remembers
    again = clone(changed).set_params(members=("linear", NETWORK))
    assert not again.family.remembers


def test_names_stay_where_nothing_else_is_known_of_their_members():
    names = ("measured/jaw", "effort/jaw")
    plain, paired = get_estimator("linear_trees"), Stack(("ukf_elastic", "coupled_play"))
    robot = get_robot("davinci_grasper")
    assert plain.for_features(names, robot, ("jaw",)).members == plain.members
    told = paired.for_features(names, robot, ("jaw",))
    assert told.name == "stack"
    assert told.members[1].positions == (0,)


def test_what_a_physical_filter_leaves_is_learnt_from_its_features():
    training = [grasper_recording(seed) for seed in range(3)]
    both = calibrate(training, Stack((ElasticJointFilter(elements=2), Plays())))
    assert both.target == "position"
    physical, learnt = both.model.members_
    assert both.feature_set.names == physical.family.inputs(physical.model_params())
    before = after = 0.0
    for one in training:
        X, dt = both.feature_set.compute(one, both.gap_limit), time_steps(one.t, both.gap_limit)
        truth = one.columns("truth", both.joints)
        filtered = physical.evaluate(X, dt)
        summed = filtered + learnt.evaluate(X, dt)
        np.testing.assert_array_equal(both.model.evaluate(X, dt), summed)
        before, after = before + np.var(filtered - truth), after + np.var(summed - truth)
    assert after < before
    again = class_of("stack").from_data(both.model.data, 2, 1)
    np.testing.assert_array_equal(again.evaluate(X, dt), summed)
