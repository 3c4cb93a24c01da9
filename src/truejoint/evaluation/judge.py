"""Errors of every model on a recording of the test, and what the control loop says of its rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import PurePath
from typing import Any, Protocol

import numpy as np

from truejoint.array_types import Array, Integers, Mask
from truejoint.calibration import Calibration
from truejoint.calibration.origin import Origin
from truejoint.calibration.zero import at_start, zeroed
from truejoint.errors import CalibrationError, RecordingError
from truejoint.evaluation.metrics import tool_positions
from truejoint.evaluation.results import OFFSET, RAW, Domain, Trace
from truejoint.evaluation.scoring import JudgedRecording
from truejoint.recordings.table.recording import Recording
from truejoint.recordings.table.signals import direction, velocity
from truejoint.robots import Robot
from truejoint.runtime import Status
from truejoint.runtime.corrector import corrector_for
from truejoint.runtime.limits import believable_corrections

_STILL = 1e-9  # m per rad or m per m; below, a joint does not move the tool
_PROBES = 20
_HOMING = ~int(Status.NOT_HOMED | Status.HOMED_AGAIN)


class Corrects(Protocol):
    """Anything that turns a recording into corrected joint positions."""

    def correct(self, recording: Recording) -> Array:
        """Corrected positions (n, n_joints) [rad or m] of every row."""


class JointCalibration(Corrects, Protocol):
    """What an evaluation needs of a fitted calibration."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints that it corrects."""

    @property
    def baselines(self) -> Mapping[str, Corrects]:
        """Fixed offset, and what else could be fitted of `BASELINES`, on the same rows."""

    @property
    def origin(self) -> Origin:
        """What it was made from."""

    @property
    def metadata(self) -> Mapping[str, Any]:
        """What it says about itself: JSON values."""


def judge_recording(
    recording: Recording,
    name: str,
    models: Mapping[str, Sequence[Corrects]],
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
    start, judged = _rows_with_truth(recording, truth, joints, rezero)
    at_zero = {
        estimator: [
            zeroed(seed, recording, rezero) if isinstance(seed, Calibration) else seed
            for seed in seeds
        ]
        for estimator, seeds in models.items()
    }
    measured = recording.columns("measured", joints)
    estimates = {RAW: [_finite(measured, RAW, name)[judged]]}
    for key, seeds in at_zero.items():
        found = [_positions(seed, recording, truth, start) for seed in seeds]
        estimates[key] = [_finite(positions, key, name)[judged] for positions in found]
    errors = {key: [value - truth[judged] for value in own] for key, own in estimates.items()}
    tool, tool_errors = _of_the_tool(robot, recording, judged, joints, truth[judged], estimates)
    efforts = [joint for joint in joints if joint in recording.joints_of("effort")]
    status = loop_status(at_zero[chosen][0], recording)
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
        status=None if status is None else status[judged],
        believable=believable(at_zero[chosen][0], (truth - measured)[judged]),
    )
    return JudgedRecording(trace, errors, tool_errors)


def _rows_with_truth(
    recording: Recording, truth: Array, joints: Sequence[str], rezero: float
) -> tuple[Mask, Mask]:
    """Tell in which rows (n,) truth sets the zero, and in which it judges."""
    judged = np.asarray(np.isfinite(truth).all(axis=1))
    start = judged.copy()
    if judged.any():
        start[judged] = at_start(recording.t[judged], rezero)
    judged &= ~start
    if judged.sum() < 2:
        besides = f" after the {rezero:g} s that re-zero it" if rezero > 0.0 else ""
        raise RecordingError(
            f"{recording.provenance.source or 'recording'}: {int(judged.sum())} rows have the "
            f"truth of {', '.join(joints)}{besides}; a test needs at least 2"
        )
    return start, judged


def _positions(model: Corrects, recording: Recording, truth: Array, start: Mask) -> Array:
    """Corrected positions (n, n_joints); of a baseline that cannot be re-zeroed itself, shifted."""
    corrected = model.correct(recording)
    if isinstance(model, Calibration) or not start.any():
        return corrected
    return corrected + np.median((truth - corrected)[start], axis=0)


def _of_the_tool(
    robot: Robot | None,
    recording: Recording,
    judged: Mask,
    joints: Sequence[str],
    truth: Array,
    estimates: Mapping[str, Sequence[Array]],
) -> tuple[dict[str, Array], dict[str, list[Array]]]:
    """Where the tool is (n, 3) [m] in the `known` rows: in truth, and by the first of every model.

    Besides the errors of all. Both are empty without a `robot`, or one without kinematics.
    """
    if robot is None or robot.kinematics is None:
        return {}, {}
    kinematics = robot.kinematics
    reported, columns = all_joints(recording, robot)[judged], robot.index(list(joints))

    def place(positions: Array) -> Array:
        """Place of the tool with the calibrated joints at `positions` (n, n_joints)."""
        changed = reported.copy()
        changed[:, columns] = positions
        return tool_positions(kinematics, changed)

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


def loop_status(model: object, recording: Recording) -> Integers | None:
    """`Status` bits (n,) of every row, by the corrector's own kernel; None if it takes no `model`.

    A moved zero is another matter than rows unlike the training, so bits of the homing are left
    out. An estimator that uses later rows runs in no loop; its training domain is judged by alone.
    """
    if not isinstance(model, Calibration) or model.training_domain is None:
        return None
    try:
        corrector = corrector_for(model, [recording])
    except CalibrationError:
        corrector = corrector_for(model.baselines[OFFSET], [recording])
    corrector.set_homing(True)
    return corrector.run(recording).status & _HOMING


def believable(model: object, error: Array) -> Mask | None:
    """Tell in which rows the loop would believe a correction by `error` (n, n_joints) [rad or m].

    That is truth minus measured position; None if no loop takes the `model`.
    """
    if not isinstance(model, Calibration) or model.training_domain is None:
        return None
    lower, upper = believable_corrections(model.training_domain)
    return np.asarray(((error >= lower) & (error <= upper)).all(axis=1))


def domain_of(traces: Sequence[Trace]) -> Domain | None:
    """Say what the loop would correct of the test, why not the rest, and whether truth fits it."""
    statuses = [trace.status for trace in traces if trace.status is not None]
    fits = [trace.believable for trace in traces if trace.believable is not None]
    if not statuses or not fits:
        return None
    status = np.concatenate(statuses)
    shares = {str(bit.name): float(np.mean(status & bit != 0)) for bit in Status if bit}
    flagged = sorted(((share, name) for name, share in shares.items() if share), reverse=True)
    return Domain(
        inside=float(np.mean(np.concatenate([trace.inside for trace in traces]))),
        flags={name: share for share, name in flagged},
        beyond=1.0 - float(np.concatenate(fits).mean()),
    )
