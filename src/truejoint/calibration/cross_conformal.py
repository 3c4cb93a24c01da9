"""Intervals from what a laboratory has: ten recordings, or one cut with gaps, also fitted to."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from truejoint.array_types import Array
from truejoint.calibration.calibration import Calibration
from truejoint.calibration.choice import Automatic
from truejoint.calibration.conformal import (
    check_interval,
    exchangeable_units,
    interval_of,
    possible_levels,
    state_interval,
    trajectory_scores,
)
from truejoint.calibration.fitting import calibrate, within
from truejoint.calibration.folds import FOLDS, Fold, Part, blocks, dealt, wholes, without
from truejoint.calibration.interval import GROWTH, LEVELS
from truejoint.calibration.selection import common_robot
from truejoint.estimators.base import Progress
from truejoint.estimators.registry import DEFAULT
from truejoint.estimators.wrapped import Regressor
from truejoint.recordings import Recording
from truejoint.recordings.recording import as_recordings

WHOLE_FROM: Final = 10  # recordings, from which on they are left out whole
PARTS: Final = 15  # that fewer recordings are cut into, at least


def cross_interval(
    recordings: Recording | Sequence[Recording],
    estimator: str | Regressor | Automatic = DEFAULT,
    *,
    levels: Sequence[float] = LEVELS,
    rezero: float = 0.0,
    growth: float = GROWTH,
    progress: Progress | None = None,
    **how: Any,
) -> Calibration:
    """Fit as `calibrate` does, with an interval of the same recordings (cross-conformal).

    Five more fits do without a fifth of the recordings each, and their errors on that fifth make
    the interval, as those on unseen recordings do in `with_interval`: each trajectory weighs the
    same, and one more, infinitely bad, stands for the one to come. From ten recordings on (or
    homings, where the recordings span several) they are the trajectories; fewer are cut into
    fifteen parts or more, five or more each, with a tenth of a part left out on either side.

    What is stated is to be expected of more recordings like these, as far as the five fits err as
    the fit of all does. That cannot be proved as for recordings that no fit saw; what can
    (Barber et al., Annals of Statistics 49(1), 2021, theorem 4, for intervals that keep all
    fits) is 80 % for a stated 90 %. Parts of few recordings say nothing of another day.

    Parameters
    ----------
    recordings : Recording or sequence of Recording
    estimator : str, Regressor or Automatic
        As `calibrate` takes it. One that is chosen automatically is chosen once, from all.
    levels, rezero, growth
        As `with_interval` takes them.
    progress : callable, optional
        Called with the fraction done, 0 to 1.
    **how
        As `calibrate` takes it.

    Raises
    ------
    CalibrationError
        As `calibrate`, or if a part has too few rows or no truth, or no level can be stated.

    Examples
    --------
    >>> truejoint.calibration.cross_interval(training, "linear").interval.folds
    5
    """
    check_interval(levels, rezero, growth)
    recordings = as_recordings(recordings)
    common_robot(recordings)
    report = progress or (lambda _fraction: None)
    units, is_cut = _units(recordings, per_homing=rezero == 0.0)
    possible = possible_levels(levels, len(units))
    left_out = dealt(units, "", FOLDS)
    share = 1.0 / (len(left_out) + 1)
    fitted = calibrate(recordings, estimator, progress=within(report, 0.0, share), **how)
    again = {**how, "features": fitted.feature_set, "target": fitted.target}
    again |= {"joints": fitted.joints, "zero": fitted.metadata["zeros"]["of"]}
    scores: dict[Part, Array] = {}
    judged = []
    for k, fold in enumerate(left_out):
        done = within(report, (k + 1) * share, share)
        training = without(recordings, fold.parts)
        other = calibrate(training, fitted.model.settled(), progress=done, **again)
        other = other.fitted_for(rezeroing=rezero > 0.0)
        scores |= _scores_of(other, recordings, fold, rezero, growth)
        judged.append((other, _unseen(recordings, fold)))
    interval = interval_of(
        [np.concatenate([scores[part] for part in unit], axis=2) for unit in units],
        possible,
        recordings,
        growth=growth,
        rezero=rezero,
        folds=len(left_out),
        cut=len(recordings) if is_cut else 0,
    )
    return state_interval(fitted, interval, recordings, judged)


def _units(recordings: Sequence[Recording], *, per_homing: bool) -> tuple[list[list[Part]], bool]:
    """Parts of each trajectory that weighs as one, and whether recordings were cut for them."""
    whole = exchangeable_units(recordings, per_homing=per_homing)
    if len(whole) < WHOLE_FROM:
        each = max(FOLDS, -(-PARTS // len(recordings)))
        return [[part] for part in blocks(recordings, each)], True
    return [[wholes(recordings)[i] for i in unit] for unit in whole], False


def _scores_of(
    fitted: Calibration, recordings: Sequence[Recording], fold: Fold, rezero: float, growth: float
) -> dict[Part, Array]:
    """Scores of each part of a fold, by a fit that did without it."""
    found = {}
    for part in fold.parts:
        recording = recordings[part.recording]
        among = part.rows(len(recording))
        found[part] = trajectory_scores(fitted, recording, rezero, growth, among)
    return found


def _unseen(recordings: Sequence[Recording], fold: Fold) -> list[Recording]:
    return [recordings[part.recording].rows(slice(part.first, part.end)) for part in fold.parts]
