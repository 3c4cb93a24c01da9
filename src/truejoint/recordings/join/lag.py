"""By how much a truth is late at all speeds, apart from a loop as wide at any speed.

Friction and backlash make the truth depend on the path alone, however fast it is run: polynomials
of the positions and plays of many half-widths describe that. What velocity explains beyond them is
time. With one speed velocity is a function of the path too, and nothing tells the two apart.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

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

    Attributes
    ----------
    seconds, sd : float
        Late by, at all speeds, and its standard deviation [s]; where `told` is False as if there
        were no loop.
    drop : float
        Share by which the residual's variance falls when the truth is shifted back.
    loops : tuple of pairs of float
        Width of each joint's loop, truth on the way up less truth on the way down, and its standard
        deviation [rad or m].
    told : bool
        Whether speeds differ by enough to tell a lag from a loop.
    """

    seconds: float
    sd: float
    drop: float
    loops: tuple[tuple[float, float], ...] = ()
    told: bool = True


def estimate_lag(recordings: Sequence[Sequence[Recording]], explained: Sequence[Explained]) -> Lag:
    """Lag of all truth joints together, of all recordings.

    Joints weigh by their deviations; by how much they differ adds to the deviation.
    """
    pairs = zip(recordings, explained, strict=True)
    motions = [_Motion.of(of_joint, joint) for of_joint, joint in pairs]
    told = any(motion.speeds_differ() for motion in motions)
    lags = [motion.lag(motion.path if told else motion.places) for motion in motions]
    seconds, sd = _mean(np.array([lag[:2] for lag in lags]))
    loops = tuple(motion.loop(seconds if told else 0.0) for motion in motions)
    return Lag(seconds, sd, float(np.median([lag[2] for lag in lags])), loops, told)


def lags_unlike_others(
    recordings: Sequence[Sequence[Recording]], explained: Sequence[Explained]
) -> list[tuple[int, Lag]]:
    """Find recordings, by number, late by another time than the others.

    Each by itself, as loads and friction differ; the mean of two, one beside plays of fewer
    half-widths and low-passed efforts. By how much these differ is part of its deviation.
    """
    count = len(recordings[0])
    if count < 2:
        return []
    lags = []
    for k in range(count):
        of_joints = []
        for of_joint, joint in zip(recordings, explained, strict=True):
            alone = replace(joint, samples=joint.samples[k : k + 1])
            motion = _Motion.of(of_joint[k : k + 1], alone)
            seconds, sd, drop = motion.lag(motion.path)
            half = (motion.lag(motion.explained)[0] - seconds) / 2.0
            of_joints.append((seconds + half, math.hypot(sd, half), drop))
        drop = float(np.median([lag[2] for lag in of_joints]))
        lags.append(Lag(*_mean(np.array(of_joints)[:, :2]), drop))
    values = np.array([(lag.seconds, lag.sd) for lag in lags])
    late = []
    for k, lag in enumerate(lags):
        usual, uncertainty = np.median(np.delete(values, k, axis=0), axis=0)
        if abs(lag.seconds - usual) > max(LATE, _APART * (lag.sd + float(uncertainty))):
            late.append((k, lag))
    return late


def _mean(lags: Array) -> tuple[float, float]:
    """Mean of lags and deviations (n, 2), and its deviation, by which they differ included."""
    seconds, deviations = lags.T
    weights = 1.0 / np.maximum(deviations, 1e-5) ** 2
    weights /= weights.sum()
    mean = float(weights @ seconds)
    n = len(lags)
    between = float(weights**2 @ (seconds - mean) ** 2) * n / max(1, n - 1)
    return mean, math.sqrt(float(weights**2 @ deviations**2) + between)


