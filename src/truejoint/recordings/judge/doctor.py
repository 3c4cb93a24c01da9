"""The doctor: one verdict for each thing that goes wrong between a robot and its recording.

It joins the data check to the link that brought the data: each verdict rests on findings of the
check, and on what stamps, counts of lost rows and the other arm tell besides.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import numpy as np

from truejoint.array_types import Array
from truejoint.errors import RecordingError
from truejoint.recordings.join.joining import find_clock_offset
from truejoint.recordings.judge.data_check import check_data
from truejoint.recordings.judge.finding import ORDER, Finding, Level
from truejoint.recordings.read.raven_csv import AMID
from truejoint.recordings.table.recording import Recording, as_recording
from truejoint.recordings.table.signals import velocity
from truejoint.recordings.table.stream import AFTER, BACK, BEFORE, GAP, Stream
from truejoint.summary import Summarised, json_values

CHECKS: Final[Mapping[str, tuple[str, ...]]] = {
    "rate": ("rate", "clock"),
    "stamps": (),
    "lost messages": ("gap", "dropped"),
    "arm": (),
    "unit": ("unit", "limits"),
    "effort": ("constant",),
    "effort sign": (),
    "encoder wrap": ("wrap", "jump"),
    "frozen signal": ("frozen", "saturated"),
    "truth": ("missing", "sign", "outliers", "start"),
    "delay": ("delay",),
    "homing": ("homing", "zero", "redundant", "instrument"),
    "excitation": ("standstill", "directions"),
    "coverage": ("travel", "hole", "range", "load"),
}
"""Names of the verdicts, and which findings of the data check each rests on: all of them, once."""

NO_STAMP: Final = "stamp of 0, which says that there is none"
_REPEATED: Final = "repeated time stamp"
_STRAY: Final = 0.01  # share of stamps that repeat or go back, from which on it is a failure
_FOLLOWS: Final = 0.5  # squared correlation of truth and measured position of the arm that it is of
_STRANGER: Final = 0.25  # and of one that it is not of, at most, where no other is there to compare
_BETTER: Final = 0.1  # share that the right arm leaves unexplained of what the wrong one does
_SHIFT: Final = 0.1  # s; smaller delays are the data check's to judge
_SURE: Final = 5.0  # standard deviations of the estimated shift
_BRISK: Final = 0.2  # share of its usual top speed, above which a joint is moved, not pushed
_BACK: Final = 0.3  # of the way there that a joint comes back, at least, to judge its effort
_BRAKING: Final = -0.2  # share of the work of an effort that brakes what it should drive
_OVERLAP: Final = 0.5  # share of the rows that must have a truth at their time

_LEAST_MOTION: Final = 0.005  # of its travel (or of 1 rad or m), by which a joint that moves does
_OF_MOTION: Final = ("arm", "effort sign", "frozen signal", "delay")
_TAKE_MOTION: Final = ("frozen", "saturated", "delay", "sign", "outliers", "jump")
_STOOD: Final = "no joint moves: nothing to judge it by"

VerdictLevel = Level | Literal["good"]
_LEVELS: Final[tuple[VerdictLevel, ...]] = (*ORDER, "good")


@dataclass(frozen=True)
class Verdict:
    """What the doctor says of one thing.

    Attributes
    ----------
    level : {"fail", "warn", "info", "good"}
    name : str
        One of `CHECKS`; of a live link also ``"link"``.
    evidence : str
        What was seen, with its number.
    advice : str
        What to do; empty where all is well.

    Examples
    --------
    >>> truejoint.recordings.diagnose(test).verdicts[0].name
    'rate'
    """

    level: VerdictLevel
    name: str
    evidence: str
    advice: str = ""


@dataclass(frozen=True, repr=False)
class Diagnosis(Summarised):
    """One verdict for each of `CHECKS`, in its order.

    Examples
    --------
    >>> truejoint.recordings.diagnose(test).failed
    False
    """

    verdicts: tuple[Verdict, ...]

    @property
    def failed(self) -> bool:
        """Whether a verdict is ``"fail"``."""
        return any(verdict.level == "fail" for verdict in self.verdicts)

    def summary(self) -> dict[str, str]:
        """Level and evidence by name."""
        return {v.name: f"{v.level}: {v.evidence}" for v in self.verdicts}

    def to_dict(self) -> dict[str, Any]:
        """Values for JSON."""
        values: dict[str, Any] = json_values(self)
        return values


def diagnose(recording: Recording, other: Recording | None = None) -> Diagnosis:
    """Judge a recording and the link that brought it: a verdict for each of `CHECKS`.

    Parameters
    ----------
    recording : Recording
        Of one arm, with or without truth.
    other : Recording, optional
        Of the robot's other arm meanwhile, to tell whether the truth is of that one.

    Raises
    ------
    RecordingError
        If `recording` is none, or has no measured position.

    Examples
    --------
    >>> diagnosis = truejoint.recordings.diagnose(test)
    >>> [v.name for v in diagnosis.verdicts if v.level == "fail"]
    []
    """
    recording = as_recording(recording)
    known = set(recording.joints_of("measured")) & set(recording.robot.joint_names)
    truth = [joint for joint in recording.joints_of("truth") if joint in known]
    joints = truth or [joint for joint in recording.robot.positioning if joint in known]
    if not joints:
        raise RecordingError(f"{recording.provenance.source or 'recording'}: no measured position")
    check = check_data(recording, joints=joints, needs_truth=bool(truth))
    moving = [joint for joint in joints if _moves(recording, joint)]
    seen: dict[str, Verdict | None] = {
        "stamps": _stamps(recording),
        "arm": _arm(recording, other, [joint for joint in truth if joint in moving]),
        "effort": _effort(recording, joints),
        "effort sign": _effort_sign(recording, moving),
        "truth": _truth(recording, truth),
        "delay": _delay(recording, [joint for joint in truth if joint in moving]),
        "homing": _homing(recording),
    }
    if still := [joint for joint in joints if joint not in moving]:
        advice = "a joint that is to be calibrated must move, both ways"
        what = f"{', '.join(still)} stand{'s' if len(still) == 1 else ''}"
        seen["excitation"] = Verdict("warn", "excitation", what, advice)
    if not moving:
        seen |= {name: Verdict("info", name, _STOOD, "move the joints") for name in _OF_MOTION}
    told = [f for f in check.findings if not _is_of_noise(f, joints, moving)]
    return Diagnosis(
        tuple(
            _verdict(name, recording, joints, [f for f in told if f.name in rests_on], seen)
            for name, rests_on in CHECKS.items()
        )
    )


def _moves(recording: Recording, joint: str) -> bool:
    """Whether a joint moves by more than noise and creep, as any of its sensors has it."""
    limits = recording.robot.joint(joint)
    travel = limits.upper - limits.lower
    least = _LEAST_MOTION * (travel if math.isfinite(travel) else 1.0)
    columns = [recording.table.get(f"{quantity}/{joint}") for quantity in ("measured", "truth")]
    return any(column is not None and column.max() - column.min() > least for column in columns)


def _is_of_noise(finding: Finding, joints: Sequence[str], moving: Sequence[str]) -> bool:
    """Whether a finding takes the noise of a joint that stands for its motion."""
    of = finding.where.partition(" in ")[0].rpartition("/")[2]
    stands = not moving or (of in joints and of not in moving)
    by_span = finding.name == "unit" and "spans" in finding.what  # not by where the joint is
    return stands and (by_span or finding.name in _TAKE_MOTION)


def _verdict(
    name: str,
    recording: Recording,
    joints: Sequence[str],
    findings: Sequence[Finding],
    seen: Mapping[str, Verdict | None],
) -> Verdict:
    """Worst of what the data check found and of what was seen besides, else that all is well."""
    told: list[Verdict] = [v for v in (seen.get(name),) if v is not None]
    told += [Verdict(f.level, name, f"{f.where}: {f.what}", f.advice) for f in findings]
    if not told:
        return Verdict("good", name, _WELL[name](recording, joints))
    worst = min(told, key=lambda verdict: _LEVELS.index(verdict.level))
    more = sum(verdict.level == worst.level for verdict in told) - 1
    return replace(worst, evidence=worst.evidence + (f" (and {more} more)" if more else ""))


def _rate(recording: Recording, _: Sequence[str]) -> str:
    step = 1e3 * np.quantile(np.diff(recording.t), [0.01, 0.5, 0.99])
    return (
        f"{1e3 / step[1]:.4g} Hz: a row every {step[1]:.4g} ms, 98 % within {step[0]:.4g} to "
        f"{step[2]:.4g} ms"
    )


_WELL: Final[Mapping[str, Callable[[Recording, Sequence[str]], str]]] = {
    "rate": _rate,
    "stamps": lambda *_: "all rise",
    "lost messages": lambda recording, _: f"no gap in {recording.duration:.1f} s",
    "arm": lambda *_: "nothing to compare with",
    "unit": lambda *_: "positions are where the joints can be",
    "effort": lambda recording, _: f"of {', '.join(recording.joints_of('effort'))}",
    "encoder wrap": lambda *_: "no jump",
    "frozen signal": lambda *_: "no sensor stands while its joint moves",
    "truth": lambda recording, _: f"of {', '.join(recording.joints_of('truth'))}",
    "delay": lambda *_: "below 15 ms",
    "homing": lambda *_: "one zero throughout",
    "excitation": lambda _, joints: f"{', '.join(joints)} move both ways",
    "coverage": lambda _, joints: f"{', '.join(joints)} are covered",
}


def _stamps(recording: Recording) -> Verdict | None:
    """Judge stamps that were repeated, went back or were none, by what was left out for it."""
    counts = {
        reason: count
        for reason, count in recording.provenance.dropped.items()
        if reason.endswith((_REPEATED, BACK, NO_STAMP))
    }
    if not counts:
        return None
    share = sum(counts.values()) / (len(recording) + sum(counts.values()))
    evidence = ", ".join(f"{count} times {reason}" for reason, count in counts.items())
    advice = (
        "stamp messages where they are measured; two publishers on one topic, or a clock that is "
        "set meanwhile, do this"
    )
    level: VerdictLevel = "fail" if share > _STRAY else "warn"
    return Verdict(level, "stamps", f"{evidence} ({100 * share:.2g} % of the messages)", advice)


def _likeness(recording: Recording, truth: Recording, joints: Sequence[str]) -> float:
    """Squared correlation of truth and measured positions, the median over joints that move."""
    found = []
    for joint in joints:
        if joint not in recording.joints_of("measured"):
            continue
        t, values = truth.t, truth.column(f"truth/{joint}")
        begin = recording.provenance.start - truth.provenance.start
        shift = 0.0 if math.isnan(begin) else begin
        measured = np.interp(t, recording.t + shift, recording.column(f"measured/{joint}"))
        rows = np.isfinite(values)
        if rows.sum() > 2 and np.ptp(values[rows]) > 0.0:
            moves = np.ptp(measured[rows]) > 0.0
            alike = np.corrcoef(values[rows], measured[rows])[0, 1] if moves else 0.0
            found.append(float(alike) ** 2)
    return float(np.median(found)) if found else math.nan


def _arm(recording: Recording, other: Recording | None, truth: Sequence[str]) -> Verdict | None:
    """Judge whether the truth is of this arm or of the other one."""
    own = _likeness(recording, recording, truth)
    theirs = math.nan if other is None else _likeness(other, recording, truth)
    if math.isnan(own):
        return None
    evidence = f"this arm explains {100 * own:.0f} % of the truth's motion"
    if not math.isnan(theirs):
        evidence += f", the other arm {100 * theirs:.0f} %"
    if theirs > _FOLLOWS and 1.0 - theirs < _BETTER * (1.0 - own):
        advice = "the arms are swapped: state the other --arm, or another --profile"
        return Verdict("fail", "arm", evidence, advice)
    if own < _STRANGER:
        advice = "is the truth of this arm, these joints and this session?"
        return Verdict("fail", "arm", evidence, advice)
    return Verdict("good", "arm", evidence)


def _effort(recording: Recording, joints: Sequence[str]) -> Verdict | None:
    """Judge whether there is an effort, and whether it was ever set."""
    given = [joint for joint in joints if joint in recording.joints_of("effort")]
    silent = [joint for joint in given if not recording.column(f"effort/{joint}").any()]
    advice = (
        "some drivers never set it (raven2's measured_js): record its raven_state, or train on "
        "positions alone"
    )
    if not given:
        return Verdict("warn", "effort", "there is none", advice)
    if silent:
        return Verdict(
            "fail", "effort", f"0 in every row of {', '.join(silent)}: never set", advice
        )
    return None


def _effort_sign(recording: Recording, joints: Sequence[str]) -> Verdict:
    """Judge the sign of efforts: against friction they drive a motion, there and back.

    The net work over the recording, as a share of what flows to and fro, cannot be far below 0.
    """
    robot, given = recording.robot, set(recording.joints_of("effort"))
    moving = [joint for joint in joints if joint in given]
    if moving and robot.effort == "motor" and robot.transmission is not None:
        if not given.issuperset(robot.joint_names):  # cables couple the joints: one tells nothing
            advice = "record the efforts of all motors"
            return Verdict("info", "effort sign", "some of the coupled efforts are missing", advice)
        efforts = robot.transmission.joint_effort(recording.columns("effort", robot.joint_names))
        by_joint = dict(zip(robot.joint_names, efforts.T, strict=True))
    else:
        by_joint = {joint: recording.column(f"effort/{joint}") for joint in moving}
    works = {joint: _work(recording, joint, by_joint[joint]) for joint in moving}
    shares = {joint: share for joint, share in works.items() if share is not None}
    if not shares:
        advice = "move the joints there and back, and record their efforts"
        return Verdict("info", "effort sign", "nothing to judge it by", advice)
    wrong = {joint: share for joint, share in shares.items() if share < _BRAKING}
    evidence = "net work of the efforts: " + ", ".join(
        f"{100 * share:+.0f} % in {joint}" for joint, share in (wrong or shares).items()
    )
    if not wrong:
        return Verdict("good", "effort sign", evidence)
    advice = "they brake what they should drive: turn the sign of the effort, or of the position"
    return Verdict("fail", "effort sign", evidence, advice)


def _work(recording: Recording, joint: str, effort: Array) -> float | None:
    """Net work of an effort (n,) as a share of all the work that it does and takes.

    Of brisk motion: a joint that is held may be pushed by the cables of others, and its motor then
    brakes. None where there is none both ways: one way the weight of the arm may do the work.
    """
    rate = velocity(recording.t, recording.column(f"measured/{joint}"))
    brisk = np.abs(rate) > _BRISK * np.quantile(np.abs(rate), 0.99)
    ways = np.abs(rate[brisk & (rate > 0.0)].sum()), np.abs(rate[brisk & (rate < 0.0)].sum())
    power = (effort * rate)[brisk]
    gross = float(np.abs(power).sum())
    return float(power.sum()) / gross if gross and min(ways) > _BACK * max(ways) else None


def _truth(recording: Recording, truth: Sequence[str]) -> Verdict | None:
    """Judge whether state and truth are of the same time."""
    if not truth:
        advice = "name its topic or file (--truth), or calibrate with one that has it"
        return Verdict("info", "truth", "there is none", advice)
    dropped = recording.provenance.dropped
    outside = {reason: dropped[reason] for reason in (BEFORE, AFTER, GAP) if reason in dropped}
    known = float(np.isfinite(recording.columns("truth", truth)).all(axis=1).mean())
    if known < _OVERLAP:
        why = ", ".join(f"{count} rows with {reason}" for reason, count in outside.items())
        evidence = f"{100 * known:.0f} % of the rows have a truth{': ' if why else ''}{why}"
        advice = "were both recorded at once, on one clock? state the offset (--offset-s)"
        return Verdict("fail", "truth", evidence, advice)
    return None


def _delay(recording: Recording, truth: Sequence[str]) -> Verdict | None:
    """Judge a shift of the truth's clock by the motion that both saw."""
    rows = np.ones(len(recording), dtype=np.bool_)
    for joint in truth:
        rows &= np.isfinite(recording.column(f"truth/{joint}"))
    if not truth or rows.sum() < 100:
        return None
    measured = Stream(
        recording.t, {f"measured/{j}": recording.column(f"measured/{j}") for j in truth}
    )
    sensors = Stream(recording.t, {f"truth/{j}": recording.column(f"truth/{j}") for j in truth})
    try:
        shift = find_clock_offset(measured, sensors.rows(rows), near=0.0)
    except RecordingError:
        return None  # what does not follow is not late: the other verdicts judge it
    evidence = f"the truth is {-shift.seconds:+.3f} s behind the state, +- {shift.sd:.3f} s"
    if abs(shift.seconds) > max(_SHIFT, _SURE * shift.sd):
        advice = f"bring it onto the robot's clock: --offset-s {shift.seconds:.3f}"
        return Verdict("fail", "delay", evidence, advice)
    return Verdict("good", "delay", evidence)


def _homing(recording: Recording) -> Verdict | None:
    """Judge a homing inside the recording: what comes after it counts from another zero."""
    count = recording.provenance.dropped.get(AMID, 0)
    if not count:
        return None
    step = np.diff(recording.t)
    longest = int(np.argmax(step))
    evidence = f"{count} rows of homing, after {recording.t[longest]:.1f} s it seems"
    advice = "cut it there (--part): positions before and after count from two zeros"
    return Verdict("fail", "homing", evidence, advice)
