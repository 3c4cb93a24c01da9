"""What an evaluation found, as values: scores, worst stretches, verdict, and the curves."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np
from scipy.special import stdtrit

from truejoint.array_types import Array, Integers, Mask
from truejoint.errors import CalibrationError, other_kind, unknown
from truejoint.estimators import registry
from truejoint.evaluation.paired_test import Outcome
from truejoint.runtime import Status
from truejoint.summary import Summarised, json_values
from truejoint.units import DisplayUnit, display_unit, with_unit

if TYPE_CHECKING:
    from pandas import DataFrame

    from truejoint.recordings import DataCheck

RAW: Final = registry.RAW
OFFSET: Final = registry.OFFSET
# Always in the table, in this order; what was chosen stands after them.
BASELINES: Final = (RAW, *registry.BASELINES)

_TITLES: Final = {
    RAW: ("Raw", "the raw position"),
    "stack": ("Combination", "the combination of models"),
    **registry.TITLES,
}

TOOL: Final = "tool position"
"""Stands for a joint in scores of the tool."""

# Attributes of an evaluation that its JSON has not, or has by another name.
_LEFT_OUT: Final = ("title", "errors", "interval_level", "traces")


def estimator_phrase(name: str) -> str:
    """Name of an estimator within a sentence, such as ``"the neural network"``."""
    return _TITLES.get(name, ("", f"the model {name}"))[1]


def estimator_title(name: str) -> str:
    """Name of an estimator for a person; unknown names are shown as they are.

    Examples
    --------
    >>> estimator_title("dnn")
    'Neural network'
    """
    return _TITLES.get(name, (name, ""))[0]


@dataclass(frozen=True)
class Score:
    """Accuracy of one estimator in one joint or of the tool, on one recording or over all of them.

    Attributes
    ----------
    estimator, joint, unit : str
        The joint is `TOOL` for the tool's distance from its true position; the unit is that of the
        errors, ``"rad"`` or ``"m"``.
    rmse, max_abs, mean : float
        Root mean square, largest absolute and mean error (bias); the largest of any seed, means
        over seeds. A distance has no mean error.
    percent_of_offset : float
        `rmse` as a percentage of that of the fixed offset.
    spread, seeds : float, int
        Sample standard deviation of the seeds' RMSE, NaN with fewer than two; how many there are.
    rmse_inside, rmse_outside : float
        Root mean square over the rows that the loop would correct, and over those that it would
        refuse (`Domain`); NaN where there is none.
    x, y, z : float
        RMSE of the tool's position along each axis of the base frame [m]; NaN for a joint.
    recording : str
        Name of the recording; empty for all of them.

    Examples
    --------
    >>> score = evaluation.score("linear", "jaw")
    >>> score.unit, score.rmse < 1e-3
    ('rad', True)
    """

    estimator: str
    joint: str
    unit: str
    rmse: float
    max_abs: float
    mean: float
    percent_of_offset: float
    spread: float = math.nan
    seeds: int = 1
    rmse_inside: float = math.nan
    rmse_outside: float = math.nan
    x: float = math.nan
    y: float = math.nan
    z: float = math.nan
    recording: str = ""


@dataclass(frozen=True)
class IntervalScore:
    """How often the truth lay within the stated interval of one joint, at one level.

    Attributes
    ----------
    joint, unit : str
    level : float
        Stated probability.
    coverage, standard_error : float
        Mean over the test's trajectories of the share of samples inside, and the sampling error
        of that; NaN with a single one.
    half_width, offset_half_width : float
        Mean over the samples, widening outside the trained range included, and that of the fixed
        offset's interval, made of the same recordings [rad or m].
    shares : tuple of float
        Share of the samples inside, of each trajectory that was judged.

    Examples
    --------
    >>> IntervalScore("jaw", "rad", 0.9, 0.6, 0.02, 0.01, 0.03, (0.58, 0.62, 0.6)).agreement
    'too few inside'
    """

    joint: str
    unit: str
    level: float
    coverage: float
    standard_error: float
    half_width: float
    offset_half_width: float
    shares: tuple[float, ...]

    @property
    def margin(self) -> float:
        """Two-sided 95 % margin of `coverage` by Student's t; NaN with a single trajectory."""
        if len(self.shares) < 2:
            return math.nan
        return float(stdtrit(len(self.shares) - 1, 0.975)) * self.standard_error

    @property
    def agreement(self) -> str:
        """``"agrees"``, ``"too few inside"``, ``"more inside"``, or empty when one cannot tell."""
        if math.isnan(self.margin):
            return ""
        if self.coverage + self.margin < self.level:
            return "too few inside"
        return "more inside" if self.coverage - self.margin > self.level else "agrees"


