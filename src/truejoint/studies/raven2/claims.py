"""Claims as data: that errors are below others, or hardly above them, by session."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import product
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike
from pandas import DataFrame
from scipy import stats

from truejoint.array_types import Array
from truejoint.studies.raven2.tables import by_session
from truejoint.studies.study import Statement

Verdict = tuple[bool | None, str]
"""Whether a claim holds, None where it is not told, and what was found."""
Pick = Mapping[str, Any] | tuple[Mapping[str, Any], Mapping[str, Any]] | Callable[..., Array]
"""Errors (k,) by session: columns of their rows, two such whose ratio counts, or a function."""
Pair = tuple[str, Array, Array]
SINGLE: Final = 0.05
"""Share by which two errors of one session must differ."""
_LEVEL: Final = 0.95  # at which a difference between sessions is told
_SHOWN: Final = 4  # pairs at most, of a claim
RULE: Final = (
    f"A difference counts as told at {100 * _LEVEL:.0f} % by Student's t over the sessions; where "
    f"there is one session, from {100 * SINGLE:.0f} % on."
)


def below(lower: ArrayLike, higher: ArrayLike) -> bool | None:
    """Whether errors (k,) are below others (k,), a pair a session; None where it is not told.

    >>> below([1.0, 1.1, 0.9], [2.0, 2.2, 2.1]), below([1.0, 3.0], [2.0, 2.2]), below([2.0], [1.0])
    (True, None, False)
    """
    low, high = np.asarray(lower, float), np.asarray(higher, float)
    difference = high - low
    mean, count = float(difference.mean()), difference.size
    least = SINGLE * float(max(low.mean(), high.mean()))
    if count > 1:
        deviation = float(difference.std(ddof=1)) / np.sqrt(count)
        least = float(stats.t.ppf((1.0 + _LEVEL) / 2.0, count - 1)) * deviation
    return mean > 0.0 if abs(mean) > least else None


def whole(*verdicts: bool | None) -> bool | None:
    """Verdict on all of several: False if one is, else None if one is, else True.

    >>> whole(True, None, False), whole(True, None), whole(True, True)
    (False, None, True)
    """
    return False if False in verdicts else None if None in verdicts else True


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

    def judge(rows: DataFrame) -> Verdict:
        pairs = _pairs(rows, low, high, each)
        return whole(*(below(a, b) for _, a, b in pairs)), _texts(pairs, 1.0)

    return Statement(text, source, judge)


def not_worse(
    share: float, text: str, source: str, first: Pick, second: Pick, **each: Sequence[Any]
) -> Statement:
    """Claim that a second error is above the first by at most a share of it; see `ordered`."""

    def judge(rows: DataFrame) -> Verdict:
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