@dataclass(frozen=True, eq=False)
class _Motion:
    """Rows of one joint, of all recordings."""

    stamps: tuple[Array, ...]  # of the rows, of each recording
    truths: tuple[tuple[Array, Array], ...]  # stamps and values, of each recording
    recording: Integers  # (m,), number of each row's
    block: Integers  # (m,), number of the part that each row is in
    root: Array  # (m,), of the weights; at first all but gross outliers weigh alike
    position: Array  # (m,), between 0 and 1 mostly
    speed: Array  # (m,), velocity [1/s]
    way: Array  # (m,), direction
    places: Array  # (m, k), polynomials of the positions
    path: Array  # (m, l), those, plays and efforts
    explained: Array  # (m, j), inputs of `Explained`

    @classmethod
    def of(cls, recordings: Sequence[Recording], explained: Explained) -> _Motion:
        measured, true = f"measured/{explained.joint}", f"truth/{explained.joint}"
        span = max(float(np.ptp(np.quantile(r.column(measured), [0.02, 0.98]))) for r in recordings)
        names = [*explained.features.names, "square", "cube"]
        efforts = {f.signal for f in explained.features.features if f.operation == "lowpass"}
        plays = [f"play({measured}, {share * span:.4g})" for share in _PLAYS]
        added = FeatureSet.parse([*plays, *sorted(efforts)])
        others = [k for k, n in enumerate(names) if not n.startswith(("play(", "lag(", "lowpass("))]
        stamps, truths, parts = [], [], []
        for number, (r, sample) in enumerate(zip(recordings, explained.samples, strict=True)):
            t, x, rows = r.t, r.column(measured), sample.rows
            has_truth = np.isfinite(r.column(true))
            stamps.append(t[rows])
            truths.append((t[has_truth], r.column(true)[has_truth]))
            inputs, more = explained.scaled(sample.inputs), added.compute(r)[rows]
            loops = more[:, : len(plays)] / span
            part = (
                np.full(len(rows), number),
                np.arange(len(rows)) * _PARTS // len(rows) + _PARTS * number,
                np.abs(explained.residual(r)[rows]) < _GROSS * explained.spread,
                x[rows] / span,
                velocity(t, x, _WINDOW)[rows] / span,
                direction(t, x)[rows],
                inputs[:, others],
                np.hstack([inputs[:, others], more, loops * inputs[:, :1]]),
                inputs,
            )
            parts.append(part)
        columns = [np.concatenate(values) for values in zip(*parts, strict=True)]
        return cls(tuple(stamps), tuple(truths), *columns)

    def centred(self, values: Array) -> Array:
        """Values (m, ...) less the weighted mean of each recording, times the root of the weight."""
        columns = values.reshape(len(values), -1)
        out = np.empty_like(columns)
        for number in range(len(self.stamps)):
            rows = self.recording == number
            root = self.root[rows, None]
            mean = (root**2 * columns[rows]).sum(axis=0) / max(float(np.sum(root**2)), 1e-12)
            out[rows] = (columns[rows] - mean) * root
        return out.reshape(values.shape)

    def orthonormal(self, columns: Array) -> Array:
        """Columns (m, l) that project on what `columns` (m, k) explain, with a ridge."""
        design = self.centred(columns)
        scale = np.linalg.norm(design, axis=0)
        design = design[:, scale > 0.0] / scale[scale > 0.0]
        ridge = math.sqrt(_RIDGE) * np.eye(design.shape[1])
        return np.asarray(np.linalg.qr(np.vstack([design, ridge]))[0][: len(design)])

    def truth(self, shift: float) -> Array:
        """Truth later by a shift [s], centred (m,)."""
        parts = zip(self.stamps, self.truths, strict=True)
        return self.centred(np.concatenate([np.interp(t + shift, *truth) for t, truth in parts]))

    def speeds_differ(self) -> bool:
        """Whether the joint passes the same places, the same way, at different speeds."""
        cell = np.clip((self.position - self.position.min()) / np.ptp(self.position), 0.0, 0.999)
        cell = np.floor(cell * _CELLS) + _CELLS * (self.way > 0.0)
        speeds = [np.abs(self.speed[(cell == k) & (self.way != 0.0)]) for k in np.unique(cell)]
        quantiles = [np.quantile(s, [0.1, 0.9]) for s in speeds if len(s) >= _FEWEST]
        ratios = [high / max(low, 1e-12) for low, high in quantiles]
        return bool(ratios) and float(np.median(ratios)) >= _TWO_SPEEDS

    def lag(self, columns: Array) -> tuple[float, float, float]:
        """Lag beside what `columns` (m, k) explain, its deviation [s] and the drop."""
        motion = self
        for _ in range(_WEIGHINGS):
            basis = motion.orthonormal(columns)
            seconds, sd, drop, residual = motion.solve(basis)
            limit = BISQUARE * max(robust_spread(residual), 1e-12)
            motion = replace(self, root=np.clip(1.0 - (residual / limit) ** 2, 0.0, None))
        return seconds, sd, drop

    def solve(self, basis: Array) -> tuple[float, float, float, Array]:
        """Lag and deviation [s] beside what `basis` spans, drop, and residual (m,)."""

        def left(values: Array) -> Array:
            return np.asarray(values - basis @ (basis.T @ values))

        rest = left(self.centred(self.speed))
        lag = min(_SHIFTS, key=lambda shift: float(np.sum(left(self.truth(shift)) ** 2)))
        for _ in range(_ROUNDS):
            rise = self.truth(lag + _HALF_STEP) - self.truth(lag - _HALF_STEP)
            slope = float(rest @ rise) / (2.0 * _HALF_STEP)
            step = float(rest @ self.truth(lag)) / slope if slope else 0.0
            lag = float(np.clip(lag - np.clip(step, -0.1, 0.1), _SHIFTS[0], _SHIFTS[-1]))
        residual, before = left(self.truth(lag)), left(self.truth(0.0))
        sums = np.bincount(self.block, rest * residual)
        sd = math.sqrt(float(sums @ sums) * len(sums) / (len(sums) - 1)) / max(abs(slope), 1e-300)
        drop = 1.0 - float(residual @ residual) / max(float(before @ before), 1e-300)
        return lag, sd, drop, residual

    def loop(self, seconds: float) -> tuple[float, float]:
        """Width of the loop once the truth is shifted back by `seconds`, and its deviation."""
        basis = self.orthonormal(self.places)
        way, truth = self.centred(self.way), self.truth(seconds)
        way -= basis @ (basis.T @ way)
        truth -= basis @ (basis.T @ truth)
        weight = max(float(way @ way), 1e-300)
        half = float(way @ truth) / weight
        sums = np.bincount(self.block, way * (truth - half * way))
        return -2.0 * half, 2.0 * math.sqrt(float(sums @ sums) * len(sums) / (len(sums) - 1)) / weight
