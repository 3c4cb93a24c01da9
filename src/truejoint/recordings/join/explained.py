"""What a robot's signals explain of truth minus measured, or of a redundant sensor.

The rest tells outliers and steps.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from truejoint.array_types import Array, Integers, Mask
from truejoint.features.feature_set import FeatureSet
from truejoint.recordings.table.recording import Recording
from truejoint.recordings.table.stream import direction, gaps
from truejoint.threads import one_thread

SLOW: Final = 0.1
"""Time step [s] above which rows are steps of a motion rather than a curve."""

_MOST_ROWS: Final = 8_000  # fitted to, of all recordings of a joint
_PLAYS: Final = (0.01, 0.03, 0.1)  # half-widths, as shares of the joint's range
_LOWPASS: Final = (0.05, 0.5)  # s
_RIDGE: Final = 1e-4  # of the rows, for standardised columns
_ROUNDS: Final = 8
BISQUARE: Final = 4.685
"""Spreads beyond which a row has no weight: 95 % efficient for normal noise (Tukey, 1974)."""
# No spread counts as less, as a share of the joint's range: rounding is no finding.
_FINEST: Final = 1e-4
_FINEST_OF_OTHERS: Final = 1e-3
# Nor as a share of what is explained: a step that the regression follows late is no outlier.
_FINEST_LEFT: Final = 1e-2


@dataclass(frozen=True, eq=False)
class Sample:
    """Rows of one recording that are fitted to."""

    rows: Integers  # (m,)
    inputs: Array  # (m, k), of `Explained.features`, then own position squared and cubed
    error: Array  # (m,), what is explained
    weights: Array  # (m,), 0 where a row does not fit in


@dataclass(frozen=True, eq=False)
class Explained:
    """Robust linear model of one joint; a zero of its own for each recording.

    What is explained is truth minus measured, or another `quantity` of that joint, less the ratio
    of the two times measured.
    Bisquare ridge regression on positions (the own one to its cube), plays of the own one,
    low-passed efforts, and where rows are far apart the positions before.
    """

    joint: str
    quantity: str
    ratio: float
    features: FeatureSet
    centre: Array  # (k,)
    scale: Array  # (k,), 1 where an input does not change
    coefficients: Array  # (k,), of scaled inputs
    spread: float  # of the residual, robust [rad or m]
    samples: tuple[Sample, ...]

    def residual(self, recording: Recording) -> Array:
        """Residual (n,) of every row about its median; NaN where there is no truth."""
        values = self.features.compute(recording)
        position, slopes = _own(values), self.coefficients / self.scale
        explained = values @ slopes[:-2] + position**2 * (slopes[-2] + position * slopes[-1])
        target = _target(recording, self.joint, self.quantity, self.ratio)
        residual = target - explained
        return np.asarray(residual - np.nanmedian(residual))


def explain(recordings: Sequence[Recording], joint: str, quantity: str = "truth") -> Explained:
    """Fit truth minus measured of `joint`, or another `quantity` that each recording has."""
    features = _features(recordings, joint, quantity)
    ratio = 1.0 if quantity == "truth" else _ratio(recordings, joint, quantity)
    most = max(200, _MOST_ROWS // len(recordings))
    parts: list[tuple[Integers, Array, Array]] = []
    for recording in recordings:
        error = _target(recording, joint, quantity, ratio)
        finite = np.flatnonzero(np.isfinite(error))
        rows = finite[:: max(1, -(-len(finite) // most))]
        values = features.compute(recording)
        position = _own(values)[rows, None]
        parts.append((rows, np.hstack([values[rows], position**2, position**3]), error[rows]))
    inputs, error = (np.concatenate([part[i] for part in parts]) for i in (1, 2))
    groups = np.repeat(np.arange(len(parts)), [len(part[0]) for part in parts])
    centre, scale = inputs.mean(axis=0), inputs.std(axis=0)
    scale[scale == 0.0] = 1.0
    finest = _FINEST if quantity == "truth" else _FINEST_OF_OTHERS
    spans = [np.ptp(np.quantile(error[groups == k], [0.02, 0.98])) for k in range(len(parts))]
    least = finest * abs(ratio) * float(np.ptp(inputs[:, 0]))
    least = max(least, _FINEST_LEFT * float(np.median(spans)), 1e-12)
    n, k = inputs.shape
    member = groups[:, None] == np.arange(len(parts))  # an intercept for each recording
    design = np.hstack([(inputs - centre) / scale, member])
    penalty = np.diag(np.r_[np.full(k, _RIDGE * n), np.full(len(parts), 1e-9 * n)])
    residual = error - np.array([np.median(error[members]) for members in member.T])[groups]
    for _ in range(_ROUNDS):
        spread = max(robust_spread(residual), least)
        weights = np.clip(1.0 - (residual / (BISQUARE * spread)) ** 2, 0.0, None) ** 2
        weighted = design * weights[:, None]
        solution = np.linalg.solve(design.T @ weighted + penalty, weighted.T @ error)
        residual = error - design @ solution
    spread = max(robust_spread(residual), least)
    samples = tuple(Sample(*part, weights[groups == i]) for i, part in enumerate(parts))
    return Explained(joint, quantity, ratio, features, centre, scale, solution[:k], spread, samples)


def robust_spread(values: Array) -> float:
    """Give the standard deviation of normal values with the median deviation of these (n,)."""
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))


def _target(recording: Recording, joint: str, quantity: str, ratio: float) -> Array:
    measured = recording.column(f"measured/{joint}")
    return recording.column(f"{quantity}/{joint}") - ratio * measured


def _ratio(recordings: Sequence[Recording], joint: str, quantity: str) -> float:
    """Median over recordings of how much a quantity changes for each unit of the measured one."""
    pairs = ((r.column(f"{quantity}/{joint}"), r.column(f"measured/{joint}")) for r in recordings)
    ratios = [
        np.dot(x - x.mean(), y - y.mean()) / max(np.var(y) * len(y), 1e-300) for x, y in pairs
    ]
    return float(np.median(ratios))


def _features(recordings: Sequence[Recording], joint: str, explained: str) -> FeatureSet:
    """Features of columns that change in every recording, but what is `explained`."""
    measured = f"measured/{joint}"
    common = [
        name
        for name in recordings[0].units
        if name.partition("/")[0] in ("measured", "motor", "effort", "current")
        and all(name in r.table.columns and np.ptp(r.column(name)) > 0.0 for r in recordings)
    ]
    span = max(float(np.ptp(np.quantile(r.column(measured), [0.02, 0.98]))) for r in recordings)
    texts = [measured, *(f"play({measured}, {share * span:.4g})" for share in _PLAYS if span > 0.0)]
    for name in common:
        quantity, _, channel = name.partition("/")
        if quantity in ("effort", "current"):
            texts += [f"lowpass({name}, {constant})" for constant in _LOWPASS]
        elif quantity == "measured" or (channel == joint and quantity != explained):
            texts.append(name)
    if np.median(np.diff(recordings[0].t)) > SLOW:
        texts += [f"lag({measured}, 1)", f"lag({measured}, 2)"]
    return FeatureSet.parse(dict.fromkeys(texts))


def _own(values: Array) -> Array:
    """Position of the joint itself (n,), the first feature, about its median."""
    return np.asarray(values[:, 0] - np.median(values[:, 0]))


_STEP: Final = 5.0  # spreads of the residual
_STEP_OF_SLOW: Final = 8.0  # where rows are far apart, honest ones step too
_USUAL: Final = 0.95  # of the steps are honest: few rows a stroke turn at once
_USUAL_STEPS: Final = 2.0  # of the largest of those
_BACK: Final = 0.7  # of that step, from where it left
_NEARLY_BACK: Final = 0.1  # of the step itself, where that is more: rows scatter
_NEAR: Final = 10  # rows that show the level on either side of a step that stays
_LONGEST: Final = 60  # rows for which a burst lasts at most, or 1 s, and a step that stays at least
FEWEST: Final = 50  # rows with truth of which something can be said

_FEWEST_STOPPED: Final = 3  # rows
_BEYOND: Final = 4.0  # spreads that the motor goes on by
_LEAST_BEYOND: Final = 0.01  # of the truth's range, at least
_FLAT: Final = 0.15  # of the usual slope, and of the way gone on, that a stop gives at most


@dataclass(frozen=True)
class Stop:
    """A mechanical stop: the truth stays while the reported position goes on."""

    rows: Integers  # (m,), rising
    level: float  # truth there [rad or m]
    farthest: float  # reported position that is farthest beyond


def apart_from_stops(recording: Recording, joint: str) -> tuple[Recording, list[Stop]]:
    """Take the truth of `joint` away where it is at a stop or all but, and give the stops.

    They are at either end, where the truth stays while measured goes on outwards, beyond where the
    line of truth over measured ends. (On the way back slack keeps it too.)
    """
    column, measured = recording.column(f"truth/{joint}"), recording.column(f"measured/{joint}")
    finite = np.flatnonzero(np.isfinite(column))
    y, x = column[finite], measured[finite]
    low, high = (y.min(), y.max()) if len(y) else (0.0, 0.0)
    middle = (y > low + 0.2 * (high - low)) & (y < high - 0.2 * (high - low))
    if middle.sum() < FEWEST or not np.ptp(x[middle]):
        return recording, []
    design = np.column_stack([x, np.ones(len(x)), direction(recording.t, measured)[finite]])
    solution = np.linalg.lstsq(design[middle], y[middle])[0]
    line, rises = design @ solution, design[:, 2] * np.sign(solution[0])
    spread = robust_spread((y - line)[middle])
    stops, truth = [], column.copy()
    for end in (1.0, -1.0):
        path, way = end * line, end * y
        outwards = np.flatnonzero(rises == end)
        if len(outwards) < FEWEST:
            continue
        farthest = outwards[np.argsort(path[outwards])][-max(_FEWEST_STOPPED, len(y) // 500) :]
        level = float(np.median(way[farthest]))
        gone_on = float(path[outwards].max()) - level
        beyond = outwards[path[outwards] > level + 2.0 * spread]
        if (
            len(beyond) < _FEWEST_STOPPED
            or gone_on < max(_BEYOND * spread, _LEAST_BEYOND * (high - low))
            or np.quantile(np.abs(way[beyond] - level), 0.9) > _FLAT * gone_on
            or np.quantile(way, 0.999) > level + _FLAT * gone_on
            or np.polyfit(path[beyond], way[beyond], 1)[0] > _FLAT
        ):
            continue
        near = (path > level - 3.0 * spread) & (way < level + 2.0 * _FLAT * gone_on)
        near &= way > level - 2.0 * _FLAT * gone_on
        truth[finite[near]] = math.nan
        rows = finite[near & (path > level + 2.0 * spread)]
        stops.append(Stop(rows, end * level, float(x[np.argmax(path)])))
    if not stops:
        return recording, []
    return replace(recording, table=recording.table.assign(**{f"truth/{joint}": truth})), stops


@dataclass(frozen=True, eq=False)
class Steps:
    """Rows of one recording that do not belong to their neighbours."""

    outliers: Integers  # (m,), rising
    size: Array  # (m,), how far those are off, of either sign [unit of the column]
    stays: Integers  # (k,), rows from which on the level is another
    rise: Array  # (k,), by how much


def find_steps(recording: Recording, explained: Explained, share: float = 1.0) -> Steps:
    """Outliers, rows between two opposite steps of the residual, and steps without a way back.

    What steps away and creeps back, as friction does, is no outlier. `share` scales the step that
    counts.
    """
    residual = explained.residual(recording)
    finite = np.flatnonzero(np.isfinite(residual))
    t, level = recording.t[finite], residual[finite]
    dt = float(np.median(np.diff(t)))
    limit = share * explained.spread * (_STEP_OF_SLOW if dt > SLOW else _STEP)
    longest = max(_LONGEST, round(1.0 / dt))
    step = np.diff(level)
    step[gaps(t)] = 0.0
    limit *= _narrowed(level, step)
    limit = max(limit, _USUAL_STEPS * float(np.quantile(np.abs(step), _USUAL)))
    target = _target(recording, explained.joint, explained.quantity, explained.ratio)[finite]
    # Where what explains it steps, as an effort does that turns round, the truth may be right.
    far = (np.abs(step) > limit) & (np.sign(step) * np.diff(target) > 0.5 * np.abs(step))
    bad = np.zeros(len(level), dtype=np.bool_)
    stays = []
    judged = 0
    for before in np.flatnonzero(far).tolist():
        if before < judged:
            continue
        behind = level[before + 1 : before + 2 + longest]
        nearly = max(_BACK * limit, _NEARLY_BACK * abs(step[before]))
        back = np.flatnonzero(np.abs(behind - level[before]) < nearly)
        if len(back) and far[before + back[0]]:
            judged = before + int(back[0]) + 1
            bad[before + 1 : judged] = True
        elif (len(back) == 0 or back[0] >= _LONGEST) and before + 1 + _LONGEST < len(level):
            near = level[max(0, before + 1 - _NEAR) : before + 1], behind[:_NEAR]
            if abs(np.median(near[0]) - np.median(near[1])) < _BACK * limit:
                continue
            stays.append(before + 1)
            judged = before + 1 + _LONGEST
    rows, good = np.flatnonzero(bad), np.flatnonzero(~bad)
    size = level[rows] - np.interp(rows, good, level[good])
    rise = np.array([level[k : k + _LONGEST].mean() - level[k - 1] for k in stays])
    return Steps(finite[rows], size, finite[np.array(stays, dtype=np.int64)], rise)


def _narrowed(level: Array, step: Array) -> float:
    """Share of the spread (n,) that is left without the largest step (n - 1,), if that stays."""
    largest = int(np.argmax(np.abs(step))) + 1
    sides = level[:largest], level[largest:]
    rise = float(np.median(sides[1]) - np.median(sides[0]))
    if step[largest - 1] * np.sign(rise) < _BACK * abs(rise):
        return 1.0  # it rises slowly, or comes back
    rest = np.concatenate([side - np.median(side) for side in sides])
    return min(1.0, robust_spread(rest) / max(robust_spread(level), 1e-300))


def gross_outliers(recordings: Sequence[Recording], joint: str) -> list[Mask]:
    """Rows (n,) of each recording whose truth minus measured of `joint` is grossly off."""
    moving = [apart_from_stops(recording, joint)[0] for recording in recordings]
    enough = [r for r in moving if np.isfinite(r.column(f"truth/{joint}")).sum() >= FEWEST]
    with one_thread():  # of a few thousand rows
        explained = explain(enough, joint) if enough else None
    masks = [np.zeros(len(recording), dtype=np.bool_) for recording in moving]
    for recording, mask in zip(moving, masks, strict=True):
        if explained is not None and recording in enough:
            mask[find_steps(recording, explained).outliers] = True
    return masks
