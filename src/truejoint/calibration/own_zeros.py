"""Zeros of their own of recordings or homings, and training rows without them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final, Literal, get_args

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.calibration.compatibility import source_of
from truejoint.calibration.rows import TrainingRows, fitted_rows
from truejoint.calibration.signal_shift import shift_signals
from truejoint.errors import CalibrationError
from truejoint.estimators.base import constant_columns
from truejoint.estimators.wrapped import get_estimator
from truejoint.recordings import Recording

ZeroOf = Literal["shared", "recording", "homing"]
_SETTLED: Final = 1e-7  # [rad or m] that zeros of homings are found to
_FOLLOWS: Final = 0.5  # of a zero that may be left when the measured positions moved by it


def zero_groups(recordings: Sequence[Recording], zero: ZeroOf) -> tuple[list[str], Integers]:
    """Names of what recordings share a zero with, and which of them each does.

    A recording whose homing has no name is one of its own. Raises CalibrationError if `zero` is
    nothing of the kind, or there are fewer than two.
    """
    if zero not in get_args(ZeroOf):
        raise CalibrationError(f"zero {zero!r:.60}; choose {', '.join(get_args(ZeroOf))}")
    origins = [recording.provenance for recording in recordings]
    keys = [(zero == "homing" and one.homing_id) or i for i, one in enumerate(origins)]
    different = list(dict.fromkeys(keys))
    names = [key if isinstance(key, str) else source_of(recordings[key]) for key in different]
    if len(names) < 2:
        raise CalibrationError(
            f"a zero for each {zero} takes two of them; all recordings are of {names[0]}: give "
            "more, or let them share one zero"
        )
    return names, np.array([different.index(key) for key in keys])


def at_one_zero(
    parts: Sequence[TrainingRows],
    group: Integers,
    moves: Array | None,
    signals: Sequence[str],
) -> tuple[Sequence[TrainingRows], Array]:
    """Parts without the zeros of their groups, and these zeros (n_groups, n_joints) [rad or m].

    `group` (n_parts,) numbers the groups. The zeros are taken off the truth, or with `moves`
    (n_signals, n_joints) added to the `signals`. They are about their mean. Raises CalibrationError
    where the signals leave open what was added to them.
    """
    found = _group_zeros(parts, group)
    if moves is None:
        pairs = zip(parts, found[group], strict=True)
        return [replace(p, error=p.error - z, truth=p.truth - z) for p, z in pairs], found
    zeros, at_zero, left = np.zeros_like(found), parts, found
    while np.abs(left).max() > _SETTLED:
        zeros = zeros + left
        at_zero = [
            part.rules.rows(shift_signals(part.recording, signals, moves @ own), part.outlying)
            for part, own in zip(parts, zeros[group], strict=True)
        ]
        before, left = left, _group_zeros(at_zero, group)
        if not np.abs(left).max() < _FOLLOWS * np.abs(before).max():
            raise CalibrationError(
                "the true position hardly follows the measured one where other signals are known, "
                "so the zero of a homing cannot be found; choose a zero for each recording"
            )
    return at_zero, zeros


def _group_zeros(parts: Sequence[TrainingRows], group: Integers) -> Array:
    """Zeros (n_groups, n_joints) [rad or m] about their mean: least squares with the linear model.

    The slopes are those within the groups, so a feature that changes between them alone has none.
    """
    rows = np.repeat(group, [len(part.fitted) for part in parts])
    X, error = (fitted_rows(parts, name) for name in ("features", "error"))
    inputs, errors = np.zeros_like(X), np.zeros_like(error)
    for number in range(int(group.max()) + 1):
        own = rows == number
        varies = ~constant_columns(X[own])
        inputs[np.ix_(own, varies)] = (X[own] - X[own].mean(axis=0))[:, varies]
        errors[own] = error[own] - error[own].mean(axis=0)
    left = error - get_estimator("linear").fit(inputs, errors).predict(X)
    zeros = np.array([left[rows == n].mean(axis=0) for n in range(int(group.max()) + 1)])
    return np.asarray(zeros - zeros.mean(axis=0))