@dataclass(frozen=True)
class Stretch:
    """A window of one test recording in which the chosen model was at its worst.

    Attributes
    ----------
    joint, unit : str
    recording : int
        Index into `Evaluation.traces`.
    start, end : float
        Time stamps [s] of its first and last row.
    rmse, max_abs : float
        Error of the chosen model's first seed within the window [rad or m].

    Examples
    --------
    >>> evaluation.worst[0].joint
    'jaw'
    """

    joint: str
    unit: str
    recording: int
    start: float
    end: float
    rmse: float
    max_abs: float


@dataclass(frozen=True)
class Domain:
    """What the corrector of the loop says of the test's rows, whatever the homing.

    Attributes
    ----------
    inside : float
        Share of the rows that it would correct; it would be in doubt in the others.
    flags : mapping of str to float
        Share of the rows by name of `truejoint.runtime.Status`, largest first.
    beyond : float
        Share of the rows in which truth minus measured position is a larger correction than the
        loop would ever believe.

    Examples
    --------
    >>> evaluation.domain.inside, evaluation.domain.beyond
    (1.0, 0.0)
    """

    inside: float
    flags: Mapping[str, float]
    beyond: float


@dataclass(frozen=True)
class Comparison:
    """Whether the chosen model is closer to the truth in a joint than another, beyond chance.

    Attributes
    ----------
    estimator, joint : str
        The other one.
    outcome : {"better", "worse", "cannot be told"}
        Of the chosen one's mean squared error, at 95 %.
    stretches, seconds : int, float
        Over how many stretches of the test, of which the longest lasts so long [s].

    Examples
    --------
    >>> evaluation.comparisons[1].estimator, evaluation.comparisons[1].outcome
    ('offset', 'better')
    """

    estimator: str
    joint: str
    outcome: Outcome
    stretches: int
    seconds: float


@dataclass(frozen=True)
class JointVerdict:
    """One joint's RMSE [rad or m] beside the limit that it was held to.

    Attributes
    ----------
    joint, unit : str
    rmse, limit : float
        Where no limit is `stated`, it is the RMSE of the estimator `against`.
    stated, passed : bool
    against : str
        Empty where the limit is stated.
    alike : str
        Simpler estimator that the passed one is not better than beyond chance; empty without one.

    Examples
    --------
    >>> evaluation.verdict.joints[0].against
    'offset'
    """

    joint: str
    unit: str
    rmse: float
    limit: float
    stated: bool
    passed: bool
    against: str = ""
    alike: str = ""


@dataclass(frozen=True)
class Verdict:
    """Whether the chosen model is good enough, in one sentence and joint by joint.

    Attributes
    ----------
    passed : bool
        True when every joint is within its limit and nothing in `objections` forbids a verdict.
    text, rule : str
        The sentence for a person, and what was asked of each joint.
    joints : tuple of JointVerdict
    objections : tuple of str
        Why the test itself cannot be believed, for instance rows seen in training.
    doubts : tuple of str
        Why a pass has reservations, for instance rows unlike the training.
    remarks : tuple of str
        What a reader should know though it changes nothing.
    deploy, advice : str
        Estimator of the table that belongs on the robot, empty where that cannot be told, and the
        sentence that says so: see `advise`. Both are empty where the test cannot be believed.

    Examples
    --------
    >>> evaluation.verdict.level, evaluation.verdict.deploy
    ('pass', '')
    """

    passed: bool
    text: str
    rule: str
    joints: tuple[JointVerdict, ...]
    objections: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    deploy: str = ""
    advice: str = ""

    @property
    def level(self) -> Literal["pass", "warn", "fail"]:
        """``"pass"`` only without a doubt."""
        if not self.passed:
            return "fail"
        return "warn" if self.doubts else "pass"


