"""Which model is named to be deployed."""

from typing import Any

import numpy as np
import pytest

from truejoint.evaluation.paired_test import compare
from truejoint.evaluation.verdict import PLAIN, to_deploy

NOISE = np.random.default_rng(0).normal(size=(5, 2, 800, 1))


def _trace(row: int, **sizes: float) -> Any:
    class Curves:
        t = np.arange(800.0)
        inside = np.arange(800) % 10 > 0
        estimates = sizes

        def error(self, name: str) -> np.ndarray:
            own = sizes[name] * NOISE[list(sizes).index(name), row]
            own[::10] = 0.0 if name == "dnn" else 100.0  # rows that the loop refuses
            return own

    return Curves()


@pytest.mark.parametrize(
    ("sizes", "deploy"),
    [
        ({"raw": 3.0, "offset": 1.0, "linear": 0.5, "dnn": 0.3}, "dnn"),
        ({"raw": 3.0, "offset": 1.0, "linear": 0.5, "dnn": 0.49}, "linear"),
        ({"raw": 0.3, "offset": 1.0, "linear": 0.5, "dnn": 0.4}, "raw"),
        ({"raw": 3.0, "offset": 1.0, "mine": 0.5, "dnn": 0.3}, "dnn"),
    ],
)
def test_the_simple_one_unless_a_richer_one_is_better_beyond_chance(
    sizes: dict[str, float], deploy: str
) -> None:
    traces = [_trace(row, **sizes) for row in range(2)]
    assert to_deploy(traces, PLAIN | {"mine"}) == deploy


def test_tests_count_together() -> None:
    good, bad = {"raw": 2.0, "offset": 1.0, "dnn": 0.5}, {"raw": 2.0, "offset": 1.0, "dnn": 4.0}
    assert to_deploy([_trace(0, **good)]) == "dnn"
    assert to_deploy([_trace(0, **good), _trace(1, **bad)]) == "offset"


def test_a_model_too_erratic_to_be_beaten_is_not_named() -> None:
    steady = {"raw": 3.0, "offset": 1.0, "linear": 0.5, "poly2": 0.4, "dnn": 0.3}
    assert to_deploy([_trace(0, **steady), _trace(1, **(steady | {"poly2": 4.0}))]) == "dnn"


def test_one_that_is_better_in_each_test_need_not_be_so_by_as_much_in_each() -> None:
    """A few tests that differ would else say less together than each of them does."""
    sizes = {"raw": 9.0, "offset": 9.0, "linear": 0.5, "dnn": 0.45}
    traces = [_trace(row, **(sizes | {"linear": own})) for row, own in enumerate((0.6, 5.0))]
    errors = [[t.error(name)[t.inside] for t in traces] for name in ("dnn", "linear")]
    assert compare(*errors).outcome == "cannot be told", "the case shows nothing"
    assert to_deploy(traces) == "dnn"
    worse = _trace(0, **(sizes | {"linear": 0.4}))
    assert to_deploy([worse, traces[1]]) == "linear"
