"""Evaluate calibrations on recordings that they never saw, always beside the baselines."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from numbers import Real
from pathlib import PurePath
from typing import Any, Protocol

import numpy as np

from truejoint.array_types import Array
from truejoint.calibration import Calibration, read_calibration
from truejoint.calibration.zero import at_start, zeroed
from truejoint.errors import CalibrationError, RecordingError, other_kind, unknown
from truejoint.evaluation import scoring
from truejoint.evaluation.comparison import compare
from truejoint.evaluation.deployment import PLAIN, to_deploy
from truejoint.evaluation.domain import believable, domain_of, loop_status
from truejoint.evaluation.intervals import judge_interval
from truejoint.evaluation.metrics import rmse, tool_positions
from truejoint.evaluation.results import BASELINES, OFFSET, RAW, Comparison, Evaluation, Trace
from truejoint.evaluation.scoring import JudgedRecording
from truejoint.evaluation.verdict import doubts_about, judge, objections_to, rezero_remark
from truejoint.recordings.data_check import DataCheck, check_data
from truejoint.recordings.recording import Recording, as_recordings
from truejoint.recordings.signals import direction, velocity
from truejoint.robots import Robot
from truejoint.summary import json_values

_STILL = 1e-9  # m per rad or m per m; below, a joint does not move the tool
_PROBES = 20
_REZEROED_RAW = f"{RAW}, re-zeroed"  # what a chosen raw position is called beside the baseline


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
    def metadata(self) -> Mapping[str, Any]:
        """What it says about itself: JSON values."""


Model = Calibration | str | os.PathLike[str]


def evaluate(
    models: Model | Sequence[Model] | Mapping[str, Model | Sequence[Model | JointCalibration]],
    recordings: Recording | Sequence[Recording],
    *,
    chosen: str | None = None,
    tolerance: Mapping[str, float] | None = None,
    window: float = 10.0,
    rezero: float = 0.0,
    check: DataCheck | None = None,
) -> Evaluation:
    """Accuracy of calibrations on test recordings, per joint, per recording and of the tool.

    Raw positions, the fixed offset, the linear and the polynomial model are always in the
    table, the latter three as fitted on the training rows of the chosen calibration. Models see
    whole recordings, so their history is right; only rows with truth are judged. The recordings
    themselves are checked (`check_data`), and judged row by row as the loop would.

    Parameters
    ----------
    models : Calibration, path of a model file, sequence of these, or mapping of str to these
        All must correct the same joints. Several of one estimator are seeds of it: curves and
        stretches show the first. A mapping is by estimator.
    recordings : Recording or sequence of Recording
        With ``truth/<joint>`` of every calibrated joint.
    chosen : str, optional
        Estimator that the verdict is about; the first of `models` by default.
    tolerance : mapping of str to float, optional
        Largest RMSE [rad or m] that the user accepts, by joint; see `judge`.
    window : float
        Length [s] of the worst stretches.
    rezero : float
        When above 0, the first `rezero` seconds of truth of every recording set the zero of every
        model and baseline, and are not judged: the accuracy of motions that begin so. Where a
        calibration has a fit for that, it is the one that is judged. The raw position stays as
        it comes; a calibration that is the raw position goes by ``raw, re-zeroed`` then.
    check : DataCheck, optional
        Of these recordings, where it was made already; a check that failed is a doubt.

    Raises
    ------
    CalibrationError
        If there is nothing to evaluate, calibrations differ in joints, or a tolerance or time is
        wrong.
    RecordingError
        If a recording lacks truth beyond what re-zeroes it, or is of another arm than the first.

    Examples
    --------
    >>> evaluation = truejoint.evaluate(model, test)
    >>> evaluation.verdict.passed
    True
    """
    _check_times(window, rezero)
    given = _by_estimator(models)
    if rezero > 0.0 and RAW in given:  # a model of no correction, but not as it comes: another row
        given = {_REZEROED_RAW if name == RAW else name: seeds for name, seeds in given.items()}
        chosen = _REZEROED_RAW if chosen == RAW else chosen
    calibrations = _fitted_for(given, rezeroing=rezero > 0.0)
    recordings = as_recordings(recordings)
    chosen, joints = _checked_models(calibrations, chosen)
    robot = _checked_robot(recordings)
    own = calibrations[chosen][0]
    metadata = own.metadata
    fitted = _models(calibrations, chosen)
    note = why_no_cartesian(robot, recordings)
    names = unique_names([recording.provenance.source for recording in recordings])
    tested = [
        _test(recording, name, fitted, joints, robot if not note else None, chosen, rezero)
        for recording, name in zip(recordings, names, strict=True)
    ]
    traces = [test.trace for test in tested]
    units = tuple(robot.joint(joint).unit for joint in joints)
    scores = scoring.joint_scores(tested, joints, units)
    check = check or check_data(
        recordings, joints=joints, model=own if isinstance(own, Calibration) else None
    )
    domain = domain_of(traces)
    plain = PLAIN | {name for name, seeds in calibrations.items() if _estimator(seeds[0]) in PLAIN}
    estimators = tuple(tested[0].errors)
    comparisons = tuple(_comparisons(traces, chosen, estimators, joints))
    verdict = judge(
        scores,
        chosen,
        tolerance=tolerance or {},
        comparisons=comparisons,
        deploy=to_deploy(traces, plain),
        objections=tuple(dict.fromkeys(objections_to(metadata, recordings, domain))),
        doubts=tuple(doubts_about(metadata, recordings, domain, check, rezero)),
    )
    if rezero > 0.0:
        as_it_is = _fitted_for(given, rezeroing=False)[chosen][0]
        own_scores = {score.joint: score for score in scores if score.estimator == chosen}
        verdict = rezero_remark(
            verdict, own_scores, _as_they_come(as_it_is, recordings, traces), rezero
        )
    return Evaluation(
        robot=robot.name,
        arm=robot.arm,
        title=robot.title,
        joints=joints,
        units=units,
        chosen=chosen,
        estimators=estimators,
        baseline_notes=dict(metadata.get("baseline_notes", {})),
        scores=scores,
        recording_scores=tuple(scoring.recording_scores(tested, joints, units)),
        cartesian=tuple(scoring.cartesian_scores(tested)),
        cartesian_note=note,
        worst=scoring.worst_stretches(traces, chosen, verdict.joints, window),
        window=window,
        rezero=rezero,
        verdict=verdict,
        check=check,
        domain=domain,
        comparisons=comparisons,
        training=json_values(metadata),
        **judge_interval(given[chosen][0], recordings, traces),
    )


def _check_times(window: float, rezero: float) -> None:
    if not (isinstance(rezero, Real) and 0.0 <= rezero < math.inf):
        raise CalibrationError(
            f"the time to re-zero from is {rezero!r:.40} s; it must be 0 s or more"
        )
    if not (isinstance(window, Real) and 0.0 < window < math.inf):
        raise CalibrationError(
            f"the window of worst stretches is {window!r:.40} s; it must be > 0 s"
        )


def _comparisons(
    traces: Sequence[Trace], chosen: str, estimators: Sequence[str], joints: Sequence[str]
) -> Iterator[Comparison]:
    """Set the chosen model beside each other one, in each joint, over all rows."""
    step = float(np.median(np.concatenate([np.diff(trace.t) for trace in traces])))
    others = [name for name in estimators if name != chosen]
    for (column, joint), other in product(enumerate(joints), others):
        own, its = ([t.error(name)[:, column] for t in traces] for name in (chosen, other))
        found = compare(own, its)
        yield Comparison(other, joint, found.outcome, found.stretches, found.rows * step)


def _by_estimator(
    models: Model | Sequence[Model] | Mapping[str, Model | Sequence[Model | JointCalibration]],
) -> Mapping[str, Sequence[JointCalibration]]:
    if isinstance(models, Mapping):
        return {k: [_read(one) for one in _several(v)] for k, v in models.items()}
    found: dict[str, list[JointCalibration]] = {}
    for model in map(_read, _several(models)):
        found.setdefault(_estimator(model) or type(model).__name__, []).append(model)
    return found


def _several(given: Any) -> Sequence[Any]:
    return given if isinstance(given, list | tuple) else [given]


def _read(given: Any) -> JointCalibration:
    """Give a model, or that of a file; raises CalibrationError for what is none."""
    model = read_calibration(given) if isinstance(given, str | os.PathLike) else given
    if not all(hasattr(model, name) for name in ("correct", "joints", "baselines", "metadata")):
        advice = "give what `calibrate` gives, or the path of a model file"
        raise CalibrationError(other_kind(model, "Calibration", advice))
    found: JointCalibration = model
    return found


def _estimator(model: JointCalibration) -> str:
    return model.estimator if isinstance(model, Calibration) else ""


def _fitted_for(
    models: Mapping[str, Sequence[JointCalibration]], *, rezeroing: bool
) -> Mapping[str, Sequence[JointCalibration]]:
    return {
        name: [
            seed.fitted_for(rezeroing=rezeroing) if isinstance(seed, Calibration) else seed
            for seed in seeds
        ]
        for name, seeds in models.items()
    }


def _as_they_come(
    model: Corrects, recordings: Sequence[Recording], traces: Sequence[Trace]
) -> Array:
    """RMSE (n_joints,) [rad or m] of positions that are not re-zeroed, on the rows of `traces`."""
    errors = [
        model.correct(recording)[np.isin(recording.t, trace.t)] - trace.truth
        for recording, trace in zip(recordings, traces, strict=True)
    ]
    return np.asarray(rmse(np.concatenate(errors)))


def _checked_models(
    calibrations: Mapping[str, Sequence[JointCalibration]], chosen: str | None
) -> tuple[str, tuple[str, ...]]:
    if not calibrations or not all(calibrations.values()):
        raise CalibrationError("there is no calibration to evaluate; give at least one")
    chosen = chosen or next(iter(calibrations))
    if chosen not in calibrations:
        raise CalibrationError(f"the verdict: {unknown('calibration', chosen, calibrations)}")
    joints = tuple(calibrations[chosen][0].joints)
    for name, seed in ((name, seed) for name, seeds in calibrations.items() for seed in seeds):
        if tuple(seed.joints) != joints:
            raise CalibrationError(
                f"{name} corrects {', '.join(seed.joints)} but {chosen} corrects "
                f"{', '.join(joints)}; compare calibrations of the same joints"
            )
    return chosen, joints


def _checked_robot(recordings: Sequence[Recording]) -> Robot:
    if not recordings:
        raise RecordingError("there is no recording to evaluate on; give at least one")
    first = recordings[0].provenance
    for other in (recording.provenance for recording in recordings):
        if (other.robot, other.arm) != (first.robot, first.arm):
            raise RecordingError(
                f"{other.source or 'recording'} is of {other.robot} {other.arm} but "
                f"{first.source or 'the first'} is of {first.robot} {first.arm}; evaluate one "
                "arm at a time"
            )
    return recordings[0].robot


def _models(
    calibrations: Mapping[str, Sequence[JointCalibration]], chosen: str
) -> Mapping[str, Sequence[Corrects]]:
    """Fitted models by estimator, baselines first; one that is given replaces its baseline.

    It does under another name too; the fixed offset stays, as the yardstick.
    """
    first = calibrations[chosen][0]
    given = {_estimator(seed) for seeds in calibrations.values() for seed in seeds} - {OFFSET}
    baselines = {k: [model] for k, model in first.baselines.items() if k not in given}
    known = baselines | dict(calibrations)
    models = {n: known[n] for n in dict.fromkeys((*BASELINES, *calibrations)) if n in known}
    if OFFSET not in models:
        raise CalibrationError(
            f"the calibration {chosen} carries no fixed offset, the yardstick; calibrate it again"
        )
    return models


def _test(
    recording: Recording,
    name: str,
    models: Mapping[str, Sequence[Corrects]],
    joints: tuple[str, ...],
    robot: Robot | None,
    chosen: str,
    rezero: float,
) -> JudgedRecording:
    truth = recording.columns("truth", joints)
    known = np.asarray(np.isfinite(truth).all(axis=1))
    start = known.copy()
    if known.any():
        start[known] = at_start(recording.t[known], rezero)
    known &= ~start
    if known.sum() < 2:
        besides = f" after the {rezero:g} s that re-zero it" if rezero > 0.0 else ""
        raise RecordingError(
            f"{recording.provenance.source or 'recording'}: {int(known.sum())} rows have the "
            f"truth of {', '.join(joints)}{besides}; a test needs at least 2"
        )

    at_zero = {
        estimator: [
            zeroed(seed, recording, rezero) if isinstance(seed, Calibration) else seed
            for seed in seeds
        ]
        for estimator, seeds in models.items()
    }

    def positions(model: Corrects) -> Array:
        found = model.correct(recording)
        if isinstance(model, Calibration) or not start.any():
            return found
        return found + np.median((truth - found)[start], axis=0)

    measured = recording.columns("measured", joints)
    estimates = {RAW: [_finite(measured, RAW, name)[known]]} | {
        estimator: [_finite(positions(seed), estimator, name)[known] for seed in seeds]
        for estimator, seeds in at_zero.items()
    }
    truth = truth[known]
    errors = {key: [value - truth for value in seeds] for key, seeds in estimates.items()}
    tool: dict[str, Array] = {}
    tool_errors: dict[str, list[Array]] = {}
    if robot is not None and robot.kinematics is not None:
        reported, columns = all_joints(recording, robot)[known], robot.index(list(joints))

        def pose(positions: Array) -> Array:
            """All joints (n, robot joints), the calibrated ones at `positions` (n, n_joints)."""
            changed = reported.copy()
            changed[:, columns] = positions
            return changed

        true = tool_positions(robot.kinematics, pose(truth))
        for key, seeds in estimates.items():
            tools = [tool_positions(robot.kinematics, pose(value)) for value in seeds]
            tool_errors[key] = [position - true for position in tools]
        tool = {"truth": true} | {key: true + tool_errors[key][0] for key in (OFFSET, chosen)}
    efforts = [joint for joint in joints if joint in recording.joints_of("effort")]
    status = loop_status(at_zero[chosen][0], recording)
    trace = Trace(
        name=name,
        provenance=recording.provenance.to_dict(),
        rows_total=len(recording),
        t=recording.t[known],
        truth=truth,
        measured=measured[known],
        velocity=velocity(recording.t, measured)[known],
        direction=direction(recording.t, measured)[known],
        effort={joint: recording.column(f"effort/{joint}")[known] for joint in efforts},
        effort_unit={joint: recording.units[f"effort/{joint}"] for joint in efforts},
        estimates={key: seeds[0] for key, seeds in estimates.items()},
        tool=tool,
        status=None if status is None else status[known],
        believable=believable(at_zero[chosen][0], truth - measured[known]),
    )
    return JudgedRecording(trace, errors, tool_errors)


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
    known = [joint for joint in robot.joint_names if joint in recording.joints_of("measured")]
    positions = np.tile(robot.home, (len(recording), 1))
    positions[:, robot.index(known)] = recording.columns("measured", known)
    return positions


def unique_names(sources: Sequence[str]) -> list[str]:
    """Short names of recordings: the file's name, with its folder where two are the same."""
    short = [PurePath(source).name or "recording" for source in sources]
    longer = [
        "/".join(PurePath(source).parts[-2:]) if short.count(name) > 1 and source else name
        for source, name in zip(sources, short, strict=True)
    ]
    return [
        name if longer.count(name) == 1 else f"{name} #{longer[: i + 1].count(name)}"
        for i, name in enumerate(longer)
    ]
