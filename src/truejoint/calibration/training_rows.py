"""Rows of training recordings: with truth, without gross outliers, at the rate of a fit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from numbers import Real
from typing import TYPE_CHECKING

import numpy as np

from truejoint.array_types import Array, Mask
from truejoint.calibration.rows import Rows
from truejoint.errors import CalibrationError
from truejoint.estimators.family import Target
from truejoint.features.feature_set import FeatureSet
from truejoint.recordings.join.explained import gross_outliers

if TYPE_CHECKING:
    from truejoint.recordings import Recording


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
