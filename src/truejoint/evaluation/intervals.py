"""How often the truth of the test lay within the interval that the calibration states."""

import math
from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np
import pandas as pd
from pandas import DataFrame
from scipy.special import stdtrit

from truejoint.array_types import Array
from truejoint.calibration.calibration import Calibration
from truejoint.calibration.interval import Interval
from truejoint.calibration.zero import at_start, zeroed
from truejoint.evaluation.results import by_recording
from truejoint.recordings.table.recording import Recording

_WANTED: Final = 0.9  # level of the band, where it is stated
_NAMED: Final = 4  # recordings that a sentence names


def judge_interval(
    calibration: Calibration, recordings: Sequence[Recording], rows: DataFrame
) -> dict[str, Any]:
    """Judge the interval of a calibration on recordings that no part of it saw.

    Recordings on which it would mislead are left out and named. A recording counts as one
    trajectory; where the interval holds after any homing, all recordings after one homing do.
    Gives what `Evaluation` says of intervals, by attribute, and its `rows` with bounds.
    """
    interval = calibration.interval
    if interval is None:
        return {"rows": rows}
    level = min(map(float, interval.levels), key=lambda value: (abs(value - _WANTED), -value))
    homings, bounds, judged = _own_homings(calibration), list[Array](), list[Recording]()
    names_of: dict[str, list[str]] = {}  # recordings, by why they are left out
    units: dict[str, list[tuple[Array, Array]]] = {}  # errors and widenings, by trajectory
    for recording, part in zip(recordings, by_recording(rows.index), strict=True):
        inputs, homing = calibration.rows(recording), recording.provenance.homing_id
        has_truth = inputs.has_truth
        scored = ~at_start(recording.t[has_truth], interval.rezero)
        model = zeroed(calibration, inputs, interval.rezero)
        position = model.correct(inputs)[has_truth]
        widening = 1.0 + interval.growth * model.range_excess(inputs)[has_truth]
        holds = _allows_offset(interval) or not homings or not homing or homing in homings
        half = np.where(scored & holds, widening, math.nan)[:, None] * interval.half_width(level)
        shown = np.isin(recording.t[has_truth], rows["t"].iloc[part])
        bounds.append(np.hstack([position - half, position + half])[shown])
        reason = ""
        if model.origin.includes(recording):
            reason = "used in the fit"
        elif model.origin.includes(recording, in_interval=True):
            reason = "used to make the interval"
        elif not holds:
            named = ", ".join(sorted(homings))
            reason = f"the interval holds after the homing {named}, not after another"
        elif not scored.any():
            reason = f"all truth lies within the {interval.rezero:g} s that re-zero the model"
        if reason:
            names_of.setdefault(reason, []).append(rows.index[part][0])
            continue
        judged.append(recording)
        shared = homing and interval.any_homing
        unit = units.setdefault(f"homing {homing}" if shared else rows.index[part][0], [])
        unit.append(((inputs.truth[has_truth] - position)[scored], widening[scored]))
    objections = []
    for reason, names in names_of.items():
        more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
        listed = "; ".join(names[:_NAMED]) + more
        objections.append(f"Coverage is not judged on {listed}: {reason}.")
    places = pd.MultiIndex.from_product([("lower", "upper"), calibration.joints])
    bounded = DataFrame(np.concatenate(bounds), rows.index, places)
    return {
        "intervals": DataFrame(_scores(calibration, list(units.values()))),
        "interval_trajectories": tuple(units),
        "interval_level": level,
        "interval_note": _note(calibration, level, judged),
        "interval_objections": tuple(objections),
        "rows": pd.concat([rows, bounded], axis=1),
    }


def _allows_offset(interval: Interval) -> bool:
    """Whether the interval holds after a fresh homing, which brings an offset."""
    return interval.rezero > 0.0 or interval.any_homing


def _own_homings(calibration: Calibration) -> set[str]:
    """Homings of the interval's recordings or, where the model was re-zeroed since, that one."""
    if calibration.zero is not None:
        return {calibration.zero.homing_id} - {""}
    return {session.homing_id for session in calibration.origin.interval_sessions} - {""}


def _scores(
    calibration: Calibration, units: Sequence[Sequence[tuple[Array, Array]]]
) -> Iterator[dict[str, Any]]:
    """Score every level and joint on errors and widenings of trajectories, by recording."""
    interval = calibration.required_interval()
    errors, widenings = (
        [np.concatenate([pair[k] for pair in unit]) for unit in units] for k in range(2)
    )
    for row, level in enumerate(interval.levels if units else ()):
        base = interval.half_widths[row]
        allowed = [widening[:, None] * base for widening in widenings]
        inside = [np.abs(e) <= most for e, most in zip(errors, allowed, strict=True)]
        shares = np.array([rows.mean(axis=0) for rows in inside])
        half_width = base * np.mean([widening.mean() for widening in widenings])
        for k, joint in enumerate(calibration.joints):
            yield {
                "joint": joint,
                "unit": calibration.units[f"measured/{joint}"],
                "level": float(level),
                **coverage_of(shares[:, k], level),
                "half_width": half_width[k],
                "shares": tuple(shares[:, k].tolist()),
            }


def coverage_of(shares: Array, level: float) -> dict[str, Any]:
    """Mean of the shares (n,) inside, its sampling error, and whether it agrees with the level.

    It cannot be told of a single trajectory: NaN, and an empty text.
    """
    coverage, n = float(shares.mean()), len(shares)
    error, agreement = math.nan, ""
    if n > 1:
        error = float(shares.std(ddof=1)) / math.sqrt(n)
        margin = float(stdtrit(n - 1, 0.975)) * error
        agreement = "agrees"
        if abs(coverage - level) > margin:
            agreement = "too few inside" if coverage < level else "more inside"
    return {"coverage": coverage, "standard_error": error, "agreement": agreement}


def _note(calibration: Calibration, level: float, judged: Sequence[Recording]) -> str:
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
    loads = {recording.provenance.load for recording in judged}
    beyond = sorted(load for load in loads if seen and (load < min(seen) or load > max(seen)))
    if beyond:
        masses = ", ".join(f"{1e3 * load:.0f} g" for load in beyond)
        note += f" The test hangs masses on the tool that the interval has not seen ({masses})."
    named = _own_homings(calibration) and all(r.provenance.homing_id for r in judged)
    if not named and not _allows_offset(interval):
        note += " Not all recordings name their homing; it is taken to be the same one."
    return note
