"""Intervals of whole trajectories, or of parts of those of the fit, and whether they hold."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from truejoint.array_types import Array
from truejoint.calibration import folds
from truejoint.calibration.baseline_fit import residual_statistics
from truejoint.calibration.calibration import Calibration, as_calibration
from truejoint.calibration.choose import Automatic
from truejoint.calibration.compatibility import common_robot, source_of
from truejoint.calibration.fit import calibrate, cross_fit
from truejoint.calibration.fit_task import within
from truejoint.calibration.interval import GROWTH, LEVELS, Interval, needed_trajectories
from truejoint.calibration.origin import Session, distinct
from truejoint.calibration.rows import Rows
from truejoint.calibration.truth_zero import judged_error, rows_with_truth
from truejoint.errors import CalibrationError
from truejoint.estimators.base import Progress, untold
from truejoint.estimators.registry import DEFAULT
from truejoint.estimators.wrapped import Regressor
from truejoint.recordings import Recording
from truejoint.recordings.table.recording import as_recordings

WHOLE_FROM: Final = 10  # recordings, from which on they are left out whole
PARTS: Final = 15  # that fewer recordings are cut into, at least


def with_interval(
    calibration: Calibration,
    recordings: Recording | Sequence[Recording],
    *,
    levels: Sequence[float] = LEVELS,
    rezero: float = 0.0,
) -> Calibration:
    """Add an interval, made of trajectories that the fit has not seen, to a calibration.

    The score of a sample is its absolute error, divided by how much wider the interval is there
    outside the trained range. Every trajectory weighs the same, however long it is, and one more
    that may be arbitrarily bad stands for the trajectory to come; the half-width is the quantile
    of the scores at the stated level (Lee, Barber and Willett, arXiv:2306.06342).

    A trajectory is what was recorded after one homing, where the recordings span several homings
    and are not re-zeroed; otherwise one recording. Copies of a recording count once.

    The size of errors of an `EffortBaseline` becomes that of these recordings; so much is then
    believed of a zero, in the errors that make the interval as in those to come.

    Parameters
    ----------
    calibration : Calibration
    recordings : Recording or sequence of Recording
        With truth. The interval holds for motions, homings and loads like those in them.
    levels : sequence of float
        Probabilities to state. Those that the trajectories are too few for are left out.
    rezero : float
        When above 0, the first `rezero` seconds of truth of every recording set its zero
        (`find_zero`) and are not scored: the interval then holds after re-zeroing likewise. If
        there is a fit for that (`Calibration.for_rezeroing`), give it in place of the calibration.

    Raises
    ------
    CalibrationError
        If there are too few trajectories for any level, one was used in the fit, or has no truth.

    Examples
    --------
    >>> pieces = [truejoint.evaluation.part_by_time(test, k / 9, (k + 1) / 9) for k in range(9)]
    >>> with_interval(model, pieces).interval.trajectories
    9
    """
    recordings = distinct(as_recordings(recordings))
    for recording in recordings:
        if as_calibration(calibration).origin.includes(recording):
            raise CalibrationError(
                f"{source_of(recording)} was used in the fit, so its errors are too small for an "
                "interval; give recordings that the calibration has not seen"
            )
    groups = exchangeable_units(recordings, per_homing=rezero == 0.0)
    possible = _possible_levels(levels, len(groups), rezero)
    parts = folds.wholes(recordings)
    units = [[parts[index] for index in group] for group in groups]
    judges = [(calibration, folds.Fold("", tuple(parts)))]
    return _stating(calibration, judges, recordings, units, possible, rezero=rezero)


def _possible_levels(levels: Sequence[float], n_units: int, rezero: float = 0.0) -> list[float]:
    """Those that so many trajectories are enough for; raises CalibrationError if there are none."""
    if not np.size(levels) or not 0.0 <= rezero < math.inf:
        raise CalibrationError(
            f"interval with levels {levels}, rezero {rezero!r} s; give a level, and a time of 0 s "
            "or more"
        )
    wanted = np.unique(levels).tolist()
    possible = [level for level in wanted if needed_trajectories(level) <= n_units]
    if not possible:
        raise CalibrationError(
            f"{n_units} calibration trajectories are too few for a {100 * wanted[0]:g} % "
            f"interval, which takes {needed_trajectories(wanted[0])}; record more, each after "
            "another homing if it is to hold after any homing"
        )
    return possible


def _stating(
    calibration: Calibration,
    judges: Sequence[tuple[Calibration, folds.Fold]],
    recordings: Sequence[Recording],
    units: Sequence[Sequence[folds.Part]],
    levels: Sequence[float],
    **how: Any,
) -> Calibration:
    """Calibration with the interval of the errors of fits on the parts that each did not see.

    Errors of the parts of one of the `units` stand together; `how` are fields of `Interval`.
    """
    by_fold, held_out = [], []
    for fit, fold in judges:
        rows = {i: rows_with_truth(fit, recordings[i]) for i in fold.recordings}
        parts: list[Recording | Rows] = [rows[part.recording] for part in fold.parts]
        if how.get("cut"):
            parts = [recordings[p.recording].rows(slice(p.first, p.end)) for p in fold.parts]
        by_fold.append(rows)
        held_out.append((fit, list(rows.values()) if how.get("whole") else parts))
    calibration = knowing_errors(calibration, held_out)
    by_part: dict[folds.Part, list[Array]] = {}
    for rows, (fit, fold) in zip(by_fold, judges, strict=True):
        used = replace(fit, effort_baseline=calibration.effort_baseline)
        scores = {number: scores_of(used, own, how["rezero"]) for number, own in rows.items()}
        for part in fold.parts:
            own = scores[part.recording][:, part.first : part.end]
            known = np.isfinite(own).all(axis=0)
            if not known.any():
                raise CalibrationError(
                    f"{source_of(recordings[part.recording])}: a part of it has no truth, so it "
                    "makes no interval; leave it out, or record it again"
                )
            by_part.setdefault(part, []).append(own[:, known])
    joined = [np.concatenate([s for part in unit for s in by_part[part]], axis=1) for unit in units]
    joints = list(zip(*joined, strict=True))
    half = np.array([[conformal_threshold(joint, level) for joint in joints] for level in levels])
    counts: dict[str, Any] = {
        "trajectories": len(units),
        "homings": len({r.provenance.homing_id for r in recordings} - {""}),
    }
    interval = Interval(np.array(levels), half, GROWTH, **counts, **how)
    origin = replace(calibration.origin, interval_sessions=tuple(map(Session.of, recordings)))
    return replace(calibration, interval=interval, origin=origin)


def knowing_errors(
    calibration: Calibration, judged: Sequence[tuple[Calibration, Sequence[Recording | Rows]]]
) -> Calibration:
    """Calibration that knows how large errors are: of fits on recordings that they did not see.

    What is believed of a zero rests on that size, so an interval is made of errors after it.
    """
    baseline = calibration.effort_baseline
    if baseline is None:
        return calibration
    statistics = [residual_statistics(*pair, baseline.step) for pair in judged]
    sizes, times, beginnings = zip(*statistics, strict=True)
    baseline = replace(
        baseline,
        residual=np.sqrt(np.mean(np.square(sizes), axis=0)),
        correlation=np.median(times, axis=0),
        beginning=np.sqrt(np.mean(np.square(beginnings), axis=0)),
    )
    return replace(calibration, effort_baseline=baseline)


def exchangeable_units(
    recordings: Sequence[Recording], *, per_homing: bool = True
) -> list[list[int]]:
    """Group the indices of recordings that count as one trajectory: see `with_interval`.

    With `per_homing`, those after one homing, as they share its offset, where there are several.
    """
    names = [recording.provenance.homing_id for recording in recordings]
    if not per_homing or len(set(names) - {""}) < 2:
        return [[i] for i in range(len(recordings))]
    units: dict[str | int, list[int]] = {}
    for i, name in enumerate(names):
        units.setdefault(name or i, []).append(i)
    return list(units.values())


def conformal_threshold(scores: Sequence[Array], level: float) -> float:
    """Score that a sample of one more trajectory stays below with probability `level` or more.

    Each of the n trajectories has the weight 1/(n + 1), spread evenly over its `scores` (n_i,);
    what is left stands at infinity for the one to come. There are `needed_trajectories` or more.
    """
    values = np.concatenate(scores)
    share = np.concatenate([np.full(len(s), 1.0 / len(s)) for s in scores]) / (len(scores) + 1)
    order = np.argsort(values, kind="stable")
    reached = np.cumsum(share[order])
    # The weights are rounded sums: 9 trajectories reach 0.9 but for rounding.
    first = int(np.searchsorted(reached, level - 1e-9))
    return float(values[order][min(first, len(values) - 1)])


def scores_of(calibration: Calibration, rows: Rows, rezero: float) -> Array:
    """Scores (n_joints, n) of the model, NaN where none is judged."""
    error, judged = judged_error(calibration, rows, rezero)
    widening = 1.0 + GROWTH * calibration.range_excess(rows)[judged]
    scores = np.full((error.shape[1], len(rows)), np.nan)
    scores[:, judged] = np.abs(error.T) / widening
    return scores


def cross_interval(
    recordings: Recording | Sequence[Recording],
    estimator: str | Regressor | Automatic = DEFAULT,
    *,
    levels: Sequence[float] = LEVELS,
    progress: Progress | None = None,
    **how: Any,
) -> Calibration:
    """Fit as `calibrate` does, with an interval of the same recordings (cross-conformal).

    Two to six more fits do without some of the recordings each, and their errors on these make the
    interval, as those on unseen recordings do in `with_interval`. With ten recordings or more (or
    homings, where the recordings span several) they are the trajectories, copies of one counting
    once. Recordings that come in levels of speed, effort or stated mass are left out by level: a
    fit that remembers loads would else be judged on loads that it knows.

    Fewer than ten are cut into fifteen parts or more, five or more each, which are the
    trajectories. Two recordings (or homings) or more are left out whole, unless one is
    nearly all the time or the fit without it is refused; else a fit does without parts, and a tenth
    of a part on either side. Parts of one recording say nothing of another day, and of n that
    differ no more than n of n + 1 can be promised for the next.

    Expect the stated share of more recordings like these, as far as those fits err as the
    fit of all does. The proven share (Barber et al., Annals of Statistics 49(1), 2021, theorem 4,
    for intervals that keep all fits) is 80 % for a stated 90 %.

    Parameters
    ----------
    recordings : Recording or sequence of Recording
    estimator : str, Regressor or Automatic
        As `calibrate` takes it. One that is chosen automatically is chosen once, from all.
    levels
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
    recordings = as_recordings(recordings)
    common_robot(recordings)
    report = progress or untold
    different = distinct(recordings)
    units, cut, plans = _plans(different)
    possible = _possible_levels(levels, len(units))
    share = 1.0 / (len(plans[0][0]) + 1)
    fitted = calibrate(recordings, estimator, progress=within(report, 0.0, share), **how)
    rest = (1.0 - share) / len(plans)
    for number, (left_out, _) in enumerate(plans):  # the first that works
        try:
            fits = cross_fit(
                fitted, different, left_out, fit_rate=how.get("fit_rate"),
                progress=within(report, share + number * rest, rest),
            )  # fmt: skip
            break
        except CalibrationError:
            if number == len(plans) - 1:
                raise
    report(1.0)
    left_out, whole = plans[number]
    judges = list(zip(fits, left_out, strict=True))
    counts = {"folds": len(left_out), "cut": cut, "whole": whole}
    return _stating(fitted, judges, different, units, possible, rezero=0.0, **counts)


