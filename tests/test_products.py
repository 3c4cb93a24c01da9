"""Products in blocks of four are products, and their bits do not depend on the number of rows."""

import numpy as np
import pytest

from truejoint.products import BLOCK, add_product, add_triangle, padded


@pytest.mark.parametrize("n", range(10))
@pytest.mark.parametrize("m", [1, 3, 4, 9])
def test_a_padded_product_is_a_product(n, m):
    rng = np.random.default_rng(n)
    x, matrix, start = rng.normal(size=n), rng.normal(size=(n, m)), rng.normal(size=m)
    wide, out = padded(matrix), padded(start)
    add_product(x, wide, out)
    np.testing.assert_allclose(out[:m], start + x @ matrix, rtol=1e-13, atol=1e-13)
    assert not out[m:].any()
    assert len(out) % BLOCK == 0


@pytest.mark.parametrize("n", [1, 4, 6, 11])
def test_a_padded_triangle_is_a_triangle(n):
    rng = np.random.default_rng(n)
    matrix = padded(np.tril(rng.normal(size=(n, n))), axes=2)
    x, out = padded(rng.normal(size=n)), np.zeros(len(matrix))
    add_triangle(x, matrix, out)
    np.testing.assert_allclose(out, x @ matrix, rtol=1e-13, atol=1e-13)
