"""Truth beside what the robot reports: sign, unit, limits, outliers, zeros, delay, redundancy."""

import itertools
import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from scipy.stats import rankdata

from truejoint.array_types import Array, Integers
from truejoint.features import FeatureSet
from truejoint.recordings.join.explained import (
    FEWEST,
    SLOW,
    Explained,
    Stop,
    apart_from_stops,
    explain,
    find_steps,
    robust_spread,
)
from truejoint.recordings.join.lag import LATE, Lag, lags_alone_and_together
from truejoint.recordings.judge.columns import pushes
from truejoint.recordings.judge.finding import Defect, Finding, Level, Rows, one_line_each
from truejoint.recordings.table.recording import Recording, runs
from truejoint.recordings.table.stream import direction
from truejoint.robots import Joint
from truejoint.units import display_unit, plural, shown

Marked = tuple[Defect, Recording]

REDUNDANT: Final = ("motor", "driver")  # quantities that tell the position of a joint once more
_MISLEADS: Final = 0.3  # spreads, that outliers add to the root mean square of the residual
_FEW_OF_SLOW: Final = 0.01  # of rows that are steps: a few of those are honest
_START: Final = 1.0  # s, in which an arm may still be settling
_MOVED: Final = 3.0  # spreads of a left-out recording, and of the residual of all together
_LATE_DROP: Final = 0.05  # of the residual's variance
_MISLEADING_DROP: Final = 0.5  # of it: more than all else that the signals do not explain
_SURE: Final = 3.0  # uncertainties
_SLOPE: Final = 0.05  # by which a slope differs
_SLOPE_PARTS: Final = 4  # of a recording
_ALIKE: Final = 0.1  # by which two ranges differ at most
_SWAPPED: Final = 0.3  # of the variance, that the other joint tells more than the own one
_FAR_LATER: Final = 1.5  # times as late as all together
# Between what healthy joints show (a sixth to 1.1) and degrees for radians.
_RATIO: Final = 7.6
_OPPOSITE: Final = -0.4  # rank correlation; right signs are far above 0, wrong ones far below
_FOLLOWS: Final = 0.5  # rank correlation, behind the slack that suits best
_SLACKS: Final = (0.02, 0.1, 0.2, 0.3, 0.4)  # half-widths, as shares of the range
_LEAST_MOTION: Final = {"rad": 0.05, "m": 0.01}  # that no slack hides
_MOST_ROWS: Final = 2000
_FARTHEST: Final = {"rad": 4.0 * math.pi, "m": 2.0}  # that a joint without limits moves
_SLACK: Final = 0.1  # of the travel between limits
_RIDGE_LEFT_OUT: Final = 1e-2  # of the rows: a recording left out may lie outside


def judge_positions(
    recordings: Sequence[Recording],
    joints: Sequence[str],
    signals: Collection[str],
    columns: Sequence[Marked],
) -> Iterable[Finding]:
    """Judge `joints`; where sign or unit is wrong, or `columns` tell a broken sensor, no further.

    A redundant sensor that is none of the `signals` that a model reads is no failure.
    """
    scales = [
        (defect, recording)
        for joint in joints
        for widest in [max(np.ptp(_range(r.column(f"measured/{joint}"))) for r in recordings)]
        for recording in recordings
        for defect in _judge_scale(recording, joint, float(widest))
    ]
    off = [pair for pair in columns if pair[0].name in ("wrap", "frozen", "saturated")]
    off += [pair for pair in scales if pair[0].level == "fail"]
    broken = {(id(recording), defect.where.partition("/")[2]) for defect, recording in off}
    marked = [pair for pair in columns if pair[0].name == "stop"] + scales
    judged = {joint: [r for r in recordings if (id(r), joint) not in broken] for joint in joints}
    truths = []
    for joint, sound_ones in judged.items():
        moving = []
        for recording in sound_ones:
            if _tells(recording, f"truth/{joint}"):
                apart, stops = apart_from_stops(recording, joint)
                marked += [(_at_stop(stop, recording, joint), recording) for stop in stops]
                moving += [apart] if _tells(apart, f"truth/{joint}") else []
        if moving:
            truths.append((moving, explain(moving, joint)))
    delays, late = _judge_delay(truths, recordings)
    if late:  # a late truth is far off at every turn
        moved = [([_at_once(r, late.get(id(r), 0.0)) for r in rs], e.joint) for rs, e in truths]
        truths = [(of_joint, explain(of_joint, joint)) for of_joint, joint in moved]
    for of_joint, explained in truths:
        marked += _judge_sensor(of_joint, explained)
        marked += _judge_slopes(of_joint, explained.joint)
    for joint, quantity in itertools.product(judged, REDUNDANT):
        column = f"{quantity}/{joint}"
        if telling := [r for r in judged[joint] if _tells(r, column)]:
            odd = _judge_sensor(telling, explain(telling, joint, quantity))
            marked += [(d if column in signals else replace(d, level="warn"), r) for d, r in odd]
    marked += [(defect, r) for r in recordings for defect in _judge_swapped(r, joints)]
    yield from one_line_each(marked, recordings)
    yield from delays


