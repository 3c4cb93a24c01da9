"""What may be wrong with points of a tool: mirrored, scaled, wrongly numbered, moved, not the tip.

Each is tried by a fit of its own, and named where the points are far likelier with it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import product
from typing import Final, NamedTuple

import numpy as np

from truejoint.array_types import Array, Integers, Mask
from truejoint.errors import CalibrationError
from truejoint.tip.accuracy import split_residuals
from truejoint.tip.block import Block
from truejoint.tip.fit import (
    GATE,
    MARKER,
    NORM_MEDIAN,
    SCALE,
    TipFit,
    TipPrior,
    TipRows,
    fit_rows,
    whiten_rows,
)
from truejoint.units import with_unit

_PROOF: Final = 9.0
"""By how much the logarithm of the likelihood grows where a fault is named."""
_SCALE_SD: Final = 0.03
_MARKER_SD: Final = 0.02  # m
_MEANT: Final = 0.5  # rad by which a block may be turned from how it is meant to stand
_MOVE_COST: Final = 6.0  # of a time among many, and of a way in any direction
_EDGE: Final = 6  # points at least before and after a move


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


def find_fault(rows: TipRows, prior: TipPrior, trials: Iterator[Trial], place: Integers) -> str:
    """Name the trial with which the points are far likelier than without; empty if none is."""
    base = _likelihood(rows, prior, place)[0]
    if not math.isfinite(base):  # far too many outliers
        base = _likelihood(rows, prior, place, gate=math.inf)[0]
    best, fault = base + _PROOF, ""
    for trial in trials:
        likelihood, fit = _likelihood(trial.rows, trial.prior, place)
        if fit is not None and likelihood - trial.cost > best:
            best, fault = likelihood - trial.cost, trial.words(fit)
    return fault


def _likelihood(
    rows: TipRows, prior: TipPrior, place: Integers, gate: float = GATE
) -> tuple[float, TipFit | None]:
    try:
        fit = fit_loosely(rows, prior, gate)
    except CalibrationError:
        return -math.inf, None
    return split_residuals(fit, rows, place)[0].likelihood, fit


def mirrored(
    rows: TipRows, block: Block, prior_of: Callable[[TipRows], TipPrior]
) -> Iterator[Trial]:
    """Try the points mirrored; the axis is told by how the block is meant to stand."""
    flipped = replace(rows, point=rows.point * [-1.0, 1.0, 1.0])

    def words(fit: TipFit) -> str:
        turns = [np.diag(signs) for signs in ([1, 1, 1], [-1, -1, 1], [-1, 1, -1])]
        cosines = [np.trace(block.rotation.T @ fit.state.rotation @ turn) for turn in turns]
        best = int(np.argmax(cosines))
        where = f" in {'xyz'[best]}" if cosines[best] > 1.0 + 2.0 * math.cos(_MEANT) else ""
        return f"when mirrored{where}: change the sign of one axis of the points"

    yield Trial(flipped, prior_of(flipped), words)


def renumbered(
    rows: TipRows, block: Block, dimples: Sequence[str], prior_of: Callable[[TipRows], TipPrior]
) -> Iterator[Trial]:
    """Try the dimples numbered along other sides of the block, from other ends, or one further."""
    names = list(block.points)
    point = np.array(list(block.points.values()))
    corner = np.round(point[:, :2], 6)
    orders = [
        np.lexsort((sign * corner[:, 1 - axis], other * corner[:, axis]))
        for axis, sign, other in product((0, 1), (1, -1), (1, -1))
    ]
    orders += [np.roll(np.arange(len(names)), step) for step in (1, -1)]
    orders += [np.argsort(order) for order in orders]
    at = np.array([names.index(name) if name in names else -1 for name in dimples])
    for order in orders:
        moved = replace(rows, point=np.where(at[:, None] < 0, rows.point, point[order][at]))
        if (moved.point == rows.point).all():
            continue

        def words(_: TipFit, order: Integers = order) -> str:
            called = ", ".join(f"{names[k]} is {names[order[k]]}" for k in (0, 1, len(names) - 1))
            return f"when its dimples are numbered otherwise ({called}): number them as it is drawn"

        try:
            yield Trial(moved, prior_of(moved), words)
        except CalibrationError:  # they lie in a line
            continue


def scaled(rows: TipRows, prior: TipPrior, advice: str) -> Iterator[Trial]:
    """Try points of another size."""

    def words(fit: TipFit) -> str:
        return f"when scaled by {fit.state.scale / prior.state.scale:.4f}: {advice}"

    yield Trial(rows, _freed(prior, (SCALE,), _SCALE_SD), words)


def off_the_tip(rows: TipRows, prior: TipPrior) -> Iterator[Trial]:
    """Try a marker, or whatever touches, that is not at the tip."""

    def words(fit: TipFit) -> str:
        x, y, z = (1e3 * fit.state.marker).tolist()
        return (
            f"when they are of a place ({x:.1f}, {y:.1f}, {z:.1f}) mm off the tip in the tool's "
            "frame: put the marker at the tip (pivot calibration), or give its place in a "
            "registration (extract --tracker)"
        )

    yield Trial(rows, _freed(prior, MARKER, _MARKER_SD), words)


def moved_amid(rows: TipRows, prior: TipPrior, t: Sequence[float], what: str) -> Iterator[Trial]:
    """Try a block, or a tracker, that moves once while the points are taken, at times `t` [s]."""
    try:
        fit = fit_rows(rows, prior, gate=np.inf)
    except CalibrationError:  # far too bad for one move
        return
    best, step, first = 0.0, np.zeros(3), 0
    for k in range(_EDGE, len(rows) - _EDGE + 1):
        shift, information = shift_of(fit, np.arange(len(rows)) >= k)
        if (gain := float(shift @ information @ shift)) > best:
            best, step, first = gain, shift, k
    yield _moved(fit, np.arange(len(rows)) >= first, step, f"after {t[first]:.1f} s", what)


def moved_against(rows: TipRows, prior: TipPrior, still: Mask, what: str) -> Iterator[Trial]:
    """Try a block that has moved against points (m,) that stand `still`."""
    try:
        fit = fit_rows(rows, prior, gate=np.inf)
    except CalibrationError:
        return
    yield _moved(fit, ~still, shift_of(fit, ~still)[0], "against its references", what)


def _moved(fit: TipFit, chosen: Mask, step: Array, when: str, what: str) -> Trial:
    """Try some points moved by a `step` (3,) [m]."""
    point = fit.rows.point + np.where(chosen[:, None], step / fit.state.scale, 0.0)
    far = with_unit(float(np.linalg.norm(step)), "m")
    words = f"when {what} moves by {far} {when}: bolt it down and take all points anew"
    return Trial(replace(fit.rows, point=point), fit.prior, lambda _: words, _MOVE_COST)


def shift_of(fit: TipFit, chosen: Mask) -> tuple[Array, Array]:
    """Shift (3,) in the frame [m] by which the `chosen` points (m,) are off the others.

    And the information of it (3, 3), the inverse of its covariance.
    """
    white = whiten_rows(fit.rows, ~fit.left_out & chosen, fit.state)
    turned = white.whitening.transpose(0, 2, 1) * white.weight[:, None, None]
    pull = (turned @ white.residual[:, :, None]).sum(axis=0)[:, 0]
    shared = (turned @ white.jacobian).sum(axis=0)
    information = (turned @ white.whitening).sum(axis=0) - shared @ fit.covariance @ shared.T
    return np.linalg.solve(information, pull), information


def _freed(prior: TipPrior, names: Sequence[str], sd: float) -> TipPrior:
    """Prior in which parameters are known within `sd` only."""
    at = [prior.state.names.index(name) for name in names]
    precision, free = prior.precision.copy(), prior.free.copy()
    precision[at, at], free[at] = sd**-2.0, True
    return replace(prior, precision=precision, free=free)
