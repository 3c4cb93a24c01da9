"""How far off a tip is that was fitted to points, and what may be wrong with the points.

Residuals are split into what points err and what joints keep. Mirrored, scaled, wrongly numbered or
moved points are each tried by a fit of their own, and named where the points are far likelier so;
so is a marker that is off the tip, whose place is then fitted.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import product
from typing import Final, NamedTuple

import numpy as np
from scipy.spatial import Delaunay, QhullError

from truejoint.array_types import Array, Integers, Mask
from truejoint.errors import CalibrationError
from truejoint.robots import Robot
from truejoint.tip.block import Block
from truejoint.tip.fit import (
    GATE,
    MARKER,
    NORM_MEDIAN,
    SCALE,
    Equations,
    TipFit,
    TipPrior,
    TipRows,
    fit_rows,
    whiten_rows,
)
from truejoint.tip.terms import Terms
from truejoint.units import with_unit

# What a point may err, and joints may keep, as multiples of what was fitted with or is expected.
_POINT: Final = np.geomspace(0.25, 4.0, 9)
_JOINT: Final = np.array([0.0, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0])
_DOUBT: Final = math.log(2.0)  # deviation of the logarithm of a noise that a person states
_SAME: Final = 3e-3  # m; tips that rest nearer to each other, from the same sides, are at one place
_LEAST: Final = 7.0  # of a split's likelihood below the best
_ANYWHERE: Final = 0.02  # m, how widely outliers lie
_PLACES: Final = 200  # at which the error over a workspace is worked out
_PROOF: Final = 9.0  # by which the likelihood's logarithm grows where a fault is named
_HINT: Final = 2.0  # the same where it is said; of a hundred good sets two say so
_SCALE_SD: Final = 0.03
_MARKER_SD: Final = 0.02  # m
_MEANT: Final = 0.5  # rad by which a block may be turned from how it is meant to stand
_MOVE_COST: Final = 6.0  # of a time among many, and of a way in any direction
_NEAREST: Final = 3  # numberings that are fitted
EDGE: Final = 6  # points at least before and after a move


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
    for number in np.unique(place[~fit.left_out]):
        off = fit.residual[(place == number) & ~fit.left_out]
        total += float(((off - off.mean(axis=0)) ** 2).sum())
        freedom += 3 * (len(off) - 1)
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
    ways = list(product(fit.rows.point_sd * _POINT, _JOINT[least <= _JOINT]))
    sds = [(float(point_sd), share * stated.joint_sd) for point_sd, share in ways]
    found = restricted(equations, fit, fit.prior, sds)
    likely = []
    for (point_sd, share), (likelihood, normal) in zip(ways, found, strict=True):
        repeats = freedom * (math.log(point_sd) + 0.5 * square / point_sd**2)
        doubt = 0.5 * (math.log(point_sd / stated.point_sd) / _DOUBT) ** 2 + math.log1p(share**2)
        likely.append((likelihood + known - repeats - doubt, normal))
    best, block = max(value for value, _ in likely), np.ix_(fit.prior.free, fit.prior.free)
    splits = []
    for pair, (value, normal) in zip(sds, likely, strict=True):
        if value > best - _LEAST:
            covariance = np.zeros_like(fit.prior.precision)
            covariance[block] = np.linalg.inv(normal)
            splits.append(Split(*pair, value, covariance))
    return sorted(splits, key=lambda split: -split.likelihood)


def likeliest(fit: TipFit, priors: Sequence[TipPrior]) -> int:
    """Place of the prior under which the inliers of a fit are likeliest."""
    equations = fit.rows.rows(~fit.left_out).equations(fit.state)
    sds = [(fit.rows.point_sd, fit.rows.joint_sd)]
    found = (likelihood for p in priors for likelihood, _ in restricted(equations, fit, p, sds))
    return int(np.argmax(list(found)))


def heavy_tailed(fit: TipFit, prior: TipPrior, kinds: Sequence[str]) -> TipPrior:
    """Weigh a normal prior so that it acts as a Cauchy prior of each term but zeros, about a fit.

    Few terms are far larger than most, which a normal prior draws towards 0. A step of expectation
    and maximisation (Lange, Little and Taylor, J. Am. Stat. Assoc. 84, 1989).
    """
    square = (fit.state.minus(prior.state) ** 2 + fit.sd**2) * np.diag(prior.precision)
    root, chosen = np.ones(len(square)), np.flatnonzero(np.array(kinds) != "zero")
    root[chosen] = np.sqrt(2.0 / (1.0 + square[chosen]))
    return replace(prior, precision=prior.precision * np.outer(root, root))


def restricted(
    equations: Equations, fit: TipFit, prior: TipPrior, sds: Iterable[tuple[float, Array]]
) -> Iterator[tuple[float, Array]]:
    """Logarithms of the restricted likelihood of equations that are linear about a fit.

    One for each pair of deviations, of points and of joints; and the normal matrix (k, k) of the
    parameters that are free.
    """
    free, off = np.flatnonzero(prior.free), fit.state.minus(prior.state)
    known, pull = prior.precision[np.ix_(free, free)], (prior.precision @ off)[free]
    sure = np.flatnonzero(np.diag(prior.precision))
    size = np.linalg.slogdet(prior.precision[np.ix_(sure, sure)])[1]
    equations = equations._replace(by_parameter=equations.by_parameter[:, :, free])
    for point_sd, joint_sd in sds:
        white = equations.whitened(joint_sd, np.array(point_sd))
        jacobian, residual = white.jacobian.reshape(-1, len(free)), white.residual.ravel()
        own = known + jacobian.T @ jacobian
        step = -np.linalg.solve(own, pull + jacobian.T @ residual)
        left, moved = residual + jacobian @ step, off[free] + step
        misfit = left @ left + moved @ known @ moved
        spread = 2.0 * np.log(np.linalg.det(white.whitening)).sum() - np.linalg.slogdet(own)[1]
        yield 0.5 * float(spread + size - misfit), own


def shares(splits: Sequence[Split]) -> Array:
    """Probabilities (k,) of splits."""
    likely = np.exp([split.likelihood - splits[0].likelihood for split in splits])
    return np.asarray(likely / likely.sum())


def refitted(fit: TipFit, stated: TipRows, splits: Sequence[Split]) -> TipFit:
    """Fit anew with the deviations of points and joints that are expected of all splits."""
    sds = np.array([[split.point_sd, *split.joint_sd] for split in splits])
    point_sd, *joint_sd = np.sqrt(np.average(sds**2, axis=0, weights=shares(splits)))
    rows = replace(stated, point_sd=float(point_sd), joint_sd=np.array(joint_sd))
    return fit_rows(rows, fit.prior, start=fit.state)


def tip_error(fit: TipFit, splits: Sequence[Split], terms: Terms, joint: Array) -> TipError:
    """Error of the tip in the frame at joints (m, n_joints) [rad or m] that are come to at random.

    By what the fit leaves open and what joints keep; it is no less than the fit's residual over the
    root of its number.
    """
    side = np.random.default_rng(0).choice([-1.0, 1.0], (len(joint), len(terms.joints), 1))
    basis = terms.basis_at(joint[:, list(fit.rows.columns)], side)
    rows = replace(fit.rows, joint=joint, basis=basis, point=np.zeros((len(joint), 3)))
    equations = rows.equations(replace(fit.state, marker=np.zeros(3)))
    jacobian = equations.by_parameter.copy()
    jacobian[:, :, [fit.state.names.index(name) for name in (*MARKER, SCALE)]] = 0.0
    flat, share = jacobian.reshape(-1, jacobian.shape[2]), shares(splits)
    by_joint = (equations.by_joint**2).sum(axis=(0, 1))
    forms = [flat.T @ flat @ split.covariance for split in splits]
    kept = [float(by_joint @ split.joint_sd**2) for split in splits]
    squares = np.array([np.trace(form) + own for form, own in zip(forms, kept, strict=True)])
    # Mean square of one arm: a quadratic form of normal numbers, whose variance is this.
    chance = np.array([2.0 * (form * form.T).sum() for form in forms]) / squares**2
    squares /= len(rows)
    middle = float(np.average(np.log(squares), weights=share))
    spread = float(np.average((np.log(squares) - middle) ** 2 + chance, weights=share))
    residual = fit.residual[~fit.left_out]
    least = float((residual**2).sum(axis=1).mean()) / len(residual)
    rms = math.sqrt(max(math.exp(middle), least))
    return TipError(rms, 0.5 * rms * math.sqrt(spread))


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


class Trial(NamedTuple):
    """Rows and prior of a fit in which something is otherwise."""

    rows: TipRows
    prior: TipPrior
    words: Callable[[TipFit], str]  # What would be wrong, and what to do
    cost: float = 0.0  # Of the likelihood, for what was fitted before


def fit_loosely(rows: TipRows, prior: TipPrior, gate: float = GATE) -> TipFit:
    """Fit to rows whose points err more than stated, if most of them are further off."""
    every = fit_rows(rows, prior, gate=np.inf)
    factor = max(1.0, float(np.median(every.distance)) / NORM_MEDIAN)
    loose = replace(rows, point_sd=factor * rows.point_sd)
    return fit_rows(loose, prior, gate=gate, start=every.state)


def check_faults(
    source: str, rows: TipRows, prior: TipPrior, trials: Iterable[Trial], place: Integers,
    trouble: str = "",
) -> str:  # fmt: skip
    """Refuse points that are far likelier with something wrong in them, and name that.

    Where none of that is found, refuse them for other `trouble` if there is one. Gives in words
    what is likelier, but not far; empty where nothing is.
    """
    plain, most, fault = _likelihood(rows, prior, place)[0], _HINT, ""
    if not math.isfinite(plain):  # far too many outliers
        plain = _likelihood(rows, prior, place, math.inf)[0]
    for trial in trials:
        likelihood, fit = _likelihood(trial.rows, trial.prior, place)
        gain = likelihood - trial.cost - plain
        if fit is not None and gain > most:
            most, fault = gain, trial.words(fit)
    if most > _PROOF:
        trouble = f"the points fit only {fault}"
    if trouble:
        raise CalibrationError(f"{source}: {trouble}")
    return fault and f"the points fit better {fault}"


def _likelihood(
    rows: TipRows, prior: TipPrior, place: Integers, gate: float = GATE
) -> tuple[float, TipFit | None]:
    try:
        fit = fit_loosely(rows, prior, gate)
    except CalibrationError:
        return -math.inf, None
    return split_residuals(fit, rows, place)[0].likelihood, fit


def mirrored(rows: TipRows, block: Block, prior_of: Callable[[TipRows], TipPrior]) -> Trial:
    """Try the points mirrored; the axis is told by how the block is meant to stand."""
    flipped = replace(rows, point=rows.point * [-1.0, 1.0, 1.0])

    def words(fit: TipFit) -> str:
        turns = [np.diag(signs) for signs in ([1, 1, 1], [-1, -1, 1], [-1, 1, -1])]
        cosines = [np.trace(block.rotation.T @ fit.state.rotation @ turn) for turn in turns]
        best = int(np.argmax(cosines))
        where = f" in {'xyz'[best]}" if cosines[best] > 1.0 + 2.0 * math.cos(_MEANT) else ""
        return f"when mirrored{where}: change the sign of one axis of the points"

    return Trial(flipped, prior_of(flipped), words)


def renumbered(
    rows: TipRows, block: Block, dimples: Sequence[str], prior_of: Callable[[TipRows], TipPrior]
) -> Iterator[Trial]:
    """Try the dimples numbered along other sides of the block, from other ends, or one further.

    The few of these that lie nearest to the tips before anything is fitted.
    """
    names, point = list(block.points), np.array(list(block.points.values()))
    corner = np.round(point[:, :2], 6)
    orders = [
        np.lexsort((sign * corner[:, 1 - axis], other * corner[:, axis]))
        for axis, sign, other in product((0, 1), (1, -1), (1, -1))
    ]
    orders += [np.roll(np.arange(len(names)), step) for step in (1, -1)]
    orders += [np.argsort(order) for order in orders]
    at = np.array([names.index(name) if name in names else -1 for name in dimples])
    near: list[tuple[float, Trial]] = []
    for order in orders:
        moved = replace(rows, point=np.where(at[:, None] < 0, rows.point, point[order][at]))
        if (moved.point == rows.point).all():
            continue
        called = ", ".join(f"{names[k]} is {names[order[k]]}" for k in (0, 1, -1))
        words = f"when its dimples are numbered otherwise ({called}): number them as it is drawn"
        with suppress(CalibrationError):  # they lie in a line
            trial = Trial(moved, prior_of(moved), lambda _, words=words: words)  # type: ignore[misc]
            near.append((float(np.linalg.norm(moved.residual(trial.prior.state))), trial))
    yield from (trial for _, trial in sorted(near, key=lambda each: each[0])[:_NEAREST])


def scaled(rows: TipRows, prior: TipPrior, advice: str) -> Trial:
    """Try points of another size."""
    stated, words = prior.state.scale, "when scaled by {:.4f}: {}".format
    return _freed(rows, prior, (SCALE,), _SCALE_SD, lambda f: words(f.state.scale / stated, advice))


def marker_sd(rows: TipRows, prior: TipPrior, place: Integers) -> float:
    """How far off the tip a marker may be [m]: 0, unless the points are far likelier off it."""
    free = _freed(rows, prior, MARKER, _MARKER_SD, str).prior
    likelier = _likelihood(rows, free, place)[0] - _likelihood(rows, prior, place)[0]
    return _MARKER_SD if likelier > _PROOF else 0.0


def _freed(
    rows: TipRows, prior: TipPrior, names: Sequence[str], sd: float, words: Callable[[TipFit], str]
) -> Trial:
    """Try parameters that are known within `sd` only."""
    at = [prior.state.names.index(name) for name in names]
    precision, free = prior.precision.copy(), prior.free.copy()
    precision[at, at], free[at] = sd**-2.0, True
    return Trial(rows, replace(prior, precision=precision, free=free), words)


def moved(
    rows: TipRows, prior: TipPrior, what: str, cases: Iterable[tuple[str, Mask]]
) -> Iterator[Trial]:
    """Try the likeliest of moves of `what`: each says when, and which points (m,) come after."""
    try:
        fit = fit_rows(rows, prior, gate=np.inf)
    except CalibrationError:  # far too bad for one move
        return
    moves = [(*shift_of(fit, after)[:2], when, after) for when, after in cases]
    if moves:
        step, _, when, after = max(moves, key=lambda move: float(move[0] @ move[1] @ move[0]))
        point = rows.point + np.where(after[:, None], step / fit.state.scale, 0.0)
        far = with_unit(float(np.linalg.norm(step)), "m")
        words = f"when {what} moves by {far} {when}: bolt it down and take all points anew"
        yield Trial(replace(rows, point=point), prior, lambda _: words, _MOVE_COST)


def shift_of(fit: TipFit, chosen: Mask) -> tuple[Array, Array, Array]:
    """Shift (3,) in the frame [m] by which the `chosen` points (m,) are off the others.

    And the inverse (3, 3) of its covariance; again of what these points alone tell.
    """
    white = whiten_rows(fit.rows, ~fit.left_out & chosen, fit.state)
    turned = white.whitening.transpose(0, 2, 1) * white.weight[:, None, None]
    parts = white.whitening, white.jacobian, white.residual[:, :, None]
    own, shared, pull = ((turned @ part).sum(axis=0) for part in parts)
    information = own - shared @ fit.covariance @ shared.T
    return np.linalg.solve(information, pull[:, 0]), information, own
