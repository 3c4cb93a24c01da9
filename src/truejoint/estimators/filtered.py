"""What the rows and the fits of filters share: a step of one, and its run over histories."""

from __future__ import annotations

from itertools import pairwise
from typing import Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled
from truejoint.filters import FilterStatus, UnscentedFilter
from truejoint.filters import fields as at
from truejoint.filters.fields import call_step

FAULTS: Final = int(
    FilterStatus.INVALID_INPUT
    | FilterStatus.INVALID_MEASUREMENT
    | FilterStatus.TRANSITION_FAILED
    | FilterStatus.MEASUREMENT_FAILED
    | FilterStatus.OUT_OF_RANGE
    | FilterStatus.SINGULAR
)
"""What makes a filter's estimate none: its row is then NaN, and the sample IMPLAUSIBLE."""


@compiled
def advance(numbers: Integers, memory: Array, dt: float) -> bool:
    """Advance the filter; whether its estimate is one. After one that is none, rows start anew.

    What happened meanwhile nobody saw, so that the covariance must be that of a start.
    """
    memory[at.DT] = dt
    return bool((call_step(numbers[at.ADVANCE], numbers, memory) & FAULTS) == 0)


@compiled
def quadratic(weights: Array, spread: Array, n: int) -> float:
    """Variance of the weighted sum of the first n numbers of a covariance, not negative."""
    variance = 0.0
    for i in range(n):
        for j in range(n):
            variance += weights[i] * spread[i, j] * weights[j]
    return max(variance, 0.0)


def histories(dt: Array) -> list[slice]:
    """Rows of each history, of the time (n,) since the row before, 0 where one starts."""
    return [slice(*ends) for ends in pairwise([*np.flatnonzero(dt == 0.0).tolist(), len(dt)])]


def run_histories(
    unscented: UnscentedFilter,
    prior: tuple[Array, Array],
    z: Array,
    u: Array,
    dt: Array,
    *,
    smoothed: bool,
) -> tuple[Array, Array]:
    """States (N, n) and covariances (N, n, n) by filter or smoother, each history from a prior."""
    n = len(prior[0])
    states, covariances = np.empty((len(dt), n)), np.empty((len(dt), n, n))
    for rows in histories(dt):
        result = unscented.run(z[rows], u[rows], x0=prior[0], P0=prior[1], dt=dt[rows])
        estimate = unscented.smooth(result) if smoothed else result
        states[rows], covariances[rows] = estimate.x, estimate.P
    return states, covariances
