"""An estimator on some features, held to the range of its training, alone and in a mean."""

from functools import cache

import numpy as np
import pytest
from sklearn.svm import SVR
from tests.estimators.motor_side.test_motor_side import recording as grasper
from tests.export.library import exported, needs_compiler
from tests.export.library import good_rows as good_rows_in_c
from tests.refusals import refused
from tests.runtime.registered import good_rows

from truejoint.calibration import Calibration, calibrate, read_calibration, write_calibration
from truejoint.errors import CalibrationError
from truejoint.estimators import ElasticJointFilter, Plays, Polynomial, Stack
from truejoint.estimators.family import EstimatorData
from truejoint.estimators.stack.run import FAMILY

FEATURES = ("measured/jaw", "driver/jaw", "effort/jaw")
MEMBERS = ElasticJointFilter(elements=1), Plays(rows=2000)


@cache
def mean() -> Calibration:
    """Half a filter at the motor's side, half plays on measured positions."""
    recordings = [grasper(seed) for seed in range(3)]
    both = Stack(MEMBERS, ((0.5,), (0.5,)), sees=((1, 2), (0, 2)), beside=((), (0,)))
    return calibrate(recordings, both, features=FEATURES, target="position", fit_rate=20.0)


@pytest.mark.parametrize("member", [Polynomial(2), SVR(C=5.0)])
def test_within_the_range_it_is_its_member_and_beyond_a_straight_line(member):
    X = np.random.default_rng(0).uniform(-1.0, 1.0, (400, 3))
    y = 2.0 * X[:, 2] + X[:, 0] ** 2
    bounded = Stack((member,), sees=((2, 0),)).fit(X, y)
    (alone,) = bounded.members_
    inside = 0.9 * X[:50]
    np.testing.assert_allclose(
        bounded.predict(inside), alone.predict(inside[:, [2, 0]]).ravel(), rtol=0, atol=1e-12
    )
    beyond = np.zeros((3, 3))
    beyond[:, 0] = 2.0, 3.0, 4.0
    first, second = np.diff(bounded.predict(beyond))
    assert first == pytest.approx(second)
    assert abs(first) < 0.3  # the slope of the linear model, not that of the parabola
    beyond[:, 1] = 1e3  # is not seen
    assert np.ptp(np.diff(bounded.predict(beyond))) < 1e-9


def test_a_filter_on_signals_of_its_own_and_others_stand_in_one_mean(tmp_path):
    recordings, unseen = [grasper(seed) for seed in range(3)], grasper(9)
    assert mean().model.family.inputs is None
    assert not mean().counts_samples
    alone = [
        calibrate(recordings, member, features=features, target="position", fit_rate=20.0)
        for member, features in (
            (ElasticJointFilter(elements=1), FEATURES[1:]),
            (Stack(MEMBERS[1:], sees=((0, 1),), beside=((0,),)), ("measured/jaw", "effort/jaw")),
        )
    ]
    expected = np.mean([one.correct(unseen) for one in alone], axis=0)
    np.testing.assert_allclose(mean().correct(unseen), expected, rtol=0, atol=1e-9)
    path = tmp_path / "m.safetensors"
    write_calibration(mean(), path)
    read = read_calibration(path)
    np.testing.assert_array_equal(read.correct(unseen), mean().correct(unseen))
    assert good_rows(path, unseen, mean().correct(unseen), most=300) == 300


@needs_compiler
def test_the_mean_is_printed_to_c_with_the_same_bits(tmp_path):
    assert good_rows_in_c(exported(tmp_path, mean()), mean(), grasper(9)) > 300


@pytest.mark.parametrize(("columns", "said"), [
    ((), "1 to 1000 different places"), ((0, 0), "different places"),
    ((7,), "has place 7; there are 3 features"), ("x", "different places"),
])  # fmt: skip
def test_wrong_places_are_refused(columns, said):
    X, y = np.arange(60.0).reshape(20, 3), np.arange(20.0)
    fitted = Stack((Polynomial(1),), sees=((0,),)).fit(X, y)
    params = {**fitted.model_params(), "columns": (columns,)}
    refused(said, FAMILY.check, EstimatorData("stack", params, fitted.arrays_), 3, 1)


@pytest.mark.parametrize(("given", "said"), [
    ({"sees": ((0,),)}, "for other members than its 2"),
    ({"beside": ((), ())}, "for other members than its 2"),
    ({"sees": ((0,), (3,)), "weights": ((0.5,), (0.5,))}, "has place 3; there are 3 features"),
    ({"sees": ((0,), (1,))}, "takes weights"), ({"sees": (0, 1)}, "different places"),
])  # fmt: skip
def test_what_members_cannot_see_is_refused(given, said):
    refused(
        said, Stack(("linear", "poly2"), **given).fit, np.eye(3)[[0, 1, 2] * 9], np.arange(27.0)
    )


def test_what_only_works_offline_stands_alone_and_is_kept_in_no_file():
    X = np.random.default_rng(0).uniform(-1.0, 1.0, (60, 2))
    alone = Stack((SVR(),), sees=((0, 1),)).fit(X, X[:, 0])
    with pytest.raises(CalibrationError, match=r"SVR is run by scikit-learn .* model file cannot"):
        _ = alone.data
    with pytest.raises(CalibrationError, match="cannot run in a loop"):
        Stack((SVR(), "linear"), ((0.5,), (0.5,)), sees=((0,), (0, 1))).fit(X, X[:, 0])
