"""Products of a row with a matrix, in an order that any compiler turns into vector instructions."""

import numpy as np

from truejoint.array_types import Array
from truejoint.compiled import compiled, copy, inlined, wide

BLOCK = 4
"""Columns of a matrix are filled up with zeros to a multiple of this."""


def padded(array: Array, axes: int = 1) -> Array:
    """Fill the last axis, or so many last `axes`, up with zeros to a multiple of `BLOCK`."""
    lengths = enumerate(array.shape, start=axes - array.ndim)
    return np.pad(array, [(0, -n % BLOCK if place >= 0 else 0) for place, n in lengths])


@compiled
def weighted(row: Array, weights: Array) -> float:
    """Sum of products, column by column; numba's own would load SciPy's BLAS into the loop."""
    total = 0.0
    for i in range(weights.shape[0]):
        total += row[i] * weights[i]
    return total


@inlined
def standardise(x: Array, mean: Array, inverse_scale: Array, out: Array) -> None:
    """Features `x` (k,) less their mean, times the inverse scale, into `out`."""
    for i in range(x.shape[0]):
        out[i] = (x[i] - mean[i]) * inverse_scale[i]


@inlined
def rescale(x: Array, mean: Array, scale: Array, out: Array) -> None:
    """Undo `standardise` for outputs: times the scale, plus the mean."""
    for j in range(out.shape[0]):
        out[j] = mean[j] + scale[j] * x[j]


@compiled
def layer(source: Array, weight: Array, bias: Array, target: Array) -> None:
    """Weigh inputs: ``source @ weight + bias`` into `target`, by `add_product`."""
    copy(bias, target, target.shape[0])
    add_product(source, weight, target)


@compiled
@wide
def add_product(x: Array, matrix: Array, out: Array) -> None:
    """Add ``x @ matrix`` (m,) to `out` for `x` (n,), m a multiple of 4.

    Eight rows in one pass over the columns, summed in pairs, so that no addition waits for seven
    others; one order of sums for one row, a whole recording and C.
    """
    n, m = matrix.shape[0], matrix.shape[1]
    whole = n - n % 8
    for i in range(0, whole, 8):
        a, b, c, d = x[i], x[i + 1], x[i + 2], x[i + 3]
        e, f, g, h = x[i + 4], x[i + 5], x[i + 6], x[i + 7]
        row_a, row_b, row_c, row_d = matrix[i], matrix[i + 1], matrix[i + 2], matrix[i + 3]
        row_e, row_f, row_g, row_h = matrix[i + 4], matrix[i + 5], matrix[i + 6], matrix[i + 7]
        for j in range(m):
            out[j] += ((a * row_a[j] + b * row_b[j]) + (c * row_c[j] + d * row_d[j])) + (
                (e * row_e[j] + f * row_f[j]) + (g * row_g[j] + h * row_h[j])
            )
    for i in range(whole, n):
        a = x[i]
        row_a = matrix[i]
        for j in range(m):
            out[j] += a * row_a[j]


@compiled
def add_triangle(x: Array, matrix: Array, out: Array) -> None:
    """Add ``x @ matrix`` to `out` (n,) for a lower triangle (n, n), n a multiple of 4."""
    for i in range(0, matrix.shape[0], 4):
        a, b, c, d = x[i], x[i + 1], x[i + 2], x[i + 3]
        row_a, row_b, row_c, row_d = matrix[i], matrix[i + 1], matrix[i + 2], matrix[i + 3]
        for first in range(0, i + 4, 4):
            for j in range(first, first + 4):
                out[j] += (a * row_a[j] + b * row_b[j]) + (c * row_c[j] + d * row_d[j])
