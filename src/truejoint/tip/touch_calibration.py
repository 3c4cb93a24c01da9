"""Calibrate an arm by touched points alone: no joint sensor, and no earlier calibration."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from truejoint.array_types import Array
from truejoint.calibration.calibration import Calibration
from truejoint.calibration.compatibility import check_columns
from truejoint.calibration.fit import calibrate
from truejoint.errors import CalibrationError
from truejoint.estimators.family import EstimatorData
from truejoint.estimators.polynomial.learn import Polynomial
from truejoint.estimators.polynomial.run import of_degree
from truejoint.features.feature_set import default_gap_limit
from truejoint.recordings import Recording
from truejoint.tip.block import TOUCH_SD, Block
from truejoint.tip.fit import SCALE, TipFit, TipPrior, TipRows, TipState, align, fit_rows
from truejoint.tip.terms import (
    LEFT,
    SPREAD,
    Terms,
    check_priors,
    learned_priors,
    wide_priors,
)
from truejoint.tip.touch import (
    Touches,
    at_rest,
    check_count,
    likelihood,
    with_estimated_errors,
)
from truejoint.units import with_unit

_CALIBRATING: Final = 12  # touches of an unknown arm; half as many with a prior
_FOLDS: Final = 6
_FLAT: Final = 0.05  # of the touches' extent, below which they lie in a plane
_SIDED: Final = 0.15  # of the touches that come from either side of each joint
_SEEN: Final = 0.5  # of the prior deviation, above which a zero was not seen
_SIZED: Final = 0.8  # the same of the size of a print
_WORTH: Final = 5e-5  # effect of an unmeasured print's size on the tip that is reported [m]
_UNSURE: Final = 0.2  # deviation of a zero that is reported, in `SPREAD`


def fewest_touches(priors: Sequence[Calibration]) -> int:
    """Different touches that it takes at least to calibrate an arm with such priors."""
    return _CALIBRATING // 2 if priors else _CALIBRATING


@dataclass(frozen=True, eq=False)
class TouchReport:
    """Accuracy of a calibration by touch, and what the touches did not show.

    Attributes
    ----------
    touches : Touches
    fit : TipFit
    left_out_error : float
        RMS distance [m] of the tip, in the block's frame, from points that a fit without them
        expects, less the touches' own noise: the cross-validated error.
    left_out_sd : float
        Standard deviation of that [m].
    zero_sd : ndarray, shape (n_joints,)
        Standard deviation of each joint's zero amid the workspace [rad or m].
    not_seen : tuple of str
        In words, what only the prior holds.
    point, before, left_out : ndarray, shape (m, 3)
        Of each touch its point in the block; the error of the tip by the measured positions, with
        the block laid over them as well as it can be; and the error by a fit without this touch
        [m].

    Examples
    --------
    >>> TouchReport.__dataclass_fields__["zero_sd"].type
    'Array'
    """

    touches: Touches
    fit: TipFit
    left_out_error: float
    left_out_sd: float
    zero_sd: Array
    not_seen: tuple[str, ...]
    point: Array
    before: Array
    left_out: Array


class TermsFit(NamedTuple):
    """Joints and frame that fit what was touched or shot."""

    fit: TipFit
    rows: TipRows
    """With what the terms leave of the joints."""
    prior: TipPrior
    """The likeliest."""
    is_learned: bool
    """Whether the prior is of other calibrations."""


def calibrate_by_touch(
    recording: Recording,
    touches: Touches,
    block: Block,
    *,
    touch_sd: float = TOUCH_SD,
    priors: Sequence[Calibration] = (),
) -> tuple[Calibration, TouchReport]:
    """Fit joints and a block's pose together to touches of its dimples.

    Of each positioning joint a constant, slopes and squares of all of them, and plays of its own:
    with three joints 39 numbers. The tip is then right in the block's frame, and joints as far as
    `TouchReport.not_seen` leaves them. The prior of the terms is the one under which the touches
    are likeliest, among wide ones and those that other calibrations give.

    Parameters
    ----------
    recording : Recording
        Continuous, from before the first touch on: plays need to know where a joint came from.
    touches : Touches
    block : Block
    touch_sd : float
        Standard deviation of a tip from its dimple, per axis [m].
    priors : sequence of Calibration
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
    check_count(touches, fewest_touches(priors), "calibrate")
    terms = Terms.of_workspace(recording.robot)
    features = features_of(recording, terms)
    _check_spread(recording, touches, block, terms, features, is_flat_fine=bool(priors))
    terms_fit = fit_terms(recording, touches, block, terms, features, priors, touch_sd)
    report = _report(touches, block, terms_fit, terms, has_priors=bool(priors))
    state = terms_fit.fit.state
    correction = terms.basis(*terms.columns(features)) @ state.coefficients
    table = {"t": recording.t} | {c: recording.column(c) for c in recording.units}
    for k, joint in enumerate(terms.joints):
        table[f"truth/{joint}"] = recording.column(f"measured/{joint}") + correction[:, k]
    whole = Recording.from_columns(
        table, recording.provenance, recording.units, robot=recording.robot
    )
    # Domain, units and baselines are fitted; the touches alone give the model.
    fitted = calibrate(
        [whole], "linear", features=terms.features, joints=terms.joints, redundant=[]
    )
    data = EstimatorData("polynomial", of_degree(2), terms.arrays(state.coefficients))
    model = Polynomial.from_data(data, len(terms.features), len(terms.joints))
    if (baseline := fitted.effort_baseline) is not None:
        residual = np.hypot(terms_fit.rows.corrected_sd, report.zero_sd)
        baseline = replace(baseline, residual=residual)
    calibration = replace(
        fitted,
        fitted=data,
        learnt=None,
        effort_baseline=baseline,
        origin=replace(fitted.origin, estimator=model.name),
    ).with_metadata(
        settings=" ".join(repr(model).split()),
        truth="touch",
        touch={
            "touches": len(touches),
            "prior": [prior.title for prior in priors] if terms_fit.is_learned else [],
            "left_out": [touches.dimple[i] for i in np.flatnonzero(terms_fit.fit.left_out)],
            "left_out_error": report.left_out_error,
            "left_out_sd": report.left_out_sd,
            "zero_sd": report.zero_sd.tolist(),
            "joint_sd": terms_fit.rows.corrected_sd.tolist(),
            "scale": state.scale,
            "rotation": state.rotation.tolist(),
            "translation": state.translation.tolist(),
            "not_seen": list(report.not_seen),
        },
    )
    return calibration, report


