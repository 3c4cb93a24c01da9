"""Jaw angle by plays of motor and cables: hysteresis as a linear regression.

The reset cable's end follows the jaw but for the slider's friction. The motor's side differs by the
jaw's friction and by the load that stretches the drive cable. So an estimate from ``x2`` alone
hardly feels a load, and one from both sides is more accurate as long as there is none.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Final

from truejoint.array_types import Array
from truejoint.estimators.base import Arrays, Flags, Progress
from truejoint.estimators.family import Family, Rule, number
from truejoint.estimators.jaw.base import JawEstimator
from truejoint.estimators.jaw.signals import MOTOR, RESET
from truejoint.estimators.plays import jaw_bank
from truejoint.estimators.plays.learn import feature_scales
from truejoint.estimators.plays.run import expand_rows
from truejoint.estimators.polynomial.learn import Polynomial

PENALTY: Final = 1e-5


def fit_bank(
    widths: tuple[float, ...], penalty: float, X: Array, y: Array, dt: Array, has_truth: Flags
) -> Arrays:
    """Fit `jaw_bank.bank` to the rows `X` (n, k), `y` (n,) that have a truth; `dt` (n,) is of all.

    The penalty is fixed: on a motion of one amplitude, cross-validation would choose one that is
    too small for any other.
    """
    params, arrays = jaw_bank.bank(widths, X.shape[1]), feature_scales(X[has_truth])
    inputs = expand_rows(params, arrays, X, dt, has_truth)
    ((_, terms, _),) = params["members"]
    model = Polynomial(**terms, penalty=penalty).fit(inputs, y[has_truth])
    return {**arrays, **{f"0/{name}": array for name, array in model.arrays_.items()}}


@dataclass(eq=False, repr=False, kw_only=True)
class JawPlays(JawEstimator):
    """Ridge regression on plays of one or two signals of a forceps, and on their products.

    From the reset cable alone it hardly feels a load. From both sides it is the most accurate of
    all without a load, and wrong under one. From the motor alone it is what the strategy without
    sensors of yan2020, II-B, can reach.

    Parameters
    ----------
    signals : tuple of str
        One or two of ``motor/jaw``, ``cable/drive`` (both ``x1``) and ``cable/reset`` (``x2``).
    plays : tuple of float
        Half-widths of the plays of each signal, in half ranges of it.
    penalty : float
        Ridge on the standardised terms.

    Examples
    --------
    >>> JawPlays(signals=("cable/reset",)).name
    'play_reset'
    """

    family: ClassVar[Family] = jaw_bank.FAMILY
    training: ClassVar[Mapping[str, Rule]] = {"penalty": number(0.0, 1e12)}
    signals: tuple[str, ...] = (MOTOR, RESET)
    plays: tuple[float, ...] = jaw_bank.WIDTHS
    penalty: float = PENALTY

    def _learn_jaw(
        self, X: Array, y: Array, dt: Array, has_truth: Flags, progress: Progress
    ) -> Arrays:
        return fit_bank(tuple(self.plays), self.penalty, X, y, dt, has_truth)
