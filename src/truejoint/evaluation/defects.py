"""Defects of one recording: gaps, jumps, wraps, frozen signals, truth that is missing."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from truejoint.array_types import Array, Mask
from truejoint.evaluation.signals import GAP_STEPS, gaps
from truejoint.recordings.recording import Recording, runs


@dataclass(frozen=True)
class Finding:
    """One thing that a data check found.

    Attributes
    ----------
    level : {"fail", "warn", "info"}
        ``"fail"``: results on these data would mislead; ``"warn"``: look before you trust them.
    what : str
        What was seen, with its number.
    where : str
        Which joint, signal and recordings.
    advice : str
        What to do about it.

    Examples
    --------
    >>> Finding("warn", "1 % of the truth is missing", "jaw", "look at the sensor").level
    'warn'
    """

    level: Literal["fail", "warn", "info"]
    what: str
    where: str
    advice: str


@dataclass(frozen=True)
class Defect(Finding):
    """A defect of one recording; `size` orders those with the same `where` and `advice`."""

    size: float


def find_defects(
    recording: Recording, joints: Sequence[str], signals: Sequence[str]
) -> Iterable[Defect]:
    """Everything about a recording that would mislead a calibration or a test.

    Of `joints` the measured and true positions are examined, of the columns `signals`, which a
    model reads, whether they vary. Raises RecordingError if a column is missing.
    """
    yield from _clock(recording.t)
    yield from _dropped(recording)
    for name in signals:
        values = recording.column(name)
        used = name.partition("/")[2] not in recording.robot.unused_channels
        if used and values.min() == values.max():
            what = f"the signal is {values[0]:.4g} in every row"
            advice = "a model learns nothing from it; is the sensor connected?"
            yield Defect("warn", what, name, advice, 1.0)
    for joint in joints:
        measured = recording.column(f"measured/{joint}")
        yield from _jumps(recording, f"measured/{joint}", recording.t, measured)
        if f"truth/{joint}" in recording.units:
            truth = recording.column(f"truth/{joint}")
            known = np.isfinite(truth)
            yield from _missing_truth(recording.t, joint, known)
            if known.sum() >= 2:
                t = recording.t[known]
                yield from _jumps(recording, f"truth/{joint}", t, truth[known])
                yield from _frozen(joint, t, truth[known], measured[known])


def _clock(t: Array) -> Iterable[Defect]:
    step = np.diff(t)
    usual = float(np.median(step))
    after = gaps(t)
    if len(after):
        longest = float(step.max())
        lost = float(step[after].sum() / (t[-1] - t[0]))
        what = (
            f"{_count(len(after), 'gap')} longer than {GAP_STEPS:g} samples, up to {longest:.3g} "
            f"s, {100 * lost:.2g} % of the time"
        )
        advice = (
            "a model with history starts anew after each; look for lost messages or a clock jump"
        )
        yield Defect("warn", what, "time stamps", advice, longest)
    irregular = float(np.mean(np.abs(step - usual) > 0.5 * usual))
    if irregular > 0.05:
        what = (
            f"{100 * irregular:.0f} % of the steps are more than half off the median of "
            f"{1e3 * usual:.4g} ms"
        )
        advice = "record stamps of the sensor rather than of arrival"
        yield Defect("info" if irregular < 0.2 else "warn", what, "time stamps", advice, irregular)


def _dropped(recording: Recording) -> Iterable[Defect]:
    dropped = {reason: n for reason, n in recording.provenance.dropped.items() if n}
    total = sum(dropped.values())
    share = total / (total + len(recording))
    if total:
        reasons = ", ".join(f"{n} {reason}" for reason, n in dropped.items())
        what = (
            f"{_count(total, 'row')} ({100 * share:.2g} %) dropped when the file was read: "
            f"{reasons}"
        )
        advice = "look at the streams if the share is not what you expect"
        yield Defect("warn" if share > 0.05 else "info", what, "rows", advice, share)


def _missing_truth(t: Array, joint: str, known: Mask) -> Iterable[Defect]:
    share = 1.0 - float(known.mean())
    if share > 0.05:
        what = f"{100 * share:.0f} % of the rows have no true position"
        advice = "only rows with truth are used; check the joint sensor and its clock"
        yield Defect("fail" if share > 0.5 else "warn", what, f"truth/{joint}", advice, share)
    silent = float(t[-1] - t[known][-1]) if known.any() else 0.0
    if silent > 0.1 * (t[-1] - t[0]):
        what = f"the truth stops {silent:.1f} s before the end"
        advice = "the joint sensor stopped; what follows is not used"
        yield Defect("warn", what, f"truth/{joint}", advice, silent)


def _jumps(recording: Recording, name: str, t: Array, values: Array) -> Iterable[Defect]:
    """Find steps far beyond what the joint does otherwise; whole turns are encoder wraps."""
    size = np.abs(np.diff(values))
    size[gaps(t)] = 0.0
    far = (size > 6.0 * np.quantile(size, 0.99)) & (size > 0.1 * np.ptp(values))
    if not far.any():
        return
    unit, largest = recording.units[name], float(size.max())
    turns = size[far] / (2.0 * math.pi)
    whole = np.round(turns)
    wrapped = unit == "rad" and bool(np.all((np.abs(turns - whole) < 0.02) & (whole >= 1)))
    what = (
        f"{_count(int(far.sum()), 'whole turn' if wrapped else 'sudden jump')}, the first at "
        f"{t[int(np.argmax(far)) + 1]:.3f} s, the largest {largest:.3g} {unit}"
    )
    advice = "unwrap the encoder before use" if wrapped else "cut the rows out or record again"
    yield Defect("fail" if wrapped else "warn", what, name, advice, largest)


def _frozen(joint: str, t: Array, truth: Array, measured: Array) -> Iterable[Defect]:
    """Find a sensor that repeats one value while the other end of the cable moves far.

    Far is a quarter of the covered range: less may be honest backlash.
    """
    for name, still, other in (("truth", truth, measured), ("measured", measured, truth)):
        repeats = runs(np.diff(still) == 0.0)
        first, last = max(repeats, key=lambda run: run[1] - run[0], default=(0, 0))
        moved, span = np.ptp(other[first : last + 1]), np.ptp(other)
        if span > 0.0 and moved > 0.25 * span:
            seconds = float(t[last] - t[first])
            what = (
                f"the sensor repeats one value for {seconds:.1f} s, from {t[first]:.1f} s, while "
                "the joint moves"
            )
            advice = "check the sensor; cut the stretch out before fitting or judging"
            yield Defect("fail", what, f"{name}/{joint}", advice, seconds)


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}" + ("" if number == 1 else "s")
