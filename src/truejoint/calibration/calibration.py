"""A fitted calibration: corrects recordings, or one sample at a time."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from typing import Any, Self

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from truejoint.array_types import Array
from truejoint.calibration.compatibility import check_arm, check_columns, check_robot, check_unit
from truejoint.calibration.encoding import CalibrationData, as_calibration, decode, encode
from truejoint.calibration.interval import LEVEL, inverse_span, range_excesses
from truejoint.calibration.model_file import read_model_file, write_model_file
from truejoint.calibration.signal_shift import shift_signals
from truejoint.errors import CalibrationError, ModelFileError, TruejointError
from truejoint.estimators.base import JointRegressor, RowState
from truejoint.estimators.family import EstimatorData, find_family
from truejoint.estimators.wrapped import class_of
from truejoint.features.feature_set import FeatureState, check_history, check_sample_dt, time_steps
from truejoint.recordings import Recording
from truejoint.recordings.table.recording import as_recording
from truejoint.robots import Robot
from truejoint.summary import Summarised
from truejoint.units import with_unit


@dataclass
class OnlineState:
    """What a calibration remembers between samples; made by `Calibration.start`.

    Attributes
    ----------
    features : FeatureState
    row : ndarray, shape (k,)
        Features of the last sample.
    model : RowState
        What the estimator remembers itself.

    Examples
    --------
    >>> state = model.start()
    >>> sample = [test.column(name)[0] for name in model.signals]
    >>> model.step(state, 0.0, sample).tolist() == model.correct(test)[0].tolist()
    True
    """

    features: FeatureState
    row: Array
    model: RowState


@dataclass(frozen=True, eq=False, repr=False)
class Calibration(Summarised, CalibrationData[JointRegressor]):
    """A fitted estimator with all that is needed to use it on the arm that it was made for.

    Made by `calibrate` or `read_calibration`. See `CalibrationData` for what it holds.

    Examples
    --------
    >>> model.estimator, model.joints
    ('linear', ('jaw',))
    >>> model.correct(test).shape  # rows, joints [rad or m]
    (400, 1)
    >>> list(model.correct_table(test).columns)
    ['t', 'corrected/jaw', 'half_width/jaw']
    """

    @property
    def estimator(self) -> str:
        """Name of the estimator, for instance ``"dnn"`` or ``"RandomForestRegressor"``."""
        name = self.metadata.get("estimator")
        return name if isinstance(name, str) and name.isidentifier() else self.model.name

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
        if self.rezero_models:
            of = "recording" if self.moves is None else "homing"
            about["zero"] = f"for use after re-zeroing, fitted with one for each {of}"
        if self.interval is not None:
            units = [self.units[f"measured/{joint}"] for joint in self.joints]
            for level, widths in zip(self.interval.levels, self.interval.half_widths, strict=True):
                stated = zip(self.joints, widths, units, strict=True)
                about[f"{100 * level:g} %"] = ", ".join(
                    f"{joint} ± {with_unit(width, unit)}" for joint, width, unit in stated
                )
            about["interval"] = self.interval.meaning
        with suppress(KeyError, TypeError):  # not by touches, or by somebody else's rules
            told = facts["touch"]
            near = with_unit(told["left_out_error"], "m")
            about["truth"] = f"{told['touches']} touches; tip within {near} in the block's frame"
            about["not seen"] = "; ".join(told["not_seen"]) or "-"
        with suppress(KeyError, TypeError):  # not stated, or by somebody else's rules
            about["held out"] = "RMSE " + ", ".join(
                f"{row['joint']} {with_unit(row['rmse'], row['unit'])}"
                for row in facts["held_out"]
                if row["estimator"] == self.estimator
            )
        return about

    @property
    def baselines(self) -> Mapping[str, Calibration]:
        """Fixed offset, linear and polynomial, fitted on the same rows: a calibration each."""
        bare = replace(
            self, target="error", baseline_models={}, rezero_models={}, interval=None,
            effort_baseline=None,
        )  # fmt: skip
        return {
            name: replace(
                bare,
                model=model,
                offsets={"model": self.offsets[name]} if name in self.offsets else {},
                metadata={**self.metadata, "estimator": name},
            )
            for name, model in self.baseline_models.items()
        }

    def correct(self, recording: Recording) -> Array:
        """Correct the measured positions of a recording: `joints` (n, n_joints) [rad or m].

        It needs the columns `signals`, no truth. Raises CalibrationError if robot, arm, columns,
        units or (where features count samples) the rate differ.
        """
        self.check_recording(recording)
        return self.evaluate(recording)

    def evaluate(self, recording: Recording) -> Array:
        """Correct (n, n_joints) [rad or m] without checks, as pieces of what `correct` takes."""
        X = self._features(recording)
        predicted = self.model.evaluate(X, time_steps(np.array(recording.t), self.gap_limit))
        predicted = predicted + self.output_shift
        if self.target == "position":
            return predicted
        return recording.columns("measured", self.joints) + predicted

    def correct_table(self, recording: Recording, level: float | None = None) -> pd.DataFrame:
        """Correct a recording into a table; raises as `correct`.

        Columns ``t`` [s] and ``corrected/<joint>``, and with an interval ``half_width/<joint>``
        [rad or m], at a `level` of 0.9 unless another is asked for; raises CalibrationError if one
        is that the calibration does not state.
        """
        columns = {"t": recording.t}
        values = {"corrected": self.correct(recording)}
        if self.interval is not None or level is not None:
            values["half_width"] = self.half_widths(recording, LEVEL if level is None else level)
        for name, array in values.items():
            columns |= {f"{name}/{joint}": array[:, k] for k, joint in enumerate(self.joints)}
        return pd.DataFrame(columns)

    def predict_error(self, recording: Recording) -> Array:
        """Corrected minus measured position (n, n_joints) [rad or m]; raises as `correct`."""
        return self.correct(recording) - recording.columns("measured", self.joints)

    def correct_with_interval(
        self, recording: Recording, level: float = 0.9
    ) -> tuple[Array, Array, Array]:
        """Give `correct` and the bounds between which a joint is with a probability of `level`.

        Each (n, n_joints) [rad or m]; see `Interval` for the meaning. Raises CalibrationError as
        `correct`, or if the calibration has no interval of that level.
        """
        corrected = self.correct(recording)
        half = self.half_widths(recording, level)
        return corrected, corrected - half, corrected + half

    def half_widths(self, recording: Recording, level: float = 0.9) -> Array:
        """Half-width (n, n_joints) [rad or m] of the interval at every row of a recording.

        Wider where a feature is outside its trained range. Raises CalibrationError if the
        calibration has no interval, or not of that level.
        """
        interval = self.required_interval()
        widening = 1.0 + interval.growth * self.range_excess(recording)
        return widening[:, None] * interval.half_width(level)

    def range_excess(self, recording: Recording) -> Array:
        """How far outside the trained range each row (n,) is, as a share of it; 0 inside."""
        X = self._features(recording)
        out = np.empty(len(X))
        range_excesses(X, self.lower, self.upper, inverse_span(self.lower, self.upper), out)
        return out

    def start(self) -> OnlineState:
        """State before the first sample, for `step`."""
        row = np.empty(len(self.feature_set))
        return OnlineState(self.feature_set.start(), row, self.model.start())

    def step(self, state: OnlineState, t: float, sample: ArrayLike) -> Array:
        """Correct one sample; the same bits as `correct` gives for the whole recording.

        `sample` (n_signals,) holds the values of `signals` at time `t` [s], later than the last;
        `state` is changed in place. Gives the position of each of `joints` (n_joints,) [rad or m].
        Raises CalibrationError if the sample has another length or is not finite, or time does not
        advance; the state is then as before.
        """
        values = np.ascontiguousarray(sample, dtype=np.float64)
        if values.shape != (len(self.signals),):
            raise CalibrationError(
                f"sample has shape {values.shape}; it must hold the {len(self.signals)} signals "
                f"{', '.join(self.signals)}"
            )
        if not np.isfinite(values).all():
            name = self.signals[int(np.argmin(np.isfinite(values)))]
            raise CalibrationError(f"sample at {t!r} s: {name!r} is not finite; leave it out")
        seen, last = state.features.clock
        if not math.isfinite(t) or (seen and not t > last):
            raise CalibrationError(f"sample at {t!r} s does not follow that at {last!r} s")
        moved = values + self.signal_shift
        fresh = self.feature_set.step(state.features, t, moved, self.gap_limit, state.row)
        predicted = self.model.step(state.model, 0.0 if fresh else t - last, state.row)
        predicted = predicted + self.output_shift
        if self.target == "position":
            return predicted
        measured = [self.signals.index(f"measured/{joint}") for joint in self.joints]
        return np.asarray(values[measured] + predicted)

    def with_metadata(self, **items: Any) -> Self:
        """Add JSON values, such as ``held_out``, to the metadata of a copy.

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

    def _features(self, recording: Recording) -> Array:
        moved = shift_signals(recording, self.signals, self.signal_shift)
        return self.feature_set.compute(moved, self.gap_limit)

    @property
    def looks_back(self) -> bool:
        """Whether a correction depends on rows before: by a feature, or by the model itself."""
        return bool(self.model.family.remembers or self.feature_set.start().memory.size)

    def check_robot(self, robot: Robot) -> None:
        """Raise CalibrationError unless a robot's arm is the one that it was made for."""
        check_robot((self.robot, self.arm), robot)

    def check_recording(self, recording: Recording) -> None:
        """Raise CalibrationError unless a recording is one that `correct` can correct."""
        as_recording(recording)
        arm = self.robot, self.arm
        check_arm(recording, arm, f"the calibration of {self.title}")
        check_columns(recording, self.signals, "calibration needs")
        for signal in self.signals:
            check_unit(recording, signal, self.units[signal], "the calibration was made with")
        if self.feature_set.counts_samples or self.model.family.counts_samples:
            check_sample_dt(recording, float(self.metadata["sample_dt"]))
        if self.looks_back:
            check_history(recording, self.gap_limit)


