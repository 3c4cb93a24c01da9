"""Defects of single columns: clock, lost rows, missing truth, wraps, sensors that stand still."""

import math
from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np

from truejoint.array_types import Array, Integers, Mask
from truejoint.recordings.judge.finding import Defect, Level
from truejoint.recordings.table.recording import Recording, runs
from truejoint.recordings.table.stream import GAP_STEPS, gaps
from truejoint.units import plural

_SATURATED: Final = 0.05  # of the range, that the joint moves on while its sensor does not
_OFTEN: Final = 3  # times that it does so by half of that, which tell as much
_FEWEST: Final = 50  # rows with truth of which it can be said that a sensor stands
_LEAP: Final = 5.0  # usual steps, with which a sensor that stood while its joint moved goes on
_MANY_SIZES: Final = 3.0  # times the smallest step
_PUSHES: Final = 1.2  # times the largest effort elsewhere
_ODD_STEPS: Final = (1e-5, 60.0)  # s; a clock outside is hardly one in seconds


def judge_columns(
    recording: Recording, joints: Sequence[str], signals: Sequence[str], *, needs_truth: bool
) -> Iterable[Defect]:
    """Examine measured and true positions of `joints`, and whether `signals`, columns, vary."""
    yield from _clock(recording.t)
    counts = recording.provenance.dropped.items()  # without truth a row is kept
    dropped = {why: n for why, n in counts if not why.startswith(("truth: ", "no truth: "))}
    if dropped:
        total = sum(n for why, n in dropped.items() if not why.startswith("bytes "))
        share = total / (total + len(recording))
        reasons = ", ".join(f"{n} {reason}" for reason, n in dropped.items())
        which = f"{plural(total, 'row')} ({100 * share:.2g} %)"
        what = f"{which} dropped when the file was read: {reasons}"
        yield Defect("warn" if share > 0.05 else "info", "dropped", what, "rows", size=share)
    for name in signals:
        values = recording.column(name)
        used = name.partition("/")[2] not in recording.robot.unused_channels
        if used and values.min() == values.max():
            what = f"the signal is {values[0]:.4g} in every row"
            yield Defect("warn", "constant", what, name, size=1.0)
    for joint in joints:
        measured = recording.column(f"measured/{joint}")
        yield from _jumps(recording, f"measured/{joint}", np.arange(len(recording)))
        if f"truth/{joint}" not in recording.units:
            continue
        truth = recording.column(f"truth/{joint}")
        has_truth = np.isfinite(truth)
        rows = np.flatnonzero(has_truth)
        if needs_truth:
            yield from _missing_truth(recording.t, joint, has_truth)
            if len(rows) and np.ptp(truth[rows]) and (truth[rows] == measured[rows]).all():
                what, advice = "it is the measured position", "name the column of the joint sensor"
                yield Defect("fail", "missing", what, f"truth/{joint}", advice, size=1.0)
        yield from _repeats(recording.t[rows], truth[rows], measured[rows], f"truth/{joint}")
        yield from _repeats(recording.t[rows], measured[rows], truth[rows], f"measured/{joint}")
        if len(rows) >= 2:
            yield from _jumps(recording, f"truth/{joint}", rows)
        if len(rows) >= _FEWEST:
            yield from _stands(recording, joint, rows)


