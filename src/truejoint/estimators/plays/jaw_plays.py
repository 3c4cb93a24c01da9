"""Jaw angle by banks of play operators (Prandtl-Ishlinskii): hysteresis as a linear regression.

The reset cable's end follows the jaw but for the slider's friction; the motor's side differs by the
jaw's friction and by whatever load stretches the drive cable. So an estimate from ``x2`` alone
hardly knows about loads, and one from both is more accurate as long as there is none.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from truejoint.array_types import Array
from truejoint.estimators.base import Arrays, Flags, Progress, standardisation
from truejoint.estimators.family import Family, Params
from truejoint.estimators.jaw.base import JawEstimator
from truejoint.estimators.plays import gated_rows as gated_play
from truejoint.estimators.plays import jaw_bank as play
from truejoint.robots.forceps import Forceps


def ridge(columns: Array, y: Array, penalty: float) -> tuple[Array, float]:
    """Ridge regression on standardised columns (n, k): weights (k,) of the columns, and constant.

    The constant is not penalised.
    """
    mean, inverse = standardisation(columns)
    scaled = (columns - mean) * inverse
    constant = float(y.mean())
    left = scaled.T @ scaled / len(y) + penalty * np.eye(scaled.shape[1])
    weights = np.linalg.solve(left, scaled.T @ (y - constant) / len(y)) * inverse
    return np.asarray(weights), constant - float(weights @ mean)


@dataclass(eq=False, repr=False)
class Play(JawEstimator):
    """Ridge regression on powers of one or two displacements and on plays on them.

    From the reset cable alone (``reset``) it hardly feels a load; from both sides (``reset`` and
    ``motor``, or ``drive`` where an encoder sits on the drive cable) it is the most accurate of
    all without a load, and wrong under one; from the motor alone it is what the strategy without
    sensors of yan2020, II-B, can reach.

    Parameters
    ----------
    displacements : tuple of str
        One or two of ``motor``, ``drive`` (both ``x1``) and ``reset`` (``x2``).
    degree : int
        Highest power of a displacement, 1 to 8.
    reset_widths, drive_widths : tuple of float
        Half-widths of the plays on ``x2`` and on ``x1`` [m].
    penalty : float
        Ridge on the standardised columns.
    gear_ratio, wheel_radius : float
        ``z_i`` and ``R`` [m], which turn the motor's angle into ``x1``: (2), (3).

    Examples
    --------
    >>> Play(displacements=("reset",)).name
    'play_reset'
    """

    family: ClassVar[Family] = play.FAMILY
    displacements: tuple[str, ...] = ("reset", "motor")
    degree: int = play.POWERS
    reset_widths: tuple[float, ...] = play.RESET_WIDTHS
    drive_widths: tuple[float, ...] = play.DRIVE_WIDTHS
    penalty: float = 1e-5
    gear_ratio: float = Forceps().gear_ratio
    wheel_radius: float = Forceps().wheel_radius

    def _learn_jaw(self, X: Array, y: Array, dt: Array, known: Flags, progress: Progress) -> Arrays:
        params = self.model_params()
        names = [name for name in play.DISPLACEMENTS if name in self.displacements]
        values = [
            X[:, names.index(name)] * factor
            for name, factor in zip(self.displacements, play.bank_factors(params), strict=True)
        ]
        scale = np.array([1.0 / np.abs(v).max() for v in values])
        columns = _columns(values, scale, params, dt)
        weights, constant = ridge(columns[known], y[known], float(self.penalty))
        progress(0.9)
        return {"scale": scale, "weights": weights, "constant": np.array([constant])}


@dataclass(eq=False, repr=False)
class GatedPlay(JawEstimator):
    """`Play` on the reset cable, corrected by `Play` on both sides as far as the two agree.

    Without a load both see the same jaw, and their difference stays within a few times what it was
    in calibration; the estimate from both sides is then the better one. A load stretches the drive
    cable, which only that one mistakes for a motion of the jaw: the difference grows, and the
    estimate goes over, without a jump, to the reset cable's. In the loop it states how far off it
    may be, which a load makes more.

    Parameters
    ----------
    gate : float
        How many times the difference's RMS in calibration still counts as agreement.
    smallest_gate : float
        Difference that always does [rad].
    gear_ratio, wheel_radius : float
        As for `Play`.

    Examples
    --------
    >>> GatedPlay(gate=4.0).name
    'play_gated'
    """

    family: ClassVar[Family] = gated_play.FAMILY
    gate: float = 3.0
    smallest_gate: float = 1.75e-3
    gear_ratio: float = Forceps().gear_ratio
    wheel_radius: float = Forceps().wheel_radius

    def _learn_jaw(self, X: Array, y: Array, dt: Array, known: Flags, progress: Progress) -> Arrays:
        params = self.model_params()
        reset = Play(**gated_play.side_params(params, "reset")).fit(X[:, 1:], y, dt=dt)
        progress(0.4)
        both = Play(**gated_play.side_params(params, "both")).fit(X, y, dt=dt)
        progress(0.8)
        alone = reset.evaluate(X[:, 1:], dt)[known, 0]
        together = both.evaluate(X, dt)[known, 0]
        spread = _rms(together - alone)
        misfit = np.array([_rms(together - y[known]), _rms(alone - y[known])])
        return {
            **{f"reset_{name}": array for name, array in reset.arrays_.items()},
            **{f"both_{name}": array for name, array in both.arrays_.items()},
            "gate": np.array([max(self.gate * spread, self.smallest_gate)]),
            "constant": np.zeros(1),
            "misfit": misfit,
        }


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _columns(values: list[Array], scale: Array, params: Params, dt: Array) -> Array:
    """Columns (n, k) of the regression on displacements, (n,) each."""
    degree, widths = int(params["degree"]), play.bank_widths(params)
    blocks = []
    for value, inverse, own in zip(values, scale, widths, strict=True):
        block = np.empty((len(value), degree + len(own)))
        play.bank_columns(dt, np.ascontiguousarray(value), inverse, own, block)
        blocks.append(block)
    banks = np.hstack(blocks)
    pairs = play.product_pairs(degree, [len(own) for own in widths])
    return np.ascontiguousarray(np.hstack([banks, banks[:, :1] * banks[:, pairs]]))
