"""Whether a zero for each recording is better for those to come, once these are re-zeroed."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from truejoint.array_types import Array
from truejoint.calibration.choose import by_joint
from truejoint.calibration.cross_validate import GAIN, is_better, log_ratio
from truejoint.calibration.folds import FOLDS, Fold
from truejoint.calibration.zero import judged_error
from truejoint.errors import CalibrationError

if TYPE_CHECKING:
    from truejoint.calibration.calibration import Calibration
    from truejoint.calibration.rows import Rows

_REZERO: Final = 2.0  # [s] of truth that each recording is re-zeroed from to be judged,
_SHARE: Final = 0.1  # or this share of the shortest one
_TRIED_ON: Final = 3  # parts, after which zeros that are not as much better so far are given up

Pair = Callable[[Sequence[int]], "tuple[Calibration, Calibration]"]
"""Fits to the recordings of these indices: with one zero, and with one for each."""


def validate_zeros(
    parts: Sequence[Rows],
    left_out: Sequence[Fold],
    fit: Pair,
    say: Callable[[str, float], None],
) -> tuple[bool, dict[str, Any]]:
    """Whether a zero for each recording is better without doubt, and how that was found, as JSON.

    Five of the folds at most, of whole recordings, are left out of a pair of fits each, and their
    recordings are re-zeroed from the first seconds as `find_zero` gives it. A
    zero for each is better where it beats one zero, by the rule of a choice, in a joint, and is no
    worse on the average in any. `say` is told what is done and the share of it.
    """
    began = time.perf_counter()
    stretch = min(_REZERO, _SHARE * min(part.recording.duration for part in parts))
    judged, squares = list[str](), list[Array]()
    left_out = left_out[:: -(-len(left_out) // FOLDS)]
    for number, fold in enumerate(left_out):
        out = sorted({part.recording for part in fold.parts})
        training = [index for index in range(len(parts)) if index not in out]
        if len(training) < 2:
            continue
        say(f"Judging a zero for each recording without {fold.name}", number / len(left_out))
        testing = [parts[index] for index in out]
        try:
            pair = fit(training)
            squares.append(np.array([_square(each, testing, stretch) for each in pair]))
        except CalibrationError:  # as the choice itself passes such a fold over
            continue
        judged.append(fold.name)
        means = _ratios(squares).mean(axis=0)
        if len(judged) >= _TRIED_ON and (means.min() > GAIN or means.max() > 0.0):
            break
    if not squares:
        return False, {"kept": False, "note": "no part can be left out for it"}
    square, ratios = np.array(squares), _ratios(squares)
    is_better_fit = any(map(is_better, ratios.T)) and bool((ratios.mean(axis=0) <= 0.0).all())
    joints = pair[0].joints
    return is_better_fit, {
        "kept": is_better_fit,
        "rezeroed_from": stretch,
        "left_out": judged,
        "shared": by_joint(joints, square[:, 0]),
        "recording": by_joint(joints, square[:, 1]),
        "ratio": math.exp(ratios.mean()),
        "ratios": np.exp(ratios.mean(axis=1)).tolist(),
        "seconds": round(time.perf_counter() - began, 3),
    }


def _ratios(squares: Sequence[Array]) -> Array:
    """Logarithms (n_folds, n_joints) of the ratio of the errors of pairs (2, n_joints)."""
    shared, each = np.moveaxis(np.array(squares), 1, 0)
    return log_ratio(each, shared)


def _square(calibration: Calibration, parts: Sequence[Rows], stretch: float) -> Array:
    """Mean square (n_joints,) of the errors of recordings after their first seconds."""
    errors = [judged_error(calibration, part, stretch)[0] for part in parts]
    return np.asarray(np.mean(np.concatenate(errors) ** 2, axis=0))
