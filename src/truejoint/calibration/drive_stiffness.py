"""Stiffness of a jaw's drive cable by known weights."""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from truejoint.array_types import Array
from truejoint.errors import CalibrationError
from truejoint.estimators.jaw.signals import FLICKER, SLIDING
from truejoint.estimators.jaw_load.learn import USUAL_GROWTH, FrictionFilter, Stiffness
from truejoint.estimators.jaw_load.run import DEGREE, external_torque

LARGEST_RATIO: Final = 3.0  # of identified and assumed stiffness, either over the other
_SCATTER: Final = 1e-3  # of what a weight that shows is seen as [Nm]
_GROWTH_SPREAD: Final = 300.0  # of the stiffness' growth about the usual [N/m per N]
_ROUNDS: Final = 4  # of finding stiffness and friction, which is in proportion to it


def identify_stiffness(
    model: FrictionFilter, X: ArrayLike, torque: ArrayLike, dt: ArrayLike | None = None
) -> Stiffness:
    """Find the drive cable's stiffness, and its growth with tension, from known weights.

    Hang one each way, which tells the growth, and move the jaw slowly there and back under it,
    whole cycles: friction then cancels. Under a weight that only hangs still, what friction may
    hide of it counts as not known, and what a hand's swinging leaves in it biases the stiffness.

    Parameters
    ----------
    model : FrictionFilter
        Fitted to an unloaded motion.
    X : array_like, shape (n, 2)
        Records in which weights hang: motor angle [rad] and ``x2`` [m].
    torque : array_like, shape (n,)
        Torque of the weight that hangs freely in a row [Nm], positive where it opens the jaw; NaN
        in rows where none does.
    dt : array_like, shape (n,), optional
        Time since the row before [s], 0 where a record starts; rows 5 ms apart by default.

    Raises
    ------
    CalibrationError
        If no weight is stated, one is beyond `FrictionFilter.largest_load`, none shows above the
        jaw's friction, or no stiffness within a factor of 3 of the model's explains them.

    Examples
    --------
    >>> phase = np.linspace(0.0, 12.0 * np.pi, 4000)
    >>> angle, reset = 0.8 * np.sin(phase), 3e-3 * np.sin(phase)
    >>> X = np.column_stack([11.5 * np.sin(phase), reset])
    >>> model = FrictionFilter().fit(X, angle)
    >>> at_rest = np.tile(X[-1], (1000, 1))
    >>> loaded = at_rest - [1.0, 0.0]
    >>> rows = np.concatenate([X, at_rest, loaded])
    >>> torque = np.where(np.arange(6000) > 5500, 0.016, np.nan)
    >>> round(identify_stiffness(model, rows, torque).drive_stiffness / 1e3, 1)
    15.4
    """
    rows, torques = np.ascontiguousarray(X, dtype=np.float64), np.asarray(torque, dtype=np.float64)
    times = model.time_steps(dt, len(rows))
    hangs = _hangs(torques, times)
    stretch = model.states(rows, times).states[:, -1]
    means = np.array(
        [
            [
                torques[hang].mean(),
                model.spring_stiffness * rows[hang, 1].mean(),
                stretch[hang].mean(),
            ]
            for hang in hangs
        ]
    )
    weights, tension, stretched = means.T
    heaviest = float(np.abs(weights).max())
    if heaviest > model.largest_load:
        raise CalibrationError(
            f"a weight of {1e3 * heaviest:.1f} mNm is beyond the {1e3 * model.largest_load:.1f} "
            "mNm that no load exceeds (largest_load): the drive cable would be slack; hang a "
            "lighter one"
        )
    hidden = _hidden(model, rows, times, hangs, weights)
    stiffness = Stiffness(model.drive_stiffness, model.stiffness_growth, math.inf)
    for _ in range(_ROUNDS):
        friction = model.with_stiffness(stiffness).jaw_friction
        scatter = np.hypot(_SCATTER, hidden * friction / math.sqrt(3.0))
        if not (np.abs(weights) > hidden * friction).any():
            raise CalibrationError(
                f"a weight of {1e3 * heaviest:.1f} mNm does not show above the jaw's friction, "
                f"which hides {1e3 * float(hidden.max()) * friction:.1f} mNm; hang a heavier one, "
                "or along the last motion"
            )
        stiffness = _fitted(model, weights, tension, stretched, scatter)
    return stiffness


def _hidden(
    model: FrictionFilter, rows: Array, times: Array, hangs: Sequence[slice], weights: Array
) -> Array:
    """Share (n,) of the jaw's friction that may still turn round under each weight.

    None where the jaw yields to the weight.
    """
    bent = model.elements(rows, times) @ model.arrays_["drive"][1 + DEGREE :]
    most = max(abs(float(model.arrays_["drive"][1 + DEGREE :].sum())), 1e-12)
    turned = np.array([bent[hang].mean() for hang in hangs]) / most
    moved = np.array([np.ptp(rows[hang, 1]) for hang in hangs])
    known_again = np.exp(-np.maximum(moved - FLICKER, 0.0) / SLIDING)
    return np.asarray(np.clip(1.0 - np.sign(weights) * turned, 0.0, 2.0) * known_again)


def _fitted(
    model: FrictionFilter, weights: Array, tension: Array, stretched: Array, scatter: Array
) -> Stiffness:
    """Stiffness and growth by least squares; the growth is also what is usual of ropes."""
    assumed = model.drive_stiffness

    def misfit(ratio_and_growth: Array) -> Array:
        cable = np.array([assumed * ratio_and_growth[0], *ratio_and_growth[1:], model.jaw_radius])
        shown = [external_torque(*pair, cable) for pair in zip(stretched, tension, strict=True)]
        usual = (ratio_and_growth[1] - USUAL_GROWTH) / _GROWTH_SPREAD
        return np.append((np.array(shown) - weights) / scatter, usual)

    bounds = [1.0 / LARGEST_RATIO, 1.0], [LARGEST_RATIO, 5e3]
    search = least_squares(misfit, [1.0, USUAL_GROWTH], bounds=bounds, x_scale=[1.0, 1e3])
    ratio, growth = (float(value) for value in search.x)
    if not 1.01 / LARGEST_RATIO < ratio < 0.99 * LARGEST_RATIO:
        raise CalibrationError(
            f"no stiffness within {LARGEST_RATIO:g} times {assumed:g} N/m explains the weights: "
            "check weight, lever and sign, and that the model was calibrated unloaded"
        )
    slopes = np.asarray(search.jac)
    spread = np.linalg.inv(slopes.T @ slopes)[0, 0]
    return Stiffness(assumed * ratio, growth, assumed * math.sqrt(float(spread)))


def _hangs(torque: Array, dt: Array) -> list[slice]:
    """Give the runs of rows in which a weight hangs; refuses rows without any."""
    hung = np.isfinite(torque) & (torque != 0.0)
    starts = hung & (np.concatenate([[True], ~hung[:-1]]) | (dt == 0.0))
    ends = hung & np.concatenate([~hung[1:] | (dt[1:] == 0.0), [True]])
    pairs = zip(np.flatnonzero(starts), np.flatnonzero(ends), strict=True)
    hangs = [slice(int(first), int(last) + 1) for first, last in pairs]
    if not hangs:
        raise CalibrationError(
            "no weight is stated: give the torque of each in the rows in which it hangs freely, "
            "and NaN in the others"
        )
    return hangs
