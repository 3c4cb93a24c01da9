"""Ridge regression: penalties that err least on blocks left out in turn, and these blocks."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.errors import CalibrationError
from truejoint.estimators.base import standardisation

PENALTIES: Final = tuple(10.0**p for p in range(-7, 2))
"""Tried on the squared coefficients of terms of variance 1, beside the mean squared error."""
CHANGE_PENALTIES: Final = (*(10.0**p for p in range(-4, 3)), math.inf)
"""Tried on the squared changes of a fitted model's coefficients; the last changes the intercept
alone."""
BLOCKS: Final = 5  # that are left out in turn

_LEAST: Final = 1e-6  # deviation of a term; what rows taken off a sum leave of one is rounding
_FEWEST_LEVELS: Final = 3  # with fewer, or larger ones, a fit would see too little
_LEAST_ROWS: Final = 50  # of new rows, by which a model is changed
_APART: Final = 1.5  # least gap between levels, in largest gaps within them


class PenalisedFit(NamedTuple):
    """Ridge regression of some outputs on terms, and what was chosen for each output."""

    coefficients: Array  # (1 + n_terms, n_outputs), constants first
    penalties: Array  # (n_outputs,), chosen of `PENALTIES`
    weights: Integers  # (n_outputs,), which of the weights tried were chosen
    errors: Array  # (n_outputs,), sum of squared errors on what was left out


def cross_validated(
    products: Array,
    weights: Sequence[Array],
    progress: Callable[[float], None] | None = None,
    penalties: Sequence[float] = PENALTIES,
) -> PenalisedFit:
    """Fit with the penalty, and the weights of terms, that err least on blocks left out in turn.

    Parameters
    ----------
    products : ndarray, shape (n_blocks, m, m)
        For each block of rows, the sums of products of every two of: 1, the terms, the outputs.
    weights : sequence of ndarray, each of shape (n_terms,)
        What is tried. A term of weight 1 is penalised as one of variance 1; a smaller weight is
        penalised more, by its square; 0 leaves the term out.
    progress : callable, optional
        Called with the fraction done, 0 to 1.
    penalties : sequence of float
        What is tried; one alone is taken.

    Examples
    --------
    >>> x = np.linspace(-1.0, 1.0, 90)
    >>> table = np.column_stack([np.ones(90), x, x**2, 3.0 * x])
    >>> blocks = np.array([rows.T @ rows for rows in np.split(table, 3)])
    >>> cross_validated(blocks, [np.ones(2)]).coefficients[:, 0].round(3) + 0.0
    array([0., 3., 0.])
    """
    n_outputs = products.shape[1] - 1 - len(weights[0])
    errors = np.zeros((len(weights), len(penalties), n_outputs))
    whole = products.sum(axis=0)
    for number, trial in enumerate(weights):
        for block in products:
            for at, table in enumerate(solutions(whole - block, trial, n_outputs, penalties)):
                residual_of = np.vstack([-table, np.eye(n_outputs)])
                errors[number, at] += np.sum(residual_of * (block @ residual_of), axis=0)
        if progress is not None:
            progress((number + 1) / len(weights))
    flat = errors.reshape(-1, n_outputs)
    chosen, penalty = np.unravel_index(flat.argmin(axis=0), errors.shape[:2])
    fits = [solutions(whole, trial, n_outputs, penalties) for trial in weights]
    columns = [fits[chosen[j]][penalty[j]][:, j] for j in range(n_outputs)]
    return PenalisedFit(np.array(columns).T, np.array(penalties)[penalty], chosen, flat.min(axis=0))


def ridge(columns: Array, y: Array, penalty: float) -> tuple[Array, float]:
    """Ridge regression on standardised columns (n, k): weights (k,) of the columns, and constant.

    The constant is not penalised.
    """
    mean, inverse = standardisation(columns)
    scaled = (columns - mean) * inverse
    constant = float(y.mean())
    gram = scaled.T @ scaled / len(y) + penalty * np.eye(scaled.shape[1])
    weights = np.linalg.solve(gram, scaled.T @ (y - constant) / len(y)) * inverse
    return np.asarray(weights), constant - float(weights @ mean)


def solutions(products: Array, weights: Array, n_outputs: int, penalties: Sequence[float]) -> Array:
    """Constants and coefficients (n_penalties, 1 + n_terms, n_outputs) for every penalty.

    Of sums of `products` (m, m) of terms that are scaled to variance 1, then by `weights`
    (n_terms,).
    """
    n_terms, n = len(weights), products[0, 0]
    mean = products[0] / n
    spread = products / n - np.outer(mean, mean)
    terms, targets = slice(1, 1 + n_terms), slice(1 + n_terms, None)
    deviation = np.sqrt(np.maximum(np.diag(spread)[terms], 0.0))
    scale = np.divide(weights, deviation, out=np.zeros(n_terms), where=deviation > _LEAST)
    used = np.flatnonzero(scale)
    factors = scale[used]
    inner = spread[terms, terms][np.ix_(used, used)] * np.outer(factors, factors)
    values, vectors = np.linalg.eigh(inner)
    right = vectors.T @ (spread[terms, targets][used] * factors[:, None])
    table = np.zeros((len(penalties), 1 + n_terms, n_outputs))
    for at, penalty in enumerate(penalties):
        shrunk = right / (np.maximum(values, 0.0) + penalty)[:, None]
        table[at, 1 + used] = factors[:, None] * (vectors @ shrunk)
        table[at, 0] = mean[targets] - mean[terms] @ table[at, 1:]
    return table


def blocks(dt: Array) -> list[Integers]:
    """Rows of each of the `BLOCKS` parts, of the time (n,) since the row before.

    Of few histories none is left out as a whole: what it alone shows, such as a load, would then
    count as something that cannot be learnt.
    """
    starts = np.flatnonzero(dt == 0.0)
    whole = [np.arange(len(dt))]
    histories = np.split(whole[0], starts[1:]) if len(starts) < BLOCKS else whole
    cut = [np.array_split(rows, BLOCKS) for rows in histories]
    return [np.concatenate(parts) for parts in zip(*cut, strict=True)]


def levels(values: Array, most: int = BLOCKS) -> list[Integers]:
    """Places of values (n,) in at most so many parts, from the least values to the largest.

    Values of one level, such as the loads of recordings under one weight, stay together, or what
    is left out of a fit would still be in it. There are levels where cuts at the largest gaps make
    three or more, none of more than a third of the values (rounded up), and the least of these gaps
    is 1.5 times the largest other one or more; of several numbers of levels, that whose gaps stand
    out most. Else each value is a level of its own.

    Examples
    --------
    >>> [part.tolist() for part in levels(np.array([1.0, 5.1, 9.0, 1.1, 5.0, 9.2]))]
    [[0, 3], [4, 1], [2, 5]]
    """
    order = np.argsort(values, kind="stable")
    gaps = np.diff(values[order])
    largest = np.argsort(-gaps, kind="stable")
    units = [order[i : i + 1] for i in range(len(order))]
    best, least = _APART, 1e-9 * max(float(gaps.max(initial=0.0)), 1e-290)
    for count in range(_FEWEST_LEVELS, len(values) // 2 + 1):
        parts_at_gaps = np.split(order, np.sort(largest[: count - 1]) + 1)
        ratio = gaps[largest[count - 2]] / max(gaps[largest[count - 1]], least)
        if ratio >= best and max(map(len, parts_at_gaps)) <= -(-len(values) // _FEWEST_LEVELS):
            best, units = ratio, parts_at_gaps
    parts = np.array_split(np.arange(len(units)), min(most, len(units)))
    return [np.concatenate([units[i] for i in part]) for part in parts]


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
    check_row_count(len(terms))
    rows = np.arange(len(terms))
    errors = np.zeros((len(CHANGE_PENALTIES), residuals.shape[1]))
    for block in np.array_split(rows, BLOCKS):
        rest = np.setdiff1d(rows, block)
        for at, (slopes, offset) in enumerate(_ridges(terms[rest], residuals[rest])):
            errors[at] += np.sum((residuals[block] - terms[block] @ slopes - offset) ** 2, axis=0)
    best = errors.argmin(axis=0)
    every = _ridges(terms, residuals)
    slopes, offset = (
        np.array([every[at][part][..., j] for j, at in enumerate(best)]) for part in (0, 1)
    )
    return slopes.T, offset, np.array(CHANGE_PENALTIES)[best]


def check_row_count(n: int) -> None:
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
    for penalty in CHANGE_PENALTIES:
        slopes = vectors @ (right / (np.maximum(values, 0.0) + penalty)[:, None])
        fits.append((slopes, level - mean @ slopes))
    return fits