def features_of(recording: Recording, terms: Terms) -> Array:
    """Features (n, k) of the terms; raises CalibrationError where columns are missing."""
    names = recording.robot.joint_names
    check_columns(recording, [f"measured/{n}" for n in names], "tip's place takes")
    return terms.features.compute(recording, default_gap_limit([recording]))


def fit_terms(
    recording: Recording,
    touches: Touches,
    block: Block,
    terms: Terms,
    features: Array,
    priors: Sequence[Calibration],
    touch_sd: float = TOUCH_SD,
) -> TermsFit:
    """Fit terms and a block's pose to touches, under the likeliest prior.

    `features` (n, k) are the terms', of the recording. The points themselves choose the prior and
    the errors that joints keep (empirical Bayes). Raises as `fit_rows` and `resting`, and
    CalibrationError for a prior of another robot or arm.
    """
    robot = recording.robot
    check_priors(priors, robot)
    measured = recording.columns("measured", robot.joint_names)
    rows = TipRows.of(
        robot, at_rest(recording, touches, measured), terms.joints,
        at_rest(recording, touches, terms.basis(*terms.columns(features))),
        block.at(touches.dimple), touch_sd, LEFT * terms.scale,
    )  # fmt: skip
    learned = learned_priors(terms, priors, recording) if priors else []
    candidates = [terms_prior(rows, block, *each) for each in [*learned, *wide_priors(terms)]]
    first = fit_rows(rows, candidates[len(learned)])
    best = int(np.argmax([likelihood(rows, prior, first) for prior in candidates]))
    rows = with_estimated_errors(rows, candidates[best])
    fit = fit_rows(rows, candidates[best], start=first.state)
    return TermsFit(fit, rows, candidates[best], best < len(learned))


def terms_prior(rows: TipRows, block: Block, mean: Array, sd: Array) -> TipPrior:
    """Prior of coefficients, `mean` and `sd` (k,), and of a block that may stand anywhere.

    The fit starts where the tool, as it is measured, meets the points. Raises CalibrationError if
    they lie in a line.
    """
    tip = rows.kinematics.forward(rows.joint)[:, :3, 3]
    start = TipState(mean, *align(tip, rows.point * block.scale), scale=block.scale)
    return TipPrior.of(start, sd, scale=block.scale_sd)