@dataclass(frozen=True, eq=False)
class Trace:
    """Curves of one test recording, rows with truth only.

    Attributes
    ----------
    name, provenance : str, mapping
        File name of the recording, made unique within the evaluation, and `Provenance.to_dict`.
    rows_total : int
        Rows of the recording, those without truth included.
    t : ndarray, shape (n,)
        Time stamps [s].
    truth, measured : ndarray, shape (n, n_joints)
        Positions [rad or m].
    velocity, direction : ndarray, shape (n, n_joints)
        Of the measured position, smoothed over 0.1 s [rad/s or m/s]; -1, 0 (standing) or 1.
    effort, effort_unit : mapping of str to ndarray (n,), mapping of str to str
        Of the joints that have one.
    estimates : mapping of str to ndarray (n, n_joints)
        Corrected positions [rad or m] by estimator; of its first seed.
    tool : mapping of str to ndarray (n, 3)
        Tool positions [m] of ``"truth"`` and of each estimator; empty without kinematics.
    lower, upper : ndarray, shape (n, n_joints), or None
        Bounds of the stated interval [rad or m], NaN in rows that it says nothing of; None where
        no interval holds.
    status : ndarray, shape (n,)
        Bits of `truejoint.runtime.Status` as the loop would give them once homed, and re-zeroed if
        the test is.
    believable : ndarray, shape (n,)
        Whether truth minus measured position is a correction that the loop would believe.

    Examples
    --------
    >>> evaluation.traces[0].truth.shape
    (400, 1)
    """

    name: str
    provenance: Mapping[str, Any]
    rows_total: int
    t: Array
    truth: Array
    measured: Array
    velocity: Array
    direction: Array
    effort: Mapping[str, Array]
    effort_unit: Mapping[str, str]
    estimates: Mapping[str, Array]
    tool: Mapping[str, Array]
    status: Integers
    believable: Mask
    lower: Array | None = None
    upper: Array | None = None

    @property
    def inside(self) -> Mask:
        """Rows (n,) that the loop would correct were their zero right."""
        return np.asarray(self.status & ~int(Status.ZERO_SUSPECT) == 0)

    def error(self, estimator: str) -> Array:
        """Estimated minus true position (n, n_joints) [rad or m]."""
        return self.estimates[estimator] - self.truth


def known_loads(traces: Sequence[Trace]) -> list[float]:
    """Masses [kg] at the tool that recordings name, ascending."""
    loads = [trace.provenance.get("load") for trace in traces]
    return sorted({float(load) for load in loads if load is not None})


