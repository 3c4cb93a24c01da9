"""How far off a tip is that was fitted to points: what points err, what joints keep, and where."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import Final, NamedTuple

import numpy as np
from scipy.spatial import Delaunay, QhullError

from truejoint.array_types import Array, Integers
from truejoint.robots import Robot
from truejoint.tip.fit import (
    SCALE,
    Equations,
    TipFit,
    TipPrior,
    TipRows,
    Whitened,
    fit_rows,
    normal_equations,
)
from truejoint.tip.terms import Terms

_POINT: Final = np.geomspace(0.25, 4.0, 9)
"""What a point may err, as multiples of what it was fitted with."""
_JOINT: Final = np.array([0.0, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0])
"""What joints may keep, as multiples of what is expected."""
_DOUBT: Final = math.log(2.0)
"""Deviation of the logarithm of a noise that a person states."""
_SAME: Final = 3e-3
"""Tips that rest nearer to each other than this, from the same sides, rest at one place [m]."""
_LEAST: Final = 7.0  # of a split's likelihood below the best
_ANYWHERE: Final = 0.02  # m, how widely outliers lie
_PLACES: Final = 200  # at which the error over a workspace is worked out


class Split(NamedTuple):
    """One way in which residuals are made up of points that err and joints that are off."""

    point_sd: float  # per axis [m]
    joint_sd: Array  # (n_joints,), [rad or m]
    likelihood: float  # Its logarithm, restricted, of all points
    covariance: Array  # (n, n), of the parameters


class TipError(NamedTuple):
    """How far off the tip is, as root mean square over places, and the deviation of that [m]."""

    rms: float
    sd: float


def repeated(rows: TipRows, plays: Array) -> Integers:
    """Give each row's place a number (m,); repeats of one place, from the same sides, share one.

    `plays` (m, n_joints, n_widths) are as of `Terms.columns`.
    """
    tip = rows.kinematics.forward(rows.joint)[:, :3, 3]
    sides = np.sign(plays).reshape(len(tip), -1)
    is_near = np.linalg.norm(tip[:, None] - tip, axis=2) < _SAME
    first: Integers = np.argmax(is_near & (sides[:, None] == sides).all(axis=2), axis=1)
    return first


def repeat_noise(fit: TipFit, place: Integers) -> tuple[float, int]:
    """Mean square per axis of how repeats differ [m^2], and its degrees of freedom."""
    total, freedom = 0.0, 0
    for number in np.unique(place):
        off = fit.residual[(place == number) & ~fit.left_out]
        total += float(((off - off.mean(axis=0)) ** 2).sum()) if len(off) else 0.0
        freedom += 3 * max(len(off) - 1, 0)
    return total / max(freedom, 1), freedom


def split_residuals(
    fit: TipFit, stated: TipRows, place: Integers, least: float = 0.0
) -> list[Split]:
    """Ways in which the residuals of a fit may be split, the likeliest first.

    By the restricted likelihood of the inliers, and of repeats about their means; an outlier may be
    anywhere. The noise `stated` by the rows before the fit is doubted by a factor of two, and
    joints are expected to keep (Cauchy) no more than stated, and no less than a share of it.
    """
    equations = fit.rows.rows(~fit.left_out).equations(fit.state)
    square, freedom = repeat_noise(fit, place)
    known = -3.0 * math.log(_ANYWHERE) * int(fit.left_out.sum())
    splits = []
    for factor, share in product(_POINT, _JOINT[least <= _JOINT]):
        point_sd, joint_sd = float(factor * fit.rows.point_sd), share * stated.joint_sd
        likelihood, covariance = _restricted(equations, fit, fit.prior, point_sd, joint_sd)
        repeats = freedom * (math.log(point_sd) + 0.5 * square / point_sd**2)
        doubt = 0.5 * (math.log(point_sd / stated.point_sd) / _DOUBT) ** 2 + math.log1p(share**2)
        splits.append(Split(point_sd, joint_sd, likelihood + known - repeats - doubt, covariance))
    splits.sort(key=lambda split: -split.likelihood)
    return [split for split in splits if split.likelihood > splits[0].likelihood - _LEAST]


def likeliest(fit: TipFit, priors: Sequence[TipPrior]) -> int:
    """Place of the prior under which the inliers of a fit are likeliest."""
    rows = fit.rows.rows(~fit.left_out)
    equations = rows.equations(fit.state)
    found = [_restricted(equations, fit, p, rows.point_sd, rows.joint_sd)[0] for p in priors]
    return int(np.argmax(found))


def _restricted(
    equations: Equations, fit: TipFit, prior: TipPrior, point_sd: float, joint_sd: Array
) -> tuple[float, Array]:
    """Logarithm of the restricted likelihood of equations that are linear about a fit.

    And the covariance (n, n) of the parameters.
    """
    free = np.flatnonzero(prior.free)
    block = np.ix_(free, free)
    whitening = equations.whitening(joint_sd, np.array(point_sd))
    white = Whitened.of(equations, whitening, np.ones(len(whitening)))
    normal, gradient = normal_equations(prior, fit.state, white)
    step = -np.linalg.solve(normal[block], gradient[free])
    left = white.residual + white.jacobian[:, :, free] @ step
    moved = fit.state.minus(prior.state)[free] + step
    misfit = float((left**2).sum() + moved @ prior.precision[block] @ moved)
    sure = np.flatnonzero(np.diag(prior.precision))
    size = float(np.log(np.linalg.det(whitening)).sum())
    size += 0.5 * float(np.linalg.slogdet(prior.precision[np.ix_(sure, sure)])[1])
    size -= 0.5 * float(np.linalg.slogdet(normal[block])[1])
    covariance = np.zeros_like(normal)
    covariance[block] = np.linalg.inv(normal[block])
    return size - 0.5 * misfit, covariance


def shares(splits: Sequence[Split]) -> Array:
    """Probabilities (k,) of splits."""
    likely = np.exp([split.likelihood - splits[0].likelihood for split in splits])
    return np.asarray(likely / likely.sum())


def refitted(fit: TipFit, stated: TipRows, splits: Sequence[Split]) -> TipFit:
    """Fit anew with the deviations of points and joints that are expected of all splits."""
    point_sd, joint_sd = (
        np.sqrt(np.average(np.square(values), axis=0, weights=shares(splits)))
        for values in ([s.point_sd for s in splits], [s.joint_sd for s in splits])
    )
    rows = replace(stated, point_sd=float(point_sd), joint_sd=joint_sd)
    return fit_rows(rows, fit.prior, start=fit.state)


def places(fit: TipFit, terms: Terms, joint: Array, seed: int = 0) -> TipRows:
    """Rows of other places with the joints there (m, n_joints) [rad or m], come to at random."""
    side = np.random.default_rng(seed).choice([-1.0, 1.0], (len(joint), len(terms.joints), 1))
    shared = terms.normalised(joint[:, list(fit.rows.columns)])
    basis = terms.basis(shared, side * np.ones(terms.widths.shape))
    return replace(fit.rows, joint=joint, basis=basis, point=np.zeros((len(joint), 3)))


def tip_error(fit: TipFit, splits: Sequence[Split], rows: TipRows) -> TipError:
    """Error of the tip in the frame at rows, by what the fit leaves open and what joints keep.

    It is no less than the fit's residual over the root of its number.
    """
    equations = rows.equations(fit.state)
    jacobian = equations.by_parameter.copy()
    jacobian[:, :, fit.state.names.index(SCALE)] = 0.0
    share = shares(splits)
    squares = np.array(
        [
            np.einsum("mia,ab,mib->", jacobian, split.covariance, jacobian)
            + np.sum((equations.by_joint * split.joint_sd) ** 2)
            for split in splits
        ]
    ) / len(rows)
    middle = float(np.average(np.log(squares), weights=share))
    spread = float(np.average((np.log(squares) - middle) ** 2, weights=share))
    kept = fit.residual[~fit.left_out]
    least = float((kept**2).sum(axis=1).mean()) / len(kept)
    # The mean square itself is known no better than the points are many.
    freedom = max(fit.freedom, 1)
    rms = math.sqrt(max(math.exp(middle), least))
    return TipError(rms, rms * math.sqrt(0.25 * spread + 0.5 / freedom))


def over_workspace(fit: TipFit, robot: Robot) -> tuple[Array, float]:
    """Joints (m, n_joints) all over a workspace, and what share of it lies amid the points."""
    space, columns = robot.workspace, list(fit.rows.columns)
    assert space is not None  # noqa: S101  # terms are over it
    joint = np.tile(robot.home, (_PLACES, 1))
    size = _PLACES, len(columns)
    joint[:, columns] = np.random.default_rng(0).uniform(space.lower, space.upper, size)
    try:
        hull = Delaunay(fit.rows.joint[~fit.left_out][:, columns])
    except QhullError:  # they lie in a plane
        return joint, 0.0
    return joint, float((hull.find_simplex(joint[:, columns]) >= 0).mean())
