"""Rows of training recordings: with truth, without gross outliers, zeros and rows too many."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from numbers import Real
from typing import TYPE_CHECKING, Final, get_args

import numpy as np

from truejoint.array_types import Array, Integers, Mask
from truejoint.calibration.compatibility import source_of
from truejoint.calibration.origin import ZeroOf
from truejoint.calibration.rows import Rows, shift_signals
from truejoint.errors import CalibrationError
from truejoint.estimators.base import constant_columns
from truejoint.estimators.family import Target
from truejoint.estimators.wrapped import get_estimator
from truejoint.features.feature_set import FeatureSet
from truejoint.recordings.join.explained import gross_outliers

if TYPE_CHECKING:
    from truejoint.recordings import Recording


_SETTLED: Final = 1e-7  # [rad or m] to which the zeros of homings are determined
_FOLLOWS: Final = 0.5  # share of a zero that may remain after the measured positions moved by it
_SAME_SENSOR: Final = 1e-5  # of its range that a signal may be off a line through another


def training_rows(
    recordings: Sequence[Recording],
    feature_set: FeatureSet,
    joints: tuple[str, ...],
    gap_limit: float,
    stride: int = 1,
    outliers: Sequence[Mask] | None = None,
) -> list[Rows]:
    """Rows of each recording; `outliers` are those of `outlying_values`, if they are known.

    Raises CalibrationError if truth is missing for more than a third of a recording on end.
    """
    masks = outlying_values(recordings, joints) if outliers is None else outliers
    parts = [
        Rows.of(recording, feature_set, joints, gap_limit, outlier=mask, stride=stride)
        for recording, mask in zip(recordings, masks, strict=True)
    ]
    for part in parts:
        part.check_truth()
    return parts


def outlying_values(recordings: Sequence[Recording], joints: Sequence[str]) -> list[Mask]:
    """Values (n, n_joints) of each recording that are grossly off their neighbours."""
    by_joint = [gross_outliers(recordings, joint) for joint in joints]
    return [np.column_stack(masks) for masks in zip(*by_joint, strict=True)]


def fitted_rows(parts: Sequence[Rows], name: str) -> Array:
    """Rows (m, ...) that a fit uses, of all parts, of the array called `name`."""
    return np.concatenate([getattr(part, name)[part.fitted] for part in parts])


def partly_known(parts: Sequence[Rows], target: Target = "error") -> tuple[Array, Array]:
    """Features (m, k) and targets (m, n_joints) of all parts, NaN where a value is left out."""
    X, targets = zip(*(part.partly_known(target) for part in parts), strict=True)
    return np.concatenate(X), np.concatenate(targets)


def stride_of(fit_rate: float | None, dt: float) -> int:
    """Stride of rows that are `dt` [s] apart, for a fit at `fit_rate` [Hz] at most."""
    if fit_rate is None:
        return 1
    if not (isinstance(fit_rate, Real) and 1e-9 <= fit_rate < math.inf):
        raise CalibrationError(
            f"fit rate is {fit_rate!r:.40} Hz; it must be above 0 Hz, 1e-9 at least"
        )
    return max(1, round(1.0 / (fit_rate * dt)))


def zero_groups(recordings: Sequence[Recording], zero: ZeroOf) -> tuple[list[str], Integers]:
    """Names of what recordings share a zero with, and the number of each recording's group.

    A recording whose homing has no name is a group of its own. Raises CalibrationError for another
    `zero`, or fewer than two groups.
    """
    if zero not in get_args(ZeroOf):
        raise CalibrationError(f"zero {zero!r:.60}; choose {', '.join(get_args(ZeroOf))}")
    origins = [recording.provenance for recording in recordings]
    keys = [(zero == "homing" and origin.homing_id) or i for i, origin in enumerate(origins)]
    different = list(dict.fromkeys(keys))
    names = [key if isinstance(key, str) else source_of(recordings[key]) for key in different]
    if len(names) < 2:
        raise CalibrationError(
            f"a zero for each {zero} takes two of them; all recordings are of {names[0]}: give "
            "more, or let them share one zero"
        )
    return names, np.array([different.index(key) for key in keys])


def take_off_zeros(
    parts: Sequence[Rows], group: Integers, moves: Array | None, signals: Sequence[str]
) -> tuple[list[Rows], Array]:
    """Parts without the zeros of their groups, and these zeros (n_groups, n_joints) [rad or m].

    `group` (n_parts,) numbers the groups. The zeros are taken off the truth, or with `moves`
    (n_signals, n_joints) added to the `signals`. They are about their mean. Raises CalibrationError
    where the signals leave open what was added to them.
    """
    zeros = _group_zeros(parts, group)
    if moves is None:
        return [replace(p, zero=z) for p, z in zip(parts, zeros[group], strict=True)], zeros
    remaining, at_zero = zeros, list(parts)
    zeros = np.zeros_like(zeros)
    while np.abs(remaining).max() > _SETTLED:
        zeros = zeros + remaining
        at_zero = [
            part.of_recording(shift_signals(part.recording, tuple(signals), moves @ zero))
            for part, zero in zip(parts, zeros[group], strict=True)
        ]
        before, remaining = remaining, _group_zeros(at_zero, group)
        if not np.abs(remaining).max() < _FOLLOWS * np.abs(before).max():
            raise CalibrationError(
                "the true position hardly follows the measured one where other signals are known, "
                "so the zero of a homing cannot be found; choose a zero for each recording"
            )
    return at_zero, zeros


def _group_zeros(parts: Sequence[Rows], group: Integers) -> Array:
    """Zeros (n_groups, n_joints) [rad or m] about their mean: least squares with the linear model.

    The slopes are those within the groups, so a feature that changes between them alone has none.
    """
    n_groups = int(group.max()) + 1
    rows = np.repeat(group, [len(part.fitted) for part in parts])
    X, error = (fitted_rows(parts, name) for name in ("X", "error"))
    inputs, errors = np.zeros_like(X), np.zeros_like(error)
    for number in range(n_groups):
        in_group = rows == number
        varies = ~constant_columns(X[in_group])
        inputs[np.ix_(in_group, varies)] = (X[in_group] - X[in_group].mean(axis=0))[:, varies]
        errors[in_group] = error[in_group] - error[in_group].mean(axis=0)
    residual = error - get_estimator("linear").fit(inputs, errors).predict(X)
    zeros = np.array([residual[rows == n].mean(axis=0) for n in range(n_groups)])
    return np.asarray(zeros - zeros.mean(axis=0))


def signal_moves(
    recordings: Sequence[Recording], signals: Sequence[str], joints: Sequence[str]
) -> Array:
    """How far each signal moves with a joint's measured position (n_signals, n_joints).

    The measured position itself, and signals of its channel that are the same sensor's in another
    unit: on a straight line with it in all recordings.
    """
    moves = np.zeros((len(signals), len(joints)))
    for j, joint in enumerate(joints):
        measured = np.concatenate([r.column(f"measured/{joint}") for r in recordings])
        columns = np.column_stack([measured, np.ones_like(measured)])
        for i, signal in enumerate(signals):
            if signal.partition("/")[2] != joint:
                continue
            values = np.concatenate([recording.column(signal) for recording in recordings])
            line = np.linalg.lstsq(columns, values)[0]
            if np.abs(values - columns @ line).max() <= _SAME_SENSOR * np.ptp(values):
                moves[i, j] = 1.0 if signal == f"measured/{joint}" else line[0]
    return moves
