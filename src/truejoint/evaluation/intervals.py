"""How often the truth of the test lay within the interval that the calibration states."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from truejoint.calibration.calibration import Calibration
from truejoint.calibration.conformal import (
    made_interval_of,
    trained_on,
    zero_offset,
)
from truejoint.calibration.interval import Interval
from truejoint.evaluation.results import IntervalScore, Trace
from truejoint.recordings.recording import Recording

Array = NDArray[np.float64]

_WANTED: Final = 0.9  # level of the band, where it is stated
_NAMED: Final = 4  # recordings that a sentence names


@dataclass(frozen=True, eq=False)
class IntervalFindings:
    """What a test says of a stated interval.

    Attributes
    ----------
    scores : tuple of IntervalScore
        Of every level and joint; empty where the note and the objections say why.
    trajectories : tuple of str
        What `IntervalScore.shares` are of.
    level : float
        Level of `Trace.lower` and `Trace.upper`; NaN without an interval.
    note : str
        What the interval is for, or that there is none.
    objections : tuple of str
        Recordings that it is not judged on, and why.
    traces : tuple of Trace
        Those given, with the bounds where the interval holds.
    """

    scores: tuple[IntervalScore, ...]
    trajectories: tuple[str, ...]
    level: float
    note: str
    objections: tuple[str, ...]
    traces: tuple[Trace, ...]


@dataclass(frozen=True, eq=False)
class _Motion:
    """One recording as the interval sees it: rows with truth, re-zeroed where that is asked.

    `error` and `position` are (n, n_joints), `widening` (n,); `scored` (n,) tells which rows the
    re-zeroing did not use.
    """

    homing: str
    trace: Trace
    error: Array
    position: Array
    widening: Array
    scored: NDArray[np.bool_]


def judge_interval(
    calibration: object, recordings: Sequence[Recording], traces: Sequence[Trace], chosen: str
) -> IntervalFindings:
    """Judge the interval of a calibration on recordings that no part of it saw.

    Recordings of the fit, those that the interval was made of, and those after a homing that it
    does not hold for are left out and named. A recording counts as one trajectory, and where the
    interval holds after any homing, all recordings after one homing do.

    Parameters
    ----------
    calibration : object
        A `Calibration` with an interval; of anything else there is nothing to tell.
    recordings : sequence of Recording
        Of the test.
    traces : sequence of Trace
        Of the same recordings, with the estimates of the calibration under `chosen`.
    chosen : str
    """
    interval = calibration.interval if isinstance(calibration, Calibration) else None
    if not isinstance(calibration, Calibration) or interval is None:
        note = "The model states no interval: it was not given recordings to make one of."
        return IntervalFindings((), (), math.nan, note, (), tuple(traces))
    motions = [
        _motion(calibration, interval, recording, trace, chosen)
        for recording, trace in zip(recordings, traces, strict=True)
    ]
    reasons = [
        _why_not(calibration, interval, r, m) for r, m in zip(recordings, motions, strict=True)
    ]
    judged = [motion for motion, reason in zip(motions, reasons, strict=True) if not reason]
    units = _units(judged, per_homing=_any_homing(interval))
    stated = [float(level) for level in interval.levels]
    level = min(stated, key=lambda value: (abs(value - _WANTED), -value))
    holds = [m.scored.any() and _holds(calibration, interval, m.homing) for m in motions]
    return IntervalFindings(
        scores=_scores(calibration, interval, units) if units else (),
        trajectories=tuple(units),
        level=level,
        note=_note(calibration, interval, level, judged),
        objections=_objections(reasons, [trace.name for trace in traces]),
        traces=tuple(
            _bounded(motion, interval.half_width(level)) if held else motion.trace
            for motion, held in zip(motions, holds, strict=True)
        ),
    )


def _motion(
    calibration: Calibration, interval: Interval, recording: Recording, trace: Trace, chosen: str
) -> _Motion:
    known = np.isfinite(recording.columns("truth", calibration.joints)).all(axis=1)
    position = trace.estimates[chosen]
    error = trace.truth - position
    scored = np.ones(len(error), dtype=bool)
    if interval.rezero > 0.0:
        shift, used = zero_offset(trace.t, error, interval.rezero)
        error, position, scored = error - shift, position + shift, ~used
    widening = 1.0 + interval.growth * calibration.range_excess(recording)[known]
    return _Motion(recording.provenance.homing_id, trace, error, position, widening, scored)


def _why_not(
    calibration: Calibration, interval: Interval, recording: Recording, motion: _Motion
) -> str:
    """Why coverage on a recording would mislead; empty when it would not."""
    if trained_on(calibration.metadata, recording):
        return "used in the fit"
    if made_interval_of(calibration.metadata, recording):
        return "used to make the interval"
    if not _holds(calibration, interval, motion.homing):
        homings = ", ".join(sorted(_own_homings(calibration)))
        return f"the interval holds after the homing {homings}, not after another"
    if not motion.scored.any():
        return f"all truth lies within the {interval.rezero:g} s that re-zero the model"
    return ""


def _any_homing(interval: Interval) -> bool:
    """Whether the interval allows for the offset that a fresh homing brings."""
    return interval.homings > 1 and interval.rezero == 0.0


def _own_homings(calibration: Calibration) -> set[str]:
    """Homings of the interval's recordings or, where the model was re-zeroed since, that one."""
    since = calibration.metadata.get("rezeroed")
    sessions = [since] if since else calibration.metadata.get("interval_sessions", ())
    return {str(session.get("homing_id", "")) for session in sessions} - {""}


