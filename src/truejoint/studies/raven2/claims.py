"""Claims as data: that errors are below others, or hardly above them, by session."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np

from truejoint.array_types import Array
from truejoint.studies.study import Statement
from truejoint.studies.verdicts import below, whole

Pick = Callable[[Any], Array]
"""Errors (k,) by session, of what a study found."""
_SHOWN: Final = 4  # pairs at most, of a claim

Pair = tuple[str, Pick, Pick]
"""What two errors are called for a person, and both."""


def ordered(text: str, source: str, *pairs: Pair) -> Statement:
    """Claim that in every pair the first error is below the second."""

    def judge(found: Any) -> tuple[bool | None, str]:
        values = [(name, low(found), high(found)) for name, low, high in pairs]
        return whole(*(below(a, b) for _, a, b in values)), _texts(values, 1.0)

    return Statement(text, source, judge)


def kept(text: str, source: str, share: float, *pairs: Pair) -> Statement:
    """Claim that in every pair the second error is above the first by at most a share of it."""

    def judge(found: Any) -> tuple[bool | None, str]:
        values = [(name, first(found), second(found)) for name, first, second in pairs]
        near = [float(b.mean()) <= (1.0 + share) * float(a.mean()) for _, a, b in values]
        return all(near), f"{_texts(values, -1.0)} (up to {100 * share:g} % more counts as none)"

    return Statement(text, source, judge)


def _texts(values: list[tuple[str, Array, Array]], sign: float) -> str:
    """Errors of the pairs; of more than `_SHOWN` those with the least `sign` times their ratio."""
    nearest = sorted(values, key=lambda pair: sign * float(np.mean(pair[2]) / np.mean(pair[1])))
    shown = values if len(values) <= _SHOWN else nearest[:_SHOWN]
    text = "; ".join(f"{n}: {np.mean(a):.3f} against {np.mean(b):.3f}" for n, a, b in shown)
    return text if shown is values else f"{text} ({len(values)} pairs, these the nearest)"
