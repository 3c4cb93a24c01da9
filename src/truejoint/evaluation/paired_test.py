"""Whether one model is closer to the truth than another, beyond what chance would show.

Rows of a motion resemble their neighbours, so they are no independent trials: stretches are, if
they are longer than the difference of the two models keeps its memory.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from scipy.special import stdtrit

from truejoint.array_types import Array, Integers
from truejoint.errors import CalibrationError

Outcome = Literal["better", "worse", "cannot be told"]

# A stretch is this many integrated correlation times long, so that the mean of one tells little of
# the next: batch means are then some 10 % too steady for a first-order process.
_TIMES: Final = 5.0
_FEWEST: Final = 4  # stretches below which nothing can be told
# Into about how many stretches a test is cut: where slow and fast errors mix, a correlation time
# tells of the fast ones, and the few longest stretches tell of the slow.
_COUNTS: Final = (16, 8, 5)
_WINDOW: Final = 5.0  # lags that count, in integrated correlation times (Sokal's rule)
_LEVEL: Final = 0.95  # two-sided


@dataclass(frozen=True)
class Difference:
    """Mean squared error of one model less that of another, with its 95 % interval.

    Attributes
    ----------
    mean, low, high : float
        In the square of the errors' unit; the bounds are infinite where there are too few
        stretches to tell.
    stretches, rows : int
        How many the interval was taken over, and how many rows the longest has.

    Examples
    --------
    >>> noise = np.random.default_rng(0).normal(size=(2, 1000))
    >>> compare([noise[0]], [2 * noise[1]]).outcome
    'better'
    """

    mean: float
    low: float
    high: float
    stretches: int
    rows: int

    @property
    def outcome(self) -> Outcome:
        """``"better"`` where the first model is, beyond chance."""
        if self.high < 0.0:
            return "better"
        return "worse" if self.low > 0.0 else "cannot be told"


def cycle_rows(directions: Sequence[Array]) -> float:
    """Rows of one motion to and fro, of the joint that turns most often, in the slowest recording.

    A shorter stretch sees a part of a hysteresis loop, which says nothing of the whole. A recording
    in which nothing turns is one stretch. `directions` (n, n_joints) of motion in each recording
    are 1, -1, or 0 while a joint stands.
    """
    longest = 1.0
    for rows in directions:
        moves = [column[column != 0.0] for column in rows.T]
        legs = 1 + max((int(np.count_nonzero(np.diff(move))) for move in moves), default=0)
        longest = max(longest, len(rows) * min(1.0, 2.0 / legs))
    return longest


def compare(errors: Sequence[Array], other: Sequence[Array], least: float = 1.0) -> Difference:
    """Compare the errors of two models, paired over stretches of the same recordings.

    The loss differential of Diebold and Mariano (1995), Comparing predictive accuracy, J. Bus.
    Econ. Stat. 13. Recordings are cut into about 16, 8 and 5 equal stretches (`_COUNTS`), fewer
    where one would be shorter than `_TIMES` integrated correlation times. Student's t is taken over
    their means (Ibragimov and Mueller, 2010, t-statistic based correlation and heterogeneity robust
    inference, J. Bus. Econ. Stat. 28); the widest interval counts. A recording that is shorter is
    one stretch.

    Parameters
    ----------
    errors, other : sequence of ndarray, shape (n,) or (n, k)
        Errors of each recording; of k outputs the squares are added. Recordings without a row are
        passed over.
    least : float
        Rows that a stretch holds at least, unless its recording is shorter: see `cycle_rows`.

    Raises
    ------
    CalibrationError
        If the shapes differ, or there is no row at all.

    Examples
    --------
    >>> noise = np.random.default_rng(0).normal(size=(2, 1000))
    >>> compare([noise[0]], [noise[1]]).outcome
    'cannot be told'
    """
    if list(map(np.shape, errors)) != list(map(np.shape, other)) or not any(map(len, errors)):
        raise CalibrationError(
            f"errors to compare are of shapes {list(map(np.shape, errors))} and "
            f"{list(map(np.shape, other))}; give those of the same rows, one at least"
        )
    lengths = np.array([len(part) for part in errors if len(part)])
    own, others = np.concatenate(errors), np.concatenate(other)
    rows = (np.square(own) - np.square(others)).reshape(len(own), -1).sum(axis=1)
    mean = float(rows.mean())
    memory = _TIMES * correlation_time(np.split(rows - mean, np.cumsum(lengths)[:-1]))
    least = max(memory, least)
    margins = [_margin(rows, lengths, max(least, len(rows) / count)) for count in _COUNTS]
    finite = [margin for margin in margins if math.isfinite(margin[0])]  # recordings may be too few
    margin, stretches, longest = max(finite or margins)
    return Difference(mean, mean - margin, mean + margin, stretches, longest)


def _margin(rows: Array, lengths: Integers, shortest: float) -> tuple[float, int, int]:
    """Margin of the mean over stretches of at least `shortest` rows, their number, the longest.

    Stretches of a recording, which are of about one length, end where it ends.
    """
    counts = np.maximum(1, (lengths / shortest + 1e-9).astype(np.int64))
    place = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    size = np.repeat(lengths // counts, counts) + (place < np.repeat(lengths % counts, counts))
    longest = int(size.max())
    if len(size) < _FEWEST:
        return math.inf, len(size), longest
    weights = size / size.sum()
    deviations = np.add.reduceat(rows, np.cumsum(size) - size) / size - rows.mean()
    alike = 1.0 / float(np.sum(weights**2))  # stretches of one length that weigh as much
    variance = float(np.sum(weights * deviations**2)) / max(alike - 1.0, 1e-9)
    quantile = float(stdtrit(len(size) - 1, 0.5 + 0.5 * _LEVEL))
    return quantile * math.sqrt(variance), len(size), longest


def correlation_time(parts: Sequence[Array]) -> float:
    """Integrated correlation time [rows] of series (n,) about zero, 1 for white noise.

    Sokal's automatic window: lags up to the first that is `_WINDOW` times as long as the time
    itself (A. Sokal, Monte Carlo methods in statistical mechanics, 1997, eq. 3.19 and what follows
    it).
    """
    size = 2 ** math.ceil(math.log2(2 * max(map(len, parts))))
    spectrum = np.sum([np.abs(np.fft.rfft(part, size)) ** 2 for part in parts], axis=0)
    lags = np.fft.irfft(spectrum, size)[: max(map(len, parts))]
    if not lags[0] > 0.0:
        return 1.0
    lengths = np.array(list(map(len, parts)))
    pairs = np.maximum(lengths[:, None] - np.arange(len(lags)), 0).sum(axis=0)
    correlation = (lags / pairs) / (lags[0] / pairs[0])
    times = 2.0 * np.cumsum(correlation) - 1.0
    enough = np.arange(len(times)) >= _WINDOW * times
    return max(float(times[int(np.argmax(enough))] if enough.any() else times.max()), 1.0)
