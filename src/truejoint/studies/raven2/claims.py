"""Claims as data: that errors are below others, or hardly above them, by session."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import product
from typing import Any, Final

import numpy as np
from pandas import DataFrame

from truejoint.array_types import Array
from truejoint.studies.raven2.tables import by_session
from truejoint.studies.study import Statement
from truejoint.studies.verdicts import below, whole

Pick = Mapping[str, Any] | tuple[Mapping[str, Any], Mapping[str, Any]] | Callable[..., Array]
"""Errors (k,) by session: columns of their rows, two such whose ratio counts, or a function."""
Pair = tuple[str, Array, Array]
_SHOWN: Final = 4  # pairs at most, of a claim


def errors(rows: Any, pick: Pick, **where: Any) -> Array:
    """Errors (k,) of every session that a `pick` names, in rows that have certain values."""
    if callable(pick):
        return pick(rows, **where)
    if isinstance(pick, tuple):
        above, base = (by_session(rows, **{**where, **one}) for one in pick)
        return above / base
    return by_session(rows, **{**where, **pick})


def ordered(text: str, source: str, low: Pick, high: Pick, **each: Sequence[Any]) -> Statement:
    """Claim that one error is below another, for each combination of some columns' values.

    Parameters
    ----------
    text, source : str
        What is claimed, and where.
    low, high
        Both errors.
    **each
        Columns that both have in common with their values, in the order of a pair's name.
    """

    def judge(rows: DataFrame) -> tuple[bool | None, str]:
        pairs = _pairs(rows, low, high, each)
        return whole(*(below(a, b) for _, a, b in pairs)), _texts(pairs, 1.0)

    return Statement(text, source, judge)


def not_worse(
    share: float, text: str, source: str, first: Pick, second: Pick, **each: Sequence[Any]
) -> Statement:
    """Claim that a second error is above the first by at most a share of it; see `ordered`."""

    def judge(rows: DataFrame) -> tuple[bool | None, str]:
        pairs = _pairs(rows, first, second, each)
        near = [float(b.mean()) <= (1.0 + share) * float(a.mean()) for _, a, b in pairs]
        return all(near), f"{_texts(pairs, -1.0)} (up to {100 * share:g} % more counts as none)"

    return Statement(text, source, judge)


def _pairs(rows: DataFrame, low: Pick, high: Pick, each: Mapping[str, Sequence[Any]]) -> list[Pair]:
    pairs = []
    for key in product(*each.values()):
        where = dict(zip(each, key, strict=True))
        varied = [str(value) for column, value in where.items() if len(each[column]) > 1]
        name = ", ".join(varied or map(str, key))
        pairs.append((name, errors(rows, low, **where), errors(rows, high, **where)))
    return pairs


def _texts(pairs: list[Pair], sign: float) -> str:
    """Errors of the pairs; of more than `_SHOWN` those with the least `sign` times their ratio."""
    nearest = sorted(pairs, key=lambda pair: sign * float(np.mean(pair[2]) / np.mean(pair[1])))
    shown = pairs if len(pairs) <= _SHOWN else nearest[:_SHOWN]
    text = "; ".join(f"{n}: {np.mean(a):.3f} against {np.mean(b):.3f}" for n, a, b in shown)
    return text if shown is pairs else f"{text} ({len(pairs)} pairs, these the nearest)"
