"""The verdict: is the chosen model good enough, may the test be believed, and what to deploy."""

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from pathlib import PurePath
from typing import Any, Final

import numpy as np
from pandas import DataFrame

from truejoint.array_types import Array
from truejoint.calibration.origin import Origin
from truejoint.calibration.zero import Zero
from truejoint.errors import CalibrationError, unknown
from truejoint.evaluation.paired_test import Outcome, compare, cycle_rows
from truejoint.evaluation.results import (
    BASELINES,
    OFFSET,
    RAW,
    TOOL,
    Domain,
    JointVerdict,
    Verdict,
    by_recording,
    each,
    estimator_phrase,
)
from truejoint.recordings.judge.data_check import DataCheck
from truejoint.recordings.table.recording import Recording
from truejoint.tables import share_text, shown
from truejoint.units import display_unit

_FEW: Final = 0.02  # share of the rows that the loop refuses which is worth a word
_MOST: Final = 0.5  # share of the rows that must be as in training for a verdict
MARGIN: Final = 0.05  # by which the RMSE of the deployed model may exceed the best's, as a share
PLAIN: Final = frozenset({RAW, OFFSET, "linear"})  # preferred where nothing richer is closer


def judge(
    scores: DataFrame,
    chosen: str,
    *,
    tolerance: Mapping[str, float] | None = None,
    comparisons: DataFrame | None = None,
    advice: "Advice | None" = None,
    objections: Sequence[str] = (),
    doubts: Sequence[str] = (),
) -> Verdict:
    """Verdict on the RMSE of the chosen model in every joint.

    Parameters
    ----------
    scores : DataFrame
        ``"rmse"`` and ``"unit"`` by ``"joint"`` and ``"estimator"``, simplest first; those of
        `chosen` and of the fixed offset are needed.
    chosen : str
    tolerance : mapping of str to float, optional
        Largest RMSE [rad or m] that the user accepts, by joint. A joint without one must beat
        the raw position and the fixed offset, and no simpler model may beat it.
    comparisons : DataFrame, optional
        Comparisons of the chosen model with others, see `Evaluation.comparisons`; without any, the
        RMSE alone decides.
    advice : Advice, optional
        Which estimator belongs on the robot: see `advise`.
    objections, doubts : sequence of str
        Reasons not to believe the test, of which any fails the verdict, and to pass it with
        reservations.

    Raises
    ------
    CalibrationError
        If no score is of `chosen`, or a tolerance names no calibrated joint or is not a positive
        number.

    Examples
    --------
    >>> judge(evaluation.scores, "linear", tolerance={"jaw": 1e-6}).level
    'fail'
    """
    scores = scores[scores["joint"] != TOOL]
    joints, estimators = (scores[key].unique().tolist() for key in ("joint", "estimator"))
    if chosen not in estimators:
        raise CalibrationError(f"the verdict: {unknown('score', chosen, estimators)}")
    limits = _checked_tolerance(tolerance or {}, joints)
    compared = [] if comparisons is None else list(each(comparisons))
    outcomes = {(c.estimator, c.joint): c.outcome for c in compared}
    last = BASELINES.index(chosen) if chosen in BASELINES else len(BASELINES)
    simpler = [name for name in estimators if name in BASELINES[:last]]
    verdicts = []
    for joint in joints:
        rows = {row.estimator: row for row in each(scores[scores["joint"] == joint])}
        row, others = rows[chosen], [rows[name] for name in simpler if name in rows]
        if limit := limits.get(joint):
            verdicts.append(JointVerdict(joint, row.unit, row.rmse, limit, True, row.rmse <= limit))
        else:
            verdicts.append(_beside_simpler(row, others or [row], outcomes))
    deploy, sentence = (advice.deploy, advice.text) if advice and not objections else ("", "")
    doubts = [*doubts, *_alike(verdicts, compared)]
    if deploy not in ("", chosen) and not all(verdict.stated for verdict in verdicts):
        doubts.append(sentence)
    return Verdict(
        passed=all(v.passed for v in verdicts) and not objections,
        text=_text(chosen, verdicts, objections),
        rule=_rule(verdicts),
        joints=tuple(verdicts),
        objections=tuple(objections),
        doubts=tuple(doubts),
        deploy=deploy,
        advice=sentence,
    )


