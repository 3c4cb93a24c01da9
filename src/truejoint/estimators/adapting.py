"""Ridge regression of what a fitted model leaves on new rows: how far it is to be changed."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from truejoint.array_types import Array
from truejoint.errors import CalibrationError

PENALTIES: Final = (*(10.0**p for p in range(-4, 3)), math.inf)
"""Tried on the squared changes of coefficients, beside the mean squared error; the last changes the
intercept alone."""
_BLOCKS: Final = 5  # of the rows, on end, left out in turn
_LEAST_ROWS: Final = 50


def changes(terms: Array, residuals: Array) -> tuple[Array, Array, Array]:
    """Give changes of a model's coefficients (m, k) and intercept (k,), and penalties (k,).

    For each output by itself, the penalty is the one of the least mean square on five blocks of
    rows, on end, that are left out in turn.

    Parameters
    ----------
    terms : ndarray, shape (n, m)
        Of the model, scaled so that they had a variance of about 1 where it was fitted.
    residuals : ndarray, shape (n, k)
        Target minus prediction of the model.

    Raises
    ------
    CalibrationError
        If there are fewer than 50 rows.
    """
    check_rows(len(terms))
    rows = np.arange(len(terms))
    blocks = np.array_split(rows, _BLOCKS)
    errors = np.zeros((len(PENALTIES), residuals.shape[1]))
    for block in blocks:
        others = np.setdiff1d(rows, block)
        for at, (slopes, offset) in enumerate(_ridges(terms[others], residuals[others])):
            errors[at] += np.sum((residuals[block] - terms[block] @ slopes - offset) ** 2, axis=0)
    best = errors.argmin(axis=0)
    every = _ridges(terms, residuals)
    slopes, offset = (
        np.array([every[at][part][..., j] for j, at in enumerate(best)]) for part in (0, 1)
    )
    return slopes.T, offset, np.array(PENALTIES)[best]


def check_rows(n: int) -> None:
    """Raise CalibrationError if `n` rows with truth are too few to change a model by."""
    if n < _LEAST_ROWS:
        raise CalibrationError(f"{n} rows with truth; a prior is changed by {_LEAST_ROWS} or more")


def _ridges(terms: Array, residuals: Array) -> list[tuple[Array, Array]]:
    """Slopes (m, k) and offset (k,) for every penalty; the offset is not penalised."""
    mean, level = terms.mean(axis=0), residuals.mean(axis=0)
    centred = terms - mean
    values, vectors = np.linalg.eigh(centred.T @ centred / len(terms))
    right = vectors.T @ (centred.T @ (residuals - level) / len(terms))
    fits = []
    for penalty in PENALTIES:
        slopes = vectors @ (right / (np.maximum(values, 0.0) + penalty)[:, None])
        fits.append((slopes, level - mean @ slopes))
    return fits
