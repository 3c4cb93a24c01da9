from __future__ import annotations

import pytest

from truejoint.estimators.registry import estimator_names
from truejoint.studies.table import _rows, reported


@pytest.mark.parametrize(
    ("table", "condition", "method", "metric", "value"),
    [
        ("2", "trajectory 28", "lsm", "max", 1.45),
        ("2", "trajectory 28", "lsm_compensated", "rms", 0.26),
        ("2", "trajectory 28", "ukf_compensated", "min", -0.44),
        ("figure 6", "trajectory 27", "ukf_compensated", "rms", 0.06),
        ("3", "load=200g phase IV", "ukf_compensated", "rms", 0.40),
        ("3", "load=30g phase II", "ukf_compensated", "rms", 0.15),
        ("3", "load=250g phase I", "ukf_compensated", "max", 0.33),
    ],
)
def test_the_numbers_are_the_papers(table, condition, method, metric, value):
    assert reported("yan2020", table, condition, method)[metric] == value


def test_what_is_not_printed_is_empty():
    assert reported("yan2020", "2", "trajectory 28", "play_gated") == {}


def test_methods_are_named_as_our_estimators():
    assert {method for _, _, _, method in _rows()} <= set(estimator_names())
