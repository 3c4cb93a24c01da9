"""Is a stated interval true? On trajectories of their own, and against another calibration."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from truejoint.array_types import Array
from truejoint.calibration.conformal import scored_error
from truejoint.errors import CalibrationError

if TYPE_CHECKING:
    from truejoint.calibration.calibration import Calibration
    from truejoint.recordings import Recording


@dataclass(frozen=True, eq=False)
class Coverage:
    """How often the truth lay within the stated interval, on trajectories of their own.

    Attributes
    ----------
    level : float
        What was stated.
    shares : ndarray, shape (n_trajectories, n_joints)
        Share of the samples of each trajectory that were inside.
    half_width : ndarray, shape (n_joints,)
        Mean over samples, widening included [rad or m].
    offset_half_width : ndarray, shape (n_joints,)
        Of the fixed offset's interval, made of the same calibration trajectories [rad or m].

    Examples
    --------
    >>> measure_coverage(model, [test]).shares.shape
    (1, 1)
    """

    level: float
    shares: Array
    half_width: Array
    offset_half_width: Array

    @property
    def mean(self) -> Array:
        """Coverage (n_joints,): mean over trajectories."""
        return np.asarray(self.shares.mean(axis=0))

    @property
    def standard_error(self) -> Array:
        """Sampling error (n_joints,) of `mean` over trajectories; NaN for a single one."""
        n = len(self.shares)
        if n < 2:
            return np.full(self.shares.shape[1], np.nan)
        return np.asarray(self.shares.std(axis=0, ddof=1) / math.sqrt(n))


def measure_coverage(
    calibration: Calibration, recordings: Sequence[Recording], level: float = 0.9
) -> Coverage:
    """Coverage of the stated interval on recordings that no part of it has seen.

    Where the interval holds after re-zeroing, each recording is re-zeroed as it says.

    Raises
    ------
    CalibrationError
        If there is no such interval, or a recording has no truth.

    Examples
    --------
    >>> measure_coverage(model, [test], level=0.9).level
    0.9
    """
    interval = calibration.required_interval()
    row = interval.index(level)
    shares, widths = [], []
    for recording in recordings:
        error, rows = scored_error(calibration, recording, interval.rezero)
        allowed = calibration.half_widths(recording, level)[rows]
        shares.append((np.abs(error) <= allowed).mean(axis=0))
        widths.append(allowed.mean(axis=0))
    return Coverage(
        level, np.array(shares), np.mean(widths, axis=0), interval.offset_half_widths[row]
    )


@dataclass(frozen=True, eq=False)
class CrossCheck:
    """Whether two independent calibrations disagree more than their intervals allow.

    Attributes
    ----------
    level : float
    difference : ndarray, shape (n_joints,)
        RMS of the difference of the two corrected positions [rad or m].
    allowed : ndarray, shape (n_joints,)
        RMS over rows of ``sqrt(a**2 + b**2)`` of the two half-widths [rad or m].
    inside : ndarray, shape (n_joints,)
        Share of the rows in which the difference is no larger than that.

    Examples
    --------
    >>> cross_check(model, model, test).difference.tolist()
    [0.0]
    """

    level: float
    difference: Array
    allowed: Array
    inside: Array

    @property
    def consistent(self) -> NDArray[np.bool_]:
        """Joints (n_joints,) for which at least the stated share is inside."""
        return np.asarray(self.inside >= self.level)


def cross_check(
    first: Calibration, second: Calibration, recording: Recording, level: float = 0.9
) -> CrossCheck:
    """Compare two calibrations of one arm, made independently, on a recording without truth.

    Errors that are independent add in squares, and so do intervals. Two calibrations that differ
    by more than both state cannot both be right; two that agree may share an error.

    Raises
    ------
    CalibrationError
        If they correct different joints, either states no such interval, or the recording does
        not fit.

    Examples
    --------
    >>> cross_check(model, model, test).consistent.tolist()
    [True]
    """
    if first.joints != second.joints:
        raise CalibrationError(
            f"the calibrations correct {', '.join(first.joints)} and {', '.join(second.joints)}; "
            "compare two of the same joints"
        )
    difference = first.correct(recording) - second.correct(recording)
    allowed = np.hypot(first.half_widths(recording, level), second.half_widths(recording, level))
    return CrossCheck(
        level,
        np.sqrt(np.mean(difference**2, axis=0)),
        np.sqrt(np.mean(allowed**2, axis=0)),
        np.mean(np.abs(difference) <= allowed, axis=0),
    )
