"""Claims as data: that errors are below others, or hardly above them, by session."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import product
from typing import Any

from pandas import DataFrame

from truejoint.array_types import Array
from truejoint.studies.claim_tests import below_all, pair_texts
from truejoint.studies.raven2.tables import by_session
from truejoint.studies.study import Holds, Statement

Verdict = tuple[Holds, str]
"""Whether a claim holds, None where it is not told, and what was found."""
Pick = Mapping[str, Any] | tuple[Mapping[str, Any], Mapping[str, Any]] | Callable[..., Array]
"""Errors (k,) by session: columns of their rows, two such whose ratio counts, or a function."""
Pair = tuple[str, Array, Array]


def errors(rows: Any, pick: Pick, **where: Any) -> Array:
    """Errors (k,) of every session that a `pick` names, in rows that have certain values."""
    if callable(pick):
        return pick(rows, **where)
    if isinstance(pick, tuple):
        above, base = (by_session(rows, **{**where, **one}) for one in pick)
        return above / base
    return by_session(rows, **{**where, **pick})


def ordered(
    text: str, source: str, low: Pick, high: Pick, *, flaw: bool = False, **each: Sequence[Any]
) -> Statement:
    """Claim that one error is below another, for each combination of some columns' values.

    Parameters
    ----------
    text, source : str
        What is claimed, and where.
    low, high
        Both errors.
    flaw : bool
        As for a `Claim`.
    **each
        Columns that both have in common with their values, in the order of a pair's name.
    """

    def judge(rows: DataFrame) -> Verdict:
        pairs = _pairs(rows, low, high, each)
        return below_all([(a, b) for _, a, b in pairs]), pair_texts(pairs)

    return Statement(text, source, judge, flaw)


def not_worse(
    share: float, text: str, source: str, first: Pick, second: Pick, **each: Sequence[Any]
) -> Statement:
    """Claim that a second error is above the first by at most a share of it; see `ordered`."""

    def judge(rows: DataFrame) -> Verdict:
        pairs = _pairs(rows, first, second, each)
        allowed = 1.0 + share
        holds = below_all([(b, allowed * a) for _, a, b in pairs])
        return holds, f"{pair_texts(pairs, allowed)} (up to {100 * share:g} % more counts as none)"

    return Statement(text, source, judge)


def _pairs(rows: DataFrame, low: Pick, high: Pick, each: Mapping[str, Sequence[Any]]) -> list[Pair]:
    pairs = []
    for key in product(*each.values()):
        where = dict(zip(each, key, strict=True))
        varied = [str(value) for column, value in where.items() if len(each[column]) > 1]
        name = ", ".join(varied or map(str, key))
        pairs.append((name, errors(rows, low, **where), errors(rows, high, **where)))
    return pairs
