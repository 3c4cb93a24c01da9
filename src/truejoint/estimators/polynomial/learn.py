"""Fixed offset, linear and polynomial regression (peng2024, II-C), and ridge regression."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Final, NamedTuple

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from truejoint.array_types import Array, Integers
from truejoint.estimators import base, registry
from truejoint.estimators.base import Arrays, JointRegressor, Progress
from truejoint.estimators.family import Family
from truejoint.estimators.polynomial.run import FAMILY, factors_of, of_degree
from truejoint.estimators.rules import Params, Rule, number, one_of, optional

PENALTIES: Final = tuple(10.0**p for p in range(-7, 2))
"""Tried on the squared coefficients of terms of variance 1, beside the mean squared error."""
BLOCKS: Final = 5  # that are left out in turn

_LEAST: Final = 1e-6  # deviation of a term; what rows taken off a sum leave of one is rounding
_FEWEST_LEVELS: Final = 3  # with fewer, or larger ones, a fit would see too little
_APART: Final = 1.5  # least gap between levels, in largest gaps within them
ROWS_PER_COEFFICIENT: Final = 10  # for each joint; with fewer rows, a fit fits the noise
MOST_PRODUCTS: Final = 600
"""Terms of a ridge regression that are products, at most."""
SHARES: Final = (0.0, 0.3, 1.0)
"""Sizes tried of terms that are products, beside the others: less is penalised more."""

_BLOCK: Final = 2048  # rows that are held at a time as polynomial terms
_RANK_TOLERANCE: Final = 1e-10
_CHUNK: Final = 4096  # the same, of a ridge regression
_FAR: Final = 6.0  # standard deviations, beyond which a row is not fitted to
_NORMAL: Final = 0.6745  # median of a normal error's size, over its standard deviation
_MOST_FAR: Final = 0.05  # share of the rows that may be; more of them are no exceptions
_ROUNDS: Final = 5


@dataclass(eq=False, repr=False)
class Polynomial(JointRegressor):
    """Least squares on all products of up to `degree` features, or a ridge regression.

    Peng2024, II-C, has the constant (`degree` 0), the linear (1) and the quadratic model (2). Terms
    that the data do not tell apart (a constant channel, two copies of a signal) share the smallest
    coefficients that fit; the intercept stays outside of that.

    A `ridge` regression has the features and products of some of them. Five parts of the rows, left
    out in turn, choose for each output a penalty and how much more products are penalised: blocks
    on end, or, where `dt` tells of fewer than five histories, a block of each.

    Parameters
    ----------
    degree : int
        Highest total degree of a term, 0 to 5; not of a ridge regression.
    ridge : bool
        Whether it is a ridge regression, which alone knows the other parameters.
    first : int, optional
        Number of features by which each of the first `crossed` is multiplied; by default all, or
        none where that makes more than 600 products.
    crossed : int, optional
        Features that are multiplied, `first` or more; by default as many as `first`.
    squared : int, optional
        Number of features by whose squares they are multiplied too; by default none.
    by_squares : int, optional
        Features that squares multiply; by default as many as `crossed`.
    penalty : float, optional
        On the squared coefficients of terms of variance 1; by default cross-validated.
    trimmed : bool
        Whether it is fitted again without rows in which it errs by more than six standard
        deviations (by the median's size), where these are a twentieth at most. They are left to
        what learns the residual: a roll is ill conditioned where the wrist is bent by a right
        angle, and a few such rows bend the model everywhere.

    Attributes
    ----------
    penalties_ : ndarray, shape (n_outputs,)
        Penalty of a ridge regression, chosen of `truejoint.estimators.polynomial.learn.PENALTIES`.
    shares_ : ndarray, shape (n_outputs,)
        The same of `SHARES`.
    errors_ : ndarray, shape (n_outputs,)
        Root mean square on the blocks that were left out, in standard deviations of the target.

    Examples
    --------
    >>> X = np.linspace(-1.0, 1.0, 50)[:, None]
    >>> Polynomial().fit(X, X[:, 0] ** 2).predict([[0.5]]).round(6)
    array([0.25])
    >>> Polynomial(0).fit(X, X[:, 0] + 2.0).predict([[0.5]]).round(6)
    array([2.])
    >>> X = np.random.default_rng(0).normal(size=(500, 2))
    >>> Polynomial(ridge=True).fit(X, X[:, 0] * X[:, 1]).predict([[2.0, 0.5]]).round(2)
    array([1.])
    """

    training: ClassVar[Mapping[str, Rule]] = {
        "trimmed": one_of(False, True), "penalty": optional(number(0.0, 1e12))
    }  # fmt: skip
    degree: int = 2
    ridge: bool = False
    first: int | None = None
    crossed: int | None = None
    squared: int = 0
    by_squares: int | None = None
    trimmed: bool = False
    penalty: float | None = None

    @property
    def family(self) -> Family:  # type: ignore[override]  # by a parameter
        """Family that runs it; a constant corrects an error alone."""
        return FAMILY.of(self.model_params())

    @property
    def partial(self) -> bool:  # type: ignore[override]  # by a parameter
        """Whether a target that is NaN is left out, and its row's others are not."""
        return not self.ridge

    def model_params(self) -> Params:
        """Parameters of the family: by default, the products for what it is fitted to."""
        if not self.ridge:
            return {**of_degree(self.degree), "ridge": self.ridge}
        k = int(vars(self).get("n_features_in_", 0))
        usual = k if k * (k + 1) // 2 <= MOST_PRODUCTS else 0
        first = usual if self.first is None else self.first
        crossed = first if self.crossed is None else self.crossed
        by_squares = crossed if self.by_squares is None else self.by_squares
        return {
            "degree": self.degree, "ridge": self.ridge, "first": first, "crossed": crossed,
            "squared": self.squared, "by_squares": by_squares if self.squared else 0,
        }  # fmt: skip

    def minimum_rows(self, n_features: int) -> int:
        """Ten rows for each coefficient of a joint, two for each input of a ridge regression."""
        if self.ridge:
            return max(100, 2 * n_features)
        return ROWS_PER_COEFFICIENT * math.comb(n_features + int(self.degree), int(self.degree))

    def _learn(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        factors = factors_of(self.model_params(), X.shape[1])
        mean, inverse_scale = base.standardisation(X)
        scaled = (X - mean) * inverse_scale
        if self.ridge:
            centre, scale = base.target_scaling(y)
            table = scale * self._penalised(scaled, (y - centre) / scale, dt, factors, progress)
            coef, intercept = table[1:], table[0] + centre
        else:
            parts = base.labelled_parts(y)
            n = len(parts)
            fits = [
                least_squares(
                    scaled[rows], y[rows, outputs], factors, base.share_of(progress, i, n)
                )
                for i, (rows, outputs) in enumerate(parts)
            ]
            coef, intercept = map(np.hstack, zip(*fits, strict=True))
        coef = np.ascontiguousarray(coef)
        return {"mean": mean, "inverse_scale": inverse_scale, "coef": coef, "intercept": intercept}

    def _penalised(
        self, scaled: Array, targets: Array, dt: Array, factors: Integers, progress: Progress
    ) -> Array:
        """Coefficients (1 + n_terms, n_outputs) of the ridge regression, constants first."""
        products = np.array([_products(scaled[b], targets[b], factors) for b in blocks(dt)])
        is_product = factors[:, 1] < scaled.shape[1]
        shares = SHARES if is_product.any() and self.penalty is None else SHARES[-1:]
        weights = [np.where(is_product, share, 1.0) for share in shares]
        penalties = PENALTIES if self.penalty is None else (float(self.penalty),)
        fit = cross_validated(products, weights, progress, penalties)
        self.shares_, self.penalties_ = np.array(shares)[fit.weights], fit.penalties
        self.errors_ = np.sqrt(np.maximum(fit.errors, 0.0) / len(scaled))
        if not self.trimmed:
            return fit.coefficients
        chosen = np.array(weights)[fit.weights]
        return _without_far(scaled, targets, factors, products.sum(axis=0), chosen, fit)

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.regressor_tags.poor_score = self.degree == 0 and not self.ridge
        return tags


@dataclass(eq=False, repr=False)
class Raw(Polynomial):
    """No correction: a fixed offset of 0, of the error."""

    degree: int = 0

    @property
    def name(self) -> str:
        """Name in tables."""
        return registry.RAW

    def _learn(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        arrays = super()._learn(X, y, dt, progress)
        return arrays | {"intercept": np.zeros(y.shape[1])}


def polynomial_design(scaled: Array, factors: NDArray[np.int64]) -> Array:
    """Terms (n, n_terms) of scaled features (n, k)."""
    with_one = np.column_stack([scaled, np.ones(len(scaled))])  # the last is the factor 1
    design = with_one[:, factors[:, 0]]
    for factor in factors.T[1:]:
        design *= with_one[:, factor]
    return design


def least_squares(
    scaled: Array, y: Array, factors: Integers, progress: Progress
) -> tuple[Array, Array]:
    """Coefficients (m, n_outputs) and intercept (n_outputs,) of least squares on m terms.

    Terms and targets of some rows after the other are folded into one triangular factor, so memory
    does not grow with their number; with a column of ones in front, the factor below its first row
    is that of the centred columns. Directions below 1e-10 of the strongest, columns of unit length,
    are left out (minimum norm).
    """
    m, n_rows = len(factors), len(scaled)
    if not m:
        progress(1.0)
        return np.zeros((0, y.shape[1])), y.mean(axis=0)
    factor = np.zeros((0, 1 + m + y.shape[1]))
    done = 0
    for table in _tables(scaled, y, factors, _BLOCK):
        stack = np.vstack([factor, table])
        factor = np.asarray(np.linalg.qr(stack, mode="r"))
        done += len(table)
        progress(done / n_rows)
    centred = factor[1 : m + 1, 1 : m + 1]
    length = np.linalg.norm(centred, axis=0)
    varies = length > _RANK_TOLERANCE * math.sqrt(n_rows)  # of terms of order one
    inverse = np.divide(1.0, length, out=np.zeros(m), where=varies)
    coef, right = np.zeros((m, factor.shape[1] - m - 1)), factor[1 : m + 1, m + 1 :]
    if varies.any():
        solution = scipy.linalg.lstsq(centred * inverse, right, cond=_RANK_TOLERANCE)[0]
        coef = np.asarray(solution) * inverse[:, None]
    intercept = (factor[0, m + 1 :] - factor[0, 1 : m + 1] @ coef) / factor[0, 0]
    return coef, intercept


def _tables(scaled: Array, y: Array, factors: Integers, size: int) -> Iterator[Array]:
    """Give columns of 1, the terms and the targets, for so many rows at a time."""
    for start in range(0, len(scaled), size):
        terms = polynomial_design(scaled[start : start + size], factors)
        yield np.column_stack([np.ones(len(terms)), terms, y[start : start + size]])


def _products(scaled: Array, y: Array, factors: Integers) -> Array:
    """Give sums (m, m) of products of every two of: 1, the terms, the targets."""
    width = 1 + len(factors) + y.shape[1]
    total = np.zeros((width, width))
    for table in _tables(scaled, y, factors, _CHUNK):
        total += table.T @ table
    return total


def _without_far(
    scaled: Array, y: Array, factors: Integers, products: Array, weights: Array, fit: "PenalisedFit"
) -> Array:
    """Coefficients (1 + n_terms, n_outputs), each output fitted again without rows far off.

    `products` (m, m) are the sums of `_products` over all rows, `weights` (n_outputs, n_terms)
    those of the terms; penalties stay.
    """
    table, n_terms = fit.coefficients.copy(), len(factors)
    before = np.zeros(y.shape, dtype=bool)
    for _ in range(_ROUNDS):
        chunks = (scaled[i : i + _CHUNK] for i in range(0, len(scaled), _CHUNK))
        values = [table[0] + polynomial_design(rows, factors) @ table[1:] for rows in chunks]
        residuals = np.abs(y - np.concatenate(values))
        far = residuals > _FAR / _NORMAL * np.median(residuals, axis=0)
        far &= far.mean(axis=0) <= _MOST_FAR
        for j in np.flatnonzero((far != before).any(axis=0)):
            rows = np.flatnonzero(far[:, j])
            inliers = products - _products(scaled[rows], y[rows], factors)
            places = [*range(1 + n_terms), 1 + n_terms + j]
            inner = inliers[np.ix_(places, places)]
            table[:, j] = solutions(inner, weights[j], 1, (fit.penalties[j],))[0, :, 0]
        if (far == before).all():
            break
        before = far
    return table


class PenalisedFit(NamedTuple):
    """Ridge regression of some outputs on terms, and what was chosen for each output."""

    coefficients: Array  # (1 + n_terms, n_outputs), constants first
    penalties: Array  # (n_outputs,), chosen of `PENALTIES`
    weights: Integers  # (n_outputs,), which of the weights tried were chosen
    errors: Array  # (n_outputs,), sum of squared errors on what was left out


def cross_validated(
    products: Array,
    weights: Sequence[Array],
    progress: Progress = base.untold,
    penalties: Sequence[float] = PENALTIES,
) -> PenalisedFit:
    """Fit with the penalty, and the weights of terms, that err least on blocks left out in turn.

    `products` (n_blocks, m, m) are, for each block of rows, the sums of products of every two of:
    1, the terms, the outputs. Of `weights`, each (n_terms,), and `penalties` all are tried; one
    penalty alone is taken. A term of weight 1 is penalised as one of variance 1, to which it is
    scaled; a smaller weight is penalised more, by its square; 0 leaves
    the term out.
    """
    n_outputs = products.shape[1] - 1 - len(weights[0])
    errors = np.zeros((len(weights), len(penalties), n_outputs))
    whole = products.sum(axis=0)
    for place, trial in enumerate(weights):
        for block in products:
            tables = solutions(whole - block, trial, n_outputs, penalties)
            for at, table in enumerate(tables):
                residual_of = np.vstack([-table, np.eye(n_outputs)])
                errors[place, at] += np.sum(residual_of * (block @ residual_of), axis=0)
        progress((place + 1) / len(weights))
    flat = errors.reshape(-1, n_outputs)
    chosen, penalty = np.unravel_index(flat.argmin(axis=0), errors.shape[:2])
    fits = {place: solutions(whole, weights[place], n_outputs, penalties) for place in set(chosen)}
    columns = [fits[chosen[j]][penalty[j]][:, j] for j in range(n_outputs)]
    return PenalisedFit(np.array(columns).T, np.array(penalties)[penalty], chosen, flat.min(axis=0))


def ridge(columns: Array, y: Array, penalty: float) -> tuple[Array, float]:
    """Ridge regression on standardised columns (n, k): weights (k,) of the columns, and constant.

    The constant is not penalised.
    """
    mean, inverse = base.standardisation(columns)
    scaled = (columns - mean) * inverse
    constant = float(y.mean())
    gram = scaled.T @ scaled / len(y) + penalty * np.eye(scaled.shape[1])
    weights = np.linalg.solve(gram, scaled.T @ (y - constant) / len(y)) * inverse
    return np.asarray(weights), constant - float(weights @ mean)


def solutions(products: Array, weights: Array, n_outputs: int, penalties: Sequence[float]) -> Array:
    """Constants and coefficients (n_penalties, 1 + n_terms, n_outputs) for every penalty.

    Terms, of which there are the sums of `products` (m, m), are scaled to variance 1, unless that
    is switched off, then by `weights` (n_terms,).
    """
    n_terms, n = len(weights), products[0, 0]
    mean = products[0] / n
    spread = products / n - np.outer(mean, mean)
    terms, targets = slice(1, 1 + n_terms), slice(1 + n_terms, None)
    variance = np.diag(spread)[terms]
    deviation = np.sqrt(np.maximum(variance, 0.0))
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
