"""Small questions about a signal over time: which way it moves, where it stands still, its gaps."""

from __future__ import annotations

import numpy as np

from truejoint.array_types import Array, Integers

# Below this share of its brisk speed (99th percentile) a joint counts as standing.
STANDING: float = 0.02
GAP_STEPS: float = 5.0
"""A time step longer than this many median steps is a gap, which the judge reports."""
BRIDGED_STEPS: float = 10.0
"""Truth is interpolated across as many of its median steps, as features keep their history."""
BRIDGED_TIME: float = 0.05
"""Time between two readings of joint sensors that a recorder interpolates across [s]."""


def velocity(t: Array, position: Array, window: float = 0.1) -> Array:
    """Velocity by central differences over about `window` [s], so that encoder steps do not show.

    Shape of `position` (n,) or (n, k); one-sided at both ends of the stamps `t` (n,) [s], n >= 2.
    """
    n = len(t)
    reach = max(1, round(0.5 * window / float(np.median(np.diff(t)))))
    before = np.maximum(np.arange(n) - reach, 0)
    after = np.minimum(np.arange(n) + reach, n - 1)
    return ((position[after] - position[before]).T / (t[after] - t[before])).T


def direction(t: Array, position: Array) -> Array:
    """Direction of motion, shape of `position`: 1 up, -1 down, 0 standing (see `STANDING`)."""
    rate = velocity(t, position)
    brisk = np.quantile(np.abs(rate), 0.99, axis=0)
    moving = np.abs(rate) > STANDING * brisk
    return np.where(moving, np.sign(rate), 0.0)


def gaps(t: Array) -> Integers:
    """Rows (m,) after which the next time stamp is more than `GAP_STEPS` median steps away."""
    step = np.diff(t)
    return np.flatnonzero(step > GAP_STEPS * np.median(step))
