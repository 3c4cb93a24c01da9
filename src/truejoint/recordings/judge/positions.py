"""Truth beside what the robot reports: sign, unit, outliers, zeros, delay, redundant sensors."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from truejoint.recordings.join.explained import SLOW, Explained, explain
from truejoint.recordings.join.lag import LATE, Lag, estimate_lag, lags_unlike_others
from truejoint.recordings.judge.finding import (
    Defect,
    Finding,
    Level,
    count,
    file_name,
    one_line_each,
    row_ranges,
    row_text,
)
from truejoint.recordings.judge.others import foreign, left_out_zeros
from truejoint.recordings.judge.outliers import FEWEST, Steps, find_steps
from truejoint.recordings.judge.scale import judge_scale
from truejoint.recordings.table.recording import Recording
from truejoint.units import shown

Marked = tuple[Defect, Recording]

REDUNDANT: Final = ("motor", "driver")  # quantities that tell the position of a joint once more
_MISLEADS: Final = 0.3  # spreads, that outliers add to the root mean square of the residual
_START: Final = 1.0  # s, in which an arm may still be settling
_MOVED: Final = 3.0  # spreads of a left-out recording
_MOVED_OF_NOISE: Final = 3.0  # and spreads of the residual of all together
_STEP_OF_REDUNDANT: Final = 0.6  # of the step that counts for the truth, which is noisier
_LATE_DROP: Final = 0.05  # of the residual's variance
_PERHAPS_DROP: Final = 0.02  # of that, for a word only
_SURE: Final = 5.0  # uncertainties
_PERHAPS: Final = 2.0  # of those, for a word only


def judge_positions(
    recordings: Sequence[Recording], joints: Sequence[str], broken: Collection[tuple[int, str]]
) -> Iterable[Finding]:
    """Judge `joints`; where sign or unit is wrong, or a sensor is `broken`, no further."""
    marked: list[Marked] = []
    judged: dict[str, list[Recording]] = {}
    for joint in joints:
        judged[joint] = []
        for recording in recordings:
            scale_defects = list(judge_scale(recording, joint))
            marked += [(defect, recording) for defect in scale_defects]
            sound = not any(d.level == "fail" for d in scale_defects)
            if sound and (id(recording), joint) not in broken:
                judged[joint].append(recording)
    truths: list[tuple[list[Recording], Explained]] = []
    for joint, whole in judged.items():
        with_truth = [r for r in whole if _truths(r, joint) >= FEWEST]
        if with_truth:
            explained = explain(with_truth, joint)
            cleaned, defects = _judge_truth(with_truth, explained)
            marked += defects
            truths.append((cleaned, explained))
        for quantity in REDUNDANT:
            marked += _judge_redundant(whole, joint, quantity)
    yield from one_line_each(marked, recordings)
    yield from _judge_delay(truths, recordings)
    if truths:
        yield from _judge_instruments(*truths[0])


def _truths(recording: Recording, joint: str) -> int:
    name = f"truth/{joint}"
    return int(np.isfinite(recording.column(name)).sum()) if name in recording.units else 0


def _judge_truth(
    recordings: Sequence[Recording], explained: Explained
) -> tuple[list[Recording], list[Marked]]:
    """Take the outliers out of recordings, and say what was found."""
    cleaned, defects = [], []
    column = f"truth/{explained.joint}"
    for recording in recordings:
        steps = find_steps(recording, explained)
        defects += [(d, recording) for d in _judge_steps(recording, explained, steps, "zero")]
        truth = recording.column(column).copy()
        truth[steps.outliers] = np.nan
        cleaned.append(replace(recording, table=recording.table.assign(**{column: truth})))
    return cleaned, defects + _judge_zeros(recordings, explained, "zero", defects)


def _judge_steps(
    recording: Recording, explained: Explained, steps: Steps, name: str
) -> Iterable[Defect]:
    column = f"{explained.quantity}/{explained.joint}"
    unit = recording.units[column]
    if len(steps.outliers):
        rows = row_ranges(steps.outliers)
        most = shown(float(np.abs(steps.size).max()), unit)
        weight = float(np.sqrt((steps.size**2).sum() / len(recording)))
        what = (
            f"{len(steps.outliers)} of {count(len(recording), 'row')} up to {most} off those "
            f"beside them ({row_text(rows)})"
        )
        level: Level = "fail" if weight > _MISLEADS * explained.spread else "warn"
        yield Defect(level, "outliers", what, column, rows=rows, size=weight)
    t = recording.t
    slow = np.median(np.diff(t)) > SLOW  # where honest motion steps too
    for row, rise in zip(steps.stays, steps.rise, strict=True):
        begins = t[row] - t[0] < _START
        what = f"it jumps by {shown(float(rise), unit)} at row {row} and stays"
        advice = "cut the start off" if begins else "cut the recording there, or record again"
        rows = ((int(row), int(row) + 1),)
        kind, harmless = "start" if begins else name, begins or slow
        yield Defect(
            "warn" if harmless else "fail", kind, what, column, advice, rows, abs(float(rise))
        )


def _judge_zeros(
    recordings: Sequence[Recording], explained: Explained, name: str, steps: Sequence[Marked]
) -> list[Marked]:
    """Find recordings whose zero is not that of the others, nor seen to step within them."""
    stepped = {id(recording) for defect, recording in steps if defect.name == name}
    if len(recordings) < 2:
        return []
    zeros = left_out_zeros(explained)
    column = f"{explained.quantity}/{explained.joint}"
    limit = max(_MOVED * zeros.spread, _MOVED_OF_NOISE * explained.spread)
    moved = []
    for number in np.flatnonzero(np.abs(zeros.offsets) > limit).tolist():
        recording, offset = recordings[number], float(zeros.raw[number])
        if id(recording) not in stepped:
            what = f"its zero is {shown(offset, recording.units[column])} off that of the others"
            advice = "re-zero, calibrate each homing on its own, or give each recording its zero"
            defect = Defect("fail", name, what, column, advice, size=abs(offset))
            moved.append((defect, recording))
    return moved[:1] if len(recordings) == 2 else moved


def _judge_redundant(recordings: Sequence[Recording], joint: str, quantity: str) -> list[Marked]:
    """Two sensors of one joint that disagree, in a recording or from a row on."""
    column = f"{quantity}/{joint}"
    moving = [
        r
        for r in recordings
        if len(r) >= FEWEST and column in r.units and np.ptp(r.column(column)) > 0.0
    ]
    if not moving:
        return []
    explained = explain(moving, joint, quantity)
    marked: list[Marked] = []
    for recording in moving:
        steps = find_steps(recording, explained, _STEP_OF_REDUNDANT)
        defects = _judge_steps(recording, explained, steps, "redundant")
        marked += [(defect, recording) for defect in defects]
    return marked + _judge_zeros(moving, explained, "redundant", marked)


def _judge_delay(
    truths: Sequence[tuple[list[Recording], Explained]], every: Sequence[Recording]
) -> Iterable[Finding]:
    """Truth that is late or early in all joints together, in single recordings or in all."""
    sources = [[r.provenance.source for r in recordings] for recordings, _ in truths]
    if not sources:
        return
    most = max(sources, key=sources.count)  # a joint is not judged where its sensor is broken
    alike = [pair for pair, names in zip(truths, sources, strict=True) if names == most]
    recordings, explained = [pair[0] for pair in alike], [pair[1] for pair in alike]
    where = ", ".join(f"truth/{e.joint}" for e in explained)
    together = estimate_lag(recordings, explained)
    single = [
        (replace(defect, where=where, size=abs(lag.seconds)), recordings[0][number])
        for number, lag in ([] if together.slow else lags_unlike_others(recordings, explained))
        for defect in _late(lag)
    ]
    if 0 < len(single) <= len(recordings[0]) / 2:
        yield from one_line_each(single, every)
    else:
        defect = (replace(defect, where=where) for defect in _late(together))
        yield from (Finding(f.level, f.name, f.what, f.where, f.advice) for f in defect)


def _late(lag: Lag) -> Iterable[Defect]:
    """Say how late the truth is, if that is not nothing; where rows are far apart, in any case."""
    beyond = abs(lag.seconds) >= LATE
    sure = beyond and lag.drop >= _LATE_DROP and abs(lag.seconds) > _SURE * lag.sd
    likely = beyond and abs(lag.seconds) > _PERHAPS * lag.sd
    likely = likely and (lag.slow or lag.drop >= _PERHAPS_DROP)
    if not (likely or lag.slow):
        return
    late = "behind" if lag.seconds > 0.0 else "ahead of"
    what = (
        f"the truth is {1e3 * abs(lag.seconds):.0f} ms {late} the robot's state "
        f"(+- {1e3 * lag.sd:.0f} ms)"
    )
    advice = "correct the clocks or shift the truth" if sure else "look at the clocks"
    yield Defect("fail" if sure else "warn" if likely else "info", "delay", what, "", advice)


def _judge_instruments(recordings: Sequence[Recording], explained: Explained) -> Iterable[Finding]:
    for index, times in foreign(explained):
        what = f"its signals lie {times:.0f} times as far from the others' as those from each other"
        advice = "is it of another instrument, or another motion? keep those apart"
        where = file_name(recordings[index])
        yield Finding("warn", "instrument", what, where, advice)
