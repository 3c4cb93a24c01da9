"""Calibrate an arm by touched points alone: no joint sensor, and no earlier calibration."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from truejoint.array_types import Array
from truejoint.calibration.calibration import Calibration
from truejoint.calibration.fitting import calibrate
from truejoint.calibration.plate import TOUCH_SD, Plate
from truejoint.calibration.sessions import check_columns
from truejoint.calibration.tip_rows import TipFit, TipPrior, TipRows, TipState, align, fit_tip
from truejoint.calibration.touches import (
    Touches,
    check_count,
    known_kinematics,
    resting,
    with_estimated_errors,
)
from truejoint.errors import CalibrationError
from truejoint.estimators.polynomial import PolynomialRegressor
from truejoint.models.family import EstimatorData
from truejoint.models.features import FeatureSet, default_gap_limit
from truejoint.models.polynomial import polynomial_factors
from truejoint.recordings import Recording
from truejoint.robots import Robot
from truejoint.units import with_unit

FEWEST: Final = 12
WIDTHS: Final = (1e-3, 5e-3, 2e-2)
"""Half-widths of each joint's own plays, as shares of its workspace."""
SPREAD: Final = {"rad": np.deg2rad(1.0), "m": 1e-3}
"""Scale of what is expected of the terms, widely: see `_SPREADS`."""
_SPREADS: Final = {"zero": 5.0, "slope": 2.0, "square": 0.5, "play": 0.3}
_SHARES: Final = (1.0, 0.5, 0.25, 0.12, 0.06)
LEFT: Final = 0.03
"""What the terms leave of each joint, before the touches say more, as a share of `SPREAD`."""
_FOLDS: Final = 6
_FLAT: Final = 0.05  # of the touches' extent, below which they lie in a plane
_SIDED: Final = 0.15  # of the touches that come from either side of each joint
_SEEN: Final = 0.5  # of what was expected, above which a zero's deviation says that it was not seen


@dataclass(frozen=True, eq=False)
class TouchReport:
    """What a calibration by touch is worth, and what it did not see.

    Attributes
    ----------
    fit : TipFit
    left_out_error : float
        RMS distance [m] of the tip, in the block's frame, from points that a fit without them
        expects, less what touches err themselves: the honest error.
    zero_sd : ndarray, shape (n_joints,)
        Standard deviation of each joint's zero amid the workspace [rad or m].
    not_seen : tuple of str
        In words, what only the prior holds.

    Examples
    --------
    >>> TouchReport.__dataclass_fields__["zero_sd"].type
    'Array'
    """

    fit: TipFit
    left_out_error: float
    zero_sd: Array
    not_seen: tuple[str, ...]


def calibrate_by_touch(
    recording: Recording, touches: Touches, plate: Plate, *, touch_sd: float = TOUCH_SD
) -> tuple[Calibration, TouchReport]:
    """Fit joints and a block's pose together to touches of its dimples.

    Of each positioning joint a constant, slopes and squares of all of them, and plays of its own:
    with three joints 39 numbers. It makes the tip right in the block's frame; joints only as far as
    `TouchReport.not_seen` leaves them.

    Parameters
    ----------
    recording : Recording
        Continuous, from before the first touch on: plays need to know where a joint came from.
    touches : Touches
    plate : Plate
    touch_sd : float
        How far off its dimple a tip rests, per axis [m].

    Returns
    -------
    calibration : Calibration
        An ordinary one, of a polynomial of degree 2, without an interval; its metadata have
        ``truth`` ``"touch"`` and what `TouchReport` says.
    report : TouchReport

    Raises
    ------
    CalibrationError
        If kinematics or workspace are not known, touches are fewer than twelve, lie in a plane,
        come from one side, or do not fit.

    Examples
    --------
    >>> calibrate_by_touch(test, Touches((1.0,), ("1",)), None)
    Traceback (most recent call last):
    truejoint.errors.CalibrationError: ...
    """
    robot = recording.robot
    check_count(touches, FEWEST, "calibrate")
    known_kinematics(robot)
    if robot.workspace is None:
        raise CalibrationError(f"no workspace of {robot.title} is known; state it in its file")
    terms = Terms.of(robot)
    check_columns(recording, [f"measured/{n}" for n in robot.joint_names], "tip's place takes")
    features = terms.features.compute(recording, default_gap_limit([recording]))
    rows = _rows(robot, terms, features, recording, touches, plate, touch_sd)
    _check_spread(rows, terms, features, resting(recording, touches), touches)
    # How bent and how wide the arm's errors are, the touches themselves say (empirical Bayes).
    priors = [_prior(rows, terms, plate, share) for share in _SHARES]
    kept = ~fit_tip(rows, priors[0]).left_out
    likely = [fit_tip(rows.rows(kept), one, gate=np.inf).evidence for one in priors]
    prior = priors[int(np.argmax(likely))]
    rows = with_estimated_errors(rows, prior)
    found = fit_tip(rows, prior)
    report = _report(rows, prior, found, terms, touch_sd)
    correction = terms.basis(features) @ found.state.coefficients
    names = {f"truth/{joint}": correction[:, k] for k, joint in enumerate(terms.joints)}
    stated = {
        name: recording.column(name.replace("truth", "measured")) + added
        for name, added in names.items()
    }
    table = {"t": recording.t, **{c: recording.column(c) for c in recording.units}, **stated}
    whole = Recording.from_columns(table, recording.provenance, recording.units)
    square = PolynomialRegressor(degree=2)
    fitted = calibrate([whole], square, features=terms.features, joints=terms.joints, redundant=[])
    arrays = terms.arrays(found.state.coefficients)
    data = EstimatorData("polynomial", {"degree": 2}, arrays)
    model = PolynomialRegressor.from_data(data, len(terms.features), len(terms.joints))
    baseline = fitted.effort_baseline
    if baseline is not None:
        baseline = replace(baseline, residual=np.hypot(rows.joint_sd, report.zero_sd))
    facts: dict[str, Any] = {
        "truth": "touch",
        "touch": {
            "touches": len(touches),
            "left_out": [touches.dimple[i] for i in np.flatnonzero(found.left_out)],
            "left_out_error": report.left_out_error,
            "zero_sd": report.zero_sd.tolist(),
            "joint_sd": rows.joint_sd.tolist(),
            "scale": found.state.scale,
            "rotation": found.state.rotation.tolist(),
            "translation": found.state.translation.tolist(),
            "not_seen": list(report.not_seen),
        },
    }
    own = replace(fitted, model=model, effort_baseline=baseline)
    return own.with_metadata(**facts), report


