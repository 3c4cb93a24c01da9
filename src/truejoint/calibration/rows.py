"""Rows that a calibration is fitted to: what each recording gives."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Final

import numpy as np

from truejoint.array_types import Array, Integers, Mask
from truejoint.calibration.compatibility import source_of
from truejoint.errors import CalibrationError
from truejoint.estimators.family import Target
from truejoint.features.feature_set import FeatureSet, time_steps
from truejoint.recordings import Recording
from truejoint.recordings.judge.outliers import gross_outliers

LONGEST_WITHOUT_TRUTH: Final = 1 / 3  # share of a recording's time, beyond which it is refused


@dataclass(frozen=True, eq=False)
class RowRules:
    """How rows are made of a recording."""

    feature_set: FeatureSet
    joints: tuple[str, ...]
    gap_limit: float  # [s] that the history of a feature bridges
    stride: int  # every how many rows one is fitted to

    def rows(self, recording: Recording, outlying: Mask) -> TrainingRows:
        """Rows of a recording without its `outlying` values (n, n_joints).

        Raises CalibrationError if its truth is missing for more than a third of its time on end.
        """
        truth = recording.columns("truth", self.joints)
        known = np.asarray(np.isfinite(truth).all(axis=1))
        _check_truth(recording, known, self.joints)
        features = self.feature_set.compute(recording, self.gap_limit)
        known &= ~outlying.any(axis=1)
        fitted = np.flatnonzero(known)[:: self.stride]
        error = recording.error(self.joints)
        return TrainingRows(self, recording, features, truth, error, known, outlying, fitted)


@dataclass(frozen=True, eq=False)
class TrainingRows:
    """What one recording gives to fit to."""

    rules: RowRules
    recording: Recording
    features: Array  # (n, k)
    truth: Array  # (n, n_joints) [rad or m], not known in every row
    error: Array  # (n, n_joints), truth minus measured
    known: Mask  # (n,), where the truth of every joint is, and not outlying
    outlying: Mask  # (n, n_joints), values that are left out
    fitted: Integers  # (m,), rows fitted to of those

    @property
    def outliers(self) -> int:
        """Rows with truth of which a value is left out."""
        return int((np.isfinite(self.truth).all(axis=1) & self.outlying.any(axis=1)).sum())

    @property
    def dt(self) -> Array:
        """Time (n,) [s] since the row before, 0 where a history starts."""
        return time_steps(np.array(self.recording.t), self.rules.gap_limit)

    def partly(self, target: Target) -> tuple[Array, Array]:
        """Features and targets of rows (m, ...) with truth, outlying values NaN."""
        rows = np.flatnonzero(np.isfinite(self.truth).all(axis=1) & ~self.outlying.all(axis=1))
        rows = rows[:: self.rules.stride]
        known = self.error if target == "error" else self.truth
        return self.features[rows], np.where(self.outlying[rows], np.nan, known[rows])

    def targets(self, target: Target) -> Array:
        """Targets of every row (n, n_joints), NaN where they are not fitted to."""
        known = self.error if target == "error" else self.truth
        targets = np.full_like(known, np.nan)
        targets[self.fitted] = known[self.fitted]
        return targets


def fitted_rows(parts: Sequence[TrainingRows], name: str) -> Array:
    """Rows (m, ...) that are fitted to, of all parts, of the array called `name`."""
    return np.concatenate([getattr(part, name)[part.fitted] for part in parts])


def partly_known(parts: Sequence[TrainingRows], target: Target = "error") -> tuple[Array, Array]:
    """Features (m, k) and targets (m, n_joints) of all parts, NaN where a value is left out."""
    features, targets = zip(*(part.partly(target) for part in parts), strict=True)
    return np.concatenate(features), np.concatenate(targets)


def outlying_values(recordings: Sequence[Recording], joints: Sequence[str]) -> list[Mask]:
    """Values (n, n_joints) of each recording that are grossly off their neighbours."""
    by_joint = [gross_outliers(recordings, joint) for joint in joints]
    return [np.column_stack(masks) for masks in zip(*by_joint, strict=True)]


def stride_of(fit_rate: float | None, dt: float) -> int:
    """Every how many rows one is fitted to, of rows that are `dt` [s] apart."""
    if fit_rate is None:
        return 1
    if not (isinstance(fit_rate, Real) and 1e-9 <= fit_rate < math.inf):
        raise CalibrationError(
            f"fit rate is {fit_rate!r:.40} Hz; it must be above 0 Hz, 1e-9 at least"
        )
    return max(1, round(1.0 / (fit_rate * dt)))


def _check_truth(recording: Recording, known: Mask, joints: Sequence[str]) -> None:
    """Refuse a recording whose truth is missing for more than a third of its time on end."""
    t = recording.t
    what = ", ".join(f"truth/{joint}" for joint in joints)
    if not known.any():
        raise CalibrationError(
            f"{source_of(recording)}: {what} known together in none of {len(t)} rows; check that "
            "the joint sensors ran and share the clock of the robot"
        )
    rows = np.concatenate([[-1], np.flatnonzero(known), [len(t)]])
    begin, end = t[np.maximum(rows[:-1], 0)], t[np.minimum(rows[1:], len(t) - 1)]
    missing = np.where(np.diff(rows) > 1, end - begin, 0.0)  # a gap in the rows is none of truth
    worst = int(np.argmax(missing))
    if missing[worst] > LONGEST_WITHOUT_TRUTH * recording.duration:
        raise CalibrationError(
            f"{source_of(recording)}: {what} missing from {begin[worst]:.2f} s to "
            f"{end[worst]:.2f} s, {100 * missing[worst] / recording.duration:.0f} % of the "
            "recording (a third is allowed); cut it to the part with truth or record it again"
        )
