"""Signals over time: how they move, and truth brought to the stamps of the state."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from truejoint.array_types import Array, Integers, Mask, floats
from truejoint.errors import RecordingError, other_kind
from truejoint.recordings.table.recording import MISSING
from truejoint.robots.blocks import Block

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


BACK: Final = "time stamp not after the one before"
BEFORE: Final = "no truth: before it starts"
AFTER: Final = "no truth: after it ends"
GAP: Final = "no truth: gap between its samples"

_MAX_LOST: Final = 0.1  # largest share of rows that a clock which jumps may cost


@dataclass(frozen=True, eq=False)
class Stream(Block):
    """Columns with time stamps of their own.

    Attributes
    ----------
    t : ndarray, shape (n,)
        Time stamps [s] on a clock that both streams share.
    columns : mapping of str to ndarray (n,)
        By name.

    Raises
    ------
    RecordingError
        If one is not as many numbers as there are stamps.

    Examples
    --------
    >>> Stream(np.arange(3.0), {"truth/jaw": np.zeros(3)}).t
    array([0., 1., 2.])
    """

    t: Array
    columns: Mapping[str, Array]

    def __post_init__(self) -> None:
        columns = {
            name: floats(values, f"stream: column {name!r}", RecordingError)
            for name, values in self.columns.items()
        }
        object.__setattr__(self, "columns", columns)
        object.__setattr__(self, "t", floats(self.t, "stream: time stamps", RecordingError))
        for name, values in columns.items():
            if values.shape != self.t.shape or self.t.ndim != 1:
                raise RecordingError(
                    f"stream: column {name!r} has shape {values.shape}, its time stamps "
                    f"{self.t.shape}; both must be (n,)"
                )

    def rows(self, selection: Mask) -> "Stream":
        """Keep the selected rows only."""
        return Stream(self.t[selection], {n: v[selection] for n, v in self.columns.items()})


def synchronise(
    state: Stream, truth: Stream, gap_limit: float
) -> tuple[dict[str, Array], dict[str, int]]:
    """Truth at the time stamps of the state, by linear interpolation.

    Gives ``t``, the state's and the truth's columns (n,) by name; and, by reason, how many rows
    were left out of either stream or have no truth. Nothing is extrapolated, nor interpolated
    across two truth samples more than `gap_limit` apart: such rows keep their state and have NaN
    for the truth. Angles are interpolated as they are, without wrapping: a joint sensor that jumps
    by a turn must be unwrapped before.

    Parameters
    ----------
    state, truth : Stream
        On one clock; the rates need not be regular. Rows whose stamp is not after the one before
        (a clock that was set back, a stray stamp) or that hold NaN are left out.
    gap_limit : float
        Longest time between two truth samples to interpolate across [s].

    Raises
    ------
    RecordingError
        If `gap_limit` is not positive, a stream has fewer than 2 rows left, or more than a tenth
        of a stream lies after a jump back of its clock.

    Examples
    --------
    >>> t = np.arange(5.0)
    >>> state = Stream(t, {"measured/jaw": t})
    >>> columns, dropped = synchronise(state, Stream(t + 0.5, {"truth/jaw": 2 * t + 1}), 1.5)
    >>> columns["truth/jaw"], dropped
    (array([nan,  2.,  4.,  6.,  8.]), {'no truth: before it starts': 1})
    """
    if not (gap_limit > 0):
        raise RecordingError(f"synchronise: gap limit {gap_limit} s; give one above 0 s")
    dropped: dict[str, int] = {}
    state, truth = usable_rows(state, "state", dropped), usable_rows(truth, "truth", dropped)
    early, late = state.t < truth.t[0], state.t > truth.t[-1]
    wide = np.flatnonzero(np.diff(truth.t) > gap_limit)
    edge = np.zeros(state.t.size + 1, dtype=np.int8)
    np.add.at(edge, np.searchsorted(state.t, truth.t[wide], side="right"), 1)
    np.add.at(edge, np.searchsorted(state.t, truth.t[wide + 1], side="left"), -1)
    gap = np.cumsum(edge[:-1], dtype=np.int8) > 0
    unknown = early | late | gap
    columns = {"t": state.t, **state.columns}
    for name, values in truth.columns.items():
        columns[name] = np.interp(state.t, truth.t, values)
        columns[name][unknown] = np.nan
    counts = {BEFORE: early, AFTER: late, GAP: gap}
    dropped |= {reason: int(rows.sum()) for reason, rows in counts.items() if rows.any()}
    return columns, dropped


def forward_rows(t: Array) -> Mask:
    """Rows (n,) whose stamps `t` (n,) [s] go forward; NaN does not.

    A single stamp that leaps ahead is a stray: it is left out, not all those after it.
    """
    keep = np.isfinite(t)
    if (np.diff(t) > 0.0).all():
        return keep
    rows = np.flatnonzero(keep)
    before, stamps, after = t[rows][:-2], t[rows][1:-1], t[rows][2:]
    keep[rows[1:-1][(stamps > after) & (after > before)]] = False
    rows = np.flatnonzero(keep)
    latest = np.maximum.accumulate(t[rows])
    keep[rows[1:][t[rows][1:] <= latest[:-1]]] = False
    return keep


def usable_rows(stream: Stream, name: str, dropped: dict[str, int]) -> Stream:
    """Rows without NaN whose stamps go forward; the others are counted in `dropped`."""
    if not isinstance(stream, Stream):
        advice = "give Stream(t, columns), or what read_truth(path) reads"
        raise RecordingError(f"{name}: {other_kind(stream, 'Stream', advice)}")
    finite = np.isfinite(stream.t)
    for values in stream.columns.values():
        finite &= np.isfinite(values)
    if not finite.all():
        dropped[f"{name}: {MISSING}"] = int((~finite).sum())
        stream = stream.rows(finite)
    forward = forward_rows(stream.t)
    lost = int((~forward).sum())
    if lost > max(1, _MAX_LOST * forward.size):
        row = int(np.argmin(forward))
        raise RecordingError(
            f"{name}: the clock goes back at row {row} ({stream.t[row]:.6f} s) and {lost} of "
            f"{forward.size} rows do not follow the time before; cut the recording there"
        )
    if lost:
        dropped[f"{name}: {BACK}"] = lost
        stream = stream.rows(forward)
    if stream.t.size < 2:
        raise RecordingError(f"{name}: {stream.t.size} usable rows; at least 2 are needed")
    return stream
