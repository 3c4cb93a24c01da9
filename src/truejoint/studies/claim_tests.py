"""Claims as data, and the tests behind every verdict: errors of repetitions beside others, at 95 %.

A `Pick` names errors (k,) by session: columns of their rows, two such whose ratio counts, a limit
for every session, or a function.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from itertools import product
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike
from pandas import DataFrame
from scipy import stats

from truejoint.array_types import Array
from truejoint.studies.rows import select
from truejoint.studies.study import CLAIMS, LEVEL, Claim, Holds, Statement

Verdict = tuple[Holds, str]
"""Whether a claim holds, None where it is not told, and what was found."""
Judge = Callable[[DataFrame], Verdict]
Pick = Mapping[str, Any] | Sequence[Mapping[str, Any]] | float | Callable[..., Array]

NEAR: Final = 1.5
"""Factor within which an error is as a paper prints it."""
RULE: Final = (
    f"A claim holds, or does not, at {100 * LEVEL:.0f} % by Student's t over the repetitions. "
    "If one of its comparisons speaks against it, the level is shared among all of them. One "
    "repetition tells nothing."
)
_SHOWN: Final = 4  # comparisons at most that a text gives


def below(lower: ArrayLike, higher: ArrayLike, among: int = 1) -> bool | None:
    """Whether values (k,) are below others, or a limit, in k repetitions; None if not told.

    That they are not is told at the level shared `among` so many comparisons (Bonferroni), as one
    that is told so refutes a claim on all.
    """
    difference = np.subtract(higher, lower, dtype=float)
    if difference.size < 2:
        return None
    mean, count = float(difference.mean()), difference.size
    holds = mean > 0.0
    level = LEVEL if holds else 1.0 - (1.0 - LEVEL) / among
    quantile = float(stats.t.ppf(0.5 + 0.5 * level, count - 1))
    told = abs(mean) > quantile * float(difference.std(ddof=1)) / np.sqrt(count)
    return holds if told else None


def below_all(pairs: Sequence[tuple[ArrayLike, ArrayLike]]) -> Holds:
    """Whether the first of every pair is `below` the second."""
    return whole(*(below(low, high, len(pairs)) for low, high in pairs))


def whole(*verdicts: Holds) -> Holds:
    """Verdict on all of several: False if one is, else None, else "more" if one is, else True."""
    order: tuple[Holds, ...] = (False, None, "more")
    return next((one for one in order if one in verdicts), True)


def about(values: ArrayLike, least: float, most: float) -> Holds:
    """Whether values (k,) are between two limits; ``"more"`` where they are told to be above."""
    above, beneath = below(least, values), below(values, most)
    return "more" if above and beneath is False else whole(above, beneath)


def matches(pairs: Sequence[tuple[str, ArrayLike, float]]) -> Verdict:
    """Whether named errors (k,) are the sizes that a paper prints, within a factor `NEAR`.

    ``"more"`` where none is larger and one is told to be smaller than that. The text gives the
    pair that is farthest off, and how many are within the factor in the mean.
    """
    verdicts: list[Holds] = []
    for _, values, printed in pairs:
        under = below(values, NEAR * printed, len(pairs))
        above = below(printed / NEAR, values)
        verdicts.append("more" if under and above is False else whole(under, above))
    means = np.array([np.mean(np.asarray(values, dtype=float)) for _, values, _ in pairs])
    off = np.abs(np.log(means / [printed for *_, printed in pairs]))
    (name, _, printed), worst = pairs[int(off.argmax())], means[off.argmax()]
    return whole(*verdicts), (
        f"{name}: {worst:.3f}, printed {printed:.3f}, the farthest of {len(pairs)}; "
        f"{np.sum(off <= np.log(NEAR))} within a factor {NEAR:g}"
    )


def mostly(count: int, of: int) -> bool | None:
    """Whether something is so in more than half of all cases, by `count` of so many drawn.

    By the exact interval of a share (Clopper and Pearson, 1934).
    """
    share = stats.binomtest(count, of).proportion_ci(LEVEL)
    return True if share.low > 0.5 else False if share.high < 0.5 else None


def scatters_more(values: ArrayLike, others: Sequence[ArrayLike]) -> Holds:
    """Whether values (k,) scatter more than each of others (k,), by the F test of variances."""
    first = np.asarray(values, dtype=float)
    verdicts: list[Holds] = []
    for other in map(np.asarray, others):
        if first.size < 2 or other.size < 2:
            return None
        ratio = float(first.var(ddof=1) / other.var(ddof=1))
        rest = 0.5 * (1.0 - LEVEL) / (len(others) if ratio < 1.0 else 1)  # see `below`
        low, high = (
            float(stats.f.ppf(p, first.size - 1, other.size - 1)) for p in (rest, 1 - rest)
        )
        verdicts.append(True if ratio > high else False if ratio < low else None)
    return whole(*verdicts)


def against(lower: ArrayLike, higher: ArrayLike) -> str:
    """Say in how many repetitions values (k,) are not below others; empty where in none."""
    difference = np.subtract(higher, lower, dtype=float)
    count = int(np.sum(difference <= 0.0))
    return f", the other way in {count} of {difference.size}" if count else ""


def pair_texts(pairs: Sequence[tuple[str, Array, Array]], allowed: float = 0.0) -> str:
    """Means of named pairs, of more than `_SHOWN` those that decide, and repetitions against them.

    The first of a pair is to be the smaller one or, where a growth by a factor is `allowed`, the
    second no larger than that.
    """
    sign = -1.0 if allowed else 1.0
    nearest = sorted(pairs, key=lambda pair: sign * float(np.mean(pair[2]) / np.mean(pair[1])))
    shown = pairs if len(pairs) <= _SHOWN else nearest[:_SHOWN]
    text = "; ".join(
        f"{name}: {np.mean(a):.3f} against {np.mean(b):.3f}"
        + (against(b, allowed * a) if allowed else against(a, b))
        for name, a, b in shown
    )
    return text if shown is pairs else f"{text} ({len(pairs)} pairs, these the nearest)"


def by_session(rows: DataFrame, **where: Any) -> Array:
    """RMSE (k,) of every session: the mean over the rows that `select` gives of it."""
    return np.asarray(select(rows, **where).groupby("session", sort=False).rmse.mean().to_numpy())


def errors(rows: Any, pick: Pick, **where: Any) -> Array:
    """Errors (k,) of every session that a `pick` names, in rows that have certain values."""
    if callable(pick):
        return pick(rows, **where)
    if isinstance(pick, float):
        return np.full(rows.session.nunique(), pick)
    if isinstance(pick, Mapping):
        return by_session(rows, **{**where, **pick})
    above, base = (by_session(rows, **{**where, **one}) for one in pick)
    return above / base


def ordered(low: Pick, high: Pick, each: Mapping[str, Sequence[Any]], share: float = 0.0) -> Judge:
    """Judge whether one error is below another, for each combination of some columns' values.

    `each` gives columns that both errors share with their values, in the order of a pair's name.
    With a `share`, it judges whether `high` is above `low` by at most that share of it.
    """

    def judge(rows: DataFrame) -> Verdict:
        pairs = []
        for key in product(*each.values()):
            where = dict(zip(each, key, strict=True))
            varied = [str(value) for column, value in where.items() if len(each[column]) > 1]
            name = ", ".join(varied or map(str, key))
            pairs.append((name, errors(rows, low, **where), errors(rows, high, **where)))
        if not share:
            return below_all([(a, b) for _, a, b in pairs]), pair_texts(pairs)
        allowed = 1.0 + share
        holds = below_all([(b, allowed * a) for _, a, b in pairs])
        return holds, f"{pair_texts(pairs, allowed)} (up to {100 * share:g} % more counts as none)"

    return judge


def statements(study: str, judges: Mapping[str, Judge]) -> dict[str, Statement]:
    """Claims that a study judges, by key, in the papers' order.

    A claim that has none of the `judges` is an order of errors, as ``claims.toml`` states it.
    """
    return {
        key: stated._replace(judge=judges.get(key) or ordered(**stated.order or {}))
        for key, stated in CLAIMS.items()
        if stated.study == study
    }


def judged(
    claims: Mapping[str, Statement], rows: DataFrame, on: str = "", without: Collection[str] = ()
) -> list[Claim]:
    """Judge claims, but those `without`, on rows; `on` names what they are of, among several."""
    return [claim.judged(rows, on) for key, claim in claims.items() if key not in without]