@dataclass(frozen=True, eq=False, repr=False)
class Evaluation(Summarised):
    """What is known about the accuracy of a calibration on recordings that it never saw.

    Attributes
    ----------
    robot, arm, title : str
        The title is robot and arm for a person.
    joints, units : tuple of str
        Calibrated joints and the SI unit of each.
    chosen, estimators : str, tuple of str
        The one that the verdict is about, and all in the table: raw, offset, linear, poly2, then
        the others; the order of `scores`.
    baseline_notes : mapping of str to str
        What is to be known about a baseline that is missing or weak.
    errors : tuple of Score
        Every score: of joints and of the tool, over all recordings and on each.
    cartesian_note : str
        Why there are no scores of the tool; empty where there are.
    worst, window : tuple of Stretch, float
        Worst first, and their length [s].
    rezero : float
        Time of truth [s] that every recording was re-zeroed from; 0: judged as they come.
    verdict : Verdict
    check, domain : DataCheck, Domain
        Of the test's recordings.
    comparisons : tuple of Comparison
        The chosen model's first seed beside every other estimator, joint by joint.
    intervals, interval_trajectories : tuple of IntervalScore, tuple of str
        One row per stated level and joint of the chosen model's first seed, and what their shares
        are of: recordings, or all recordings after one homing.
    interval_level : float
        Level of the bounds in `traces`; NaN without an interval.
    interval_note, interval_objections : str, tuple of str
        What the interval is for, or that there is none; on which recordings of the test it is not
        judged, and why.
    training, traces : mapping, tuple of Trace
        JSON values that the chosen model says about its training, and curves for the report.

    Examples
    --------
    >>> evaluation.chosen, evaluation.joints
    ('linear', ('jaw',))
    >>> evaluation.to_dict()["verdict"]["passed"]
    True
    """

    robot: str
    arm: str
    title: str
    joints: tuple[str, ...]
    units: tuple[str, ...]
    chosen: str
    estimators: tuple[str, ...]
    baseline_notes: Mapping[str, str]
    errors: tuple[Score, ...]
    cartesian_note: str
    worst: tuple[Stretch, ...]
    window: float
    verdict: Verdict
    check: DataCheck
    domain: Domain
    comparisons: tuple[Comparison, ...]
    training: Mapping[str, Any]
    traces: tuple[Trace, ...]
    intervals: tuple[IntervalScore, ...] = ()
    interval_trajectories: tuple[str, ...] = ()
    rezero: float = 0.0
    interval_level: float = math.nan
    interval_note: str = "The model states no interval: it was not given recordings to make one of."
    interval_objections: tuple[str, ...] = ()

    def summary(self) -> dict[str, str]:
        """Verdict, and the accuracy beside that of the fixed offset, by label."""
        accuracy = {}
        for joint, unit in zip(self.joints, self.units, strict=True):
            both = (self.score(name, joint).rmse for name in (self.chosen, OFFSET))
            rmse, offset_rmse = (with_unit(value, unit) for value in both)
            accuracy[joint] = f"{rmse} RMSE (fixed offset {offset_rmse})"
        return {
            "of": f"{estimator_title(self.chosen)}, {self.title}",
            "test": ", ".join(trace.name for trace in self.traces),
            **accuracy,
            "verdict": self.verdict.text,
            "advice": self.verdict.advice,
        }

    @property
    def scores(self) -> tuple[Score, ...]:
        """Scores of joints over all recordings, by estimator."""
        return tuple(s for s in self.errors if not s.recording and s.joint != TOOL)

    @property
    def cartesian(self) -> tuple[Score, ...]:
        """Scores of the tool over all recordings, by estimator; none without kinematics."""
        return tuple(s for s in self.errors if not s.recording and s.joint == TOOL)

    @property
    def recording_scores(self) -> tuple[Score, ...]:
        """Scores of joints on each recording, by estimator."""
        return tuple(s for s in self.errors if s.recording)

    def frame(self) -> DataFrame:
        """Give all scores as a tidy DataFrame, a row each; SI units.

        Examples
        --------
        >>> frame = evaluation.frame()
        >>> table = frame[frame.recording == ""].pivot(index="estimator", columns="joint")
        >>> table["rmse", "jaw"].idxmin()
        'linear'
        """
        import pandas as pd  # noqa: PLC0415  # half a second, for those who ask

        return pd.DataFrame([vars(score) for score in self.errors])

    def score(self, estimator: str, joint: str) -> Score:
        """Give the row of an estimator and a joint; raises CalibrationError if there is none."""
        for row in self.errors:
            if row.estimator == estimator and row.joint == joint and not row.recording:
                return row
        if joint in self.joints:
            raise CalibrationError(
                f"the evaluation: {unknown('model', estimator, self.estimators)}"
            )
        raise CalibrationError(f"the evaluation: {unknown('joint', joint, self.joints)}")

    def shown_joints(self) -> list[tuple[int, str, DisplayUnit]]:
        """Column, name and unit for a person of each calibrated joint."""
        units = map(display_unit, self.units)
        return list(zip(range(len(self.joints)), self.joints, units, strict=True))

    def shown_scores(self) -> Iterator[tuple[str, DisplayUnit, list[Score]]]:
        """Joints, then the tool: name, unit for a person, and the scores of all estimators."""
        scores: dict[tuple[str, str], list[Score]] = {}
        for score in self.errors:
            if not score.recording:
                scores.setdefault((score.joint, score.unit), []).append(score)
        for (joint, unit), own in scores.items():
            yield joint, display_unit(unit), own

    def error(self, estimator: str, column: int) -> Array:
        """Error (n,) [rad or m] of an estimator in one joint, over the rows of all `traces`."""
        return np.concatenate([trace.error(estimator)[:, column] for trace in self.traces])

    def tool_error(self, estimator: str) -> Array:
        """Error (n, 3) [m] of the tool's position in the base frame, over the rows of `traces`."""
        return np.concatenate([t.tool[estimator] - t.tool["truth"] for t in self.traces])

    def to_dict(self) -> dict[str, Any]:
        """Everything but the curves, as values for JSON; SI units, NaN becomes None."""
        values: dict[str, Any] = json_values(
            {name: value for name, value in vars(self).items() if name not in _LEFT_OUT}
            | {
                "units": dict(zip(self.joints, self.units, strict=True)),
                "scores": list(map(vars, self.scores)),
                "recordings": list(map(vars, self.recording_scores)),
                "cartesian": list(map(vars, self.cartesian)),
                "verdict": vars(self.verdict) | {"level": self.verdict.level},
                "worst": [
                    {**vars(s), "recording": self.traces[s.recording].name} for s in self.worst
                ],
                "intervals": [vars(s) | {"agreement": s.agreement} for s in self.intervals],
                "test": [
                    {"name": t.name, "rows": len(t.t), "rows_total": t.rows_total, **t.provenance}
                    for t in self.traces
                ],
            }
        )
        return values


def as_evaluation(value: object) -> Evaluation:
    """Give back an evaluation; raises CalibrationError for anything else."""
    if isinstance(value, Evaluation):
        return value
    raise CalibrationError(other_kind(value, "Evaluation", "give what `evaluate` gives"))
