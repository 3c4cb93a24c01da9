"""Stiffness and friction of joints whose cables pull at each other, from recorded motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import least_squares

from truejoint.array_types import Array, Mask
from truejoint.estimators.plays.coupled_rows import coupled_play_rows

_FIRST_REACH: Final = 0.1  # half-width of each play where the search starts, in half ranges
_REACHES: Final = (0.002, 1.5)  # least and largest
_STRONGEST: Final = 0.98  # pull of the others on a joint over its own stiffness, along any motion
_STIFFNESS: Final = 2.0  # logarithm of a joint's stiffness over another's, at most
_PRIOR: Final = 0.02  # weight of joints that do not pull at each other and are equally stiff
_RIDGE: Final = 1e-3  # on plays of variance 1
_TRIALS: Final = 12
_STEP: Final = 0.02  # of a parameter, for a slope


@dataclass(frozen=True, eq=False)
class Coupling:
    """What `truejoint.estimators.plays.coupled_rows.coupled_play` takes of `k` joints."""

    coupling: Array  # (k, k)
    reaches: Array  # (k,), half-widths in units of the positions


def identify_coupling(
    positions: Array, fresh: Mask, has_target: Mask, explained: Array, targets: Array
) -> Coupling:
    """Find the coupling whose plays explain most of the targets: variable projection.

    Stiffness is symmetric and positive, so that a few pulls settle all joints. What is linear in
    what is given besides, and in the plays, is solved for at every trial.

    Parameters
    ----------
    positions : ndarray, shape (n, k)
        Where motors want the joints, in half ranges, in the order of time.
    fresh, known : ndarray of bool, shape (n,)
        Rows in which a history starts, and those with targets.
    explained : ndarray, shape (n_known, m)
        What else may explain the targets.
    targets : ndarray, shape (n_known, n_outputs)

    Examples
    --------
    >>> t = np.arange(0.0, 60.0, 0.05)
    >>> wanted = np.column_stack([np.sin(t), np.cos(0.37 * t)])
    >>> truly = np.array([[0.0, 0.6], [0.6, 0.0]]), np.array([0.1, 0.2])
    >>> left = np.empty_like(wanted)
    >>> coupled_play_rows(*truly, t == 0.0, wanted, np.zeros(2), left)
    >>> found = identify_coupling(wanted, t == 0.0, t >= 0.0, wanted, left)
    >>> bool(abs(found.coupling[0, 1] - 0.6) < 0.1)
    True
    """
    k = positions.shape[1]
    pairs = np.triu_indices(k, 1)
    n_pairs = len(pairs[0])
    basis, _ = np.linalg.qr(np.column_stack([np.ones(len(explained)), _scaled(explained)]))
    residual = _scaled(targets - basis @ (basis.T @ targets), targets.std(axis=0))
    plays, last = np.empty_like(positions), np.empty(k)

    def coupling(parameters: Array) -> Coupling:
        shared, stiffness, reaches = np.split(parameters - 1.0, [n_pairs, n_pairs + k])
        pulls = np.zeros((k, k))
        pulls[pairs] = shared
        pulls += pulls.T
        pulls *= min(1.0, _STRONGEST / max(-float(np.linalg.eigvalsh(pulls)[0]), 1e-9))
        root = np.exp(0.5 * stiffness)
        return Coupling(pulls * root / root[:, None], _FIRST_REACH * np.exp(reaches))

    def residuals(parameters: Array) -> Array:
        tried = coupling(parameters)
        coupled_play_rows(tried.coupling, tried.reaches, fresh, positions, last, plays)
        columns = plays[has_target]
        columns = _scaled(columns - basis @ (basis.T @ columns))
        inner = columns.T @ columns / len(columns) + _RIDGE * np.eye(k)
        weights = np.linalg.solve(inner, columns.T @ residual / len(columns))
        misfit = (residual - columns @ weights) / np.sqrt(len(columns))
        return np.concatenate([misfit.ravel(), _PRIOR * (parameters[: n_pairs + k] - 1.0)])

    # About 1, as steps are shares of a parameter and some are 0 where the search starts.
    widest = np.log(np.array(_REACHES) / _FIRST_REACH)
    low, high = (
        1.0 + np.repeat([sign, sign * _STIFFNESS, end], [n_pairs, k, k])
        for sign, end in zip((-1.0, 1.0), widest, strict=True)
    )
    start = np.ones(n_pairs + 2 * k)
    search = least_squares(
        residuals,
        start,
        bounds=(low, high),
        diff_step=np.full_like(start, _STEP),
        x_scale=0.3,
        max_nfev=_TRIALS,
    )
    return coupling(search.x)


def _scaled(columns: Array, sizes: Array | None = None) -> Array:
    """Columns (n, m) over their `sizes` (m,), by default their deviations; 0 where that is 0."""
    sizes = columns.std(axis=0) if sizes is None else sizes
    return np.divide(columns, sizes, out=np.zeros_like(columns), where=sizes > 1e-12)
