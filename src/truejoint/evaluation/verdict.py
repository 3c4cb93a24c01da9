"""The verdict: is the chosen model good enough, and may the test be believed."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from numbers import Real
from pathlib import PurePath
from typing import Any

from truejoint.array_types import Array
from truejoint.calibration.conformal import trained_on
from truejoint.errors import CalibrationError, unknown
from truejoint.evaluation.digits import shown
from truejoint.evaluation.results import OFFSET, JointVerdict, Score, Verdict, estimator_phrase
from truejoint.recordings.recording import Recording
from truejoint.units import display_unit


def judge(
    scores: Sequence[Score],
    chosen: str,
    *,
    tolerance: Mapping[str, float] | None = None,
    objections: Sequence[str] = (),
    remarks: Sequence[str] = (),
) -> Verdict:
    """Verdict on the RMSE of the chosen model in every joint.

    Parameters
    ----------
    scores : sequence of Score
        Rows of all estimators; those of `chosen` and of the fixed offset are needed.
    chosen : str
    tolerance : mapping of str to float, optional
        Largest RMSE [rad or m] that the user accepts, by joint. A joint without one must beat
        the fixed offset.
    objections, remarks : sequence of str
        Reasons not to believe the test, of which any fails the verdict, and what else is to know.

    Raises
    ------
    CalibrationError
        If a tolerance names no calibrated joint or is not a positive number.

    Examples
    --------
    >>> judge(evaluation.scores, "linear", tolerance={"jaw": 1e-6}).passed
    False
    """
    rows = {(row.estimator, row.joint): row for row in scores}
    joints = list(dict.fromkeys(row.joint for row in scores))
    limits = _checked_tolerance(tolerance or {}, joints)
    verdicts = []
    for joint in joints:
        row = rows[chosen, joint]
        stated = joint in limits
        limit = limits[joint] if stated else rows[OFFSET, joint].rmse
        passed = row.rmse <= limit if stated else row.rmse < limit
        verdicts.append(JointVerdict(joint, row.unit, row.rmse, limit, stated, passed))
    return Verdict(
        passed=all(v.passed for v in verdicts) and not objections,
        text=_text(chosen, verdicts, objections),
        rule=_rule(verdicts),
        joints=tuple(verdicts),
        objections=tuple(objections),
        remarks=(*remarks, *_better_models(scores, verdicts)),
    )


def _checked_tolerance(tolerance: Mapping[str, float], joints: Sequence[str]) -> dict[str, float]:
    if not isinstance(tolerance, Mapping):
        example = f"{{{joints[0]!r}: {tolerance!r:.20}}}"
        raise CalibrationError(f"tolerance {tolerance!r:.60} is of no joint; write {example}")
    for joint, value in tolerance.items():
        if joint not in joints:
            raise CalibrationError(f"tolerance: {unknown('calibrated joint', joint, joints)}")
        if not (isinstance(value, Real) and value > 0.0 and math.isfinite(value)):
            raise CalibrationError(
                f"the tolerance of {joint} is {value!r:.60}; state a positive number"
            )
    return dict(tolerance)


def _rule(verdicts: Sequence[JointVerdict]) -> str:
    stated = [v for v in verdicts if v.stated]
    if not stated:
        return (
            "No tolerance was stated, so a joint passes when its RMSE is below that of the fixed "
            "offset."
        )
    rule = "A joint passes when its RMSE is within the tolerance stated for it."
    others = [v.joint for v in verdicts if not v.stated]
    if others:
        rule += f" No tolerance was stated for {_and(others)}: below the fixed offset passes."
    return rule


def _text(chosen: str, verdicts: Sequence[JointVerdict], objections: Sequence[str]) -> str:
    if objections:
        return f"This test cannot be believed: {objections[0]}."
    title = estimator_phrase(chosen)
    title = title[:1].upper() + title[1:]
    bad = [v for v in verdicts if not v.passed]
    if bad:
        parts = [_beside(v) for v in bad]
        count = f"{len(bad)} of {len(verdicts)} joints" if len(verdicts) > 1 else "the joint"
        return f"{title} is not good enough in {count}: {_and(parts)}."
    subject = "the joint" if len(verdicts) == 1 else f"all {len(verdicts)} joints"
    if not any(v.stated for v in verdicts):
        return f"{title} is closer to the truth than a fixed offset in {subject}."
    if all(v.stated for v in verdicts):
        return f"{title} is within the stated tolerance in {subject}."
    return f"{title} is within tolerance, or below the fixed offset where none is stated."


def _beside(verdict: JointVerdict) -> str:
    unit = display_unit(verdict.unit)
    value, limit = shown([verdict.rmse * unit.scale, verdict.limit * unit.scale])
    against = "tolerance" if verdict.stated else "fixed offset"
    return f"{verdict.joint} {value} {unit.name} against a {against} of {limit} {unit.name}"


def _better_models(scores: Sequence[Score], verdicts: Sequence[JointVerdict]) -> tuple[str, ...]:
    """Say where another estimator of the table beats the chosen one."""
    better = []
    for own in verdicts:
        best = min((row for row in scores if row.joint == own.joint), key=lambda row: row.rmse)
        if best.rmse < own.rmse:
            unit = display_unit(own.unit)
            value, ours = shown([best.rmse * unit.scale, own.rmse * unit.scale])
            name = estimator_phrase(best.estimator)
            better.append(f"{name} in {own.joint} ({value} against {ours} {unit.name})")
    return (f"Smaller RMSE: {_and(better)}.",) if better else ()


def _and(parts: Sequence[str]) -> str:
    return parts[0] if len(parts) == 1 else ", ".join(parts[:-1]) + " and " + parts[-1]


def seen_in_training(
    metadata: Mapping[str, Any], recordings: Sequence[Recording]
) -> tuple[str, ...]:
    """Object to each test recording whose rows were in the training (`trained_on`)."""
    seen = [_name(r) or "a recording" for r in recordings if trained_on(metadata, r)]
    return tuple(f"the model was trained on rows of {n}, which it is tested on" for n in seen)


def remarks_on(metadata: Mapping[str, Any], recordings: Sequence[Recording]) -> Iterator[str]:
    """Tell of homings of the test that training has not seen, and of truth that re-zeroed."""
    known = set(metadata.get("homing_ids", ()))
    other = sorted({r.provenance.homing_id for r in recordings} - known - {""})
    if known and other:
        yield (
            f"The test has homings that training has not seen ({', '.join(other[:4])}); positions "
            "of two homings differ by an offset that no model knows."
        )
    since = metadata.get("rezeroed") or {}
    for recording in recordings:
        source, homing = recording.provenance.source, recording.provenance.homing_id
        if source and (since.get("source"), since.get("homing_id")) == (source, homing):
            yield (
                f"The model was re-zeroed on truth of {_name(recording)}, which it is tested on; "
                "what is left of the offset shows only in other recordings."
            )
            return


def rezero_remark(
    verdict: Verdict, rezeroed: Mapping[str, Score], as_they_come: Array, duration: float
) -> Verdict:
    """Say what re-zeroing is worth: RMSE without it (n_joints,), by the fit for that, beside it."""
    better: list[str] = []
    worse: list[str] = []
    for (joint, score), plain in zip(rezeroed.items(), as_they_come.tolist(), strict=True):
        unit = display_unit(score.unit)
        before, after = shown([plain * unit.scale, score.rmse * unit.scale])
        harms = score.rmse > plain
        (worse if harms else better).append(f"{joint} {after} {unit.name} instead of {before}")
    start = f"from the first {duration:g} s of each recording"
    remarks = []
    if better:
        remarks.append(f"Re-zeroed {start}: {_and(better)} as positions come.")
    if worse:
        remarks.append(
            f"Re-zeroing {start} harms: {_and(worse)}. So short a stretch may be a part of a slow "
            "cycle, with errors all to one side: re-zero from a longer one, or leave it."
        )
    return replace(verdict, remarks=(*remarks, *verdict.remarks))


def _name(recording: Recording) -> str:
    return PurePath(recording.provenance.source).name
