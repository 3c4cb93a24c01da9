"""Calibrations that are judged together, on recordings of one arm."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import PurePath

import numpy as np

from truejoint.array_types import Array
from truejoint.calibration import Calibration
from truejoint.errors import CalibrationError, RecordingError, unknown
from truejoint.evaluation import scoring
from truejoint.evaluation.comparison import compare
from truejoint.evaluation.deployment import PLAIN, to_deploy
from truejoint.evaluation.domain import domain_of
from truejoint.evaluation.intervals import judge_interval
from truejoint.evaluation.metrics import rmse
from truejoint.evaluation.results import (
    BASELINES,
    OFFSET,
    RAW,
    Comparison,
    Domain,
    Evaluation,
    Score,
    Trace,
    Verdict,
)
from truejoint.evaluation.scoring import JudgedRecording
from truejoint.evaluation.tested import (
    Corrects,
    JointCalibration,
    judged_recording,
    why_no_cartesian,
)
from truejoint.evaluation.verdict import doubts_about, judge, objections_to, rezero_remark
from truejoint.recordings.judge.data_check import DataCheck, check_data
from truejoint.recordings.table.recording import Recording
from truejoint.robots import Robot
from truejoint.summary import json_values

_REZEROED_RAW = f"{RAW}, re-zeroed"  # what a chosen raw position is called beside the baseline

Models = Mapping[str, Sequence[JointCalibration]]


@dataclass(frozen=True, eq=False)
class Trial:
    """Which calibrations are judged, which of them the verdict is about, and on what."""

    given: Models  # as they came
    calibrations: Models  # those fitted for motions that begin with a truth, where they do
    chosen: str
    joints: tuple[str, ...]
    recordings: Sequence[Recording]
    robot: Robot
    rezero: float  # of truth at the start of each motion [s]

    @classmethod
    def of(
        cls, given: Models, recordings: Sequence[Recording], chosen: str | None, rezero: float
    ) -> Trial:
        """Check that models and recordings go together; raises as `evaluate`."""
        if rezero > 0.0 and RAW in given:  # no correction, but not as it comes: another row
            given = {_REZEROED_RAW if name == RAW else name: own for name, own in given.items()}
            chosen = _REZEROED_RAW if chosen == RAW else chosen
        calibrations = _fitted_for(given, rezeroing=rezero > 0.0)
        name, joints = _checked_models(calibrations, chosen)
        robot = _checked_robot(recordings)
        return cls(given, calibrations, name, joints, recordings, robot, rezero)

    @property
    def own(self) -> JointCalibration:
        """What the verdict is about."""
        return self.calibrations[self.chosen][0]

    def data_check(self) -> DataCheck:
        """Check the recordings themselves."""
        own = self.own
        model = own if isinstance(own, Calibration) else None
        return check_data(self.recordings, joints=self.joints, model=model)

    def evaluation(
        self, tolerance: Mapping[str, float], window: float, check: DataCheck
    ) -> Evaluation:
        """Judge; `window` [s] is the length of the worst stretches."""
        robot, metadata = self.robot, self.own.metadata
        units = tuple(robot.joint(joint).unit for joint in self.joints)
        note = why_no_cartesian(robot, self.recordings)
        tested = self._tested(None if note else robot)
        traces = [test.trace for test in tested]
        scores = scoring.joint_scores(tested, self.joints, units)
        domain, comparisons = domain_of(traces), tuple(self._comparisons(traces))
        verdict = self._verdict(traces, scores, comparisons, domain, check, tolerance)
        return Evaluation(
            robot=robot.name,
            arm=robot.arm,
            title=robot.title,
            joints=self.joints,
            units=units,
            chosen=self.chosen,
            estimators=tuple(tested[0].errors),
            baseline_notes=dict(metadata.get("baseline_notes", {})),
            scores=scores,
            recording_scores=tuple(scoring.recording_scores(tested, self.joints, units)),
            cartesian=tuple(scoring.cartesian_scores(tested)),
            cartesian_note=note,
            worst=scoring.worst_stretches(traces, self.chosen, verdict.joints, window),
            window=window,
            rezero=self.rezero,
            verdict=verdict,
            check=check,
            domain=domain,
            comparisons=comparisons,
            training=json_values(metadata),
            **judge_interval(self.given[self.chosen][0], self.recordings, traces),
        )

    def _tested(self, robot: Robot | None) -> list[JudgedRecording]:
        models = _with_baselines(self.calibrations, self.chosen)
        names = unique_names([recording.provenance.source for recording in self.recordings])
        return [
            judged_recording(one, name, models, self.joints, robot, self.chosen, self.rezero)
            for one, name in zip(self.recordings, names, strict=True)
        ]

    def _comparisons(self, traces: Sequence[Trace]) -> Iterator[Comparison]:
        """Set the chosen model beside each other one, in each joint, over all rows."""
        step = float(np.median(np.concatenate([np.diff(trace.t) for trace in traces])))
        others = [name for name in traces[0].estimates if name != self.chosen]
        for (column, joint), other in product(enumerate(self.joints), others):
            own, its = ([t.error(name)[:, column] for t in traces] for name in (self.chosen, other))
            found = compare(own, its)
            yield Comparison(other, joint, found.outcome, found.stretches, found.rows * step)

    def _verdict(
        self,
        traces: Sequence[Trace],
        scores: Sequence[Score],
        comparisons: Sequence[Comparison],
        domain: Domain | None,
        check: DataCheck,
        tolerance: Mapping[str, float],
    ) -> Verdict:
        metadata = self.own.metadata
        of_plain = {n for n, own in self.calibrations.items() if estimator_of(own[0]) in PLAIN}
        verdict = judge(
            scores,
            self.chosen,
            tolerance=tolerance,
            comparisons=comparisons,
            deploy=to_deploy(traces, PLAIN | of_plain),
            objections=tuple(dict.fromkeys(objections_to(metadata, self.recordings, domain))),
            doubts=tuple(doubts_about(metadata, self.recordings, domain, check, self.rezero)),
        )
        if self.rezero == 0.0:
            return verdict
        as_it_is = _fitted_for(self.given, rezeroing=False)[self.chosen][0]
        own = {score.joint: score for score in scores if score.estimator == self.chosen}
        as_they_come = _as_they_come(as_it_is, self.recordings, traces)
        return rezero_remark(verdict, own, as_they_come, self.rezero)


def estimator_of(model: JointCalibration) -> str:
    """Name of a calibration's estimator; empty for what is none of ours."""
    return model.estimator if isinstance(model, Calibration) else ""


def _fitted_for(models: Models, *, rezeroing: bool) -> Models:
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


def _checked_models(calibrations: Models, chosen: str | None) -> tuple[str, tuple[str, ...]]:
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


def _with_baselines(calibrations: Models, chosen: str) -> Mapping[str, Sequence[Corrects]]:
    """Fitted models by estimator, baselines first; one that is given replaces its baseline.

    It does under another name too; the fixed offset stays, as the yardstick.
    """
    first = calibrations[chosen][0]
    given = {estimator_of(seed) for seeds in calibrations.values() for seed in seeds} - {OFFSET}
    baselines = {k: [model] for k, model in first.baselines.items() if k not in given}
    known = baselines | dict(calibrations)
    models = {n: known[n] for n in dict.fromkeys((*BASELINES, *calibrations)) if n in known}
    if OFFSET not in models:
        raise CalibrationError(
            f"the calibration {chosen} carries no fixed offset, the yardstick; calibrate it again"
        )
    return models


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
