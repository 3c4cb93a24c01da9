"""Calibrate an arm by touched points alone: no joint sensor, and no earlier calibration."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from truejoint.array_types import Array
from truejoint.calibration.calibration import Calibration
from truejoint.calibration.compatibility import check_columns
from truejoint.calibration.fit import calibrate
from truejoint.errors import CalibrationError
from truejoint.estimators.family import EstimatorData
from truejoint.estimators.polynomial.learn import PolynomialRegressor
from truejoint.features.feature_set import default_gap_limit
from truejoint.recordings import Recording
from truejoint.tip.plate import TOUCH_SD, Plate
from truejoint.tip.registration import Registration
from truejoint.tip.sighted import SHOT_SD, Shots, Sighted, shot, touched
from truejoint.tip.tip_rows import TipFit, TipPrior, TipRows, align, fit_tip
from truejoint.tip.touch_terms import (
    LEFT,
    SPREAD,
    WIDTHS,
    Terms,
    check_known,
    learned_priors,
    wide_priors,
)
from truejoint.tip.touches import (
    Touches,
    check_count,
    likelihood,
    resting,
    with_estimated_errors,
)
from truejoint.units import with_unit

_CALIBRATING: Final = 12  # touches of an arm of which nothing is known; half as many with a prior
_FOLDS: Final = 6
_FLAT: Final = 0.05  # of the touches' extent, below which they lie in a plane
_SIDED: Final = 0.15  # of the touches that come from either side of each joint
_SEEN: Final = 0.5  # of what was expected, above which a deviation says that it was not seen
_SIZED: Final = 0.8  # the same of the size of a print
_WORTH: Final = 5e-5  # of the tip, above which what a print's size leaves open is told [m]


def fewest_touches(known: Sequence[Calibration]) -> int:
    """How many different touches it takes at least to calibrate an arm with such priors."""
    return _CALIBRATING // 2 if known else _CALIBRATING


@dataclass(frozen=True, eq=False)
class TouchReport:
    """What a calibration by touch is worth, and what it did not see.

    Attributes
    ----------
    rests : Touches
        When the tip rested, and where.
    fit : TipFit
    left_out_error : float
        RMS distance [m] of the tip, in the block's frame, from points that a fit without them
        expects, less what touches err themselves: the honest error.
    left_out_sd : float
        Standard deviation of that [m]: so few touches do not say it any better.
    zero_sd : ndarray, shape (n_joints,)
        Standard deviation of each joint's zero amid the workspace [rad or m].
    not_seen : tuple of str
        In words, what only the prior holds.
    point, before, left_out : ndarray, shape (m, 3)
        Of each touch its point in the block, how far off the tip was by the measured positions,
        the block laid over them as well as it can be, and how far off it is by a fit without this
        touch [m].

    Examples
    --------
    >>> TouchReport.__dataclass_fields__["zero_sd"].type
    'Array'
    """

    rests: Touches
    fit: TipFit
    left_out_error: float
    left_out_sd: float
    zero_sd: Array
    not_seen: tuple[str, ...]
    point: Array
    before: Array
    left_out: Array


@dataclass(frozen=True, eq=False)
class TermsFit:
    """Joints and frame that fit what was touched or shot.

    Attributes
    ----------
    found : TipFit
    rows : TipRows
        With what the terms leave of the joints.
    prior : TipPrior
        That was the likeliest.
    is_learned : bool
        Whether it is of other calibrations.
    """

    found: TipFit
    rows: TipRows
    prior: TipPrior
    is_learned: bool


def calibrate_by_touch(
    recording: Recording,
    touches: Touches,
    plate: Plate,
    *,
    touch_sd: float = TOUCH_SD,
    known: Sequence[Calibration] = (),
) -> tuple[Calibration, TouchReport]:
    """Fit joints and a block's pose together to touches of its dimples.

    Of each positioning joint a constant, slopes and squares of all of them, and plays of its own:
    with three joints 39 numbers. It makes the tip right in the block's frame; joints only as far as
    `TouchReport.not_seen` leaves them. How wide the terms are expected to be, the touches say
    themselves: the prior under which they are likeliest, also of those that calibrations make.

    Parameters
    ----------
    recording : Recording
        Continuous, from before the first touch on: plays need to know where a joint came from.
    touches : Touches
    plate : Plate
    touch_sd : float
        How far off its dimple a tip rests, per axis [m].
    known : sequence of Calibration
        An older one of this arm, or three or more of other arms of the robot, as a prior.

    Returns
    -------
    calibration : Calibration
        An ordinary one, of a polynomial of degree 2, without an interval; its metadata have
        ``truth`` ``"touch"`` and what `TouchReport` says.
    report : TouchReport

    Raises
    ------
    CalibrationError
        If kinematics or workspace are not known, touches are fewer than twelve (with a prior, six),
        lie in a plane and there is no prior, come from one side, or do not fit, or the prior is of
        another robot or of two arms.

    Examples
    --------
    >>> calibrate_by_touch(test, Touches((1.0,), ("1",)), None)
    Traceback (most recent call last):
    truejoint.errors.CalibrationError: ...
    """
    check_count(touches, fewest_touches(known), "calibrate")
    return _calibrated(recording, touched(touches, plate, recording.robot, touch_sd), known)


def calibrate_by_points(
    recording: Recording,
    shots: Shots,
    registration: Registration | None = None,
    *,
    shot_sd: float = SHOT_SD,
    known: Sequence[Calibration] = (),
) -> tuple[Calibration, TouchReport]:
    """Fit joints and a tracker's pose together to single shots of the tool at rest.

    As `calibrate_by_touch`, whose ``block`` is the tracker's frame: the tip is right in that, and
    in the robot's base as far as the `registration` says where the tracker stands. Without one
    nothing is known of that, and what the tracker sees is the tip itself (a pivot calibration).

    Examples
    --------
    >>> calibrate_by_points(test, Shots((1.0,), np.zeros((1, 3))))
    Traceback (most recent call last):
    truejoint.errors.CalibrationError: ...
    """
    check_count(shots.rests, fewest_touches(known), "calibrate")
    seen = shot(shots, registration or Registration(), recording.robot, shot_sd)
    return _calibrated(recording, seen, known)


def _calibrated(
    recording: Recording, seen: Sighted, known: Sequence[Calibration]
) -> tuple[Calibration, TouchReport]:
    """Fit, judge, and make an ordinary calibration of it."""
    terms = Terms.of(recording.robot)
    features = features_of(recording, terms)
    _check_spread(seen, terms, features, resting(recording, seen.rests), is_flat_fine=bool(known))
    fit = fit_terms(recording, seen, terms, features, known)
    report = _report(seen, fit, terms, is_given=bool(known))
    coefficients = fit.found.state.coefficients
    correction = terms.basis(features) @ coefficients
    table: dict[str, Array] = {"t": recording.t}
    table |= {c: recording.column(c) for c in recording.units}
    for k, joint in enumerate(terms.joints):
        table[f"truth/{joint}"] = recording.column(f"measured/{joint}") + correction[:, k]
    whole = Recording.from_columns(table, recording.provenance, recording.units)
    # All but the model: domain, units, baselines. Of the model the touches tell all.
    fitted = calibrate(
        [whole], "linear", features=terms.features, joints=terms.joints, redundant=[]
    )
    data = EstimatorData("polynomial", {"degree": 2}, terms.arrays(coefficients))
    model = PolynomialRegressor.from_data(data, len(terms.features), len(terms.joints))
    baseline = fitted.effort_baseline
    if baseline is not None:
        baseline = replace(baseline, residual=np.hypot(fit.rows.joint_sd, report.zero_sd))
    own = replace(fitted, model=model, effort_baseline=baseline).with_metadata(
        estimator=model.name, settings=" ".join(repr(model).split()), truth="touch",
        touch=_facts(seen, fit, report, known),
    )  # fmt: skip
    return own, report


def _facts(
    seen: Sighted, fit: TermsFit, report: TouchReport, known: Sequence[Calibration]
) -> dict[str, Any]:
    """Say what the model file keeps of the touches, as plain values."""
    state = fit.found.state
    return {
        "touches": len(seen.rests),
        "what": seen.what,
        "frame": seen.frame,
        "prior": [one.title for one in known] if fit.is_learned else [],
        "left_out": [seen.rests.dimple[i] for i in np.flatnonzero(fit.found.left_out)],
        "left_out_error": report.left_out_error,
        "left_out_sd": report.left_out_sd,
        "zero_sd": report.zero_sd.tolist(),
        "joint_sd": fit.rows.joint_sd.tolist(),
        "scale": state.scale,
        "rotation": (state.rotation @ seen.stated[:3, :3]).tolist(),
        "translation": (state.rotation @ seen.stated[:3, 3] + state.translation).tolist(),
        "not_seen": list(report.not_seen),
    }


def features_of(recording: Recording, terms: Terms) -> Array:
    """Features (n, k) of the terms; raises CalibrationError where columns are missing."""
    names = recording.robot.joint_names
    check_columns(recording, [f"measured/{n}" for n in names], "tip's place takes")
    return terms.features.compute(recording, default_gap_limit([recording]))


def fit_terms(
    recording: Recording, seen: Sighted, terms: Terms, features: Array,
    known: Sequence[Calibration],
) -> TermsFit:  # fmt: skip
    """Fit terms and frame to what was seen, under the likeliest prior, errors estimated too.

    `features` (n, k) are the terms', of the recording. How bent and how wide the arm's errors are,
    and whether it is as others, what was seen says itself (empirical Bayes). Raises as `fit_tip`
    and `resting`, and CalibrationError for a prior that is none.
    """
    check_known(known, recording.robot)
    rows = _rows(recording, seen, terms, features)
    expected = wide_priors(terms)
    learned = learned_priors(terms, known, recording) if known else []
    priors = [seen.prior(rows, one.mean, one.sd) for one in [*learned, *expected]]
    first = fit_tip(rows, priors[len(learned)])
    best = int(np.argmax([likelihood(rows, one, first) for one in priors]))
    rows = with_estimated_errors(rows, priors[best])
    found = fit_tip(rows, priors[best], start=first.state)
    return TermsFit(found, rows, priors[best], best < len(learned))


def _rows(recording: Recording, seen: Sighted, terms: Terms, features: Array) -> TipRows:
    robot = recording.robot
    measured, basis = recording.columns("measured", robot.joint_names), terms.basis(features)
    rests = resting(recording, seen.rests)
    return TipRows(
        seen.kinematics,
        np.array([measured[rows].mean(axis=0) for rows in rests]),
        tuple(robot.index(terms.joints)),
        np.array([basis[rows].mean(axis=0) for rows in rests]),
        seen.point,
        np.full(len(rests), seen.sd),
        LEFT * terms.scale,
    )


def _check_spread(
    seen: Sighted, terms: Terms, features: Array, rests: list[slice], *, is_flat_fine: bool
) -> None:
    """Refuse touches in one plane, unless `is_flat_fine`, and those that come from one side."""
    source = seen.rests.source
    extent = np.linalg.svd(seen.point - seen.point.mean(axis=0), compute_uv=False)
    if extent[2] < _FLAT * extent[0] and not is_flat_fine:
        raise CalibrationError(
            f"{source}: all {seen.what} lie in one plane, which leaves slopes and a turn open; "
            "touch stairs (truejoint plate), or give a prior (--prior)"
        )
    each = terms.per_joint(np.array([features[own].mean(axis=0) for own in rests]))
    for joint, columns in zip(terms.joints, each, strict=True):
        rising = float((columns[:, -len(WIDTHS)] < 0.0).mean())
        if not _SIDED <= rising <= 1.0 - _SIDED:
            raise CalibrationError(
                f"{source}: {joint} comes from one side in {max(rising, 1 - rising):.0%} of the "
                f"{seen.what}, which hides what its cable loses; come from both"
            )


def _report(seen: Sighted, fit: TermsFit, terms: Terms, *, is_given: bool) -> TouchReport:
    found, rows = fit.found, fit.rows
    off = _left_out(fit)
    kept = ~found.left_out
    squares = (off[kept] ** 2).sum(axis=1)
    square = max(float(squares.mean()) - 3.0 * seen.sd**2, 0.0)
    error, spread = math.sqrt(square), float(squares.std(ddof=1)) / math.sqrt(len(squares))
    error_sd = spread / (2.0 * max(error, math.sqrt(spread)))
    tool = rows.kinematics.forward(rows.joint)
    tip = tool[:, :3, 3] + tool[:, :3, :3] @ found.state.marker
    turn, shift = align(tip[kept], rows.point[kept] * seen.scale)
    zero_sd = found.sd[terms.zeros] * terms.scale
    before = (tip - shift) @ turn - rows.point * seen.scale
    words = _unseen(seen, fit, terms, is_given=is_given)
    return TouchReport(seen.rests, found, error, error_sd, zero_sd, words, rows.point, before, off)


def _left_out(fit: TermsFit) -> Array:
    """Tell how far off each touch is (m, 3) [m] by a fit without it and a few others."""
    rows, fold = fit.rows, np.zeros(len(fit.rows), dtype=np.int64)
    kept = ~fit.found.left_out
    fold[kept] = np.arange(kept.sum()) % _FOLDS
    fold[~kept] = _FOLDS
    off = fit.found.residual.copy()
    for number in range(_FOLDS):
        train = rows.rows(kept & (fold != number))
        other = fit_tip(train, fit.prior, gate=np.inf, start=fit.found.state)
        off[fold == number] = rows.residual(other.state)[fold == number]
    return off


def _unseen(seen: Sighted, fit: TermsFit, terms: Terms, *, is_given: bool) -> tuple[str, ...]:
    """Say in words what touches did not tell, and how far what they told badly may be off."""
    words, found = [], fit.found
    held = 1.0 / np.sqrt(np.diag(fit.prior.precision)[terms.zeros])
    sd = found.sd[terms.zeros]
    for joint, own, before, scale in zip(terms.joints, sd, held, terms.scale, strict=True):
        unit = "rad" if scale == SPREAD["rad"] else "m"
        within = with_unit(float(own * scale), unit)
        if own > _SEEN * before:
            words.append(f"zero of {joint}: not seen, assumed within {within}")
        elif own > 0.2:
            words.append(f"zero of {joint}: ± {within}")
    size = float(np.sqrt(((seen.point - seen.point.mean(axis=0)) ** 2).sum(axis=1).mean()))
    if seen.scale_sd * size > _WORTH:  # nobody has measured it
        size_sd, off = float(found.sd[-1]), found.state.scale / seen.scale - 1.0
        share = f"{100 * off:+.2f} % ± {100 * size_sd:.2f} %"
        if size_sd > _SIZED * seen.scale_sd:
            share = f"not seen, assumed within {100 * size_sd:.1f} %"
        words.append(
            f"size of the print: {share}, which is {with_unit(size_sd * size, 'm')} of the tip: "
            "measure it, and enter measured_mm"
        )
    if is_given and not fit.is_learned:
        words.append("the prior: the touches are likelier without it, so it was not used")
    return tuple(words)
