"""A fitted calibration: corrects recordings, or one sample at a time.

Here is all that runs. What learns is looked up when it is asked for, so a control loop does without
scikit-learn and pandas.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple, Self, TypeVar, cast

import numpy as np

from truejoint import drawing, schema
from truejoint.array_types import Array
from truejoint.calibration.compatibility import check_arm, check_columns, check_robot, check_units
from truejoint.calibration.domain import TrainingDomain
from truejoint.calibration.efforts import EffortBaseline
from truejoint.calibration.interval import LEVEL, Interval, inverse_span, range_excesses
from truejoint.calibration.origin import Origin
from truejoint.calibration.redundancy import ParityEquations
from truejoint.calibration.rows import Rows
from truejoint.errors import CalibrationError, RecordingError, other_kind
from truejoint.estimators.family import EstimatorData, Family, Target, evaluate
from truejoint.features.feature_set import FeatureSet, check_history, check_sample_dt
from truejoint.robots.robot import Robot
from truejoint.summary import Summarised
from truejoint.units import with_unit

if TYPE_CHECKING:  # a control loop corrects without them
    import pandas as pd

    from truejoint.calibration.potentiometers import PotentiometerReference
    from truejoint.calibration.zero import Zero
    from truejoint.estimators.base import JointRegressor
    from truejoint.recordings import Recording

Recorded = TypeVar("Recorded")
_FILES = "truejoint.calibration.model_file"  # which needs this module


class Fit(NamedTuple):
    """A fitted model, the baselines beside it, and the estimator as it was fitted."""

    fitted: EstimatorData
    baselines: Mapping[str, EstimatorData]
    learnt: JointRegressor | None = None  # no file holds it


@dataclass(frozen=True, eq=False, repr=False)
class Calibration(Summarised):
    """A fitted estimator with all that is needed to use it on the arm that it was made for.

    Made by `calibrate` or `read_calibration`; it is what a model file holds.

    Examples
    --------
    >>> model.estimator, model.joints
    ('linear', ('jaw',))
    >>> model.correct(test).shape  # rows, joints [rad or m]
    (400, 1)
    >>> list(model.correct_table(test).columns)
    ['t', 'corrected/jaw', 'half_width/jaw']
    """

    machine: Robot  # and its arm
    joints: tuple[str, ...]  # that it corrects
    feature_set: FeatureSet  # inputs of the model, in order
    target: Target  # of the model: truth minus measured (peng2024, II-J), or the position itself
    units: Mapping[str, str]  # SI unit of each column that a recording must have
    gap_limit: float  # time without a sample [s] after which the history of features starts anew
    lower: Array  # (k,), range of each feature in the training rows
    upper: Array
    fitted: EstimatorData  # of `joints` in their order
    fitted_baselines: Mapping[str, EstimatorData]  # fitted to the error on the same rows
    origin: Origin = field(default_factory=Origin)
    metadata: Mapping[str, Any] = field(default_factory=dict)  # JSON values for people
    training_domain: TrainingDomain | None = None  # for the checks of a control loop
    interval: Interval | None = None  # None until trajectories are given that the fit has not used
    effort_baseline: EffortBaseline | None = None  # for the monitors
    parity: ParityEquations | None = None  # of measured positions with `redundant` columns
    redundant: Mapping[str, str] = field(default_factory=dict)  # units of these, by column
    potentiometers: PotentiometerReference | None = None  # what they read against the encoders
    rezeroed_fit: Fit | None = None
    """Fit with a zero for each training recording, for motions that begin with re-zeroing. It is
    useless without, as all that differs between recordings went into `Origin.zeros`."""
    offsets: Mapping[str, Array] = field(default_factory=dict)
    """Zero (n_joints,) [rad or m] of ``"model"`` and of the baselines; 0 where none is stated."""
    moves: Array | None = None
    """(n_signals, n_joints), how far a signal moves with the zero of each joint: then the zero is
    one of the measured positions, as after a homing. None: it is added to the output."""
    zero: Zero | None = None  # that was set last, by `at`
    learnt: JointRegressor | None = None  # the estimator as it was fitted; no file holds it

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Any:
        """Read a model file, as `read_calibration`."""
        return import_module(_FILES).read_calibration(path)

    def save(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Write a model file, as `write_calibration`."""
        import_module(_FILES).write_calibration(self, path, overwrite=overwrite)

    @property
    def robot(self) -> str:
        """Name of the robot."""
        return self.machine.name

    @property
    def arm(self) -> str:
        """Arm of the robot, empty if it has one."""
        return self.machine.arm

    @property
    def title(self) -> str:
        """Robot and arm for a person, for instance ``"raven2 (left arm)"``."""
        return self.machine.title

    @property
    def estimator(self) -> str:
        """Name of the estimator, for instance ``"dnn"`` or ``"RandomForestRegressor"``."""
        name = self.origin.estimator
        return name if name.isidentifier() else self.model.name

    @cached_property
    def family(self) -> Family:
        """Family that runs the estimator."""
        return self.model.family if self._is_learnt else self.fitted.kind

    @property
    def _is_learnt(self) -> bool:
        return self.learnt is not None and self.learnt.arrays_ is self.fitted.arrays

    @cached_property
    def model(self) -> JointRegressor:
        """The fitted estimator as an object of the class that learns."""
        if self._is_learnt and self.learnt is not None:
            return self.learnt
        class_of = import_module("truejoint.estimators.wrapped").class_of
        shape = len(self.feature_set), len(self.joints)
        return cast("JointRegressor", class_of(self.fitted.family).from_data(self.fitted, *shape))

    @cached_property
    def signals(self) -> tuple[str, ...]:
        """Columns that are needed: those of the features, then any other measured position."""
        measured = (f"measured/{joint}" for joint in self.joints)
        return tuple(dict.fromkeys((*self.feature_set.signals, *measured)))

    @property
    def loop_signals(self) -> tuple[str, ...]:
        """Columns of a sample in the control loop: `signals`, then those that check them."""
        return (*self.signals, *self.redundant)

    def without_redundant(self) -> Self:
        """Give it without the columns that check `signals`, for recordings that lack them."""
        domain = self.training_domain
        if domain is not None:
            n, by_name = len(self.signals), vars(domain).items()
            domain = replace(domain, **{k: v[:n] for k, v in by_name if k.startswith("signal_")})
        return replace(self, training_domain=domain, parity=None, redundant={})

    @property
    def usual_level(self) -> float:
        """Level where none is asked for: 0.9, or the nearest that the interval states."""
        levels: list[float] = [LEVEL] if self.interval is None else self.interval.levels.tolist()
        return min(levels, key=lambda level: (abs(level - LEVEL), -level))

    def required_interval(self) -> Interval:
        """Interval that is stated; raises CalibrationError without one."""
        if self.interval is None:
            raise CalibrationError(
                f"the calibration of {self.title} states no interval; make one of recordings that "
                "it has not seen: truejoint calibrate ... --interval RECORDING"
            )
        return self.interval

    @cached_property
    def offset(self) -> Array:
        """Zero of the model (n_joints,) [rad or m]."""
        return self.offsets.get("model", np.zeros(len(self.joints)))

    @cached_property
    def signal_shift(self) -> Array:
        """Shift that is added to each signal (n_signals,) before anything is made of it."""
        return np.zeros(len(self.signals)) if self.moves is None else self.moves @ self.offset

    @cached_property
    def output_shift(self) -> Array:
        """Shift that is added to the prediction (n_joints,) [rad or m]."""
        by_signals = self.moves is not None and self.target == "position"
        return np.zeros(len(self.joints)) if by_signals else self.offset

    @property
    def for_rezeroing(self) -> Self:
        """The fit for motions that begin with re-zeroing; itself where there is no other.

        Examples
        --------
        >>> model.for_rezeroing is model
        True
        """
        fit = self.rezeroed_fit
        if fit is None:
            return self
        return replace(
            self, fitted=fit.fitted, fitted_baselines=fit.baselines, learnt=fit.learnt,
            interval=None, rezeroed_fit=None,
        )  # fmt: skip

    def at(self, zero: Zero) -> Self:
        """Give the calibration at another zero: the one way to re-zero it.

        It is that of `for_rezeroing`. The model moves by `Zero.shift`, each baseline by its own
        offset, and the range of plausible corrections moves along. `zero` and the homings of
        `origin` say so. Raises CalibrationError unless the zero has a finite number for each joint.

        Examples
        --------
        >>> from truejoint.calibration import Zero
        >>> moved = model.at(Zero([1e-3]))
        >>> bool(np.allclose(moved.correct(test) - model.correct(test), 1e-3))
        True
        """
        if not hasattr(zero, "shift"):
            raise CalibrationError(other_kind(zero, "Zero", "find_zero gives one, or Zero([0.01])"))
        if zero.shift.shape != (len(self.joints),) or not np.isfinite(zero.shift).all():
            raise CalibrationError(
                f"zero {zero.shift.tolist()!r:.60} is not a finite number for each of "
                f"{', '.join(self.joints)}"
            )
        rezeroed = self.for_rezeroing
        if zero.moves is not None:
            rezeroed = replace(rezeroed, moves=zero.moves)
        rezeroed = rezeroed.shifted(zero.shift)
        offsets = dict(rezeroed.offsets)
        for name in rezeroed.fitted_baselines:
            by = zero.baselines.get(name, zero.shift if zero.moves is None else 0.0)
            offsets[name] = offsets.get(name, np.zeros(len(self.joints))) + by
        origin = rezeroed.origin
        if zero.homing_id:
            origin = replace(origin, homing_ids=(zero.homing_id,))
        return replace(rezeroed, offsets=offsets, origin=origin, zero=zero)

    def shifted(self, offset: Array) -> Self:
        """Move the zero of the model by `offset` (n_joints,) [rad or m]; baselines stay."""
        domain = self.training_domain
        if domain is not None:
            bounds = {n: getattr(domain, n) + offset for n in ("error_lower", "error_upper")}
            domain = replace(domain, **bounds)
        offsets = {**self.offsets, "model": self.offset + offset}
        return replace(self, offsets=offsets, training_domain=domain)

    @cached_property
    def baselines(self) -> Mapping[str, Self]:
        """Fixed offset, linear and polynomial, fitted on the same rows: a calibration each."""
        bare = replace(
            self, target="error", fitted_baselines={}, rezeroed_fit=None, interval=None,
            effort_baseline=None,
        )  # fmt: skip
        baselines = dict[str, Self]()
        for name, fitted in self.fitted_baselines.items():
            offsets = {"model": self.offsets[name]} if name in self.offsets else {}
            origin = replace(self.origin, estimator=name)
            baselines[name] = replace(bare, fitted=fitted, offsets=offsets, origin=origin)
        return baselines

    def rows(self, recording: Recording | Rows) -> Rows:
        """See a recording through the features, once for all that is made of it.

        Rows that were seen in the same way are given back. Raises CalibrationError if robot, arm,
        columns, units or (where features count samples) the rate differ.
        """
        shift = self.signal_shift if self.signal_shift.any() else None
        how = {name: getattr(self, name) for name in ("feature_set", "joints", "gap_limit")}
        if not isinstance(recording, Rows):
            self.check_recording(recording)
            return Rows.of(recording, **how, signal_shift=shift)
        is_same = all(getattr(recording, name) == value for name, value in how.items())
        if is_same and np.array_equal(np.asarray(recording.signal_shift), np.asarray(shift)):
            return recording
        self.check_recording(recording.recording)
        fresh = replace(recording, **how, signal_shift=shift)
        return fresh.of_recording(recording.recording)

    def correct(self, recording: Recording | Rows) -> Array:
        """Correct the measured positions of a recording: `joints` (n, n_joints) [rad or m].

        It needs the columns `signals`, no truth; raises as `rows`.
        """
        rows = self.rows(recording)
        n_joints = len(self.joints)
        last = rows.last_prediction
        if last and last[0][0] is self.fitted:  # at another zero
            predicted = last[0][1]
        elif self.family.row is None:
            predicted = self.model.evaluate(rows.X, rows.dt)
        else:
            memory = self.family.memory(self.fitted, len(self.feature_set), n_joints)
            predicted = evaluate(self.family, memory, rows.X, rows.dt, n_joints)
        last[:] = [(self.fitted, predicted)]
        predicted = predicted + self.output_shift
        return predicted if self.target == "position" else rows.measured + predicted

    predict = correct  # scikit-learn's word

    def correct_table(self, recording: Recording, level: float | None = None) -> pd.DataFrame:
        """Correct a recording into a table; raises as `correct`.

        Columns ``t`` [s] and ``corrected/<joint>``, and with an interval ``half_width/<joint>``
        [rad or m], by default at `usual_level`. Raises CalibrationError for a level that the
        calibration does not state.
        """
        rows = self.rows(recording)
        columns = {"t": rows.t}
        values = {"corrected": self.correct(rows)}
        if self.interval is not None or level is not None:
            stated = self.usual_level if level is None else level
            values["half_width"] = self.half_widths(rows, stated)
        for name, array in values.items():
            columns |= {f"{name}/{joint}": array[:, k] for k, joint in enumerate(self.joints)}
        table = type(recording.table)(columns)  # a recording knows tables, a control loop does not
        names = [name for name in columns if name != "t"]
        table.attrs["units"] = {n: self.units[f"measured/{n.partition('/')[2]}"] for n in names}
        return table

    def predict_error(self, recording: Recording | Rows) -> Array:
        """Corrected minus measured position (n, n_joints) [rad or m]; raises as `correct`."""
        rows = self.rows(recording)
        return self.correct(rows) - rows.measured

    def correct_with_interval(
        self, recording: Recording | Rows, level: float = 0.9
    ) -> tuple[Array, Array, Array]:
        """Give `correct` and the bounds between which a joint is with a probability of `level`.

        Each (n, n_joints) [rad or m]; see `Interval` for the meaning. Raises CalibrationError as
        `correct`, or if the calibration has no interval of that level.
        """
        rows = self.rows(recording)
        corrected, half = self.correct(rows), self.half_widths(rows, level)
        return corrected, corrected - half, corrected + half

    def half_widths(self, recording: Recording | Rows, level: float = 0.9) -> Array:
        """Half-width (n, n_joints) [rad or m] of the interval at every row of a recording.

        Wider where a feature is outside its trained range. Raises CalibrationError if the
        calibration has no interval, or not of that level.
        """
        interval = self.required_interval()
        widening = 1.0 + interval.growth * self.range_excess(recording)
        return widening[:, None] * interval.half_width(level)

    def range_excess(self, recording: Recording | Rows) -> Array:
        """How far outside the trained range each row (n,) is, as a share of it; 0 inside."""
        X = self.rows(recording).X
        excess = np.empty(len(X))
        range_excesses(X, self.lower, self.upper, inverse_span(self.lower, self.upper), excess)
        return excess

    def with_metadata(self, **items: Any) -> Self:
        """Add JSON values, such as ``command``, to the metadata of a copy.

        Raises CalibrationError if a value is not JSON.
        """
        try:
            plain = json.loads(json.dumps(items, allow_nan=False))
        except (TypeError, ValueError) as error:
            raise CalibrationError(
                f"metadata {', '.join(items)} cannot be kept as JSON ({error}); give plain numbers "
                "and texts"
            ) from None
        return replace(self, metadata={**self.metadata, **plain})

    @property
    def facts(self) -> dict[str, Any]:
        """JSON values of what the calibration was made from: those of `origin`, and `metadata`."""
        return {**schema.plain(self.origin), **self.metadata}

    @property
    def counts_samples(self) -> bool:
        """Whether what was learnt belongs to one time step."""
        return self.feature_set.counts_samples or self.family.counts_samples

    @cached_property
    def looks_back(self) -> bool:
        """Whether a correction depends on rows before: by a feature, or by the model itself."""
        return bool(self.family.remembers or self.feature_set.memory_size)

    def check_robot(self, robot: Robot) -> None:
        """Raise CalibrationError unless a robot's arm is the one that it was made for."""
        check_robot((self.robot, self.arm), robot)

    def check_recording(self, recording: Recording) -> None:
        """Raise CalibrationError unless a recording is one that `correct` can correct."""
        arm = self.robot, self.arm
        check_arm(as_recorded(recording), arm, f"the calibration of {self.title}")
        check_columns(recording, self.signals, "calibration needs")
        check_units(recording, self.units, "the calibration was made with")
        if self.counts_samples:
            check_sample_dt(recording, self.origin.sample_dt)
        if self.looks_back:
            check_history(recording, self.origin.sample_dt)

    def summary(self) -> dict[str, str]:
        """Robot, model, training, and how far off it may be where that is known, by label."""
        facts = self.metadata
        about = {
            "robot": self.title,
            "estimator": f"{self.estimator}, predicts the {self.target}",
            "joints": ", ".join(self.joints),
            **self.feature_set.summary(),
        }
        rows, duration, took = (facts.get(key) for key in ("rows", "duration", "fit_seconds"))
        if isinstance(rows, int) and isinstance(duration, float):
            within = f", in {took:.1f} s" if isinstance(took, float) else ""
            about["trained on"] = f"{rows} rows, {duration / 60:.1f} min{within}"
        if self.rezeroed_fit is not None:
            about["second fit"] = "for motions that are re-zeroed, with a zero for each recording"
        if self.zero is not None:
            moved = self._by_joint("", self.zero.shift)
            about["zero"] = f"moved by {moved} ({self.zero.source})"
        if self.interval is not None:
            for level, widths in zip(self.interval.levels, self.interval.half_widths, strict=True):
                about[f"{100 * level:g} %"] = self._by_joint("± ", widths)
            about["interval"] = self.interval.meaning
        return about | _touch_summary(facts.get("touch"))

    def plot(self, recording: Recording | None = None) -> Any:
        """Draw a recording's corrections, or the area that training covered; matplotlib's axes."""
        if recording is not None:
            rows = self.rows(recording)
            x, y = rows.measured, self.predict_error(rows)
        elif (domain := self.training_domain) is not None:
            at = [self.signals.index(f"measured/{joint}") for joint in self.joints]
            x = np.array([domain.signal_lower[at], domain.signal_upper[at]])[[0, 1, 1, 0, 0]]
            y = np.array([domain.error_lower, domain.error_upper])[[0, 0, 1, 1, 0]]
        else:
            raise CalibrationError(f"the calibration of {self.title} states no range to draw")
        units = {joint: self.units[f"measured/{joint}"] for joint in self.joints}
        return drawing.plot(self.title, x, {self.estimator: y}, units, "correction")

    def _by_joint(self, sign: str, values: Array) -> str:
        units = (self.units[f"measured/{joint}"] for joint in self.joints)
        each = zip(self.joints, values, units, strict=True)
        return ", ".join(f"{joint} {sign}{with_unit(value, unit)}" for joint, value, unit in each)


def _touch_summary(touch: Any) -> dict[str, str]:
    """Lines of what metadata say of touches, where they say it."""
    try:
        near, far = (with_unit(touch[k], "m") for k in ("tip_error", "tip_error_workspace"))
        where = f"near them, {far} over the workspace, in the block's frame"
        truth = f"{touch['touches']} touches; tip {near} off {where}"
        return {"truth": truth, "not seen": "; ".join(touch["not_seen"]) or "-"}
    except (KeyError, TypeError):  # metadata are free: somebody else's may be called so
        return {}


def as_calibration(value: Calibration) -> Calibration:
    """Give back a calibration; raises CalibrationError for anything else, saying how to get one."""
    if hasattr(value, "effort_baseline"):  # as what stands for one in a loop may have
        return value
    advice = "give what `calibrate` gives, or read_calibration(path)"
    raise CalibrationError(other_kind(value, "Calibration", advice))


def as_recorded(value: Recorded) -> Recorded:
    """Give back a recording, known by its columns: what runs does without the tables of one."""
    if hasattr(value, "column"):
        return value
    raise RecordingError(other_kind(value, "Recording", "read_recording(path) gives one"))