def _beside_simpler(
    row: Any, others: Sequence[Any], outcomes: Mapping[tuple[str, str], Outcome]
) -> JointVerdict:
    """Hold a joint to raw position and fixed offset, and to what simpler models reach."""

    def outcome(other: Any) -> Outcome:
        plain: Outcome = "better" if row.rmse < other.rmse else "worse"
        return outcomes.get((other.estimator, other.joint), plain)

    yardsticks = [other for other in others if other.estimator in (RAW, OFFSET)] or others
    beaten = [other for other in others if outcome(other) == "worse"]
    least = min(beaten or yardsticks, key=lambda other: other.rmse)
    passed = row.rmse < least.rmse and not beaten
    best = min(others, key=lambda other: other.rmse)
    alike = best.estimator if passed and outcome(best) != "better" else ""
    return JointVerdict(
        row.joint, row.unit, row.rmse, least.rmse, False, passed, least.estimator, alike
    )


def _alike(verdicts: Sequence[JointVerdict], comparisons: Sequence[Any]) -> Iterator[str]:
    """Tell where the chosen model cannot be told from a simpler one, and by how much data."""
    for name in dict.fromkeys(verdict.alike for verdict in verdicts if verdict.alike):
        joints = [verdict.joint for verdict in verdicts if verdict.alike == name]
        counts = [c.stretches for c in comparisons if c.estimator == name and c.joint in joints]
        over = f" ({min(counts)} stretches of the test)" if counts else ""
        yield (
            f"In {_and(joints)} it cannot be told from {estimator_phrase(name)}, which is "
            f"simpler{over}."
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
    rest = (
        "its RMSE is below those of the raw position and of the fixed offset, and no simpler model "
        "is closer beyond chance (95 %, over stretches longer than its correlation time)"
    )
    others = [v.joint for v in verdicts if not v.stated]
    if len(others) == len(verdicts):
        return f"No tolerance was stated, so a joint passes when {rest}."
    rule = "A joint passes when its RMSE is within the tolerance stated for it."
    if others:
        rule += f" No tolerance was stated for {_and(others)}: passes when {rest}."
    return rule


def _text(chosen: str, verdicts: Sequence[JointVerdict], objections: Sequence[str]) -> str:
    if objections:
        return f"This test cannot be believed: {objections[0]}."
    title, n = estimator_phrase(chosen), len(verdicts)
    title = title[:1].upper() + title[1:]
    if bad := [_beside(v) for v in verdicts if not v.passed]:
        count = f"{len(bad)} of {n} joints" if n > 1 else "the joint"
        return f"{title} is not good enough in {count}: {_and(bad)}."
    subject = f"all {n} joints" if n > 1 else "the joint"
    if not any(v.stated for v in verdicts):
        return f"{title} has a smaller RMSE than raw position and fixed offset in {subject}."
    if all(v.stated for v in verdicts):
        return f"{title} is within the stated tolerance in {subject}."
    return f"{title} is within tolerance, or below raw and fixed offset where none is stated."


def _beside(verdict: JointVerdict) -> str:
    unit = display_unit(verdict.unit)
    value, limit = shown([verdict.rmse * unit.scale, verdict.limit * unit.scale])
    return (
        f"{verdict.joint} {value} {unit.name} against {limit_phrase(verdict)} {limit} {unit.name}"
    )


def limit_phrase(verdict: JointVerdict) -> str:
    """Name what a joint was held to, within a sentence and before its value."""
    return "the tolerance of" if verdict.stated else f"{estimator_phrase(verdict.against)}'s"


def _and(parts: Sequence[str]) -> str:
    return parts[0] if len(parts) == 1 else ", ".join(parts[:-1]) + " and " + parts[-1]


def objections_to(origin: Origin, recordings: Sequence[Recording], domain: Domain) -> Iterator[str]:
    """Object to rows that were in the training, and to a test unlike it."""
    for recording in recordings:
        if origin.includes(recording):
            name = _name(recording) or "a recording"
            yield f"the model was trained on rows of {name}, which it is tested on"
    if domain.inside < _MOST:
        yield (
            f"the loop would refuse {_refused(domain)}: it is of another instrument, mounting or "
            "unit than the training, or of a motion unlike it"
        )
    if domain.beyond > 1.0 - _MOST:
        yield (
            f"in {share_text(domain.beyond)} of the rows the truth is further from the measured "
            "position than any correction that the loop would believe: it is of another "
            "instrument, or of a zero that has moved"
        )


def doubts_about(
    origin: Origin,
    zero: Zero | None,
    recordings: Sequence[Recording],
    domain: Domain,
    check: DataCheck,
    rezero: float = 0.0,
) -> Iterator[str]:
    """Tell what a pass is to be taken with: data, domain, homings, and truth that re-zeroed.

    A homing that training has not seen is no doubt where `rezero` seconds of truth make up for it.
    """
    if origin.accepted:
        yield (
            "The model was fitted to recordings whose data check failed "
            f"({', '.join(origin.accepted)}), which was accepted."
        )
    for finding in check.findings:
        if finding.level == "fail":
            anyway = ", which was accepted" if finding.name in check.accepted else ""
            yield f"The data check failed{anyway}: {finding.what} ({finding.where})."
    if domain.inside < 1.0 - _FEW:
        yield f"The loop would refuse {_refused(domain)}, and pass the raw position through there."
    if suspect := domain.flags.get("ZERO_SUSPECT"):
        yield (
            f"The loop would hold the zero for suspect in {share_text(suspect)} of the rows, until "
            "it is found anew: a reading jumped, or parts from what else says where the joint is."
        )
    other = sorted({r.provenance.homing_id for r in recordings} - {*origin.homing_ids, ""})
    if origin.homing_ids and other and rezero == 0.0:
        yield (
            f"The test has homings that training has not seen ({', '.join(other[:4])}); positions "
            "of two homings differ by an offset that no model knows."
        )
    for recording in recordings:
        source, homing = recording.provenance.source, recording.provenance.homing_id
        if source and zero is not None and (zero.file, zero.homing_id) == (source, homing):
            yield (
                f"The model was re-zeroed on truth of {_name(recording)}, which it is tested on; "
                "what is left of the offset shows only in other recordings."
            )
            return


@dataclass(frozen=True)
class Advice:
    """Which model belongs on the robot, or that a test cannot tell.

    Attributes
    ----------
    deploy : str
        Estimator whose error exceeds that of no other one by more than `MARGIN`; empty where that
        is certain of none.
    rivals : tuple of str
        If it is, estimators that may be the best, the one with the smallest error first.
    stretches : int
        Fewest stretches of all recordings together that two estimators were compared over.
    text : str
        The sentence for a person.

    Examples
    --------
    >>> advise(evaluation.errors, evaluation.rows, "linear").stretches  # of four seconds
    4
    """

    deploy: str
    rivals: tuple[str, ...]
    stretches: int
    text: str


def advise(
    errors: DataFrame,
    rows: DataFrame,
    chosen: str = "",
    *,
    plain: Collection[str] = PLAIN,
    automatic: bool = True,
) -> Advice:
    """Say which estimator to deploy, by the one rule that report, command line and JSON share.

    An estimator may be deployed when no other one has a smaller mean squared error by more than
    that of a `MARGIN` of the RMSE; each at 95 % (`compare`), over all recordings together or in
    each by itself: where one shows a larger difference than another, that is no doubt of either. A
    stretch holds a motion to and fro at least, and fewer than four tell nothing. Among several such
    estimators a `plain` one goes first, then the `chosen` one, then the closest.

    Counted are the rows that the loop would correct (all, where there are none), each by its error
    as a multiple of the least RMSE in that joint: one that no model helps hides no other.

    Parameters
    ----------
    errors, rows : DataFrame
        Those of an `Evaluation`, or of several of the same estimators one after the other.
    chosen : str
        Estimator that is in use; empty for none.
    plain : collection of str
        Estimators that are preferred where a richer one is not closer.
    automatic : bool
        Whether the chosen one was chosen among many already; else the text names ``-e auto``.

    Raises
    ------
    CalibrationError
        If there are no rows.

    Examples
    --------
    >>> advise(evaluation.errors, evaluation.rows).text
    'It cannot be told which of these models to deploy: ...'
    """
    if not isinstance(rows, DataFrame) or rows.empty:
        raise CalibrationError("there is no evaluation to choose by; give its `errors` and `rows`")
    counted = rows["inside"].to_numpy()
    if counted.sum() < 2:
        counted = np.ones(len(rows), dtype=bool)
    moves = rows["direction"][counted]
    parts = by_recording(moves.index)
    own = errors[counted]
    whole = {name: own[name][moves.columns].to_numpy() for name in own.columns.unique(0)}
    scale = np.sqrt(np.min([np.mean(error**2, axis=0) for error in whole.values()], axis=0))
    scale[scale == 0.0] = 1.0
    scaled = {name: [error[part] / scale for part in parts] for name, error in whole.items()}
    size = {name: sum(float(np.sum(e**2)) for e in split) for name, split in scaled.items()}
    allowed = {name: [(1.0 + MARGIN) * e for e in split] for name, split in scaled.items()}
    least = cycle_rows([moves.to_numpy()[part] for part in parts])
    closest = sorted(scaled, key=size.__getitem__)
    good = [
        name
        for name in closest
        if all(_is_within(scaled[name], allowed[n], least) for n in closest if n != name)
    ]
    differences = {n: compare(scaled[n], allowed[closest[0]], least) for n in closest[1:]}
    alike = [n for n, d in differences.items() if d.outcome != "worse"]
    deploy = min(good, key=lambda name: (name not in plain, name != chosen), default="")
    rivals = () if good else (closest[0], *alike)
    stretches = min((difference.stretches for difference in differences.values()), default=0)
    text = _advice_text(deploy, rivals, stretches, chosen)
    other = "" if automatic else "; `truejoint calibrate -e auto` chooses among more models"
    return Advice(deploy, rivals, stretches, f"{text}{other}.")


def _is_within(errors: Sequence[Array], allowed: Sequence[Array], least: float) -> bool:
    """Whether errors are less than is allowed, over all recordings or in each."""
    if np.sum(np.concatenate(errors) ** 2) > np.sum(np.concatenate(allowed) ** 2):
        return False  # neither can be
    pairs = [([a], [b]) for a, b in zip(errors, allowed, strict=True) if len(a)]
    return compare(errors, allowed, least).outcome == "better" or all(
        compare(*pair, least).outcome == "better" for pair in pairs
    )


def _advice_text(deploy: str, rivals: Sequence[str], stretches: int, chosen: str) -> str:
    """Say what to deploy, and how to get it."""
    if not deploy:
        names = [estimator_phrase(name) for name in rivals]
        few = f"{_and(names)} cannot be told apart" if len(names) > 1 else "too little is certain"
        keep = f"keep {estimator_phrase(chosen)}" if chosen else "change nothing"
        return (
            f"It cannot be told which of these models to deploy: {few} to {100 * MARGIN:g} % of "
            f"the error, over {stretches} stretches of this test. Record a longer motion to tell; "
            f"until then, {keep}"
        )
    how = f" (`truejoint calibrate -e {deploy}`)" if deploy in BASELINES else ""
    what = f"Deploy {estimator_phrase(deploy)}{' instead' if chosen else ''}{how}"
    if deploy == RAW:
        what = "Deploy none of these models, but the raw position"
    elif deploy == chosen:
        what = f"Keep {estimator_phrase(chosen)}"
    return (
        f"{what}: over all joints, no other model here has an error more than {100 * MARGIN:g} % "
        "smaller in the rows that the loop would correct (95 % confidence)"
    )


def rezero_remarks(
    joints: Sequence[JointVerdict], as_they_come: Array, duration: float
) -> Iterator[str]:
    """Say what re-zeroing is worth: RMSE without it (n_joints,), by the fit for that, beside it."""
    better: list[str] = []
    worse: list[str] = []
    for joint, plain in zip(joints, as_they_come.tolist(), strict=True):
        unit = display_unit(joint.unit)
        before, after = shown([plain * unit.scale, joint.rmse * unit.scale])
        text = f"{joint.joint} {after} {unit.name} instead of {before}"
        if after != before:
            (worse if joint.rmse > plain else better).append(text)
    start = f"from the first {duration:g} s of each recording"
    if better:
        yield f"Re-zeroed {start}: {_and(better)} as positions come."
    if worse:
        yield (
            f"Re-zeroing {start} harms: {_and(worse)}. So short a stretch may be a part of a slow "
            "cycle, with errors all to one side: re-zero from a longer one, or leave it."
        )


def _refused(domain: Domain) -> str:
    return f"{share_text(1 - domain.inside)} of the rows ({flags_text(domain)})"


def flags_text(domain: Domain) -> str:
    """List the flags of the loop with their shares of the rows."""
    return ", ".join(f"{name} {share_text(share)}" for name, share in domain.flags.items())


def _name(recording: Recording) -> str:
    return PurePath(recording.provenance.source).name
