"""The zero of a calibration: a value, and how much of an offset is believed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from truejoint.array_types import Array

_DOUBT: Final = 1.5  # deviations of an offset that errors may explain


@dataclass(frozen=True, eq=False)
class Zero:
    """Zero of a calibration, and how it was found; `Calibration.at` takes it.

    Attributes
    ----------
    offset : ndarray, shape (n_joints,)
        How far true positions are from corrected ones [rad or m].
    deviation : ndarray, shape (n_joints,)
        Standard deviation of `offset` as an estimate of the offset of a whole motion [rad or m];
        NaN where it is not known.
    shift : ndarray, shape (n_joints,)
        By how much to move the zero [rad or m]; `offset` by default. `find_zero` gives less where
        errors of the calibration may explain the offset.
    source : str
        How it was determined: ``"truth"``, ``"touches"``, ``"motor"``, or in words of your own.
    file, homing_id : str
        Recording that it is of, and its homing.
    rows : int
        Readings of the truth.
    duration : float
        Time from the first to the last of them [s].
    baselines : mapping of str to ndarray, shape (n_joints,)
        Offset of each baseline [rad or m]; those that are not named move by `shift`.
    moves : ndarray, shape (n_signals, n_joints), optional
        Signals that the zero belongs to, if it is not one of the output: see `Calibration.moves`.
    details : mapping
        JSON values for people.

    Examples
    --------
    >>> truejoint.calibration.find_zero(model, test).rows
    400
    """

    offset: Array
    deviation: Array = field(default_factory=lambda: np.array(math.nan))
    shift: Array = field(default_factory=lambda: np.array(math.nan))
    source: str = "truth"
    file: str = ""
    homing_id: str = ""
    rows: int = 0
    duration: float = 0.0
    baselines: Mapping[str, Array] = field(default_factory=dict)
    moves: Array | None = None
    details: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        offset = np.asarray(self.offset, dtype=np.float64)
        shift = np.asarray(self.shift, dtype=np.float64)
        deviation = np.broadcast_to(self.deviation, offset.shape)
        vars(self).update(offset=offset, deviation=deviation, shift=shift if shift.ndim else offset)


def believed(offset: ArrayLike, deviation: ArrayLike) -> Array:
    """Estimate zeros (n,) [rad or m] of offsets with these deviations (n,), where few zeros move.

    That is ``offset (1 - (1.5 deviation / offset)^2)``, and nothing below 1.5 deviations. With 1
    for 1.5 it is the mean of a Gaussian zero whose variance is what today's offset has beyond that
    of the errors (empirical Bayes, as Efron and Morris, JASA 68, 1973, here of a single mean; in
    form Breiman's non-negative garrote, Technometrics 37, 1995); 1.5 is for errors of beginnings,
    which now and then are several deviations. Where the zero did not move, the mean square error is
    0.12 of that of the whole offset; the price is a zero that moved by more than 1.1 deviations: up
    to 2.2 times (at 2.6), a fifth of one more at ten. All of an offset whose deviation is NaN.
    """
    offsets, spread = (np.asarray(values, dtype=np.float64) for values in (offset, deviation))
    spread = _DOUBT * spread
    by_errors = np.divide(spread**2, offsets, out=offsets.copy(), where=np.abs(offsets) > spread)
    return np.where(np.isnan(spread), offsets, offsets - by_errors)