def _tells(recording: Recording, column: str) -> bool:
    """Whether a column has enough values, and those of a sensor beside the truth's change."""
    if column not in recording.units:
        return False
    values = recording.column(column)
    enough = bool(np.isfinite(values).sum() >= FEWEST)
    return enough and (column.startswith("truth/") or bool(np.ptp(values) > 0.0))


def _judge_slopes(recordings: Sequence[Recording], joint: str) -> Iterable[Marked]:
    """Find recordings whose truth moves further, over the same range, than that of the others."""
    column, slopes = f"truth/{joint}", []
    for recording in recordings:
        truth, measured = recording.column(column), recording.column(f"measured/{joint}")
        rows = np.flatnonzero(np.isfinite(truth))
        if not np.ptp(_range(measured[rows])):
            return
        design = np.column_stack([measured, np.ones(len(truth)), direction(recording.t, measured)])
        parts = [rows, *np.array_split(rows, _SLOPE_PARTS)]
        of_parts = [np.linalg.lstsq(design[part], truth[part])[0][0] for part in parts]
        sd = np.std(of_parts[1:]) / math.sqrt(_SLOPE_PARTS)
        slopes.append((of_parts[0], sd, np.ptp(_range(measured[rows]))))
    for number, (slope, sd, span) in enumerate(slopes):
        if len(slopes) < 2 or (number and len(slopes) == 2):
            return
        usual, uncertainty, width = slopes[1] if len(slopes) == 2 else np.median(slopes, axis=0)
        if abs(span / width - 1.0) > _ALIKE:  # slack takes more of a smaller motion
            continue
        if abs(slope / usual - 1.0) > max(_SLOPE, _SURE * math.hypot(sd, uncertainty) / abs(usual)):
            what = f"its truth moves {slope / usual:.2f} times as far as that of the others"
            defect = Defect("warn", "slope", what, column, size=abs(slope / usual - 1.0))
            yield defect, recordings[number]


def _judge_swapped(recording: Recording, joints: Sequence[str]) -> Iterable[Defect]:
    """Find two channels of one quantity that follow each other's joint in place of their own."""
    moving = [j for j in joints if np.ptp(recording.column(f"measured/{j}")) > 0.0]
    for quantity in ("truth", "motor", "driver", "setpoint", "effort"):
        there = [j for j in moving if f"{quantity}/{j}" in recording.units]
        if len(there) < 2:
            continue
        signals, theirs = recording.columns(quantity, there), recording.columns("measured", there)
        rows = np.isfinite(signals).all(axis=1)
        if quantity == "effort":  # friction goes with the direction
            theirs = direction(recording.t, theirs)
        signals, theirs = signals[rows], theirs[rows]
        if len(signals) < FEWEST or not (np.ptp(signals, axis=0) * np.ptp(theirs, axis=0)).all():
            continue
        alike = np.corrcoef(signals.T, theirs.T)[: len(there), len(there) :] ** 2
        for a, b in itertools.combinations(range(len(there)), 2):
            if min(alike[a, b] - alike[a, a], alike[b, a] - alike[b, b]) > _SWAPPED:
                what = (
                    f"follows {there[b]}, and {quantity}/{there[b]} follows {there[a]}: "
                    f"{100 * alike[a, b]:.0f} and {100 * alike[b, a]:.0f} % of their variance"
                )
                yield Defect("fail", "swapped", what, f"{quantity}/{there[a]}", size=alike[a, b])


def _at_once(recording: Recording, late: float) -> Recording:
    """State of a recording at the times at which a truth that is `late` [s] was true."""
    if not late:
        return recording
    then = recording.t - late
    inside = (then >= recording.t[0]) & (then <= recording.t[-1])
    columns = {name: recording.column(name) for name in recording.units}
    for name, values in columns.items():
        moved = np.interp(then, recording.t, values)
        columns[name] = np.where(inside, values, np.nan) if name.startswith("truth/") else moved
    return replace(recording, table=recording.table.assign(**columns))


