import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from truejoint.errors import CalibrationError
from truejoint.evaluation.judge import percent_of, rmse, tool_error
from truejoint.robots import get_robot

_errors = hnp.arrays(
    np.float64,
    hnp.array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=30),
    elements=st.floats(-1e3, 1e3),
)


@given(_errors)
def test_metrics_agree_with_sums_written_out(error: np.ndarray) -> None:
    n, k = error.shape
    for j in range(k):
        column = [float(v) for v in error[:, j]]
        root = math.sqrt(math.fsum(v * v for v in column) / n)
        assert rmse(error)[j] == pytest.approx(root, rel=1e-9, abs=1e-12)


def test_percent_is_of_the_offset_and_nan_where_that_is_zero() -> None:
    percent = percent_of([0.104, 1.0], [0.859, 0.0])
    assert percent[0] == pytest.approx(12.107, abs=1e-3)
    assert np.isnan(percent[1])


@pytest.mark.parametrize("bad", [np.empty((0, 2)), np.empty(0), np.float64(1.0)])
def test_nothing_to_average_is_refused(bad: np.ndarray) -> None:
    with pytest.raises(CalibrationError, match="no row"):
        rmse(bad)


def test_a_value_that_is_not_finite_is_refused() -> None:
    with pytest.raises(CalibrationError, match="not finite"):
        rmse([0.0, math.nan])


def test_an_error_of_the_insertion_moves_the_tool_by_as_much() -> None:
    robot = get_robot("raven2")
    assert robot.kinematics is not None
    true = np.tile(robot.home, (3, 1))
    estimated = true.copy()
    estimated[:, robot.index(["insertion"])] += np.array([[0.0], [1e-3], [-2e-3]])
    distance = np.linalg.norm(tool_error(robot.kinematics, estimated, true), axis=1)
    np.testing.assert_allclose(distance, [0.0, 1e-3, 2e-3], atol=1e-12)
