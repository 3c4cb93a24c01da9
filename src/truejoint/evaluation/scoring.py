"""Errors of every model on the test, their scores and worst windows, and what the loop says.

An error is the estimated position minus the true one, in the joint's SI unit (rad or m).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import PurePath

import numpy as np
from numpy.typing import ArrayLike

from truejoint.array_types import Array, Mask, floats
from truejoint.calibration import Calibration
from truejoint.calibration.zero import at_start, zeroed
from truejoint.errors import CalibrationError, RecordingError, other_kind
from truejoint.evaluation.results import (
    OFFSET,
    RAW,
    TOOL,
    Domain,
    JointVerdict,
    Score,
    Stretch,
    Trace,
)
from truejoint.recordings.table.recording import Recording
from truejoint.recordings.table.stream import direction, velocity
from truejoint.robots import Kinematics, Robot
from truejoint.runtime import Status
from truejoint.runtime.corrector import corrector_for
from truejoint.runtime.limits import believable_corrections

_STILL = 1e-9  # m per rad or m per m; below, a joint does not move the tool
_PROBES = 20
_COUNT = 3  # worst windows of each joint
_HOMING = ~int(Status.NOT_HOMED | Status.HOMED_AGAIN)


def rmse(error: ArrayLike) -> Array:
    """Root mean square of errors over time, shape () or (n_joints,): ``sqrt(mean(error**2))``.

    Parameters
    ----------
    error : array_like, shape (n,) or (n, n_joints)
        Estimated minus true position [rad or m].

    Raises
    ------
    CalibrationError
        If there is no row, or a value that is not finite.

    Examples
    --------
    >>> print(rmse([0.3, -0.4, 0.0]).round(3))
    0.289
    """
    values = floats(error, "errors", CalibrationError)
    if values.shape[:1] in ((), (0,)):
        raise CalibrationError(
            "no row has both an estimate and a true position; evaluate on recordings with truth"
        )
    if not np.isfinite(values).all():
        raise CalibrationError(
            "an error is not finite; select the rows with truth before computing metrics"
        )
    return np.asarray(np.sqrt(np.mean(np.square(values), axis=0)))


def percent_of(value: ArrayLike, whole: ArrayLike) -> Array:
    """`value` as a percentage of `whole`, as peng2024, Table I, states it; NaN of zero.

    Parameters
    ----------
    value, whole : array_like, same shape
        RMSE of an estimator and of the fixed offset, in one unit.

    Examples
    --------
    >>> print(percent_of(0.1, 0.4))
    25.0
    """
    value, whole = np.asarray(value, dtype=float), np.asarray(whole, dtype=float)
    return 100.0 * value / np.where(whole > 0.0, whole, np.nan)


def tool_error(kinematics: Kinematics, estimated: ArrayLike, true: ArrayLike) -> Array:
    """Error (n, 3) of the tool position [m], x, y, z in the base frame, by errors of the joints.

    Both joint vectors go through the same forward kinematics, so errors of the geometry itself
    cancel, as in peng2024, Table IV.

    Parameters
    ----------
    kinematics : Kinematics
    estimated, true : array_like, shape (n, n_joints)
        Joint positions [rad or m] of all joints of the robot; joints without truth hold the
        same value in both.

    Raises
    ------
    CalibrationError
        If the kinematics are none.

    Examples
    --------
    >>> robot = truejoint.get_robot("raven2")
    >>> moved = robot.home + [0, 0, 0.001, 0, 0, 0, 0]
    >>> print(np.linalg.norm(tool_error(robot.kinematics, moved, robot.home)).round(6))
    0.001
    """
    if not hasattr(kinematics, "forward"):
        advice = "give the `kinematics` of a robot of which they are known"
        raise CalibrationError(other_kind(kinematics, "Kinematics", advice))
    error = kinematics.forward(estimated) - kinematics.forward(true)
    return error[..., :3, 3]


@dataclass(frozen=True, eq=False)
class JudgedRecording:
    """One test recording: errors (n, n_joints) and tool errors (n, 3) by estimator and seed."""

    trace: Trace
    errors: Mapping[str, list[Array]]
    tool_errors: Mapping[str, list[Array]]


def judge_recording(
    recording: Recording,
    name: str,
    models: Mapping[str, Sequence[Calibration]],
    joints: tuple[str, ...],
    robot: Robot | None,
    chosen: str,
    rezero: float,
) -> JudgedRecording:
    """Errors of every model on a recording; those of the tool too where a `robot` is given.

    The first `rezero` seconds of truth set every zero, and are not judged. Raises RecordingError if
    fewer than two rows are left, CalibrationError if a model gives no number for one.
    """
    truth = recording.columns("truth", joints)
    judged = np.asarray(np.isfinite(truth).all(axis=1))
    if judged.any():
        judged[judged] = ~at_start(recording.t[judged], rezero)
    if judged.sum() < 2:
        besides = f" after the {rezero:g} s that re-zero it" if rezero > 0.0 else ""
        raise RecordingError(
            f"{recording.provenance.source or 'recording'}: {int(judged.sum())} rows have the "
            f"truth of {', '.join(joints)}{besides}; a test needs at least 2"
        )
    rows, measured = models[chosen][0].rows(recording), recording.columns("measured", joints)
    for seed in chain(*models.values()):
        seed.check_recording(recording)  # rows that several see alike may be of another robot
    at_zero = {key: [zeroed(seed, rows, rezero) for seed in own] for key, own in models.items()}
    estimates = {RAW: [_finite(measured, RAW, name)[judged]]}
    for key, seeds in at_zero.items():
        estimates[key] = [_finite(seed.correct(rows), key, name)[judged] for seed in seeds]
    errors = {key: [value - truth[judged] for value in own] for key, own in estimates.items()}
    tool, tool_errors = _of_the_tool(robot, recording, judged, joints, truth[judged], estimates)
    efforts = [joint for joint in joints if joint in recording.joints_of("effort")]
    model = at_zero[chosen][0]
    # An estimator that uses later rows runs in no loop; its training domain is judged by alone.
    try:
        corrector = corrector_for(model, [recording])
    except CalibrationError:
        corrector = corrector_for(model.baselines[OFFSET], [recording])
    corrector.set_homing(True)
    # A moved zero is another matter than rows unlike the training.
    status = corrector.run(recording).status & _HOMING
    assert model.training_domain is not None  # noqa: S101  # its corrector refuses others
    (lower, upper), error = believable_corrections(model.training_domain), truth - measured
    trace = Trace(
        name=name,
        provenance=recording.provenance.to_dict(),
        rows_total=len(recording),
        t=recording.t[judged],
        truth=truth[judged],
        measured=measured[judged],
        velocity=velocity(recording.t, measured)[judged],
        direction=direction(recording.t, measured)[judged],
        effort={joint: recording.column(f"effort/{joint}")[judged] for joint in efforts},
        effort_unit={joint: recording.units[f"effort/{joint}"] for joint in efforts},
        estimates={key: seeds[0] for key, seeds in estimates.items()},
        tool={key: tool[key] for key in ("truth", OFFSET, chosen) if key in tool},
        status=status[judged],
        believable=np.all((error >= lower) & (error <= upper), axis=1)[judged],
    )
    return JudgedRecording(trace, errors, tool_errors)


def _of_the_tool(
    robot: Robot | None,
    recording: Recording,
    judged: Mask,
    joints: Sequence[str],
    truth: Array,
    estimates: Mapping[str, Sequence[Array]],
) -> tuple[dict[str, Array], dict[str, list[Array]]]:
    """Where the tool is (n, 3) [m] in truth and by the first of every model, and errors of all.

    In the `judged` rows; both are empty without a `robot`, or one without kinematics.
    """
    if robot is None or robot.kinematics is None:
        return {}, {}
    kinematics = robot.kinematics
    reported, columns = all_joints(recording, robot)[judged], robot.index(list(joints))

    def place(positions: Array) -> Array:
        """Place of the tool with the calibrated joints at `positions` (n, n_joints)."""
        changed = reported.copy()
        changed[:, columns] = positions
        return kinematics.forward(changed)[..., :3, 3]

    true = place(truth)
    errors = {key: [place(value) - true for value in seeds] for key, seeds in estimates.items()}
    return {"truth": true} | {key: true + own[0] for key, own in errors.items()}, errors


def _finite(positions: Array, estimator: str, name: str) -> Array:
    bad = ~np.isfinite(positions).all(axis=1)
    if bad.any():
        raise CalibrationError(
            f"{estimator} gives no number for row {int(np.argmax(bad))} of {name}; the model "
            "does not apply to this recording"
        )
    return positions


def why_no_cartesian(robot: Robot, recordings: Sequence[Recording]) -> str:
    """Why tool positions cannot be computed; empty when no joint that moves the tool is missing."""
    if robot.kinematics is None:
        return f"The kinematics of {robot.name} are not known, so errors stay in joint space."
    for recording in recordings:
        missing = [j for j in robot.joint_names if j not in recording.joints_of("measured")]
        rows = np.linspace(0, len(recording) - 1, _PROBES).astype(np.int64)
        probes = all_joints(recording, robot)[rows]
        linear = robot.kinematics.jacobian(probes)[..., :3, :]
        needed = [j for j in missing if np.abs(linear[..., robot.index([j])]).max() > _STILL]
        if needed:
            return (
                f"{PurePath(recording.provenance.source).name or 'A recording'} lacks the "
                f"measured position of {', '.join(needed)}, which moves the tool."
            )
    return ""


def all_joints(recording: Recording, robot: Robot) -> Array:
    """Measured positions (n, n_joints) [rad or m] of all joints; home where there is no column."""
    joints = [joint for joint in robot.joint_names if joint in recording.joints_of("measured")]
    positions = np.tile(robot.home, (len(recording), 1))
    positions[:, robot.index(joints)] = recording.columns("measured", joints)
    return positions


def domain_of(traces: Sequence[Trace]) -> Domain:
    """Say what the loop would correct of the test, why not the rest, and whether truth fits it."""
    status = np.concatenate([trace.status for trace in traces])
    shares = [(float(np.mean(status & bit != 0)), str(bit.name)) for bit in Status if bit]
    return Domain(
        inside=float(np.mean(np.concatenate([trace.inside for trace in traces]))),
        flags={name: share for share, name in sorted(shares, reverse=True) if share},
        beyond=1.0 - float(np.concatenate([trace.believable for trace in traces]).mean()),
    )


def score_errors(
    tested: Sequence[JudgedRecording], joints: Sequence[str], units: Sequence[str]
) -> Iterator[Score]:
    """Score estimators in each joint over all recordings, the tool likewise, then each recording.

    Joints are `joints`, with their SI `units`.
    """
    pooled = _stacked([test.errors for test in tested])
    inside = np.concatenate([test.trace.inside for test in tested])
    yield from _scores(pooled, joints, units, inside=inside)
    vectors = _stacked([test.tool_errors for test in tested])
    lengths = {name: np.linalg.norm(e, axis=2)[..., None] for name, e in vectors.items()}
    for score in _scores(lengths, [TOOL], ["m"]):
        axes = _rmse(vectors[score.estimator]).mean(axis=0).tolist()
        yield replace(score, mean=math.nan, **dict(zip("xyz", axes, strict=True)))
    for test in tested:
        yield from _scores(_stacked([test.errors]), joints, units, recording=test.trace.name)


def _stacked(recordings: Sequence[Mapping[str, Sequence[Array]]]) -> dict[str, Array]:
    """Errors (seeds, rows, k) by estimator, the rows of all recordings together."""
    return {
        name: np.stack([np.concatenate(arrays) for arrays in zip(*parts, strict=True)])
        for name in recordings[0]
        if (parts := [errors[name] for errors in recordings])
    }


def _rmse(errors: Array) -> Array:
    """RMSE (seeds, k) of errors (seeds, rows, k); NaN without rows."""
    if not errors.shape[1]:
        return np.full(errors.shape[::2], np.nan)
    return np.asarray(np.sqrt(np.mean(np.square(errors), axis=1)))


def _scores(
    errors: Mapping[str, Array],
    joints: Sequence[str],
    units: Sequence[str],
    *,
    inside: Mask | None = None,
    recording: str = "",
) -> Iterator[Score]:
    """Score errors (seeds, rows, n_joints) by estimator; `inside` (rows,) splits them."""
    roots = {name: _rmse(error) for name, error in errors.items()}
    for name, error in errors.items():
        root = roots[name].mean(axis=0)
        columns = {
            "rmse": root,
            "max_abs": np.abs(error).max(axis=(0, 1)),
            "mean": error.mean(axis=1).mean(axis=0),
            "percent_of_offset": percent_of(root, roots[OFFSET].mean(axis=0)),
            "spread": spread(roots[name]),
        }
        if inside is not None:
            columns["rmse_inside"] = _rmse(error[:, inside]).mean(axis=0)
            columns["rmse_outside"] = _rmse(error[:, ~inside]).mean(axis=0)
        rows = np.column_stack([*columns.values()]).tolist()
        for joint, unit, row in zip(joints, units, rows, strict=True):
            values = dict(zip(columns, row, strict=True))
            yield Score(name, joint, unit, seeds=len(error), recording=recording, **values)


def spread(values: Array) -> Array:
    """Sample standard deviation over seeds (axis 0); NaN with fewer than two."""
    if len(values) < 2:
        return np.full(values.shape[1:], np.nan)
    return np.asarray(values.std(axis=0, ddof=1))


def worst_windows(
    t: Array, error: Array, window: float, count: int
) -> list[tuple[int, int, float]]:
    """Windows of one recording with the largest RMSE, at most `count`, worst first, apart.

    Each is (first, end, rmse): rows ``first:end`` of the stamps `t` (n,) [s] and the `error` (n,).
    One covers at least half of `window` [s], so that a few rows beside a gap do not count.
    """
    n = len(t)
    first = np.arange(n)
    end = np.searchsorted(t, t + window, side="right")
    total = np.concatenate(([0.0], np.cumsum(np.square(error))))
    mean_square = (total[end] - total[first]) / (end - first)
    long_enough = t[end - 1] - t >= 0.5 * min(window, float(t[-1] - t[0]))
    candidates = np.flatnonzero(long_enough) if long_enough.any() else first
    order = candidates[np.argsort(-mean_square[candidates], kind="stable")]
    free = np.ones(n, dtype=bool)
    windows: list[tuple[int, int, float]] = []
    for row in order:
        if len(windows) == count:
            break
        if free[row] and free[end[row] - 1]:
            free[row : end[row]] = False
            windows.append((int(row), int(end[row]), float(np.sqrt(max(mean_square[row], 0.0)))))
    return windows


def worst_stretches(
    traces: Sequence[Trace], chosen: str, joints: Sequence[JointVerdict], window: float
) -> tuple[Stretch, ...]:
    """Worst windows [s] of each joint over all recordings, by RMSE as a multiple of its limit."""
    stretches: list[Stretch] = []
    for column, verdict in enumerate(joints):
        of_joint = []
        for index, trace in enumerate(traces):
            error = trace.error(chosen)[:, column]
            for first, end, root in worst_windows(trace.t, error, window, _COUNT):
                largest = float(np.abs(error[first:end]).max())
                start, stop = float(trace.t[first]), float(trace.t[end - 1])
                of_joint.append(
                    Stretch(verdict.joint, verdict.unit, index, start, stop, root, largest)
                )
        stretches += sorted(of_joint, key=lambda stretch: -stretch.rmse)[:_COUNT]
    limits = {verdict.joint: verdict.limit if verdict.limit > 0 else 1.0 for verdict in joints}
    return tuple(sorted(stretches, key=lambda stretch: -stretch.rmse / limits[stretch.joint]))