def _at_stop(stop: Stop, recording: Recording, joint: str) -> Defect:
    at_stop = np.isin(np.arange(len(recording)), stop.rows)
    unit, rows = recording.units[f"truth/{joint}"], tuple(runs(at_stop))
    effort = recording.table.get(f"effort/{joint}", np.zeros(len(recording)))
    repeats = not np.ptp(recording.column(f"truth/{joint}")[at_stop])
    saturated = repeats and not pushes(np.asarray(effort), at_stop)
    what = (
        f"{plural(len(stop.rows), 'row')} at {'an end' if saturated else 'a mechanical stop'}: the "
        f"truth stays at {shown(stop.level, unit)} while measured goes on to "
        f"{shown(stop.farthest, unit)} ({_row_text(rows)})"
    )
    kind = "saturated" if saturated else "stop"
    return Defect("warn", kind, what, f"truth/{joint}", rows=rows, size=len(stop.rows))


def _judge_sensor(recordings: Sequence[Recording], explained: Explained) -> list[Marked]:
    """Find steps in, and between, recordings of a truth or of two sensors that may disagree."""
    # Their finding, and the share of the step that counts for the truth, which is noisier.
    name, share = ("zero", 1.0) if explained.quantity == "truth" else ("redundant", 0.6)
    marked = [
        (defect, recording)
        for recording in recordings
        for defect in _judge_steps(recording, explained, name, share)
    ]
    return marked + _judge_zeros(recordings, explained, name, marked)


def _judge_steps(
    recording: Recording, explained: Explained, name: str, share: float
) -> Iterable[Defect]:
    column = f"{explained.quantity}/{explained.joint}"
    unit, t, steps = recording.units[column], recording.t, find_steps(recording, explained, share)
    slow = np.median(np.diff(t)) > SLOW  # where honest motion steps too
    if len(steps.outliers):
        rows = tuple(runs(np.bincount(steps.outliers) > 0))
        most = shown(float(np.abs(steps.size).max()), unit)
        weight = float(np.sqrt((steps.size**2).sum() / len(recording)))
        what = (
            f"{len(steps.outliers)} of {plural(len(recording), 'row')} up to {most} off those "
            f"beside them ({_row_text(rows)})"
        )
        few = slow and len(steps.outliers) < _FEW_OF_SLOW * len(recording)
        level: Level = "fail" if weight > _MISLEADS * explained.spread and not few else "warn"
        yield Defect(level, "outliers", what, column, rows=rows, size=weight)
    for row, rise in zip(steps.stays, steps.rise, strict=True):
        begins, rows = t[row] - t[0] < _START, ((int(row), int(row) + 1),)
        what = f"it jumps by {shown(float(rise), unit)} at row {row} and stays"
        advice = "cut the start off" if begins else "cut the recording there, or record again"
        level, kind = "warn" if begins or slow else "fail", "start" if begins else name
        yield Defect(level, kind, what, column, advice, rows, abs(float(rise)))


def _row_text(ranges: Rows) -> str:
    """Row numbers for a person: ``"rows 3, 17-20, ..."``."""
    texts = [f"{a}" if b == a + 1 else f"{a}-{b - 1}" for a, b in ranges[:3]]
    few = len(ranges) == 1 and ranges[0][1] == ranges[0][0] + 1
    return ("row " if few else "rows ") + ", ".join(texts) + (", ..." if len(ranges) > 3 else "")


def _judge_zeros(
    recordings: Sequence[Recording], explained: Explained, name: str, steps: Sequence[Marked]
) -> list[Marked]:
    """Find recordings whose zero is not that of the others, nor seen to step within them.

    Within a loop that the others do not explain a zero may be anywhere.
    """
    if len(recordings) < 2:
        return []
    stepped = {id(recording) for defect, recording in steps if defect.name == name}
    zeros, half_loops, spread = left_out_zeros(recordings, explained)
    column = f"{explained.quantity}/{explained.joint}"
    limit = _MOVED * max(spread, explained.spread)
    advice = "re-zero, calibrate each homing on its own, or give each recording its zero"
    moved = []
    for number in np.flatnonzero(np.abs(zeros - np.median(zeros)) - half_loops > limit).tolist():
        recording, offset = recordings[number], float(zeros[number])
        if id(recording) not in stepped:
            what = f"its zero is {shown(offset, recording.units[column])} off that of the others"
            moved.append((Defect("fail", name, what, column, advice, size=abs(offset)), recording))
    return moved[:1] if len(recordings) == 2 else moved