@dataclass(frozen=True, eq=False)
class Terms:
    """Terms of the correction of each joint, and the features that they are made of."""

    joints: tuple[str, ...]
    centre: Array  # (n_joints,) of the workspace [rad or m]
    half: Array
    scale: Array  # (n_joints,), `SPREAD` of each [rad or m]
    features: FeatureSet

    @classmethod
    def of(cls, robot: Robot) -> Terms:
        """Terms for the joints of a robot's workspace, which is known."""
        space = robot.workspace
        assert space is not None  # noqa: S101  # looked for before
        names = [f"measured/{joint}" for joint in space.joints]
        names += [
            f"play(measured/{joint}, {float(width * extent)!r})"
            for joint, extent in zip(space.joints, space.extent, strict=True)
            for width in WIDTHS
        ]
        scale = np.array([SPREAD[robot.joint(joint).unit] for joint in space.joints])
        half = space.extent / 2
        return cls(space.joints, space.centre, half, scale, FeatureSet.parse(names))

    def per_joint(self, features: Array) -> list[Array]:
        """Columns (m, n_terms) of each joint, of features (m, k), all of about size 1."""
        n = len(self.joints)
        z = (features[:, :n] - self.centre) / self.half
        plays = features[:, n:].reshape(len(z), n, len(WIDTHS)) - features[:, :n, None]
        plays /= (2 * self.half[:, None]) * WIDTHS
        pairs = [z[:, i] * z[:, j] for i in range(n) for j in range(i, n)]
        shared = np.column_stack([np.ones(len(z)), z, *pairs])
        return [np.column_stack([shared, plays[:, k]]) for k in range(n)]

    def basis(self, features: Array) -> Array:
        """Correction per coefficient (m, n_joints, k) [rad or m]."""
        columns = self.per_joint(features)
        each, n = columns[0].shape[1], len(columns)
        basis = np.zeros((len(features), n, n * each))
        for k, own in enumerate(columns):
            basis[:, k, k * each : (k + 1) * each] = own * self.scale[k]
        return basis

    def spread(self, share: float = 1.0) -> Array:
        """Give the standard deviations (k,) that coefficients are expected to have.

        Squares and plays have a `share` of theirs.
        """
        n = len(self.joints)
        counts = {"zero": 1, "slope": n, "square": n * (n + 1) // 2, "play": len(WIDTHS)}
        shares = {"square": share, "play": share}
        own = [_SPREADS[kind] * shares.get(kind, 1.0) for kind in counts]
        return np.tile(np.repeat(own, list(counts.values())), n)

    def zeros(self) -> list[int]:
        """Places of the joints' constants among the coefficients."""
        each = len(self.spread()) // len(self.joints)
        return [k * each for k in range(len(self.joints))]

    def arrays(self, coefficients: Array) -> dict[str, Array]:
        """Arrays of a polynomial of degree 2 in the features, of the coefficients (k,)."""
        n, widths = len(self.joints), len(WIDTHS)
        k = len(self.features)
        factors = polynomial_factors(k, 2).tolist()
        place = {tuple(factor): i for i, factor in enumerate(factors)}
        coef, intercept = np.zeros((len(factors), n)), np.zeros(n)
        half = np.concatenate([self.half, np.repeat(self.half, widths)])
        centre = np.concatenate([self.centre, np.repeat(self.centre, widths)])
        pairs = [(i, j) for i in range(n) for j in range(i, n)]
        for joint, own in enumerate(coefficients.reshape(n, -1) * self.scale[:, None]):
            intercept[joint] = own[0]
            for i in range(n):
                coef[place[i, k], joint] += own[1 + i]
            for value, (i, j) in zip(own[1 + n :], pairs, strict=False):
                coef[place[i, j], joint] = value
            for w, value in enumerate(own[1 + n + len(pairs) :]):
                per = value / (2 * WIDTHS[w])  # (p - q) / w, both scaled by half the workspace
                coef[place[n + joint * widths + w, k], joint] += per
                coef[place[joint, k], joint] -= per
        return {"mean": centre, "inverse_scale": 1.0 / half, "coef": coef, "intercept": intercept}


def _rows(
    robot: Robot, terms: Terms, features: Array, recording: Recording, touches: Touches,
    plate: Plate, touch_sd: float,
) -> TipRows:  # fmt: skip
    measured = recording.columns("measured", robot.joint_names)
    basis = terms.basis(features)
    rests = resting(recording, touches)
    return TipRows(
        known_kinematics(robot),
        np.array([measured[rows].mean(axis=0) for rows in rests]),
        tuple(robot.index(terms.joints)),
        np.array([basis[rows].mean(axis=0) for rows in rests]),
        plate.at(touches.dimple),
        np.full(len(rests), touch_sd),
        LEFT * terms.scale,
    )


def _prior(rows: TipRows, terms: Terms, plate: Plate, share: float) -> TipPrior:
    """Prior of the terms, squares and plays with a `share` of what they may be at most."""
    tip = rows.kinematics.forward(rows.joint)[:, :3, 3]
    rotation, translation = align(tip, rows.point * plate.scale)
    spread = terms.spread(share)
    start = TipState(np.zeros(len(spread)), rotation, translation, scale=plate.scale)
    return TipPrior.of(start, [*spread, *[np.inf] * 6, 0.0, 0.0, 0.0, plate.scale_sd])


def _check_spread(
    rows: TipRows, terms: Terms, features: Array, rests: list[slice], touches: Touches
) -> None:
    """Refuse touches in one plane, and those that come from one side."""
    extent = np.linalg.svd(rows.point - rows.point.mean(axis=0), compute_uv=False)
    if extent[2] < _FLAT * extent[0]:
        raise CalibrationError(
            f"{touches.source}: all touches lie in one plane, which leaves slopes and a turn open; "
            "touch stairs (truejoint plate)"
        )
    each = terms.per_joint(np.array([features[own].mean(axis=0) for own in rests]))
    for joint, columns in zip(terms.joints, each, strict=True):
        rising = float((columns[:, -len(WIDTHS)] < 0.0).mean())
        if not _SIDED <= rising <= 1.0 - _SIDED:
            raise CalibrationError(
                f"{touches.source}: {joint} comes from one side in {max(rising, 1 - rising):.0%} "
                "of the touches, which hides what its cable loses; come from both"
            )


def _report(
    rows: TipRows, prior: TipPrior, found: TipFit, terms: Terms, touch_sd: float
) -> TouchReport:
    kept = np.flatnonzero(~found.left_out)
    fold = np.arange(len(kept)) % _FOLDS
    squares = []
    for number in range(_FOLDS):
        train = np.zeros(len(rows), dtype=np.bool_)
        train[kept[fold != number]] = True
        other = fit_tip(rows.rows(train), prior, gate=np.inf)
        off = rows.residual(other.state)[kept[fold == number]]
        squares += (off**2).sum(axis=1).tolist()
    error = math.sqrt(max(float(np.mean(squares)) - 3.0 * touch_sd**2, 0.0))
    zeros, spread = terms.zeros(), terms.spread()
    zero_sd = found.sd[zeros] * terms.scale
    words = []
    for k, joint in enumerate(terms.joints):
        unit = "rad" if terms.scale[k] == SPREAD["rad"] else "m"
        share = found.sd[zeros[k]] / spread[zeros[k]]
        if share > _SEEN:
            words.append(f"zero of {joint}: not seen, assumed within {with_unit(zero_sd[k], unit)}")
        elif zero_sd[k] > 0.2 * SPREAD[unit]:
            words.append(f"zero of {joint}: +- {with_unit(zero_sd[k], unit)}")
    return TouchReport(found, error, zero_sd, tuple(words))