def _clock(t: Array) -> Iterable[Defect]:
    step = np.diff(t)
    usual = float(np.median(step))
    # Whole numbers but for what scaling them to milliseconds left.
    is_whole = np.abs(step - np.round(step)).max() < 1e-6
    whole = len(t) >= _FEWEST and usual > 1.0 and bool(is_whole)
    if whole or not _ODD_STEPS[0] < usual < _ODD_STEPS[1]:
        what = f"a row every {usual:.3g} s" + (", in whole numbers" if whole else "")
        yield Defect("warn", "rate", what, "time stamps", size=usual)
    after = gaps(t)
    if len(after):
        longest = float(step.max())
        lost = float(step[after].sum() / (t[-1] - t[0]))
        what = (
            f"{plural(len(after), 'gap')} longer than {GAP_STEPS:g} samples, up to {longest:.3g} "
            f"s, {100 * lost:.2g} % of the time"
        )
        rows = tuple((int(row), int(row) + 2) for row in after)
        yield Defect("warn", "gap", what, "time stamps", rows=rows, size=longest)
    irregular = float(np.mean(np.abs(step - usual) > 0.5 * usual))
    if irregular > 0.05:
        off = f"more than half off the median of {1e3 * usual:.4g} ms"
        what = f"{100 * irregular:.0f} % of the steps are {off}"
        level: Level = "info" if irregular < 0.2 else "warn"
        yield Defect(level, "clock", what, "time stamps", size=irregular)


def _repeats(t: Array, values: Array, other: Array, name: str) -> Iterable[Defect]:
    """Find a sensor that is new in every few rows only, while the other one moves on.

    Its steps are of many sizes; those of a coarse encoder are all alike.
    """
    new = np.flatnonzero(np.diff(values))
    if len(new) < _FEWEST:
        return
    moving = np.count_nonzero(np.diff(other))
    sizes = np.abs(np.diff(values)[new])
    times = float(np.median(np.diff(new)))
    if times >= 2.0 and moving > 1.5 * len(new) and np.median(sizes) > _MANY_SIZES * sizes.min():
        late = 0.5 * (times - 1.0) * float(np.median(np.diff(t)))
        what = f"a new value in every {times:.0f} rows only, so about {1e3 * late:.0f} ms late"
        yield Defect("warn", "repeats", what, name, size=times)


def _missing_truth(t: Array, joint: str, has_truth: Mask) -> Iterable[Defect]:
    share = 1.0 - float(has_truth.mean())
    if share > 0.05:
        what = f"{100 * share:.0f} % of the rows have no true position"
        level: Level = "fail" if share > 0.5 else "warn"
        yield Defect(level, "missing", what, f"truth/{joint}", size=share)
    silent = float(t[-1] - t[has_truth][-1]) if has_truth.any() else 0.0
    if silent > 0.1 * (t[-1] - t[0]):
        what = f"the truth stops {silent:.1f} s before the end"
        advice = "the joint sensor stopped; what follows is not used"
        yield Defect("warn", "missing", what, f"truth/{joint}", advice, size=silent)


def _jumps(recording: Recording, name: str, rows: Integers) -> Iterable[Defect]:
    """Find steps far beyond what the joint does otherwise; whole turns are encoder wraps.

    Other steps of the truth are judged beside what the robot's signals explain (`outliers`).
    """
    t, values = recording.t[rows], recording.column(name)[rows]
    size = np.abs(np.diff(values))
    size[gaps(t)] = 0.0
    far = (size > 6.0 * np.quantile(size, 0.99)) & (size > 0.1 * np.ptp(values))
    if not far.any():
        return
    unit, largest = recording.units[name], float(size.max())
    turns = size[far] / (2.0 * math.pi)
    whole = np.round(turns)
    wrapped = unit == "rad" and bool(np.all((np.abs(turns - whole) < 0.02) & (whole >= 1)))
    if not wrapped and name.startswith("truth/"):
        return
    places = np.flatnonzero(far)
    what = (
        f"{plural(len(places), 'whole turn' if wrapped else 'sudden jump')}, the first at "
        f"{t[places[0] + 1]:.3f} s, the largest {largest:.3g} {unit}"
    )
    where = tuple((int(rows[k]), int(rows[k + 1]) + 1) for k in places)
    kind = "wrap" if wrapped else "jump"
    yield Defect("fail" if wrapped else "warn", kind, what, name, rows=where, size=largest)


