"""A time law for straight lines in joint space: full speed between corners, smooth at them."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from truejoint.array_types import Array
from truejoint.compiled import compiled
from truejoint.crtk.protocol import BLOCK_DURATION
from truejoint.errors import CommandRefused

BLEND: Final = 0.25
"""Time that any change of velocity is spread over [s]: a stop from 3 deg/s takes 12 deg/s^2."""

_STANDING: Final = 1e-3  # of a law that goes nowhere [s]
_INSTANT: Final = 1e-9  # shorter lines than this are no lines [s]: a picometre on the way


@dataclass(frozen=True, eq=False)
class TimeLaw:
    """Positions over time along straight lines, averaged over the last `BLEND` seconds.

    The moving average makes acceleration bounded: wherever the lines keep a speed v, the law
    keeps it too, and its acceleration stays below 2 v / BLEND, reached where a joint turns back.
    It starts and ends at rest on the outer knots, stays in the hull of all, and cuts
    a corner by at most v BLEND / 4 per joint. The average is taken in closed form, so that any
    stretch of a law of hours can be computed alone.

    Attributes
    ----------
    times : ndarray, shape (n,)
        Times of the knots, strictly increasing from 0 [s].
    knots : ndarray, shape (n, n_joints)
        Corners of the lines [rad or m].

    Raises
    ------
    CommandRefused
        If times do not rise, or are not as many as knots.

    Examples
    --------
    >>> time_law([[0.0], [1.0]], [0.5]).at([1.125])
    array([[0.5]])
    """

    times: Array
    knots: Array
    _centred: Array = field(init=False, repr=False)
    _integral: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        times, knots = np.asarray(self.times, dtype=float), np.asarray(self.knots, dtype=float)
        if not (
            knots.ndim == 2 and times.shape == knots.shape[:1] and (np.diff(times) > 0.0).all()
        ):
            raise CommandRefused(
                f"time law: times of shape {times.shape} at knots of shape {knots.shape}; give "
                "times (n,) that rise, and a row of knots (n, n_joints) for each"
            )
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "knots", knots)
        # Small values keep the difference of two integrals exact to 1e-11 over hours.
        centred = self.knots - self.knots[0]
        areas = np.diff(self.times)[:, None] * (centred[1:] + centred[:-1]) / 2
        integral = np.vstack([np.zeros(self.knots.shape[1]), np.cumsum(areas, axis=0)])
        object.__setattr__(self, "_centred", centred)
        object.__setattr__(self, "_integral", integral)

    @property
    def duration(self) -> float:
        """Time from rest to rest [s]."""
        return float(self.times[-1]) + BLEND

    def at(self, t: ArrayLike) -> Array:
        """Positions (m, n_joints) [rad or m] at times (m,) [s]; at rest before and after."""
        now = np.asarray(t, dtype=float)
        lines = self.times, self._centred, self._integral
        law = (_integrals(now, *lines) - _integrals(now - BLEND, *lines)) / BLEND
        # An end that is a difference of integrals would be off by rounding.
        law[now >= self.duration] = self._centred[-1]
        return np.asarray(law + self.knots[0])

    def blocks(self, rate: float) -> Iterator[Array]:
        """Set-points (m, n_joints) at `rate` [Hz] from the first period to rest, by blocks."""
        total, size = np.ceil(self.duration * rate - 1e-6), int(BLOCK_DURATION * rate)
        for start in range(0, int(total), size):
            yield self.at(np.arange(start + 1, min(start + size, total) + 1) / rate)


@compiled
def _integrals(t: Array, times: Array, lines: Array, integral: Array) -> Array:
    """Integral (m, n_joints) of the centred lines from 0 to `t`, held beyond both ends."""
    out, i, last = np.empty((t.shape[0], lines.shape[1])), 0, times.shape[0] - 1
    for row in range(t.shape[0]):
        inside, beyond = min(max(t[row], 0.0), times[last]), max(t[row] - times[last], 0.0)
        if not times[i] <= inside < times[i + 1]:
            i = min(max(np.searchsorted(times, inside, side="right") - 1, 0), last - 1)
        part, span = inside - times[i], times[i + 1] - times[i]
        for k in range(lines.shape[1]):
            here = lines[i, k] + (lines[i + 1, k] - lines[i, k]) * part / span
            area = part * (lines[i, k] + here) / 2
            out[row, k] = integral[i, k] + area + beyond * lines[last, k]
    return out


def time_law(knots: ArrayLike, speed: ArrayLike) -> TimeLaw:
    """Time law through `knots` in which, on every line, one joint moves at its full speed.

    Parameters
    ----------
    knots : array_like, shape (n, n_joints)
        Corners [rad or m]; repeated ones are passed once.
    speed : array_like, shape (n_joints,)
        Speed caps [rad/s or m/s].

    Raises
    ------
    CommandRefused
        If shapes do not fit, or a speed is not above 0.

    Examples
    --------
    >>> time_law([[0.0], [1.0]], [0.5]).duration
    2.25
    """
    corners, caps = np.asarray(knots, dtype=float), np.asarray(speed, dtype=float)
    if not (corners.ndim == 2 and caps.shape == corners.shape[1:] and (caps > 0.0).all()):
        raise CommandRefused(
            f"time law: speeds {caps.tolist()!s:.80} through knots of shape {corners.shape}; give "
            "knots (n, n_joints), and for each joint a speed above 0"
        )
    needed = (np.abs(np.diff(corners, axis=0)) / caps).max(axis=1)
    times = np.concatenate([[0.0], np.cumsum(needed)])
    # Knots of the same instant are passed once.
    keep = np.concatenate([[True], np.diff(np.floor(times / _INSTANT)) > 0.0])
    last, corners, times = corners[-1], corners[keep], times[keep]
    if len(corners) == 1:
        corners, times = np.vstack([corners, corners]), np.array([0.0, _STANDING])
    corners[-1] = last
    return TimeLaw(times, corners)
