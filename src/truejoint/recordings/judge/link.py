"""What the link between a robot and its recording does wrong, joined to the data check.

Stamps, counts of lost rows, efforts and the other arm tell what the columns alone do not.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from truejoint.array_types import Array
from truejoint.crtk.cartesian import pose
from truejoint.errors import RecordingError
from truejoint.recordings.join.joining import find_clock_offset
from truejoint.recordings.judge.data_check import DataCheck, check_data
from truejoint.recordings.judge.finding import HEADING_OF, WELL, Finding
from truejoint.recordings.read.raven_csv import AMID
from truejoint.recordings.read.track import Track
from truejoint.recordings.table.recording import Recording, as_recording
from truejoint.recordings.table.stream import AFTER, BACK, BEFORE, GAP, Stream, velocity
from truejoint.robots import Robot, arm_names, get_robot
from truejoint.robots.chain import SerialChain

_AGREES: Final = 1e-3  # [m] RMS, beside what a late stamp makes of a moving tool
_EXPLAINS: Final = 0.1  # share of the difference that the right cause leaves, at most
_FEWEST: Final = 20  # poses beside joints
_ALIKE: Final = 1.5  # what two causes leave, of which the first one is named
_LEAST_OF_TOOL: Final = 0.01  # [m] of the tool, below which any base frame would fit
_ROUNDS: Final = 5


def judge_tool_pose(recording: Recording, reported: Track | None) -> Finding | None:
    """Compare the pose that a robot reports with the forward kinematics of its measured joints.

    A base frame of its own is no fault. A wrong unit, arm or tool is tried, and named where it
    explains nine tenths of what the two differ by. None without `reported` poses
    (`read_tool_poses`), kinematics, all joints or motion.
    """
    robot, chain = recording.robot, recording.robot.kinematics
    if reported is None or chain is None:
        return None
    moving = np.flatnonzero(np.abs(chain.jacobian(robot.home)).max(axis=0) > 0.0)
    columns = {k: f"measured/{robot.joint_names[k]}" for k in moving.tolist()}
    t = reported.t - recording.provenance.start
    rows = np.flatnonzero((t >= recording.t[0]) & (t <= recording.t[-1]))
    if not {*columns.values()} <= {*recording.table} or len(rows) < _FEWEST:
        return None
    joint = np.zeros((len(rows), len(robot.joints)))
    for k, name in columns.items():
        joint[:, k] = np.interp(t[rows], recording.t, recording.column(name))
    position, expected = reported.position[rows], pose(chain, joint)
    if np.ptp(expected[:, :3, 3], axis=0).max() < _LEAST_OF_TOOL:
        return None
    off = _rms(position - expected[:, :3, 3])
    rest, _, base = _registered(expected[:, :3, 3], position)
    says = "the tool that the robot reports is {:.3g} mm (RMS) from where its joints put it"
    if min(off, rest) < _AGREES:
        in_base = "" if off < _AGREES else f", in a base frame {base}"
        return Finding("good", "pose", says.format(1e3 * min(off, rest)) + in_base, "")
    causes = list(_causes(robot, joint, position))
    unexplained = min(causes)[0]
    cause = next(why for rms, why in causes if rms <= _ALIKE * unexplained)
    if unexplained > _EXPLAINS * rest:
        cause = "is the robot file (--robot) that of this arm and its instrument?"
    return Finding("fail", "pose", says.format(1e3 * rest) + ", whatever its base", "", cause)


def _causes(robot: Robot, joint: Array, position: Array) -> Iterator[tuple[float, str]]:
    """Give what each cause leaves [m] (RMS) of the difference, and its remedy."""
    chain = robot.known_kinematics("the pose of the tool")
    place = pose(chain, joint)[:, :3, 3]
    for unit, factor in {"mm": 1e-3, "cm": 1e-2}.items():
        remedy = f"it reports {unit}: convert its poses to m"
        yield _registered(place, factor * position)[0], remedy
    for other in [get_robot(robot.name, arm) for arm in arm_names(robot.name) if robot.arm]:
        if other.arm != robot.arm and other.kinematics is not None:
            remedy = f"it is of the {other.arm} arm: state --robot {robot.name}:{other.arm}"
            yield _registered(pose(other.kinematics, joint)[:, :3, 3], position)[0], remedy
    frames = chain.link_frames(joint) if isinstance(chain, SerialChain) else place[:, :0]
    place = chain.forward(joint)[:, :3, 3]
    for k in reversed(range(frames.shape[1])):
        turn, missing = frames[:, k, :3, :3], place
        longer = np.zeros(3)
        for _ in range(_ROUNDS):  # of Gauss and Newton: base frame and link together
            _, registered, _ = _registered(place + turn @ longer, position)
            missing = registered - place
            turned = np.swapaxes(np.cross(np.eye(3), registered[:, None]), 1, 2)
            slopes = np.concatenate(
                [turned, np.broadcast_to(np.eye(3), turned.shape), turn], axis=2
            )
            solution = np.linalg.lstsq(slopes.reshape(-1, 9), missing.ravel(), rcond=None)[0]
            longer[:] = solution[6:]
        x, y, z = (1e3 * longer).round(1) + 0.0
        remedy = (
            f"the robot file behind axis {k + 1} is off by ({x:.1f}, {y:.1f}, {z:.1f}) mm in that"
        )
        yield _rms(missing - turn @ longer), f"{remedy} axis' frame: is it another instrument?"


def _registered(place: Array, position: Array) -> tuple[float, Array, str]:
    """Bring points `position` (n, 3) [m] onto others: what is left [m] (RMS), they, their base."""
    about, there = place.mean(axis=0), position.mean(axis=0)
    turn, _ = Rotation.align_vectors(position - there, place - about)
    shift = there - turn.apply(about)
    registered = np.asarray(turn.inv().apply(position - shift))
    x, y, z = (1e3 * shift).round(1) + 0.0
    angle = np.degrees(turn.magnitude())
    base = f"turned by {angle:.3g} deg and shifted by ({x:.1f}, {y:.1f}, {z:.1f}) mm"
    return _rms(registered - place), registered, base


def _rms(difference: Array) -> float:
    return float(np.sqrt((difference**2).sum(axis=1).mean()))


NO_STAMP: Final = "stamp of 0, which says that there is none"
_REPEATED: Final = "repeated time stamp"
_STRAY: Final = 0.01  # share of stamps that repeat or go back, from which on it is a failure
_FOLLOWS: Final = 0.5  # squared correlation of truth and measured position of the arm that it is of
_BETTER: Final = 0.1  # share that the right arm leaves unexplained of what the wrong one does
_SHIFT: Final = 0.1  # s; smaller delays are the data check's to judge
_SURE: Final = 5.0  # standard deviations of the estimated shift
_BRISK: Final = 0.2  # share of its usual top speed, above which a joint is moved, not pushed
_BACK: Final = 0.3  # of the way there that a joint comes back, at least, to judge its effort
_BRAKING: Final = -0.2  # share of the work of an effort that brakes what it should drive
_OVERLAP: Final = 0.5  # share of the rows that must have a truth at their time
_LEAST_MOTION: Final = 0.005  # of its travel (or of 1 rad or m), by which a joint that moves does

_NEED_MOTION: Final = ("arm", "effort-sign", "frozen", "delay")
_TAKE_MOTION: Final = ("frozen", "saturated", "delay", "sign", "outliers", "jump")


def diagnose(
    recording: Recording, other: Recording | None = None, tool_poses: Track | None = None
) -> DataCheck:
    """Judge a recording and the link that brought it: `check_data`, and what the link did.

    A heading under which nothing is wrong has a finding of level ``"good"``, so that
    `DataCheck.by_heading` tells of every heading but ``"link"``, which a live link has.

    Parameters
    ----------
    recording : Recording
        Recording of one arm, with or without truth.
    other : Recording, optional
        Recording of the robot's other arm meanwhile, to tell whether the truth is of that one.
    tool_poses : Track, optional
        Poses that the robot reported of its tool, to compare with its kinematics.

    Raises
    ------
    RecordingError
        If `recording` is none, or has no measured position.

    Examples
    --------
    >>> check = truejoint.recordings.diagnose(test)
    >>> check.failed, check.by_heading()[0].heading
    (False, 'rate')
    """
    recording = as_recording(recording)
    reported = set(recording.joints_of("measured")) & set(recording.robot.joint_names)
    truth = [joint for joint in recording.joints_of("truth") if joint in reported]
    joints = truth or [joint for joint in recording.robot.positioning if joint in reported]
    if not joints:
        raise RecordingError(f"{recording.provenance.source or 'recording'}: no measured position")
    check = check_data(recording, joints=joints, needs_truth=bool(truth))
    moving = [joint for joint in joints if _moves(recording, joint)]
    moving_truth = [joint for joint in truth if joint in moving]
    findings = [*_judge_drops(recording), *_judge_effort(recording, joints)]
    findings += _judge_overlap(recording, truth)
    findings += filter(None, [judge_tool_pose(recording, tool_poses)])
    if moving:
        findings += _judge_arm(recording, other, moving_truth)
        findings += _judge_effort_sign(recording, moving)
        findings += _judge_delay(recording, moving_truth)
    else:
        what = "no joint moves: nothing to judge it by"
        findings += [Finding("info", name, what, "", "move the joints") for name in _NEED_MOTION]
    if still := [joint for joint in joints if joint not in moving]:
        what = f"{', '.join(still)} stand{'s' if len(still) == 1 else ''}"
        advice = "a joint that is to be calibrated must move, both ways"
        findings.append(Finding("warn", "standstill", what, "", advice))
    findings += [f for f in check.findings if not _is_of_noise(f, joints, moving)]
    judged = {finding.heading for finding in findings}
    fast, usual, slow = 1e3 * np.quantile(np.diff(recording.t), [0.01, 0.5, 0.99])
    facts = {
        "rate": f"{1e3 / usual:.4g} Hz: a row every {usual:.4g} ms, 98 % within {fast:.4g} to "
        f"{slow:.4g} ms",
        "duration": recording.duration,
        "joints": ", ".join(joints),
        "efforts": ", ".join(recording.joints_of("effort")),
        "truths": ", ".join(recording.joints_of("truth")),
    }
    findings += [
        Finding("good", name, text.format(**facts), "")
        for name, text in WELL.items()
        if HEADING_OF[name] not in judged
    ]
    return DataCheck((), check.coverage).with_findings(findings)


def _moves(recording: Recording, joint: str) -> bool:
    """Whether a joint moves by more than noise and creep, as any of its sensors has it."""
    limits, table = recording.robot.joint(joint), recording.table
    travel = limits.upper - limits.lower
    least = _LEAST_MOTION * (travel if math.isfinite(travel) else 1.0)
    columns = [table[f"{q}/{joint}"] for q in ("measured", "truth") if f"{q}/{joint}" in table]
    return any(column.max() - column.min() > least for column in columns)


def _is_of_noise(finding: Finding, joints: Sequence[str], moving: Sequence[str]) -> bool:
    """Whether a finding takes the noise of a joint that stands for its motion."""
    joint = finding.where.partition(" in ")[0].rpartition("/")[2]
    stands = not moving or (joint in joints and joint not in moving)
    by_span = finding.name == "unit" and "spans" in finding.what  # not by where the joint is
    return stands and (by_span or finding.name in _TAKE_MOTION)


def _judge_drops(recording: Recording) -> Iterable[Finding]:
    """Judge stamps that repeat, go back or are 0, and homings, by the rows left out for them."""
    dropped = recording.provenance.dropped
    counts = {r: n for r, n in dropped.items() if r.endswith((_REPEATED, BACK, NO_STAMP))}
    if counts:
        share = sum(counts.values()) / (len(recording) + sum(counts.values()))
        what = ", ".join(f"{count} times {reason}" for reason, count in counts.items())
        what += f" ({100 * share:.2g} % of the messages)"
        yield Finding("fail" if share > _STRAY else "warn", "stamps", what, "")
    if homing := dropped.get(AMID, 0):
        longest = int(np.argmax(np.diff(recording.t)))
        what = f"{homing} rows of homing, after {recording.t[longest]:.1f} s it seems"
        advice = "cut it there (--part): positions before and after count from two zeros"
        yield Finding("fail", "homing", what, "", advice)


def _likeness(recording: Recording, truth: Recording, joints: Sequence[str]) -> float:
    """Squared correlation of truth and measured positions, the median over joints that move."""
    shares = []
    begins = recording.provenance.start - truth.provenance.start
    shift = 0.0 if math.isnan(begins) else begins
    for joint in set(joints) & set(recording.joints_of("measured")):
        values = truth.column(f"truth/{joint}")
        measured = np.interp(truth.t, recording.t + shift, recording.column(f"measured/{joint}"))
        rows = np.isfinite(values)
        if rows.sum() > 2 and np.ptp(values[rows]) > 0.0:
            moves = np.ptp(measured[rows]) > 0.0
            shares.append(np.corrcoef(values[rows], measured[rows])[0, 1] ** 2 if moves else 0.0)
    return float(np.median(shares)) if shares else math.nan


def _judge_arm(
    recording: Recording, other: Recording | None, truth: Sequence[str]
) -> Iterable[Finding]:
    share = _likeness(recording, recording, truth)
    other_share = math.nan if other is None else _likeness(other, recording, truth)
    if math.isnan(share):
        return
    what = f"this arm explains {100 * share:.0f} % of the truth's motion"
    if not math.isnan(other_share):
        what += f", the other arm {100 * other_share:.0f} %"
    advice = ""
    if other_share > _FOLLOWS and 1.0 - other_share < _BETTER * (1.0 - share):
        advice = "the arms are swapped: state --robot with the other arm, or another --profile"
    yield Finding("fail" if advice else "good", "arm", what, "", advice)


def _judge_effort(recording: Recording, joints: Sequence[str]) -> Iterable[Finding]:
    with_effort = [joint for joint in joints if joint in recording.joints_of("effort")]
    unset = [joint for joint in with_effort if not recording.column(f"effort/{joint}").any()]
    if not with_effort:
        yield Finding("warn", "effort", "there is none", "")
    elif unset:
        yield Finding("fail", "effort", f"0 in every row of {', '.join(unset)}: never set", "")


def _judge_effort_sign(recording: Recording, joints: Sequence[str]) -> Iterable[Finding]:
    """Judge the sign of efforts: against friction they drive a motion, there and back.

    The net work over the recording, as a share of what flows to and fro, cannot be far below 0.
    """
    robot, recorded = recording.robot, set(recording.joints_of("effort"))
    with_effort = [joint for joint in joints if joint in recorded]
    if with_effort and robot.effort == "motor" and robot.transmission is not None:
        if not recorded.issuperset(robot.joint_names):  # cables couple the joints: all are needed
            what = "some of the coupled efforts are missing"
            yield Finding("info", "effort-sign", what, "", "record the efforts of all motors")
            return
        efforts = robot.transmission.joint_effort(recording.columns("effort", robot.joint_names))
        by_joint = dict(zip(robot.joint_names, efforts.T, strict=True))
    else:
        by_joint = {joint: recording.column(f"effort/{joint}") for joint in with_effort}
    works = {joint: _work_share(recording, joint, by_joint[joint]) for joint in with_effort}
    shares = {joint: share for joint, share in works.items() if not math.isnan(share)}
    if not shares:
        advice = "move the joints there and back, and record their efforts"
        yield Finding("info", "effort-sign", "nothing to judge it by", "", advice)
        return
    wrong = {joint: share for joint, share in shares.items() if share < _BRAKING}
    what = "net work of the efforts: " + ", ".join(
        f"{100 * share:+.0f} % in {joint}" for joint, share in (wrong or shares).items()
    )
    yield Finding("fail" if wrong else "good", "effort-sign", what, "")


def _work_share(recording: Recording, joint: str, effort: Array) -> float:
    """Net work of an effort (n,) as a share of all the work that it does and takes.

    Of brisk motion: a joint that is held may be pushed by the cables of others, and its motor then
    brakes. NaN where there is none both ways: one way the weight of the arm may do the work.
    """
    rate = velocity(recording.t, recording.column(f"measured/{joint}"))
    brisk = np.abs(rate) > _BRISK * np.quantile(np.abs(rate), 0.99)
    ways = np.abs(rate[brisk & (rate > 0.0)].sum()), np.abs(rate[brisk & (rate < 0.0)].sum())
    power = (effort * rate)[brisk]
    gross = float(np.abs(power).sum())
    return float(power.sum()) / gross if gross and min(ways) > _BACK * max(ways) else math.nan


def _judge_overlap(recording: Recording, truth: Sequence[str]) -> Iterable[Finding]:
    if not truth:
        advice = "name its topic or file (--truth), or calibrate with one that has it"
        yield Finding("info", "missing", "there is none", "", advice)
        return
    share = float(np.isfinite(recording.columns("truth", truth)).all(axis=1).mean())
    if share < _OVERLAP:
        dropped = recording.provenance.dropped
        why = ", ".join(f"{dropped[r]} rows with {r}" for r in (BEFORE, AFTER, GAP) if r in dropped)
        what = f"{100 * share:.0f} % of the rows have a truth{': ' if why else ''}{why}"
        advice = "were both recorded at once, on one clock? state the offset (--offset-s)"
        yield Finding("fail", "missing", what, "", advice)


def _judge_delay(recording: Recording, truth: Sequence[str]) -> Iterable[Finding]:
    """Judge a shift of the truth's clock by the motion that both saw."""
    known = recording.with_truth(truth) if truth else None
    if known is None or len(known) < 100:
        return
    stream = Stream(known.t, {f"truth/{joint}": known.column(f"truth/{joint}") for joint in truth})
    try:
        shift = find_clock_offset(recording, stream, near=0.0)
    except RecordingError:
        return  # what does not follow is not late: the other findings judge it
    what = f"the truth is {-shift.seconds:+.3f} s behind the state, +- {shift.sd:.3f} s"
    late = abs(shift.seconds) > max(_SHIFT, _SURE * shift.sd)
    advice = f"bring it onto the robot's clock: --offset-s {shift.seconds:.3f}" if late else ""
    yield Finding("fail" if late else "good", "delay", what, "", advice)
