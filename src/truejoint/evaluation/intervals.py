"""How often the truth of the test lay within the interval that the calibration states."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from truejoint.array_types import Array, Mask
from truejoint.calibration.calibration import Calibration
from truejoint.calibration.interval import Interval
from truejoint.calibration.zero import at_start, zeroed
from truejoint.evaluation.judge import spread
from truejoint.evaluation.results import IntervalScore, Trace, known_loads
from truejoint.recordings.table.recording import Recording

_WANTED: Final = 0.9  # level of the band, where it is stated
_NAMED: Final = 4  # recordings that a sentence names


@dataclass(frozen=True, eq=False)
class _Motion:
    """One recording as the interval sees it: rows with truth, re-zeroed where that is asked."""

    homing: str
    trace: Trace  # with bounds where the interval holds, NaN in rows that the re-zeroing used
    error: Array  # (n, n_joints)
    widening: Array  # (n,)
    scored: Mask  # (n,), rows that the re-zeroing did not use
    objection: str  # why coverage on it would mislead


def judge_interval(
    calibration: Calibration, recordings: Sequence[Recording], traces: Sequence[Trace]
) -> dict[str, Any]:
    """Judge the interval of a calibration on recordings that no part of it saw.

    Recordings on which it would mislead are left out and named. A recording counts as one
    trajectory; where the interval holds after any homing, all recordings after one homing do.
    Gives what `Evaluation` says of intervals, by attribute, and `traces` with bounds.
    """
    calibration = calibration if calibration.interval else calibration.for_rezeroing
    interval = calibration.interval
    if interval is None:
        return {"traces": tuple(traces)}
    stated = [float(level) for level in interval.levels]
    level = min(stated, key=lambda value: (abs(value - _WANTED), -value))
    motions = [
        _motion(calibration, level, recording, trace)
        for recording, trace in zip(recordings, traces, strict=True)
    ]
    judged = [motion for motion in motions if not motion.objection]
    units: dict[str, list[_Motion]] = {}
    for motion in judged:
        shared = motion.homing and interval.homings > 1 and interval.rezero == 0.0
        name = f"homing {motion.homing}" if shared else motion.trace.name
        units.setdefault(name, []).append(motion)
    objections = []
    for reason in dict.fromkeys(motion.objection for motion in motions if motion.objection):
        names = [motion.trace.name for motion in motions if motion.objection == reason]
        more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
        listed = "; ".join(names[:_NAMED]) + more
        objections.append(f"Coverage is not judged on {listed}: {reason}.")
    return {
        "intervals": tuple(_scores(calibration, list(units.values()))),
        "interval_trajectories": tuple(units),
        "interval_level": level,
        "interval_note": _note(calibration, level, judged),
        "interval_objections": tuple(objections),
        "traces": tuple(motion.trace for motion in motions),
    }


def _motion(calibration: Calibration, level: float, recording: Recording, trace: Trace) -> _Motion:
    interval, joints = calibration.required_interval(), calibration.joints
    truth = recording.columns("truth", joints)
    has_truth = np.isfinite(truth).all(axis=1)
    scored = ~at_start(recording.t[has_truth], interval.rezero)
    calibration = zeroed(calibration, recording, interval.rezero)
    position = calibration.correct(recording)[has_truth]
    error = truth[has_truth] - position
    widening = 1.0 + interval.growth * calibration.range_excess(recording)[has_truth]
    homing, own = recording.provenance.homing_id, _own_homings(calibration)
    holds = _allows_offset(interval) or not own or not homing or homing in own
    if holds and scored.any():
        half = np.where(scored, widening, math.nan)[:, None] * interval.half_width(level)
        shown = np.isin(recording.t[has_truth], trace.t)
        trace = replace(trace, lower=(position - half)[shown], upper=(position + half)[shown])
    objection = ""
    if calibration.origin.includes(recording):
        objection = "used in the fit"
    elif calibration.origin.interval_includes(recording):
        objection = "used to make the interval"
    elif not holds:
        homings = ", ".join(sorted(own))
        objection = f"the interval holds after the homing {homings}, not after another"
    elif not scored.any():
        objection = f"all truth lies within the {interval.rezero:g} s that re-zero the model"
    return _Motion(homing, trace, error, widening, scored, objection)


def _allows_offset(interval: Interval) -> bool:
    """Whether the interval holds after a fresh homing, which brings an offset."""
    return interval.rezero > 0.0 or interval.homings > 1


def _own_homings(calibration: Calibration) -> set[str]:
    """Homings of the interval's recordings or, where the model was re-zeroed since, that one."""
    if calibration.zero is not None:
        return {calibration.zero.homing_id} - {""}
    return {session.homing_id for session in calibration.origin.interval_sessions} - {""}


def _scores(
    calibration: Calibration, units: Sequence[Sequence[_Motion]]
) -> Iterator[IntervalScore]:
    """Score every level and joint on trajectories, each of one or several recordings."""
    interval = calibration.required_interval()
    errors = [np.concatenate([m.error[m.scored] for m in unit]) for unit in units]
    widenings = [np.concatenate([m.widening[m.scored] for m in unit]) for unit in units]
    for row, level in enumerate(interval.levels if units else ()):
        base = interval.half_widths[row]
        allowed = [widening[:, None] * base for widening in widenings]
        inside = [np.abs(e) <= most for e, most in zip(errors, allowed, strict=True)]
        shares = np.array([rows.mean(axis=0) for rows in inside])
        sampling = spread(shares) / math.sqrt(len(units))
        half_width = base * np.mean([widening.mean() for widening in widenings])
        for k, joint in enumerate(calibration.joints):
            yield IntervalScore(
                joint=joint,
                unit=calibration.units[f"measured/{joint}"],
                level=float(level),
                coverage=float(shares[:, k].mean()),
                standard_error=float(sampling[k]),
                half_width=float(half_width[k]),
                offset_half_width=float(interval.offset_half_widths[row, k]),
                shares=tuple(float(share) for share in shares[:, k]),
            )


def _note(calibration: Calibration, level: float, judged: Sequence[_Motion]) -> str:
    interval = calibration.required_interval()
    note = f"Stated {interval.meaning}."
    if judged:
        n = interval.whole or interval.trajectories
        inside = min(n, math.ceil(level * (n + 1) - 1e-9))
        # Coverage given the set is Beta(inside, n + 1 - inside) when trajectories lie wholly
        # inside or outside (Vovk, arXiv:1209.2673); samples that vary on their own average out.
        scatter = math.sqrt(inside * (n + 1 - inside) / ((n + 1) ** 2 * (n + 2)))
        what = "recordings" if interval.whole else "trajectories"
        note += (
            f" From one set of {n} {what} to another its coverage scatters by up to about "
            f"{100 * scatter:.0f} %, which the sampling error of this test does not include."
        )
    if interval.rezero > 0.0:
        note += (
            f" Coverage and bands are of positions re-zeroed from the first {interval.rezero:g} s "
            "of each recording, whatever other numbers are of."
        )
    stated = [session.load for session in calibration.origin.interval_sessions]
    seen = [load for load in stated if not math.isnan(load)]
    loads = known_loads([motion.trace for motion in judged])
    beyond = [load for load in loads if seen and not min(seen) <= load <= max(seen)]
    if beyond:
        masses = ", ".join(f"{1e3 * load:.0f} g" for load in beyond)
        note += f" The test hangs masses on the tool that the interval has not seen ({masses})."
    named = _own_homings(calibration) and all(motion.homing for motion in judged)
    if not named and not _allows_offset(interval):
        note += " Not all recordings name their homing; it is taken to be the same one."
    return note
