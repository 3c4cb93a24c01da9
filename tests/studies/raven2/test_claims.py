from __future__ import annotations

import pytest
from pandas import DataFrame

from truejoint.studies.raven2 import claims


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
