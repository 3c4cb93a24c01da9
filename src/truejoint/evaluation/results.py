"""What an evaluation found: the frame of errors, what is known by it, and the verdict."""

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from os import PathLike
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from pandas import DataFrame, Index, concat, factorize

from truejoint import drawing
from truejoint.array_types import Array
from truejoint.errors import CalibrationError, other_kind, unknown
from truejoint.estimators import registry
from truejoint.files import check_ending, write_atomically
from truejoint.recordings.judge.data_check import DataCheck
from truejoint.summary import Summarised, json_values
from truejoint.tables import decimals_for, fixed
from truejoint.units import DisplayUnit, display_unit, with_unit

RAW: Final = registry.RAW
OFFSET: Final = registry.OFFSET
# Always in the table, in this order; what was chosen stands after them.
BASELINES: Final = (RAW, *registry.BASELINES)

_TITLES: Final = {
    RAW: ("Raw", "the raw position"),
    "stack": ("Combination", "the combination of models"),
    **registry.TITLES,
}

# They stand for joints in errors and scores of the tool, and of it along the axes of the base.
TOOL: Final = "tool position"
AXES: Final = ("tool x", "tool y", "tool z")

_COLUMNS: Final = {
    "RMSE": "rmse", "spread": "spread", "largest": "max_abs", "mean": "mean",
    "RMSE inside": "rmse_inside", "RMSE outside": "rmse_outside",
    "RMSE x": "x", "RMSE y": "y", "RMSE z": "z",
}  # fmt: skip
"""Columns of scores by title; one without a number is left out."""
# Attributes of an evaluation that its JSON has not, or has by another name.
_LEFT_OUT: Final = (
    "title", "errors", "rows", "recording_scores", "interval_level", "effort_units",
)  # fmt: skip


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
class Domain:
    """Verdict of the loop's corrector on the test's rows, whatever the homing.

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
class JointVerdict:
    """One joint's RMSE [rad or m] beside the limit that it was held to.

    Attributes
    ----------
    joint, unit : str
    rmse, limit : float
        If no limit is `stated`, it is the RMSE of the estimator `against`.
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
        Notes for a reader that change nothing.
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


def by_recording(names: Index) -> list[slice]:
    """Rows of each recording, one after the other, by the names (n,) that rows have."""
    ends = np.flatnonzero(np.diff(factorize(names)[0])) + 1
    return [slice(a, b) for a, b in pairwise([0, *ends.tolist(), len(names)])]


def each(frame: DataFrame) -> Iterator[Any]:
    """Rows of a frame, their columns as attributes."""
    yield from frame.itertuples(index=False)


