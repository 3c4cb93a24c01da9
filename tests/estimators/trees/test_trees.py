"""Trees as arrays: what they predict, and which arrays are no trees."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.refusals import refused

from truejoint.errors import CalibrationError
from truejoint.estimators.family import EstimatorData, evaluate, find_family
from truejoint.estimators.trees.run import FAMILY

# x0 <= 1: 10 and 20; else x1 <= 2: 30 and 40, or 50 and 60; then 5 more for output 1 if x1 <= 0.
ARRAYS = {
    "mean": [0.0, 0.0],
    "scale": [1.0, 1.0],
    "offset": [0.5, 0.0],
    "root": [0, 5],
    "output": [-1, 1],
    "feature": [0, -1, 1, -1, -1, 1, -1, -1],
    "threshold": [1.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    "right": [2, 0, 4, 2, 4, 7, 6, 7],
    "value": [10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 5.0, 0.0],
}
PARAMS = {"n_trees": 2, "n_nodes": 8, "n_values": 8}


def data(**changed) -> EstimatorData:
    arrays = {name: np.array(v, dtype=float) for name, v in (ARRAYS | changed).items()}
    return EstimatorData("trees", PARAMS, arrays)


def predict(trees: EstimatorData, X) -> np.ndarray:
    FAMILY.check(trees, 2, 2)
    memory = FAMILY.memory(trees, 2, 2)
    return evaluate(FAMILY, memory, np.array(X, dtype=float), np.zeros(len(X)), 2)


def test_the_row_adds_the_leaves_that_it_reaches():
    assert find_family("trees") is FAMILY
    found = predict(data(), [[1.0, 1.0], [1.1, 2.0], [9.0, 2.1], [0.0, 0.0]])
    np.testing.assert_array_equal(found, [[10.5, 20], [30.5, 40], [50.5, 60], [10.5, 25]])
    alone = predict(data(output=[-1, 0]), [[1.0, 1.0], [0.0, 0.0]])  # the second tree's output
    np.testing.assert_array_equal(alone, [[10.5, 20], [15.5, 20]])
    moved = data(mean=[1.0, 0.0], scale=[0.5, 1.0])
    np.testing.assert_array_equal(predict(moved, [[1.5, 1.0], [1.6, 1.0]])[:, 0], [10.5, 30.5])


@pytest.mark.parametrize(
    "changed",
    [
        {"right": [0, 0, 4, 2, 4, 7, 6, 7]},  # back to the root
        {"right": [1, 0, 4, 2, 4, 7, 6, 7]},  # both ways to one node
        {"right": [5, 0, 4, 2, 4, 7, 6, 7]},  # into the next tree
        {"right": [2, 7, 4, 2, 4, 7, 6, 7]},  # past the last value
        {"right": [2, -1, 4, 2, 4, 7, 6, 7]},
        {"feature": [2, -1, 1, -1, -1, 1, -1, -1]},
        {"feature": [-2, -1, 1, -1, -1, 1, -1, -1]},
        {"feature": [0.5, -1, 1, -1, -1, 1, -1, -1]},
        {"feature": [0, -1, 1, -1, 0, 1, -1, -1]},  # a tree ends without a leaf
        {"root": [0, 0]},
        {"root": [1, 5]},
        {"root": [0, 8]},
        {"output": [-1, 2]},
        {"scale": [1.0, 0.0]},
    ],
)
def test_arrays_that_are_no_trees_are_refused(changed):
    refused("trees", predict, data(**changed), [[0.0, 0.0]])


@given(st.data())
def test_random_arrays_never_lead_astray(draw):
    whole = st.integers(-2, 9).map(float)
    changed = {
        name: draw.draw(st.lists(whole, min_size=n, max_size=n))
        for name, n in {"root": 2, "output": 2, "feature": 8, "right": 8}.items()
        if draw.draw(st.booleans())
    }
    try:
        found = predict(data(**changed), [[0.0, 0.0], [5.0, 5.0]])
    except CalibrationError:
        return
    values = np.array([0.0, *ARRAYS["value"]])
    assert np.isin(found[:, 0] - 0.5, values[:, None] + values).all()
