"""Jaw angle by banks of play operators (Prandtl-Ishlinskii): hysteresis as a linear regression.

The reset cable's end follows the jaw but for the slider's friction, a hysteresis in ``x2`` itself;
the motor's side differs from the jaw by the jaw's friction and by whatever load stretches the
drive cable. So an estimate from ``x2`` alone hardly knows about loads, and one from both is more
accurate as long as there is none.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from truejoint.estimators.base import Progress, standardisation
from truejoint.estimators.jaw import JawEstimator
from truejoint.models import play
from truejoint.models.family import Family, Params
from truejoint.robots.forceps_mechanism import TABLE_1

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RidgeFit:
    """Linear model of standardised columns: the mean, and a weight and a mean for each column."""

    mean: Array
    inverse_scale: Array
    coef: Array
    constant: float

    @property
    def weights(self) -> tuple[Array, float]:
        """Weights (k,) of the columns as they are, and the constant that goes with them."""
        weights = self.coef * self.inverse_scale
        return weights, self.constant - float(weights @ self.mean)


def ridge(columns: Array, y: Array, penalty: float) -> RidgeFit:
    """Ridge regression on standardised columns (n, k); the constant is not penalised."""
    mean, inverse = standardisation(columns)
    scaled = (columns - mean) * inverse
    constant = float(y.mean())
    left = scaled.T @ scaled / len(y) + penalty * np.eye(scaled.shape[1])
    coef = np.linalg.solve(left, scaled.T @ (y - constant) / len(y))
    return RidgeFit(mean, inverse, np.asarray(coef, dtype=np.float64), constant)


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
    gear_ratio: float = TABLE_1.gear_ratio
    wheel_radius: float = TABLE_1.wheel_radius

    def _learn_jaw(
        self, X: Array, y: Array, dt: Array, known: NDArray[np.bool_], progress: Progress
    ) -> dict[str, Array]:
        params = self.model_params()
        names = [name for name in play.DISPLACEMENTS if name in self.displacements]
        values = [
            X[:, names.index(name)] * factor
            for name, factor in zip(self.displacements, play.bank_factors(params), strict=True)
        ]
        scale = np.array([1.0 / np.abs(v).max() for v in values])
        fit = ridge(_columns(values, scale, params, dt)[known], y[known], float(self.penalty))
        progress(0.9)
        weights, constant = fit.weights
        return {"scale": scale, "weights": weights, "constant": np.array([constant])}


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
