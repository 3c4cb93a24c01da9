"""When a difference between errors is told, and verdicts of several put together."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

LEVEL: Final = 0.95
"""At which a difference between sessions is told."""
SINGLE: Final = 0.05
"""Share by which two errors of one session must differ."""
RULE: Final = (
    f"A difference counts as told at {100 * LEVEL:.0f} % by Student's t over the sessions; where "
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
        least = float(stats.t.ppf((1.0 + LEVEL) / 2.0, count - 1)) * deviation
    return mean > 0.0 if abs(mean) > least else None


def whole(*verdicts: bool | None) -> bool | None:
    """Verdict on all of several: False if one is, else None if one is, else True.

    >>> whole(True, None, False), whole(True, None), whole(True, True)
    (False, None, True)
    """
    return False if False in verdicts else None if None in verdicts else True
