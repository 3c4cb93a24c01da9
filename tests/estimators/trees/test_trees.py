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


def test_a_tree_of_one_output_leaves_the_others_alone():
    found = predict(data(output=[-1, 0]), [[1.0, 1.0], [0.0, 0.0]])
    np.testing.assert_array_equal(found, [[10.5, 20], [15.5, 20]])


def test_features_are_scaled_first():
    moved = data(mean=[1.0, 0.0], scale=[0.5, 1.0])
    np.testing.assert_array_equal(predict(moved, [[1.5, 1.0], [1.6, 1.0]])[:, 0], [10.5, 30.5])


def test_many_trees_of_all_depths_sum_to_what_each_gives():
    """Every row, walked through one node after the other as the arrays of a file say."""
    rng = np.random.default_rng(0)
    arrays: dict[str, list[float]] = {name: [] for name in ("root", "feature", "threshold")}
    right, value = list[float](), list[float]()

    def grow(levels: int) -> None:
        at = len(right)
        arrays["feature"].append(-1.0 if levels == 0 else rng.integers(3))
        arrays["threshold"].append(0.0 if levels == 0 else rng.normal())
        right.append(0.0)
        if levels == 0:
            right[at] = len(value)
            value.append(rng.normal())
        else:
            grow(rng.integers(levels))
            right[at] = len(right)
            grow(levels - 1)

    n_trees = 21
    for _ in range(n_trees):
        arrays["root"].append(len(right))
        grow(int(rng.integers(9)))
    output = rng.integers(2, size=n_trees)
    X = rng.normal(size=(50, 3))
    expected = np.zeros((50, 2))
    for row, x in enumerate(X):
        for root, column in zip(arrays["root"], output, strict=True):
            node = int(root)
            while arrays["feature"][node] >= 0:
                goes_right = x[int(arrays["feature"][node])] > arrays["threshold"][node]
                node = int(right[node]) if goes_right else node + 1
            expected[row, column] += value[int(right[node])]
    params = {"n_trees": n_trees, "n_nodes": len(right), "n_values": len(value)}
    plain = {"mean": np.zeros(3), "scale": np.ones(3), "offset": np.zeros(2)}
    grown = arrays | {"output": output, "right": right, "value": value}
    numbers = {name: np.array(v, dtype=float) for name, v in grown.items()}
    forest = EstimatorData("trees", params, plain | numbers)
    FAMILY.check(forest, 3, 2)
    found = evaluate(FAMILY, FAMILY.memory(forest, 3, 2), X, np.zeros(50), 2)
    np.testing.assert_allclose(found, expected, atol=1e-13)


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


@given(
    st.sampled_from(sorted(ARRAYS)),
    st.integers(0, 7),
    st.sampled_from([-1.0, 0.0, 1.0, 2.0, 5.0, 7.0, 8.0, 1e18, -1e300, 1e300, 0.5, np.nan, np.inf]),
    st.lists(st.tuples(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6)), min_size=1, max_size=4),
)
def test_damaged_arrays_are_refused_or_predict(name, place, number, X):
    values = list(ARRAYS[name])
    values[place % len(values)] = number
    try:
        found = predict(data(**{name: values}), X)
    except CalibrationError as error:
        assert "\n" not in str(error)  # noqa: PT017
    else:
        assert found.shape == (len(X), 2)


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
