from __future__ import annotations

import numpy as np
import pytest
from pandas import DataFrame
from scipy import stats

from truejoint.studies.raven2 import claims
from truejoint.studies.raven2.claims import SINGLE, below, whole


def rows(low, high):
    """Rows of two methods, with an error for each session, by joint."""
    return DataFrame(
        [
            {"joint": joint, "session": n, "method": method, "rmse": rmse}
            for joint, pair in zip(low, zip(low.values(), high.values(), strict=True), strict=True)
            for method, errors in zip(("a", "b"), pair, strict=True)
            for n, rmse in enumerate(errors)
        ]
    )


def ordered(joints):
    return claims.ordered("order", "paper", {"method": "a"}, {"method": "b"}, joint=tuple(joints))


@pytest.mark.parametrize(
    ("high", "verdict"),
    [
        ({"x": [2.0], "y": [2.0]}, "agrees"),
        ({"x": [2.0], "y": [1.01]}, "cannot be told"),
        ({"x": [2.0], "y": [0.5]}, "does not agree"),
    ],
)
def test_an_order_holds_only_where_every_pair_tells_it(high, verdict):
    low = {"x": [1.0], "y": [1.0]}
    assert ordered(low).judged(rows(low, high)).verdict == verdict


@pytest.mark.parametrize(("after", "holds"), [(1.09, True), (0.5, True), (1.11, False)])
def test_an_error_is_no_worse_where_it_grows_by_no_more_than_a_share(after, holds):
    claim = claims.not_worse(0.1, "kept", "paper", {"method": "a"}, {"method": "b"}, joint=("x",))
    assert claim.judged(rows({"x": [1.0]}, {"x": [after]})).holds is holds


def test_ratios_and_functions_are_errors_too():
    found = rows({"x": [1.0, 2.0]}, {"x": [4.0, 4.0]})
    share = {"method": "a"}, {"method": "b"}
    assert claims.errors(found, share, joint="x").tolist() == [0.25, 0.5]
    assert claims.errors(found, lambda own, joint: own.rmse[:1], joint="x").tolist() == [1.0]


def test_of_many_pairs_those_that_decide_are_told():
    low = {f"p{k}": [1.0] for k in range(9)}
    found = rows(low, {f"p{k}": [2.0 + k] for k in range(9)})
    claim = ordered(low).judged(found, "specimen Q")
    assert "p0: 1.000 against 2.000" in claim.found
    assert "p8" not in claim.found
    assert "9 pairs" in claim.found
    assert claim.on == "specimen Q"
    both = {"method": "a"}, {"method": "b"}
    claim = claims.not_worse(0.1, "kept", "paper", *both, joint=tuple(low)).judged(found)
    assert "p8: 1.000 against 10.000" in claim.found


@pytest.mark.parametrize("seed", range(20))
def test_sessions_are_told_apart_as_by_a_paired_t_test(seed):
    rng = np.random.default_rng(seed)
    low = rng.normal(1.0, 0.1, 6)
    high = low + rng.normal(0.1, 0.12, 6)
    told = stats.ttest_rel(low, high).pvalue < 0.05
    assert below(low, high) == ((high.mean() > low.mean()) if told else None)


def test_one_session_tells_what_differs_by_more_than_a_share():
    assert below([1.0], [1.0 + 0.9 * SINGLE]) is None
    assert below([1.0], [1.0 + 1.2 * SINGLE]) is True
    assert below([1.0 + 1.2 * SINGLE], [1.0]) is False


def test_of_several_one_that_fails_decides():
    assert whole(True, True) is True
    assert whole(True, None) is None
    assert whole(None, False, True) is False