def _plans(
    recordings: Sequence[Recording],
) -> tuple[list[list[folds.Part]], int, list[tuple[list[folds.Fold], int]]]:
    """Trajectories of recordings, none a copy of another, and plans, as `cross_interval` says.

    Gives the parts of each trajectory, how many recordings are cut into them, and what the fits do
    without by each plan, with how many recordings, or homings, are left out whole all the same. The
    first plan that works is used.
    """
    groups = exchangeable_units(recordings)
    if len(groups) < WHOLE_FROM:
        parts = folds.blocks(recordings, max(folds.FOLDS, -(-PARTS // len(recordings))))
        units = [[part] for part in parts]
        plans = [(folds.dealt(units, ""), 0)]
        grouped = [[part for part in parts if part.recording in group] for group in groups]
        whole_groups = folds.dealt(grouped, "")
        enough = folds.enough_beside(recordings, [fold.recordings for fold in whole_groups])
        if len(groups) > 1 and enough.all():
            plans.insert(0, (whole_groups, len(groups)))
        return units, len(recordings), plans
    parts = folds.wholes(recordings)
    units = [[parts[i] for i in group] for group in groups]
    if len(units) < len(parts):  # several recordings of a homing
        return units, 0, [(folds.dealt(units, ""), 0)]
    return units, 0, [(folds.without_levels(recordings, folds.levels_by_quantity(recordings)), 0)]