@dataclass(frozen=True, eq=False, repr=False)
class Evaluation(Summarised):
    """Accuracy of a calibration on recordings that it never saw.

    Tables are frames in SI units.

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
        Notes on a baseline that is missing or weak.
    errors : DataFrame
        The frame of errors: estimated minus true position [rad or m] in each row of the test that
        has truth, by estimator (of its first seed) and joint. If the kinematics are known, also of
        the tool in the base frame: `AXES`, and their distance `TOOL` [m]. The index names
        recordings.
    rows : DataFrame
        Further columns of these rows, by quantity and joint: ``"truth"``, ``"measured"``,
        ``"velocity"`` and ``"direction"`` (of the measured position, smoothed over 0.1 s; -1, 0 for
        standing, 1), ``"effort"`` of joints that have one in every recording, ``"lower"`` and
        ``"upper"`` bounds of the stated interval (NaN in rows that it says nothing of, absent
        where none is stated), and ``"tool"``, its true place. By quantity alone: ``"t"`` [s],
        ``"load"`` [kg], ``"status"`` (bits of `truejoint.runtime.Status` as the loop would give
        them once homed, and re-zeroed if the test is), ``"inside"`` (the loop would correct the
        row were its zero right), ``"believable"`` (it would believe truth minus measured).
    scores : DataFrame
        A row each estimator and joint, the tool among these, over all recordings: ``"rmse"``,
        ``"max_abs"``, ``"mean"`` (bias; the largest of any seed, means over seeds), ``"unit"``,
        ``"percent_of_offset"`` (RMSE by the fixed offset's), ``"spread"`` (standard deviation of
        the ``"seeds"``' RMSE), ``"rmse_inside"`` and ``"rmse_outside"`` (over the rows that the
        loop would correct, and the rest), ``"x"``, ``"y"``, ``"z"`` (RMSE of the tool by axis).
    recording_scores : DataFrame
        The same of joints in each ``"recording"``.
    cartesian_note : str
        Why there are no scores of the tool; empty where there are.
    worst : DataFrame
        Windows of at most 10 s in which the chosen model's first seed was at its worst, the worst
        by its limit first: ``"joint"``, ``"unit"``, ``"recording"``, ``"start"`` and ``"end"``
        (stamps [s]), ``"rmse"``, ``"max_abs"``.
    rezero : float
        Time of truth [s] that every recording was re-zeroed from; 0: judged as they come.
    verdict : Verdict
    check, domain : DataCheck, Domain
        Data check of the test's recordings.
    comparisons : DataFrame
        The chosen model's first seed beside every other ``"estimator"`` in each ``"joint"``: the
        ``"outcome"`` of its mean squared error at 95 % (``"better"``, ``"worse"``, ``"cannot be
        told"``), over how many ``"stretches"``, of which the longest lasts so many ``"seconds"``.
    intervals : DataFrame
        A row each stated ``"level"`` and ``"joint"``: ``"coverage"`` (mean over the test's
        trajectories of the share of samples inside), its ``"standard_error"`` (NaN with a single
        one), whether the level lies within its two-sided 95 % margin by Student's t
        (``"agreement"``: ``"agrees"``, ``"too few inside"``, ``"more inside"``, or empty),
        ``"half_width"`` (mean over samples), ``"shares"`` (of each trajectory), ``"unit"``.
    interval_trajectories : tuple of str
        Meaning of the shares: recordings, or all recordings after one homing.
    interval_level : float
        Level of the bounds in `rows`; NaN without an interval.
    interval_note, interval_objections : str, tuple of str
        Purpose of the interval, or a word that the model has no interval; on which recordings of
        the test it is not judged, and why.
    training, test : mapping, tuple of mapping
        JSON values that the chosen model says about its training, and of each recording of the
        test its ``"name"``, made unique, ``"rows"`` with truth of ``"rows_total"``, and provenance.
    effort_units : mapping of str to str

    Examples
    --------
    >>> evaluation.chosen, evaluation.joints
    ('linear', ('jaw',))
    >>> table = evaluation.scores.pivot(index="estimator", columns="joint", values="rmse")
    >>> table["jaw"].idxmin()
    'linear'
    >>> evaluation.errors["linear"].groupby("recording").size().tolist()
    [400]
    """

    robot: str
    arm: str
    title: str
    joints: tuple[str, ...]
    units: tuple[str, ...]
    chosen: str
    estimators: tuple[str, ...]
    baseline_notes: Mapping[str, str]
    errors: DataFrame
    rows: DataFrame
    scores: DataFrame
    recording_scores: DataFrame
    cartesian_note: str
    worst: DataFrame
    verdict: Verdict
    check: DataCheck
    domain: Domain
    comparisons: DataFrame
    training: Mapping[str, Any]
    test: tuple[Mapping[str, Any], ...]
    effort_units: Mapping[str, str]
    rezero: float = 0.0
    intervals: DataFrame = field(default_factory=DataFrame)
    interval_trajectories: tuple[str, ...] = ()
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
            "test": ", ".join(recording["name"] for recording in self.test),
            **accuracy,
            "verdict": self.verdict.text,
            "advice": self.verdict.advice,
        }

    def score(self, estimator: str, joint: str) -> Any:
        """Give the row of `scores` of an estimator and a joint, its columns as attributes.

        Raises CalibrationError for others.

        Examples
        --------
        >>> score = evaluation.score("linear", "jaw")
        >>> score.unit, score.rmse < 1e-3
        ('rad', True)
        """
        at = (self.scores["estimator"] == estimator) & (self.scores["joint"] == joint)
        for row in each(self.scores[at]):
            return row
        model, other = ("model", estimator, self.estimators), ("joint", joint, self.joints)
        wrong = unknown(*(model if joint in self.joints else other))
        raise CalibrationError(f"the evaluation: {wrong}")

    @property
    def rmse(self) -> DataFrame:
        """RMSE [rad or m] by joint (and the tool) and estimator; ``attrs["units"]`` by joint."""
        table = self.scores.pivot(index="joint", columns="estimator", values="rmse")
        table.attrs["units"] = dict(zip(self.scores["joint"], self.scores["unit"], strict=True))
        return table.loc[list(table.attrs["units"]), list(self.estimators)]

    def to_dataframe(self) -> DataFrame:
        """Copy of `scores`, in which each row states its unit."""
        return self.scores.copy()

    def _repr_html_(self) -> str:
        scores: DataFrame = concat(dict(all_scores(self))).droplevel(1)
        scores = scores.rename_axis("joint").reset_index()
        return super()._repr_html_() + scores.to_html(index=False, na_rep="", border=0)

    def plot(self) -> Any:
        """Draw which error a share of the rows keeps within; give matplotlib's axes (n_joints,)."""
        share = np.linspace(0.0, 1.0, 201)
        units = {f"{joint} error": u for joint, u in zip(self.joints, self.units, strict=True)}
        errors = {n: np.quantile(np.abs(self.error(n)), share, axis=0) for n in self.estimators}
        return drawing.plot(self.title, 100.0 * share, errors, units, "share of rows [%]")

    def save(self, path: str | PathLike[str], *, overwrite: bool = False) -> None:
        """Write `to_dict` as a JSON file; raises CalibrationError if it cannot be written."""
        data, target, error = json.dumps(self.to_dict()).encode(), Path(path), CalibrationError
        check_ending(target, ".json", "an evaluation", error)
        write_atomically(target, data, overwrite=overwrite, error=error)

    def shown_joints(self) -> list[tuple[int, str, DisplayUnit]]:
        """Column, name and unit for a person of each calibrated joint."""
        units = map(display_unit, self.units)
        return list(zip(range(len(self.joints)), self.joints, units, strict=True))

    def shown_scores(self) -> Iterator[tuple[str, DisplayUnit, DataFrame]]:
        """Joints, then the tool: name, unit for a person, and the scores of all estimators."""
        for joint, scores in self.scores.groupby("joint", sort=False):
            yield str(joint), display_unit(scores["unit"].iloc[0]), scores

    def error(self, estimator: str, *columns: str) -> Array:
        """Errors (n, n_columns) [rad or m] of an estimator's first seed, of joints by default."""
        return self.errors[estimator][list(columns or self.joints)].to_numpy()

    def known(self, quantity: str) -> Array:
        """Give a quantity of `rows` (n,), or (n, n_joints) where joints have it each."""
        return self.rows[quantity].to_numpy()

    def to_dict(self) -> dict[str, Any]:
        """Everything but the frames of rows, as values for JSON; SI units, NaN becomes None."""
        is_tool = self.scores["joint"] == TOOL
        frames = {"worst", "comparisons", "intervals"}
        values: dict[str, Any] = json_values(
            {name: value for name, value in vars(self).items() if name not in _LEFT_OUT}
            | {name: getattr(self, name).to_dict("records") for name in frames}
            | {
                "units": dict(zip(self.joints, self.units, strict=True)),
                "scores": self.scores[~is_tool].to_dict("records"),
                "recordings": self.recording_scores.to_dict("records"),
                "cartesian": self.scores[is_tool].to_dict("records"),
                "verdict": vars(self.verdict) | {"level": self.verdict.level},
            }
        )
        return values


def as_evaluation(value: object) -> Evaluation:
    """Give back an evaluation; raises CalibrationError for anything else."""
    if isinstance(value, Evaluation):
        return value
    raise CalibrationError(other_kind(value, "Evaluation", "give what `evaluate` gives"))


def all_scores(evaluation: Evaluation) -> Iterator[tuple[str, DataFrame]]:
    """Give a table of text per joint, then that of the tool where its place is known, by name."""
    for name, unit, scores in evaluation.shown_scores():
        fix = partial(fixed, decimals=decimals_for(unit.scale * scores["rmse"]))
        text = {"estimator": scores["estimator"].map(estimator_title)} | {
            f"{title} [{unit.name}]": (unit.scale * scores[column]).map(fix)
            for title, column in _COLUMNS.items()
            if scores[column].notna().any()
        }
        percent = scores["percent_of_offset"].map(partial(fixed, decimals=0))
        text["percent of fixed offset"] = percent
        yield name, DataFrame(text | {"seeds": scores["seeds"].map(str)})
