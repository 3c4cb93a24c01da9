"""Intervals from the recordings of the fit itself: whole ones, or parts with gaps between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from truejoint.array_types import Array
from truejoint.calibration.calibration import Calibration
from truejoint.calibration.choose import Automatic
from truejoint.calibration.compatibility import common_robot
from truejoint.calibration.conformal import (
    check_interval,
    exchangeable_units,
    interval_of,
    knowing_errors,
    possible_levels,
    state_interval,
    trajectory_scores,
)
from truejoint.calibration.fit import calibrate, cross_fit
from truejoint.calibration.fit_task import within
from truejoint.calibration.folds import (
    FOLDS,
    Fold,
    Part,
    blocks,
    conditions,
    dealt,
    enough_beside,
    wholes,
    without_levels,
)
from truejoint.calibration.interval import GROWTH, LEVELS
from truejoint.calibration.origin import distinct
from truejoint.errors import CalibrationError
from truejoint.estimators.base import Progress, untold
from truejoint.estimators.registry import DEFAULT
from truejoint.estimators.wrapped import Regressor
from truejoint.recordings import Recording
from truejoint.recordings.table.recording import as_recordings

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

    Two to six more fits do without some of the recordings each, and their errors on these make the
    interval, as those on unseen recordings do in `with_interval`: each trajectory weighs the
    same, and one more, infinitely bad, stands for that to come. From ten recordings on (or homings,
    where the recordings span several) they are the trajectories, copies of one counting once.
    Recordings that come in levels of speed, effort or stated mass are left out by level: a fit that
    remembers loads would else be judged on loads that it knows
    (`truejoint.calibration.folds.without_levels`).

    Fewer than ten are cut into fifteen parts or more, five or more each, which are the
    trajectories. Two recordings (or homings) or more are left out whole all the same, unless one is
    nearly all the time or the fit without it is refused; else a fit does without parts, and a tenth
    of a part on either side. Parts of one recording say nothing of another day, and of n that
    differ no more than n of n + 1 can be promised for the next.

    What is stated is to be expected of more recordings like these, as far as those fits err as
    the fit of all does. That cannot be proved as for recordings that no fit saw; what can
    (Barber et al., Annals of Statistics 49(1), 2021, theorem 4, for intervals that keep all
    fits) is 80 % for a stated 90 %.

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
    >>> truejoint.calibration.cross_interval(training, "linear").interval.levels.tolist()
    [0.8, 0.9]
    """
    check_interval(levels, rezero, growth)
    recordings = as_recordings(recordings)
    common_robot(recordings)
    report = progress or untold
    different = distinct(recordings)
    plans = _plans(different, per_homing=rezero == 0.0)
    possible = possible_levels(levels, len(plans[0].units))
    share = 1.0 / (len(plans[0].left_out) + 1)
    fitted = calibrate(recordings, estimator, progress=within(report, 0.0, share), **how)
    plan, fits = _cross_fits(
        fitted, different, plans, rezero, how.get("fit_rate"), within(report, share, 1.0 - share)
    )
    held_out = [plan.held_out(different, fold) for fold in plan.left_out]
    fitted = knowing_errors(fitted, list(zip(fits, held_out, strict=True)))
    scores: dict[Part, list[Array]] = {}
    for fit, fold in zip(fits, plan.left_out, strict=True):
        used = replace(fit, effort_baseline=fitted.effort_baseline)
        rows = {i: used.rows(different[i]) for i in _recordings_of(fold)}
        for part in fold.parts:
            seen = rows[part.recording]
            found = trajectory_scores(used, seen, rezero, growth, part.rows(len(seen)))
            scores.setdefault(part, []).append(found)
    interval = interval_of(
        [np.concatenate([s for part in unit for s in scores[part]], axis=2) for unit in plan.units],
        possible,
        different,
        growth=growth,
        rezero=rezero,
        folds=len(plan.left_out),
        cut=plan.cut,
        whole=plan.whole,
    )
    return state_interval(fitted, interval, different)


def _cross_fits(
    fitted: Calibration,
    recordings: Sequence[Recording],
    plans: Sequence[_Plan],
    rezero: float,
    fit_rate: float | None,
    report: Progress,
) -> tuple[_Plan, list[Calibration]]:
    """Fits without what each fold of a plan leaves out, of the first plan that works."""
    fractions = [0.0]  # done, of the plans so far
    for number, plan in enumerate(plans):
        rest = within(report, fractions[-1], 1.0 - fractions[-1])

        def told(fraction: float, rest: Progress = rest, begin: float = fractions[-1]) -> None:
            fractions.append(begin + (1.0 - begin) * fraction)
            rest(fraction)

        try:
            fits = cross_fit(
                fitted, recordings, plan.left_out, fit_rate=fit_rate,
                for_rezeroing=rezero > 0.0, progress=told,
            )  # fmt: skip
            return plan, fits
        except CalibrationError:
            if number == len(plans) - 1:
                raise
    raise AssertionError  # there is a plan


@dataclass(frozen=True)
class _Plan:
    """What weighs as one trajectory, and what each fit does without."""

    units: list[list[Part]]
    left_out: list[Fold]
    cut: int = 0  # recordings that were cut into the units
    whole: int = 0  # of these, or of homings, that are left out whole all the same

    def held_out(self, recordings: Sequence[Recording], fold: Fold) -> list[Recording]:
        """Give what the fit without a fold did not use: recordings, or parts of them."""
        if self.whole:
            return [recordings[i] for i in _recordings_of(fold)]
        return [recordings[p.recording].rows(slice(p.first, p.end)) for p in fold.parts]


def _plans(recordings: Sequence[Recording], *, per_homing: bool) -> list[_Plan]:
    """Plans for recordings, none a copy of another, as `cross_interval` says; the first that works.

    All have as many units.
    """
    groups = exchangeable_units(recordings, per_homing=per_homing)
    if len(groups) < WHOLE_FROM:
        parts = blocks(recordings, max(FOLDS, -(-PARTS // len(recordings))))
        units = [[part] for part in parts]
        by_part = _Plan(units, dealt(units, ""), len(recordings))
        grouped = [[part for part in parts if part.recording in group] for group in groups]
        whole = dealt(grouped, "")
        enough = enough_beside(recordings, [_recordings_of(fold) for fold in whole])
        if len(groups) == 1 or not enough.all():
            return [by_part]
        return [_Plan(units, whole, len(recordings), len(groups)), by_part]
    parts = wholes(recordings)
    units = [[parts[i] for i in group] for group in groups]
    if len(units) < len(parts):  # several recordings of a homing
        return [_Plan(units, dealt(units, ""))]
    return [_Plan(units, without_levels(recordings, conditions(recordings)))]


def _recordings_of(fold: Fold) -> list[int]:
    return sorted({part.recording for part in fold.parts})