def _holds(calibration: Calibration, interval: Interval, homing: str) -> bool:
    """Whether the interval holds after a homing, as far as recordings name theirs."""
    if interval.rezero > 0.0 or _any_homing(interval):
        return True
    own = _own_homings(calibration)
    return not own or not homing or homing in own


def _units(motions: Sequence[_Motion], *, per_homing: bool) -> dict[str, list[_Motion]]:
    """Trajectories by name: recordings, or all that share a homing's offset."""
    units: dict[str, list[_Motion]] = {}
    for motion in motions:
        name = f"homing {motion.homing}" if per_homing and motion.homing else motion.trace.name
        units.setdefault(name, []).append(motion)
    return units


def _scores(
    calibration: Calibration, interval: Interval, units: dict[str, list[_Motion]]
) -> tuple[IntervalScore, ...]:
    scores = []
    for row, level in enumerate(interval.levels):
        base = interval.half_widths[row]
        shares = np.array([_share_inside(unit, base) for unit in units.values()])
        widening = np.mean([_joined(unit, "widening").mean() for unit in units.values()])
        n = len(shares)
        error = shares.std(axis=0, ddof=1) / math.sqrt(n) if n > 1 else np.full(len(base), math.nan)
        scores += [
            IntervalScore(
                joint=joint,
                unit=calibration.units[f"measured/{joint}"],
                level=float(level),
                coverage=float(shares[:, k].mean()),
                standard_error=float(error[k]),
                half_width=float(base[k] * widening),
                offset_half_width=float(interval.offset_half_widths[row, k]),
                shares=tuple(float(share) for share in shares[:, k]),
            )
            for k, joint in enumerate(calibration.joints)
        ]
    return tuple(scores)


def _share_inside(unit: Sequence[_Motion], base: Array) -> Array:
    """Share (n_joints,) of a trajectory's samples within `base` (n_joints,), widened."""
    allowed = _joined(unit, "widening")[:, None] * base
    return np.asarray((np.abs(_joined(unit, "error")) <= allowed).mean(axis=0))


def _joined(unit: Sequence[_Motion], name: str) -> Array:
    return np.concatenate([getattr(motion, name)[motion.scored] for motion in unit])


def _bounded(motion: _Motion, base: Array) -> Trace:
    """Trace with the bounds of the interval; NaN in the rows that re-zeroing used."""
    half = np.where(motion.scored, motion.widening, math.nan)[:, None] * base
    return replace(motion.trace, lower=motion.position - half, upper=motion.position + half)


def _note(
    calibration: Calibration, interval: Interval, level: float, judged: Sequence[_Motion]
) -> str:
    note = f"Stated {interval.meaning}."
    if judged:
        n = interval.trajectories
        inside = math.ceil(level * (n + 1) - 1e-9)
        # Coverage given the set is Beta(inside, n + 1 - inside) when trajectories lie wholly
        # inside or outside (Vovk, arXiv:1209.2673); samples that vary on their own average out.
        scatter = math.sqrt(inside * (n + 1 - inside) / ((n + 1) ** 2 * (n + 2)))
        note += (
            f" From one set of {n} trajectories to another its coverage scatters by up to about "
            f"{100 * scatter:.0f} %, which the sampling error of this test does not include."
        )
    if interval.rezero > 0.0:
        note += (
            f" Coverage and bands are of positions re-zeroed from the first {interval.rezero:g} s "
            "of each recording; every other number is of positions as they come."
        )
    note += _other_loads(calibration, judged)
    if interval.rezero > 0.0 or _any_homing(interval):
        return note
    if not _own_homings(calibration) or any(not motion.homing for motion in judged):
        note += " Not all recordings name their homing; it is taken to be the same one."
    return note


def _other_loads(calibration: Calibration, judged: Sequence[_Motion]) -> str:
    """Tell masses [kg] of the test beyond those that the interval saw; empty without any."""
    sessions = calibration.metadata.get("interval_sessions", ())
    seen = [float(s["load"]) for s in sessions if s.get("load") is not None]
    loads = [motion.trace.provenance.get("load") for motion in judged]
    known = {float(load) for load in loads if load is not None}
    beyond = sorted(load for load in known if seen and not min(seen) <= load <= max(seen))
    if not beyond:
        return ""
    shown = ", ".join(f"{1e3 * load:.0f} g" for load in beyond)
    return f" The test hangs masses on the tool that the interval has not seen ({shown})."


def _objections(reasons: Sequence[str], names: Sequence[str]) -> tuple[str, ...]:
    """One sentence for each reason, with the recordings that it is for."""
    sentences = []
    for reason in dict.fromkeys(filter(None, reasons)):
        concerned = [name for name, why in zip(names, reasons, strict=True) if why == reason]
        listed = "; ".join(concerned[:_NAMED])
        more = len(concerned) - _NAMED
        listed += f" and {more} more" if more > 0 else ""
        sentences.append(f"Coverage is not judged on {listed}: {reason}.")
    return tuple(sentences)
