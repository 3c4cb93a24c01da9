"""By how much a truth is late at all speeds, apart from a loop as wide at any speed.

Friction and backlash make the truth depend on the path alone, however fast it is run: polynomials
of the positions and plays of many half-widths describe that. What velocity explains beyond them is
time. With one speed velocity is a function of the path too, and nothing tells the two apart.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Final, Self

import numpy as np
from scipy.interpolate import Akima1DInterpolator

from truejoint.array_types import Array, Integers
from truejoint.features.feature_set import FeatureSet
from truejoint.recordings.join.explained import BISQUARE, Explained, robust_spread
from truejoint.recordings.table.recording import Recording
from truejoint.recordings.table.stream import direction, velocity

LATE: Final = 0.015
"""Lag [s] below which nothing is said."""

_PLAYS: Final = (0.005, 0.01, 0.02, 0.04, 0.08, 0.15, 0.25, 0.35, 0.45)  # of the range
_RIDGE: Final = 1e-7  # of the rows, for standardised columns
_SHIFTS: Final = np.linspace(-0.4, 0.4, 41)  # s
_HALF_STEP: Final = 0.01  # s, for the derivative by time
_ROUNDS: Final = 6
_WEIGHINGS: Final = 3
_MOST_ROWS: Final = 8_000  # of all recordings of a joint
_FEWEST_ROWS: Final = 1_000  # of each
_GROSS: Final = 50.0  # spreads, beyond which a row has no weight at first
_PARTS: Final = 4  # of each recording, whose scatter tells the deviation
_WINDOW: Final = 0.04  # s, of the velocity
_TWO_SPEEDS: Final = 1.5  # ratio of a cell's 90th and 10th percentile of speed
_CELLS: Final = 20  # of the range, each way
_FEWEST: Final = 10  # rows of a cell
_APART: Final = 2.0  # deviations of two lags that differ


@dataclass(frozen=True)
class Lag:
    """By how much the truth is late, in time, and by how far it stays behind, in space.

    Without `speeds_differ` nothing tells the two apart, and `seconds` is as if there were no loop.
    """

    seconds: float  # late by, at all speeds
    sd: float  # its standard deviation [s]
    drop: float  # share by which the residual's variance falls when the truth is shifted back
    loops: tuple[tuple[float, float], ...] = ()
    """Width of each joint's loop, truth on the way up less truth on the way down, and its standard
    deviation [rad or m]."""
    speeds_differ: bool = True  # by enough to tell a lag from a loop


def estimate_lag(recordings: Sequence[Sequence[Recording]], explained: Sequence[Explained]) -> Lag:
    """Lag of all truth joints together: the mean of two for each joint.

    One is beside plays of many half-widths, one beside those of few and low-passed efforts. By how
    much these differ is part of the deviation, and so is by how much joints do. At one speed a
    loop could pass for a lag: then so is what the lag would be if there were none.
    """
    motions = list(map(_Motion.of, recordings, explained))
    lag = _by_two(motions)
    if lag.speeds_differ:
        return lag
    seconds, *_ = _mean([motion.lag(motion.places) for motion in motions])
    return replace(lag, sd=math.hypot(lag.sd, lag.seconds - seconds))


def lags_alone_and_together(
    recordings: Sequence[Sequence[Recording]], explained: Sequence[Explained]
) -> tuple[list[tuple[int, Lag]], Lag]:
    """Find recordings, by number, late by another time than the others; and the lag of all.

    Each by itself, as loads and friction differ. One whose lag is as long a way as the others' at
    its speed has their loop, not another clock; with one speed no longer a way is enough for that.
    """
    motions = list(map(_Motion.of, recordings, explained))
    differ = any(motion.speeds_differ() for motion in motions)
    of_joints = [motion.lag(motion.path if differ else motion.places) for motion in motions]
    seconds, sd, drop = _mean(of_joints)
    loops = tuple(motion.loop(seconds if differ else 0.0) for motion in motions)
    together = Lag(seconds, sd, drop, loops, differ)
    if len(recordings[0]) < 2:
        return [], together
    parts = [[motion.only(k) for motion in motions] for k in range(len(recordings[0]))]
    lags = [_by_two(part) for part in parts]
    times = np.array([(lag.seconds, lag.sd) for lag in lags])
    speeds = np.array([np.sqrt(np.mean(part[0].speed ** 2)) for part in parts])
    distances = times * speeds[:, None]
    late = [
        (k, lag)
        for k, lag in enumerate(lags)
        if _is_apart(times, k, LATE) and not _shares_loop(distances, k, lag.speeds_differ)
    ]
    return late, together


def _by_two(motions: "Sequence[_Motion]") -> Lag:
    lags = []
    for motion in motions:
        seconds, sd, drop = motion.lag(motion.path)
        half = (motion.lag(motion.explained)[0] - seconds) / 2.0
        lags.append((seconds + half, math.hypot(sd, half), drop))
    differ = any(motion.speeds_differ() for motion in motions)
    return Lag(*_mean(lags), tuple(motion.loop(0.0) for motion in motions), differ)


def _is_apart(values: Array, number: int, least: float) -> bool:
    """Whether one of the values and deviations (n, 2) is unlike the others."""
    usual, uncertainty = np.median(np.delete(values, number, axis=0), axis=0)
    value, sd = values[number]
    return bool(abs(value - usual) > max(least, _APART * (sd + uncertainty)))


def _shares_loop(distances: Array, number: int, speeds_differ: bool) -> bool:
    """Whether one of the distances and deviations (n, 2) is that which the others lag behind by."""
    usual, uncertainty = np.median(np.delete(distances, number, axis=0), axis=0)
    if abs(usual) <= _APART * uncertainty:
        return False
    within = not speeds_differ and 0.0 <= distances[number, 0] / usual <= 1.0
    return within or not _is_apart(distances, number, 0.0)


def _mean(lags: Sequence[tuple[float, float, float]]) -> tuple[float, float, float]:
    """Mean lag, its deviation, by which they differ included, and the median drop."""
    seconds, deviations, drops = np.array(lags).T
    weights = 1.0 / np.maximum(deviations, 1e-5) ** 2
    weights /= weights.sum()
    mean = float(weights @ seconds)
    n = len(lags)
    between = float(weights**2 @ (seconds - mean) ** 2) * n / max(1, n - 1)
    sd = math.sqrt(float(weights**2 @ deviations**2) + between)
    return mean, sd, float(np.median(drops))


@dataclass(frozen=True, eq=False)
class _Motion:
    """Rows of one joint, of all recordings."""

    stamps_of: tuple[Array, ...]  # of the rows, of each recording
    truths_of: tuple[Akima1DInterpolator, ...]  # stamps and values, of each recording
    recording: Integers  # (m,), number of each row's
    block: Integers  # (m,), number of the part that each row is in
    root: Array  # (m,), of the weights; at first all but gross outliers weigh alike
    position: Array  # (m,), between 0 and 1 mostly
    speed: Array  # (m,), velocity [1/s]
    way: Array  # (m,), direction
    places: Array  # (m, k), polynomials of the positions
    path: Array  # (m, l), those, direction, plays and efforts
    explained: Array  # (m, j), inputs of `Explained`

    @classmethod
    def of(cls, recordings: Sequence[Recording], explained: Explained) -> Self:
        measured, true = f"measured/{explained.joint}", f"truth/{explained.joint}"
        span = max(float(np.ptp(np.quantile(r.column(measured), [0.02, 0.98]))) for r in recordings)
        signals = explained.features.features
        efforts = {f.signal for f in signals if f.operation == "lowpass"}
        others = [k for k, f in enumerate(signals) if f.operation == "value"]
        plays = [f"play({measured}, {share * span:.4g})" for share in _PLAYS]
        added = FeatureSet.parse([*plays, *sorted(efforts)])
        most = max(_FEWEST_ROWS, _MOST_ROWS // len(recordings))
        stamps, truths, parts = [], [], []
        for number, r in enumerate(recordings):
            t, x, truth = r.t, r.column(measured), r.column(true)
            has_truth = np.isfinite(truth)
            rows = np.flatnonzero(has_truth)
            rows = rows[:: -(-len(rows) // most)]
            stamps.append(t[rows])
            truths.append(Akima1DInterpolator(t[has_truth], truth[has_truth]))
            fitted, more = explained.features.compute(r)[rows], added.compute(r)[rows]
            residual = explained.residual(r)[rows]
            own = (x[rows, None] - np.median(x)) / span
            places = np.hstack([fitted[:, others], own**2, own**3])
            way = direction(t, x)[rows]
            part = (
                np.full(len(rows), number),
                np.arange(len(rows)) * _PARTS // len(rows) + _PARTS * number,
                np.abs(residual) < _GROSS * explained.spread,
                own[:, 0],
                velocity(t, x, _WINDOW)[rows] / span,
                way,
                places,
                np.hstack([places, way[:, None], more, more[:, : len(plays)] * own]),
                np.hstack([fitted, own**2, own**3]),
            )
            parts.append(part)
        columns = [np.concatenate(values) for values in zip(*parts, strict=True)]
        return cls(tuple(stamps), tuple(truths), *columns)

    def only(self, number: int) -> "_Motion":
        """Rows of one recording."""
        rows, single = self.recording == number, slice(number, number + 1)
        arrays = [getattr(self, f.name)[rows] for f in fields(self)[2:]]
        return _Motion(self.stamps_of[single], self.truths_of[single], *arrays)

    def centred(self, values: Array) -> Array:
        """Values (m, ...) less the mean of each recording, times the root of the weight."""
        columns = values.reshape(len(values), -1)
        starts = np.flatnonzero(np.diff(self.recording, prepend=-1))
        weights = self.root[:, None] ** 2
        total = np.maximum(np.add.reduceat(weights, starts), 1e-12)
        means = np.add.reduceat(weights * columns, starts) / total
        centred = (columns - means[self.recording - self.recording[0]]) * self.root[:, None]
        return np.asarray(centred.reshape(values.shape))

    def orthonormal(self, columns: Array) -> Array:
        """Columns (m, l) that project on what `columns` (m, k) explain, with a ridge."""
        design = self.centred(columns)
        scale = np.linalg.norm(design, axis=0)
        design = design[:, scale > 0.0] / scale[scale > 0.0]
        ridge = math.sqrt(_RIDGE) * np.eye(design.shape[1])
        return np.asarray(np.linalg.qr(np.vstack([design, ridge]))[0][: len(design)])

    def truth(self, *shifts: float) -> Array:
        """Truth later by shifts [s], centred (m, n_shifts)."""
        moved = []
        for t, truth in zip(self.stamps_of, self.truths_of, strict=True):
            moved.append(truth(np.clip(t[:, None] + shifts, *truth.x[[0, -1]])))
        return self.centred(np.concatenate(moved))

    def speeds_differ(self) -> bool:
        """Whether the joint passes the same places, the same way, at different speeds."""
        if not np.ptp(self.position):
            return False
        cell = np.clip((self.position - self.position.min()) / np.ptp(self.position), 0.0, 0.999)
        cell = np.floor(cell * _CELLS) + _CELLS * (self.way > 0.0)
        speeds = [np.abs(self.speed[(cell == k) & (self.way != 0.0)]) for k in np.unique(cell)]
        quantiles = [np.quantile(s, [0.1, 0.9]) for s in speeds if len(s) >= _FEWEST]
        ratios = [high / max(low, 1e-12) for low, high in quantiles]
        return bool(ratios) and float(np.median(ratios)) >= _TWO_SPEEDS

    def lag(self, columns: Array) -> tuple[float, float, float]:
        """Lag beside what `columns` (m, k) explain, its deviation [s] and the drop."""
        motion, seconds = self, math.nan
        for _ in range(_WEIGHINGS):
            seconds, sd, drop, residual = motion.solve(motion.orthonormal(columns), seconds)
            limit = BISQUARE * max(robust_spread(residual), 1e-12)
            motion = replace(self, root=np.clip(1.0 - (residual / limit) ** 2, 0.0, None))
        return seconds, sd, drop

    def solve(self, basis: Array, lag: float) -> tuple[float, float, float, Array]:
        """Lag and deviation [s] beside what `basis` spans, drop, residual (m,); NaN to search."""

        def left(values: Array) -> Array:
            return np.asarray(values - basis @ (basis.T @ values))

        rest = left(self.centred(self.speed))
        if math.isnan(lag):
            lag = float(_SHIFTS[np.argmin(np.sum(left(self.truth(*_SHIFTS)) ** 2, axis=0))])
        for _ in range(_ROUNDS):
            later, earlier, now = self.truth(lag + _HALF_STEP, lag - _HALF_STEP, lag).T
            slope = float(rest @ (later - earlier)) / (2.0 * _HALF_STEP)
            step = float(rest @ now) / slope if slope else 0.0
            lag = float(np.clip(lag - np.clip(step, -0.1, 0.1), _SHIFTS[0], _SHIFTS[-1]))
        residual, before = left(self.truth(lag, 0.0)).T
        sd = self.scatter(rest * residual) / max(abs(slope), 1e-300)
        drop = 1.0 - float(residual @ residual) / max(float(before @ before), 1e-300)
        return lag, sd, drop, residual

    def loop(self, seconds: float) -> tuple[float, float]:
        """Width of the loop once the truth is shifted back by `seconds`, and its deviation."""
        basis = self.orthonormal(self.places)
        way, truth = self.centred(self.way), self.truth(seconds)[:, 0]
        way -= basis @ (basis.T @ way)
        truth -= basis @ (basis.T @ truth)
        weight = max(float(way @ way), 1e-300)
        half = float(way @ truth) / weight
        return -2.0 * half, 2.0 * self.scatter(way * (truth - half * way)) / weight

    def scatter(self, values: Array) -> float:
        """Deviation of a sum of values (m,), by how much the sums of the parts scatter."""
        sums = np.bincount(self.block - self.block[0], values)
        return math.sqrt(float(sums @ sums) * len(sums) / (len(sums) - 1))