def _stands(recording: Recording, joint: str, rows: Integers) -> Iterable[Defect]:
    """Find a sensor that repeats one value, in `rows` with truth, while its joint moves far.

    At an end of its own range it is saturated, and the other end needs to move only outwards and
    only a little: at a turning point with slack it moves back. A motor that stands where it was
    sent is none, though a load turns its joint; but from where it stands it goes on without a leap.
    A truth that stands while the motor pushes as it does nowhere else is at a stop.
    """
    t, table, count = recording.t[rows], recording.table, len(recording)
    truth, measured = (table[f"{q}/{joint}"].to_numpy()[rows] for q in ("truth", "measured"))
    # Where the motor was sent; NaN where nothing says so, and it may have moved. Under a stated
    # load without a set-point it counts as sent nowhere while it stands.
    nowhere = np.full(count, 0.0 if recording.provenance.load > 0.0 else math.nan)
    target = np.asarray(table.get(f"setpoint/{joint}", nowhere))[rows]
    effort = np.asarray(table.get(f"effort/{joint}", np.zeros(count)))[rows]
    for name, still, other in (("truth", truth, measured), ("measured", measured, truth)):
        span = float(np.ptp(other))
        repeats = runs(np.diff(still) == 0.0)
        if name == "measured":
            steps = np.append(np.abs(np.diff(still)), 0.0)
            leap = _LEAP * np.median(steps[steps > 0.0]) if steps.any() else 0.0
            repeats = [
                (a, b)
                for a, b in repeats
                if steps[b] > leap or not np.ptp(target[a : b + 1]) < 0.5 * np.ptp(other[a : b + 1])
            ]
        if not repeats or span == 0.0:
            continue
        way = float(np.sign(np.corrcoef(truth, measured)[0, 1])) if np.ptp(still) > 0.0 else 0.0
        clipped = []
        for end, outwards in ((still.max(), way), (still.min(), -way)):
            at_end = [run for run in repeats if still[run[0]] == end]
            ways = []
            for a, b in at_end:
                # How far outwards from both ends, its first if all ends, a quarter is.
                stretch = outwards * other[a : b + 1]
                ends = stretch[:1] if b == len(other) - 1 else stretch[[0, -1]]
                ways.append(float(np.quantile(stretch, 0.75) - ends.max()) / span)
            often = sum(share > 0.5 * _SATURATED for share in ways) >= _OFTEN
            least = 0.5 * _SATURATED if often else _SATURATED
            clipped += [run for run, share in zip(at_end, ways, strict=True) if share > least]
        first, last = max(repeats, key=lambda run: run[1] - run[0])
        if clipped:
            inside = np.zeros(len(still), dtype=np.bool_)
            for a, b in clipped:
                inside[a : b + 1] = True
            held = int(inside.sum())
            where = tuple((int(rows[a]), int(rows[b]) + 1) for a, b in clipped)
            if name == "truth" and pushes(effort, inside):
                what = f"{plural(held, 'row')} at a mechanical stop: the motor goes on and pushes"
                yield Defect("warn", "stop", what, f"truth/{joint}", rows=where, size=held)
                continue
            what = f"{plural(held, 'row')} stand at an end of its range, while the joint moves on"
            share = held / len(still)
            yield Defect("fail", "saturated", what, f"{name}/{joint}", rows=where, size=share)
        # Less may be honest slack; single rows may be outliers.
        elif np.ptp(np.quantile(other[first : last + 1], [0.1, 0.9])) > 0.2 * span:
            seconds = float(t[last] - t[first])
            what = (
                f"the sensor repeats one value for {seconds:.1f} s, from {t[first]:.1f} s, while "
                "the joint moves"
            )
            where = ((int(rows[first]), int(rows[last]) + 1),)
            yield Defect("fail", "frozen", what, f"{name}/{joint}", rows=where, size=seconds)


def pushes(effort: Array, inside: Mask) -> bool:
    """Whether an effort (n,) is larger in the rows `inside` than in the others."""
    size = np.abs(effort - np.median(effort))
    return bool(np.quantile(size[inside], 0.9) > _PUSHES * np.quantile(size[~inside], 0.98))
