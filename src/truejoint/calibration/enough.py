"""Whether a calibration has enough data: what as much again is expected to better."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from truejoint.array_types import Array
from truejoint.calibration.fit import calibrate, cross_fit
from truejoint.calibration.folds import FOLDS, blocks, dealt
from truejoint.estimators.wrapped import Regressor
from truejoint.recordings import Recording
from truejoint.recordings.table.recording import as_recordings

ENOUGH: Final = 0.05
"""Share of its error below which a calibration is hardly bettered."""


def expected_gain(
    recordings: Recording | Sequence[Recording], estimator: str | Regressor = "linear", **how: Any
) -> Array:
    """Share (n_joints,) of its RMS error that a calibration would lose by twice the data.

    Each of five blocks of time is left out of one fit. How far the fits' predictions differ from
    that of the whole gives the variance of the whole's (delete-a-group jackknife: Efron and Stein,
    The Annals of Statistics 9(3), 1981), which twice the data would halve; their errors on what
    they left out give the error that it is a part of. What no data can better, such as curves that
    a linear model cannot follow, stays. Below `ENOUGH` more of the same hardly pays.

    Parameters
    ----------
    recordings : Recording or sequence of Recording
    estimator : str or Regressor
    **how
        As `calibrate` takes it: features, joints.

    Raises
    ------
    CalibrationError
        As `calibrate` does, of the whole or of four fifths.

    Examples
    --------
    >>> bool(expected_gain(training)[0] < 0.05)
    True
    """
    recordings = as_recordings(recordings)
    how = {"redundant": (), **how}  # what only checks a control loop's sensors is not asked for
    whole = calibrate(recordings, estimator, **how)
    rows = [whole.rows(recording) for recording in recordings]
    predicted = [whole.correct(held_out) for held_out in rows]
    parts = blocks(recordings, FOLDS)
    left_out = dealt([parts[k::FOLDS] for k in range(FOLDS)], "time")
    differences, errors = [], []
    fits = cross_fit(whole, recordings, left_out, fit_rate=how.get("fit_rate"))
    for fit, fold in zip(fits, left_out, strict=True):
        again = [fit.correct(held_out) for held_out in rows]
        squares = [(a - b) ** 2 for a, b in zip(again, predicted, strict=True)]
        differences.append(np.concatenate(squares).mean(axis=0))
        for part in fold.parts:
            error = (rows[part.recording].truth - again[part.recording])[part.first : part.end]
            errors.append(error[np.isfinite(error).all(axis=1)] ** 2)
    variance = (len(fits) - 1) / len(fits) * np.sum(differences, axis=0)
    square = np.concatenate(errors).mean(axis=0)
    gain = np.divide(variance / 2.0, square, out=np.zeros_like(square), where=square > 0.0)
    return np.asarray(1.0 - np.sqrt(1.0 - np.minimum(gain, 1.0)))
