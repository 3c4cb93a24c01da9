"""A recording seen through a feature set: what is fitted to, judged and corrected."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, Self

import numpy as np

from truejoint.array_types import Array, Integers, Mask
from truejoint.calibration.compatibility import source_of
from truejoint.errors import CalibrationError
from truejoint.estimators.family import EstimatorData, Target
from truejoint.features.feature_set import FeatureSet, time_steps

if TYPE_CHECKING:
    from truejoint.recordings import Recording

LONGEST_WITHOUT_TRUTH: Final = 1 / 3
"""Share of a recording's time; a recording that lacks truth for longer is refused."""


@dataclass(frozen=True, eq=False)
class Rows:
    """The rows of a recording with their features, computed once and handed on.

    Attributes
    ----------
    recording : Recording
    feature_set : FeatureSet
    joints : tuple of str
    gap_limit : float
        Time without a row [s] after which the history of a feature starts anew.
    X : ndarray, shape (n, k)
        Features.
    signal_shift : ndarray, shape (n_signals,), optional
        Shift that was added to the signals before `X` was computed, each in its unit.
    outlier : ndarray of bool, shape (n, n_joints), optional
        Values of the truth that no fit uses.
    hidden : ndarray of bool, shape (n,), optional
        Rows whose truth is hidden from a fit.
    stride : int
        A fit uses every `stride`-th row with truth.
    zero : ndarray, shape (n_joints,), optional
        Zero that is taken off the truth [rad or m].

    Examples
    --------
    >>> rows = model.rows(test)
    >>> rows.X.shape, rows.truth.shape
    ((400, 2), (400, 1))
    """

    recording: "Recording"
    feature_set: FeatureSet
    joints: tuple[str, ...]
    gap_limit: float
    X: Array
    signal_shift: Array | None = None
    outlier: Mask | None = None
    hidden: Mask | None = None
    stride: int = 1
    zero: Array | None = None

    @classmethod
    def of(
        cls,
        recording: "Recording",
        feature_set: FeatureSet,
        joints: tuple[str, ...],
        gap_limit: float,
        **how: Any,
    ) -> Self:
        """Compute the features of a recording; `how` are other fields."""
        bare = cls(recording, feature_set, joints, gap_limit, np.empty((0, 0)), **how)
        return bare.of_recording(recording)

    def __len__(self) -> int:
        return len(self.X)

    @cached_property
    def t(self) -> Array:
        """Time stamps (n,) [s]."""
        return np.array(self.recording.t)

    @cached_property
    def dt(self) -> Array:
        """Time (n,) [s] since the row before, 0 where a history starts."""
        return time_steps(self.t, self.gap_limit)

    @cached_property
    def measured(self) -> Array:
        """Measured positions (n, n_joints) [rad or m]."""
        return np.ascontiguousarray(self.recording.columns("measured", self.joints))

    @cached_property
    def truth(self) -> Array:
        """True positions (n, n_joints) [rad or m], NaN where they are not known."""
        return self._visible(self.recording.columns("truth", self.joints))

    @cached_property
    def error(self) -> Array:
        """Truth minus measured position (n, n_joints) [rad or m]."""
        return self._visible(self.recording.error(self.joints))

    @cached_property
    def last_prediction(self) -> list[tuple[EstimatorData, Array]]:
        """The estimator that saw these rows last, and its predictions (n, n_joints); or empty."""
        return []

    def _visible(self, values: Array) -> Array:
        if self.zero is not None:
            values = values - self.zero
        return values if self.hidden is None else np.where(self.hidden[:, None], np.nan, values)

    @cached_property
    def has_truth(self) -> Mask:
        """Rows (n,) in which the truth of every joint is known."""
        return np.asarray(np.isfinite(self.truth).all(axis=1))

    @cached_property
    def known(self) -> Mask:
        """Rows (n,) in which the truth of every joint is known and no outlier."""
        is_good = True if self.outlier is None else ~self.outlier.any(axis=1)
        return self.has_truth & is_good

    @cached_property
    def fitted(self) -> Integers:
        """Rows (m,) that a fit uses."""
        return np.flatnonzero(self.known)[:: self.stride]

    @property
    def outliers(self) -> int:
        """Number of rows with truth of which a fit leaves out a value."""
        return int((self.has_truth & ~self.known).sum())

    def target(self, target: Target) -> Array:
        """Targets (n, n_joints) [rad or m] of every row, known or not."""
        return self.error if target == "error" else self.truth

    def fitted_targets(self, target: Target) -> Array:
        """Targets (n, n_joints) of every row, NaN where a fit does not use them."""
        values = self.target(target)
        targets = np.full_like(values, np.nan)
        targets[self.fitted] = values[self.fitted]
        return targets

    def partly_known(self, target: Target) -> tuple[Array, Array]:
        """Features and targets of rows (m, ...) with truth, outlying values NaN."""
        outlier = np.zeros(self.truth.shape, bool) if self.outlier is None else self.outlier
        rows = np.flatnonzero(self.has_truth & ~outlier.all(axis=1))[:: self.stride]
        values = self.target(target)[rows]
        return self.X[rows], np.where(outlier[rows], np.nan, values)

    def of_recording(self, recording: "Recording") -> Self:
        """Give the same rows of a recording whose signals were changed."""
        shifted, signals = recording, self.feature_set.signals
        if self.signal_shift is not None:
            shifted = shift_signals(recording, signals, self.signal_shift[: len(signals)])
        X = self.feature_set.compute(shifted, self.gap_limit)
        return replace(self, recording=recording, X=X)

    def hide(self, hidden: Mask) -> Self:
        """Hide the truth of some rows (n,) as well; positions and efforts stay."""
        if self.hidden is not None:
            hidden = hidden | self.hidden
        return replace(self, hidden=hidden)

    def check_truth(self) -> None:
        """Raise CalibrationError if truth is missing for more than a third of the time on end."""
        t, source = self.t, source_of(self.recording)
        columns = ", ".join(f"truth/{joint}" for joint in self.joints)
        if not self.has_truth.any():
            raise CalibrationError(
                f"{source}: {columns} known together in none of {len(t)} rows; check that "
                "the joint sensors ran and share the clock of the robot"
            )
        rows = np.concatenate([[-1], np.flatnonzero(self.has_truth), [len(t)]])
        begin, end = t[np.maximum(rows[:-1], 0)], t[np.minimum(rows[1:], len(t) - 1)]
        missing = np.where(np.diff(rows) > 1, end - begin, 0.0)  # a gap in the rows does not count
        worst = int(np.argmax(missing))
        duration = self.recording.duration
        if missing[worst] > LONGEST_WITHOUT_TRUTH * duration:
            raise CalibrationError(
                f"{source}: {columns} missing from {begin[worst]:.2f} s to "
                f"{end[worst]:.2f} s, {100 * missing[worst] / duration:.0f} % of the "
                "recording (a third is allowed); cut it to the part with truth or record it again"
            )


def shift_signals(recording: "Recording", signals: Sequence[str], shift: Array) -> "Recording":
    """Add to each of the `signals` its `shift` (n_signals,) in the signal's unit."""
    pairs = zip(signals, shift, strict=True)
    changed = {signal: recording.column(signal) + by for signal, by in pairs if by}
    if not changed:
        return recording
    return replace(recording, table=recording.table.assign(**changed))