def _judge_delay(
    truths: Sequence[tuple[list[Recording], Explained]], every: Sequence[Recording]
) -> tuple[list[Finding], dict[int, float]]:
    """Truth that is late or early in all joints together, in single recordings or in all.

    And by how much [s], by the recording's id, where it is surely that.
    """
    sources = [[r.provenance.source for r in recordings] for recordings, _ in truths]
    if not sources:
        return [], {}
    most = max(sources, key=sources.count)  # a joint is not judged where its sensor is broken
    alike = itertools.compress(truths, (names == most for names in sources))
    recordings, explained = zip(*alike, strict=True)
    where = ", ".join(f"truth/{e.joint}" for e in explained)
    units = [recordings[0][0].units[f"truth/{e.joint}"] for e in explained]
    alone, together = lags_alone_and_together(recordings, explained)
    defect = _late(together, where, units)
    single = [
        (own, recordings[0][number], lag)
        for number, lag in alone
        if (own := _late(replace(lag, speeds_differ=True), where, units))
        # One speed tells a recording from the others, unless all are about as late.
        and (
            lag.speeds_differ
            or not (defect and together.speeds_differ)
            or lag.seconds / together.seconds > _FAR_LATER
        )
    ]
    if 0 < len(single) <= len(recordings[0]) / 2:
        marked = [(own, recording) for own, recording, _ in single]
        return list(one_line_each(marked, every)), {id(r): lag.seconds for _, r, lag in single}
    if defect is None:
        return [], {}
    late = itertools.chain(*recordings) if together.speeds_differ else ()
    finding = Finding(defect.level, defect.name, defect.what, defect.where, defect.advice)
    return [finding], {id(r): together.seconds for r in late}


def _late(lag: Lag, where: str, units: Sequence[str]) -> Defect | None:
    """Say how late the truth is, if that is not nothing, and how wide the loop is beside it."""
    is_late = abs(lag.seconds) > max(LATE, _SURE * lag.sd) and lag.drop >= _LATE_DROP
    if not is_late or not (
        lag.speeds_differ or any(abs(width) > _SURE * sd for width, sd in lag.loops)
    ):
        return None
    late = "behind" if lag.seconds > 0.0 else "ahead of"
    pairs = zip(lag.loops, units, strict=False)
    loops = ", ".join(f"{shown(w, unit)} (+- {shown(sd, unit)})" for (w, sd), unit in pairs)
    what = (
        f"the truth is {1e3 * abs(lag.seconds):.0f} ms {late} the robot's state "
        f"(+- {1e3 * lag.sd:.0f} ms)"
    )
    level: Level = "warn"
    if not lag.speeds_differ:
        what += f", or it is a loop of {loops}: one speed cannot tell a late clock from hysteresis"
        advice = "record the same motion at half the speed too"
    else:
        what += f", beside a loop of {loops}" if loops else ""
        advice = "correct the clocks or shift the truth"
        level = "fail" if lag.drop >= _MISLEADING_DROP else "warn"
    return Defect(level, "delay", what, where, advice, size=abs(lag.seconds))


