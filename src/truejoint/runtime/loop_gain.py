"""How far the gain of a loop around joints may go, by its rate and the lag of the motors."""

from __future__ import annotations

import math
from numbers import Real
from typing import Final

from truejoint.errors import CommandRefused

GAIN_MARGIN: Final = 2.0
"""By how much the loop's gain may grow at least before a joint that follows its motor swings."""


def loop_margin(rate: float, lag: float, gain: float = 1.0) -> float:
    """Factor by which the gain of a `Compensator` may grow until a joint that moves freely swings.

    The motor counts as two equal lags of `lag` / 2 [s], and sampling at `rate` [Hz] as a delay of
    one and a half periods: the loop's phase reaches -180 degrees where
    ``2 atan(w lag / 2) + 1.5 w / rate = pi``. Raises CommandRefused where there is no such loop.

    Examples
    --------
    >>> round(loop_margin(rate=250.0, lag=0.019, gain=1.5), 1)
    2.6
    """
    are_numbers = isinstance(rate, Real) and isinstance(lag, Real)
    if not (are_numbers and 0.0 < rate < math.inf and 0.0 <= lag < math.inf):
        raise CommandRefused(
            f"compensator: {rate!r:.40} Hz, a lag of {lag!r:.40} s; give a rate above 0 and a lag "
            "of 0 or more"
        )
    low, high = 0.0, 2.0 * math.pi * rate
    for _ in range(60):  # the phase falls with the frequency, so halving finds it
        middle = 0.5 * (low + high)
        phase = 2.0 * math.atan(0.5 * middle * lag) + 1.5 * middle / rate
        low, high = (middle, high) if phase < math.pi else (low, middle)
    return math.inf if gain == 0.0 else (1.0 + (0.5 * low * lag) ** 2) / gain


def check_rate(rate: float, lag: float, gain: float) -> None:
    """Raise CommandRefused where `rate` [Hz] is too slow for a loop's `gain` and a `lag` [s]."""
    margin = loop_margin(rate, lag, gain)
    if margin < GAIN_MARGIN:
        raise CommandRefused(
            f"compensator: {rate:g} Hz is too slow for a gain of {gain:g} on a plant that lags by "
            f"{1e3 * lag:.0f} ms: it would swing at {margin:.1f} times the gain, not at "
            f"{GAIN_MARGIN:g} times; run it faster, or lower the gain to "
            f"{gain * margin / GAIN_MARGIN:.2f}"
        )