def write_calibration(
    calibration: Calibration, path: str | os.PathLike[str], *, overwrite: bool = False
) -> None:
    """Write a calibration as one safetensors file; `read_calibration` reads it back.

    Raises
    ------
    ModelFileError
        If the file exists and `overwrite` is false, or it cannot be written.
    CalibrationError
        If it is no calibration, or no installed package has the family of its estimator.

    Examples
    --------
    >>> write_calibration(model, "jaw.safetensors")
    >>> read_calibration("jaw.safetensors").estimator
    'linear'
    """
    find_family(as_calibration(calibration).model.data.family)
    description, arrays = encode(calibration)
    write_model_file(path, description, arrays, overwrite=overwrite)


def read_calibration(path: str | os.PathLike[str]) -> Calibration:
    """Read a calibration that `write_calibration` wrote; it predicts bit for bit as before.

    Nothing in the file is run.

    Raises
    ------
    ModelFileError
        If the file is missing, truncated, edited, too large, or of a newer format.

    Examples
    --------
    >>> write_calibration(model, "jaw.safetensors")
    >>> read_calibration("jaw.safetensors").joints
    ('jaw',)
    """
    description, arrays = read_model_file(path)
    try:
        data = decode(description, arrays)
        counts = data.feature_set.counts_samples or data.model.kind.counts_samples
        dt = data.metadata.get("sample_dt")
        if counts and not (isinstance(dt, float) and 0.0 < dt < 1e9):
            raise ModelFileError("the model counts samples, and the time step is not stated")
        shape = (len(data.feature_set), len(data.joints))
        fitted, rezero_models = (
            {name: _fitted(name, model, *shape) for name, model in models.items()}
            for models in ({"model": data.model, **data.baseline_models}, data.rezero_models)
        )
    except TruejointError as error:
        raise ModelFileError(f"{path}: {error}; copy or calibrate it again") from None
    parts = {field.name: getattr(data, field.name) for field in fields(data)}
    parts |= {"model": fitted.pop("model"), "baseline_models": fitted}
    return Calibration(**parts | {"rezero_models": rezero_models})


def _fitted(name: str, data: EstimatorData, n_features: int, n_outputs: int) -> JointRegressor:
    try:
        return class_of(data.family).from_data(data, n_features, n_outputs)
    except CalibrationError as error:
        raise ModelFileError(f"estimator {name!r}: {error}") from None
