"""A Gaussian process by a few inducing points: a sum of bells, one kernel for each output.

Where the features leave what it was fitted to, every bell is 0 and the mean is predicted.
"""

from collections.abc import Mapping
from typing import Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled, fill, matrix, unrolled, wide
from truejoint.estimators.family import Family, Shape
from truejoint.estimators.network.run import scaling_shapes
from truejoint.estimators.rules import Params, integer
from truejoint.layout import Layout, Memory
from truejoint.products import BLOCK, add_product, padded, standardise

MAX_POINTS: Final = 4096
DOUBLINGS: Final = 8  # of an exponent, from where seven terms of a series do
SMALL: Final = -0.5 / 2**DOUBLINGS
FARTHEST: Final = 80.0  # square of a distance; beyond it, a bell is 0 within rounding

LAYOUT: Final = Layout().declare("truejoint.estimators.network", "scaling")
LAYOUT.declare(__package__, "gp", BLOCK=BLOCK)
unpack = LAYOUT.unpacker()


@compiled
def gaussian_process_row(
    numbers: Integers, memory: Array, dt: float, x: Array, out: Array, half_width: Array
) -> None:
    """Predict a weighted sum of ``exp(-d**2 / 2)``, `d` the distance to each point in lengths."""
    m = unpack(numbers, memory)
    k, width = m.n_features, m.width
    standardise(x, m.mean, m.inverse_scale, m.scaled)
    for j in range(out.shape[0]):
        inverse = m.inverse_lengths[j]
        for i in range(k):
            m.lengths[i] = m.scaled[i] * inverse[i]
        add_squares(m.lengths, matrix(m.points, j * k * width, k, width), m.bells)
        to_bells(m.bells)
        fill(m.sums, BLOCK, 0.0)
        add_product(m.bells, matrix(m.weights, j * width * BLOCK, width, BLOCK), m.sums)
        out[j] = m.target_mean[j] + m.target_scale[j] * m.sums[0]


@compiled
@wide
def add_squares(x: Array, points: Array, out: Array) -> None:
    """Add up squared distances (m,) of `x` (k,) from the columns of `points` (k, m), from 0 on."""
    for j in range(points.shape[1]):
        out[j] = 0.0
    for i in range(points.shape[0]):
        feature, row = x[i], points[i]
        for j in range(points.shape[1]):
            away = feature - row[j]
            out[j] += away * away


@compiled
@wide
def to_bells(values: Array) -> None:
    """Replace squares (m,) by ``exp(-square / 2)``, within 1e-15, by sums and products alone.

    They become vector instructions, which a call of a C library's `exp` does not. A series gives
    ``y = exp(v) - 1`` for a small v, and ``y * (2 + y)`` is the same for twice that v. Rounding is
    relative to y, not to 1 + y, so that the doublings do not add up.
    """
    for j in range(values.shape[0]):
        v = min(values[j], FARTHEST) * SMALL
        y = v * (1.0 + v * (1.0 / 2.0 + v * (1.0 / 6.0 + v * (1.0 / 24.0 + v * (
            1.0 / 120.0 + v * (1.0 / 720.0 + v * (1.0 / 5040.0)))))))  # fmt: skip
        for _ in range(unrolled(DOUBLINGS)):
            y = y * (2.0 + y)
        values[j] = 1.0 + y


def _shapes(params: Params, n_features: int, n_outputs: int) -> dict[str, Shape]:
    points = int(params["points"])
    return {
        **scaling_shapes(n_features, n_outputs),
        "inverse_lengths": (n_outputs, n_features),
        "points": (points, n_features),
        "weights": (n_outputs, points),
    }


def _pack(params: Params, arrays: Mapping[str, Array], k: int, n: int) -> Memory:
    n_points = int(params["points"])
    inverse = arrays["inverse_lengths"]
    points = padded((arrays["points"] * inverse[:, None]).transpose(0, 2, 1))
    weights = padded(padded(arrays["weights"])[..., None])
    return LAYOUT.pack(
        **{name: arrays[name] for name in scaling_shapes(k, n)},
        inverse_lengths=inverse,
        points=points.ravel(),
        weights=weights.ravel(),
        bells=np.zeros(n_points + -n_points % BLOCK),
    )


FAMILY: Final = Family(
    "gp",
    rules={"points": integer(2, MAX_POINTS)},
    shapes=_shapes,
    pack=_pack,
    row=gaussian_process_row,
)