def _judge_scale(recording: Recording, joint: str, widest: float) -> Iterable[Defect]:
    """Judge unit, sign, likeness and limits, the first that is wrong: each upsets the next."""
    reported, truth = recording.column(f"measured/{joint}"), recording.table.get(f"truth/{joint}")
    if truth is not None:
        rows = np.flatnonzero(truth.notna())
        rows = rows[:: max(1, len(rows) // _MOST_ROWS)]
        pair = truth.to_numpy()[rows], reported[rows]
        if len(rows) > 2 and (defect := _judge_pair(*pair, recording.robot.joint(joint))):
            yield defect
            return
        least = max(_LEAST_MOTION[recording.robot.joint(joint).unit], 0.5 * widest)
        if len(rows) > 2 and np.ptp(pair[0]) > 0.0 and np.ptp(_range(reported)) >= least:
            same = _likeness(recording, joint, rows)
            if same < _FOLLOWS:
                what = f"the truth does not follow the measured position (correlation {same:.2f})"
                yield Defect("fail", "arm", what, f"truth/{joint}", size=-same)
                return
    yield from _judge_limits(recording.robot.joint(joint), *_range(reported))


def _likeness(recording: Recording, joint: str, rows: Integers) -> float:
    """Best rank correlation of a truth with the measured position behind some slack."""
    name = f"measured/{joint}"
    span = float(np.ptp(_range(recording.column(name))))
    slacks = FeatureSet.parse([f"play({name}, {share * span:.4g})" for share in _SLACKS])
    ranks = rankdata(recording.column(f"truth/{joint}")[rows])
    followed = [place for place in slacks.compute(recording)[rows].T if np.ptp(place) > 0.0]
    return max((float(np.corrcoef(ranks, rankdata(p))[0, 1]) for p in followed), default=1.0)


def _judge_pair(truth: Array, reported: Array, joint: Joint) -> Defect | None:
    """Judge unit and sign of a truth (n,) beside the reported positions (n,)."""
    ratio = float(np.ptp(_range(truth))) / max(float(np.ptp(_range(reported))), 1e-12)
    if ratio > _RATIO or 0.0 < ratio < 1.0 / _RATIO:
        unit, display, wrong = joint.unit, display_unit(joint.unit), max(ratio, 1.0 / ratio)
        where, other = ("truth", "measured position") if ratio > 1.0 else ("measured", "truth")
        guess = f" (1 {unit} = {display.scale:.4g} {display.name})"
        what = f"it spans {wrong:.3g} times what the {other} does{guess}"
        advice = f"give both in {unit}: state the column's unit, as {display.name}, or its scale"
        return Defect("fail", "unit", what, f"{where}/{joint.name}", advice, size=wrong)
    if np.ptp(truth) > 0.0 and np.ptp(reported) > 0.0:
        same = float(np.corrcoef(rankdata(truth), rankdata(reported))[0, 1])
        if same < _OPPOSITE:
            what = f"the truth falls where the measured position rises (correlation {same:.2f})"
            return Defect("fail", "sign", what, f"truth/{joint.name}", size=-same)
    return None


def _judge_limits(joint: Joint, low: float, high: float) -> Iterable[Defect]:
    """Positions far outside the limits are in another unit; a little outside, limits are wrong."""
    travel, unit, name = joint.upper - joint.lower, joint.unit, f"measured/{joint.name}"
    advice = f"is it in {display_unit(unit).name}? state the unit of its column"
    if not math.isfinite(travel):
        if high - low > _FARTHEST.get(unit, math.inf):
            what = f"it spans {high - low:.4g} {unit}, more than a joint moves"
            yield Defect("fail", "unit", what, name, advice, size=high - low)
        return
    beyond = max(low - joint.upper, joint.lower - high, high - joint.upper, joint.lower - low)
    what = (
        f"it runs from {shown(low, unit)} to {shown(high, unit)}; the limits are "
        f"{shown(joint.lower, unit)} to {shown(joint.upper, unit)}"
    )
    if high - low > 1.5 * travel or beyond > 2.0 * travel:
        yield Defect("fail", "unit", what, name, advice, size=beyond)
    elif beyond > _SLACK * travel:
        yield Defect("warn", "limits", what, name, size=beyond)


def _range(values: Array) -> tuple[float, float]:
    """Range without the farthest 2 % at either end."""
    low, high = np.quantile(values, [0.02, 0.98])
    return float(low), float(high)


def left_out_zeros(
    recordings: Sequence[Recording], explained: Explained
) -> tuple[Array, Array, float]:
    """Offset (n,) of each of two or more recordings from what the others, with one zero, predict.

    Half the width (n,) of the loop left in each one's residual about it, and the median of the
    spreads of those [rad or m].
    """
    inputs = [(s.inputs - explained.centre) / explained.scale for s in explained.samples]
    designs = [np.hstack([x, np.ones((len(x), 1))]) for x in inputs]
    pairs = list(zip(designs, explained.samples, strict=True))
    normal = np.array([(d * s.weights[:, None]).T @ d for d, s in pairs])
    right = np.array([d.T @ (s.weights * s.error) for d, s in pairs])
    others = normal.sum(axis=0) - normal
    diagonal = np.arange(others.shape[1] - 1)
    others[:, diagonal, diagonal] += _RIDGE_LEFT_OUT * others[:, -1:, -1]
    solutions = np.linalg.solve(others, (right.sum(axis=0) - right)[:, :, None])[:, :, 0]
    residuals = [s.error - d @ x for (d, s), x in zip(pairs, solutions, strict=True)]
    zeros = np.array([np.median(residual) for residual in residuals])
    half_loops = np.zeros(len(zeros))
    for k, (recording, sample) in enumerate(zip(recordings, explained.samples, strict=True)):
        measured = recording.column(f"measured/{explained.joint}")
        way = direction(recording.t, measured)[sample.rows]
        if (way > 0.0).any() and (way < 0.0).any():
            up, down = np.median(residuals[k][way > 0.0]), np.median(residuals[k][way < 0.0])
            half_loops[k] = 0.5 * abs(up - down)
    spreads = [robust_spread(residual) for residual in residuals]
    return zeros, half_loops, float(np.median(spreads))
