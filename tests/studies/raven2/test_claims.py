import numpy as np
import pytest
from pandas import DataFrame
from scipy import stats

from truejoint.studies import claim_tests as claims
from truejoint.studies.claim_tests import (
    about,
    against,
    below,
    below_all,
    matches,
    mostly,
    scatters_more,
    whole,
)
from truejoint.studies.study import Statement


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
    return Statement("order", "paper", judge=claims.ordered(A, B, {"joint": tuple(joints)}))


A, B = {"method": "a"}, {"method": "b"}
NEAR = np.array([0.99, 1.0, 1.01])


@pytest.mark.parametrize(
    ("high", "verdict"),
    [
        ({"x": 2.0 * NEAR, "y": 2.0 * NEAR}, "holds"),
        ({"x": 2.0 * NEAR, "y": 1.001 * NEAR[::-1]}, "cannot be told"),
        ({"x": 2.0 * NEAR, "y": 0.5 * NEAR}, "does not"),
    ],
)
def test_an_order_holds_only_where_every_pair_tells_it(high, verdict):
    low = {"x": NEAR, "y": NEAR}
    claim = ordered(low).judged(rows(low, high))
    assert claim.verdict == verdict
    assert ("the other way in" in claim.found) == (verdict != "holds")
    once = {joint: values[:1] for joint, values in high.items()}
    assert ordered(low).judged(rows({j: [1.0] for j in low}, once)).verdict == "cannot be told"


@pytest.mark.parametrize(("after", "holds"), [(1.04, True), (0.5, True), (1.3, False), (1.1, None)])
def test_an_error_is_no_worse_where_it_grows_by_no_more_than_a_share(after, holds):
    claim = Statement("kept", "paper", judge=claims.ordered(A, B, {"joint": ("x",)}, 0.1))
    found = claim.judged(rows({"x": NEAR}, {"x": after * NEAR[::-1]}))
    assert found.holds is holds
    assert ("the other way in" in found.found) == (holds is not True)


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
    _, text = claims.ordered(A, B, {"joint": tuple(low)}, 0.1)(found)
    assert "p8: 1.000 against 10.000" in text


@pytest.mark.parametrize("seed", range(20))
def test_sessions_are_told_apart_as_by_a_paired_t_test(seed):
    rng = np.random.default_rng(seed)
    low = rng.normal(1.0, 0.1, 6)
    high = low + rng.normal(0.1, 0.12, 6)
    told = stats.ttest_rel(low, high).pvalue < 0.05
    assert below(low, high) == ((high.mean() > low.mean()) if told else None)


def test_a_test_among_many_refutes_at_a_level_that_is_shared():
    """Of ten comparisons of equal errors one would else refute a claim in two of five studies."""
    rng = np.random.default_rng(0)
    refuted = sum(
        below_all([(rng.normal(size=5), rng.normal(size=5)) for _ in range(10)]) is False
        for _ in range(400)
    )
    assert refuted <= 20  # 2.5 % are expected
    assert below([1.0], 2.0) is below([2.0], 1.0) is None, "one repetition tells nothing"


def test_ranges_shares_and_scatter_are_told():
    assert about(0.5 * NEAR, 0.44, 0.64) is True
    assert about(0.9 * NEAR, 0.44, 0.64) == "more"
    assert about(0.1 * NEAR, 0.44, 0.64) is False
    assert about(0.64 * NEAR, 0.44, 0.64) is None
    assert [mostly(k, 20) for k in (20, 16, 12, 4)] == [True, True, None, False]
    assert mostly(2, 2) is None
    rng = np.random.default_rng(1)
    told = [scatters_more(rng.normal(size=6), [rng.normal(size=6)]) for _ in range(400)]
    assert told.count(None) >= 370  # 5 % are expected to be told
    assert against([1.0, 2.0], 3.0) == ""


@pytest.mark.parametrize(
    ("sizes", "verdict"),
    [
        ((1.2, 0.8), True),
        ((1.2, 0.5), "more"),  # smaller than printed is better
        ((1.2, 1.7), False),
        ((1.2, 1.5), None),
        ((1.7, 0.5), False),
    ],
)
def test_errors_are_as_printed_within_a_factor_and_smaller_ones_are_better(sizes, verdict):
    pairs = [(str(size), size * NEAR, 1.0) for size in sizes]
    holds, text = matches(pairs)
    assert holds == verdict
    assert "the farthest of 2" in text
    assert f"{sum(1 / 1.5 <= size <= 1.5 for size in sizes)} within a factor 1.5" in text
    assert matches([("once", [1.0], 1.0)])[0] is None


def test_a_claim_says_its_number_its_test_its_level_and_how_often_it_was_tried():
    claim = Statement("order", "paper", number="P7", judge=claims.ordered(A, B, {}))
    judged = claim.judged(rows({"x": NEAR}, {"x": 2.0 * NEAR}))
    assert (judged.number, judged.test) == ("P7", "Student's t at 95 %, n = 3")


def test_of_several_one_that_fails_decides():
    assert whole(True, True) is True
    assert whole(True, "more") == "more"
    assert whole(None, "more") is None
    assert whole(True, None) is None
    assert whole(None, False, True) is False
