from __future__ import annotations

import numpy as np

from truejoint.studies.raven2 import claims


def pair(low, high):
    return "it", lambda _: np.array(low), lambda _: np.array(high)


def test_an_order_holds_only_where_every_pair_tells_it():
    def verdict(*pairs):
        return claims.ordered("order", "paper", *pairs).judged(None).verdict

    clear, reverse, close = pair([1.0], [2.0]), pair([2.0], [1.0]), pair([1.0], [1.01])
    assert verdict(clear, clear) == "agrees"
    assert verdict(clear, close) == "cannot be told"
    assert verdict(clear, close, reverse) == "does not agree"


def test_an_error_is_kept_where_it_grows_by_no_more_than_a_share():
    def holds(before, after):
        return claims.kept("kept", "paper", 0.1, pair([before], [after])).judged(None).holds

    assert holds(1.0, 1.09)
    assert holds(1.0, 0.5)  # better is no loss
    assert not holds(1.0, 1.11)


def test_of_many_pairs_those_that_decide_are_told():
    pairs = [(f"p{k}", lambda _: np.ones(1), lambda _, k=k: np.full(1, 2.0 + k)) for k in range(9)]
    found = claims.ordered("order", "paper", *pairs).judged(None, "specimen Q")
    assert "p0: 1.000 against 2.000" in found.found
    assert "p8" not in found.found
    assert "9 pairs" in found.found
    assert found.on == "specimen Q"
    assert (
        "p8: 1.000 against 10.000" in claims.kept("kept", "paper", 0.1, *pairs).judged(None).found
    )