def _check_spread(
    recording: Recording,
    touches: Touches,
    block: Block,
    terms: Terms,
    features: Array,
    *,
    is_flat_fine: bool,
) -> None:
    """Refuse touches in one plane, unless `is_flat_fine`, and those that come from one side."""
    source, point = touches.source, block.at(touches.dimple)
    plays = terms.columns(at_rest(recording, touches, features))[1]
    extent = np.linalg.svd(point - point.mean(axis=0), compute_uv=False)
    if extent[2] < _FLAT * extent[0] and not is_flat_fine:
        raise CalibrationError(
            f"{source}: all touches lie in one plane, which leaves slopes and a turn open; "
            "touch stairs (truejoint touch block), or give a prior (--prior)"
        )
    for joint, rising in zip(terms.joints, (plays < 0.0).mean(axis=(0, 2)), strict=True):
        if not _SIDED <= rising <= 1.0 - _SIDED:
            raise CalibrationError(
                f"{source}: {joint} comes from one side in {max(rising, 1 - rising):.0%} of the "
                "touches, which hides what its cable loses; come from both"
            )


def _report(
    touches: Touches, block: Block, terms_fit: TermsFit, terms: Terms, *, has_priors: bool
) -> TouchReport:
    fit, rows = terms_fit.fit, terms_fit.rows
    off, inlier = _held_out_errors(terms_fit), ~fit.left_out
    squares = (off[inlier] ** 2).sum(axis=1)
    error = math.sqrt(max(float(squares.mean()) - 3.0 * rows.point_sd**2, 0.0))
    spread = float(squares.std(ddof=1)) / math.sqrt(len(squares))
    error_sd = spread / (2.0 * max(error, math.sqrt(spread)))
    uncorrected = replace(fit.state, coefficients=np.zeros(len(fit.state.coefficients)))
    tip = rows.tool_points(uncorrected)[1]
    turn, shift = align(tip[inlier], rows.point[inlier] * block.scale)
    zero_sd = fit.sd[terms.zeros] * terms.scale
    before = (tip - shift) @ turn - rows.point * block.scale
    not_seen = _unseen(block, terms_fit, terms, has_priors=has_priors)
    return TouchReport(touches, fit, error, error_sd, zero_sd, not_seen, rows.point, before, off)


def _held_out_errors(terms_fit: TermsFit) -> Array:
    """Error of each touch (m, 3) [m] by a fit without it and a few others."""
    fit, rows, prior, _ = terms_fit
    inlier = ~fit.left_out
    fold = np.full(len(rows), _FOLDS)
    fold[inlier] = np.arange(inlier.sum()) % _FOLDS
    errors = fit.residual.copy()
    for number in range(_FOLDS):
        train = rows.rows(inlier & (fold != number))
        other = fit_rows(train, prior, gate=np.inf, start=fit.state)
        errors[fold == number] = rows.residual(other.state)[fold == number]
    return errors


def _unseen(
    block: Block, terms_fit: TermsFit, terms: Terms, *, has_priors: bool
) -> tuple[str, ...]:
    """Say in words what the touches did not show, and how far off it may be."""
    words, fit = [], terms_fit.fit
    prior_sd = 1.0 / np.sqrt(np.diag(terms_fit.prior.precision)[terms.zeros])
    rows = zip(terms.joints, fit.sd[terms.zeros], prior_sd, terms.scale, strict=True)
    for joint, sd, before, scale in rows:
        within = with_unit(float(sd * scale), "rad" if scale == SPREAD["rad"] else "m")
        if sd > _SEEN * before:
            words.append(f"zero of {joint}: not seen, assumed within {within}")
        elif sd > _UNSURE:
            words.append(f"zero of {joint}: ± {within}")
    point = terms_fit.rows.point
    size = float(np.sqrt(((point - point.mean(axis=0)) ** 2).sum(axis=1).mean()))
    if block.scale_sd * size > _WORTH:  # nobody has measured it
        size_sd = float(fit.sd[fit.state.names.index(SCALE)])
        share = f"{100 * (fit.state.scale / block.scale - 1.0):+.2f} % ± {100 * size_sd:.2f} %"
        if size_sd > _SIZED * block.scale_sd:
            share = f"not seen, assumed within {100 * size_sd:.1f} %"
        words.append(
            f"size of the print: {share}, which is {with_unit(size_sd * size, 'm')} of the tip: "
            "measure it, and enter measured_mm"
        )
    if has_priors and not terms_fit.is_learned:
        words.append("the prior: the touches are likelier without it, so it was not used")
    return tuple(words)
