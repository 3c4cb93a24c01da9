"""A fixed offset, whatever the features: peng2024, II-C."""

from __future__ import annotations

from typing import Final

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled, copy, vector
from truejoint.estimators.family import Family
from truejoint.layout import Layout

LAYOUT: Final = Layout()
OFFSET: Final = LAYOUT.array("offset", "what is predicted")


@compiled
def offset_row(
    numbers: Integers, memory: Array, dt: float, x: Array, out: Array, half_width: Array
) -> None:
    """Predict a fixed offset."""
    n = out.shape[0]
    copy(vector(memory, numbers[OFFSET], n), out, n)


FAMILY: Final = Family(
    "polynomial.offset",
    rules={},
    shapes=lambda _params, _n_features, n_outputs: {"offset": (n_outputs,)},
    pack=lambda _params, arrays, _k, _n: LAYOUT.pack(**arrays),
    row=offset_row,
    targets=("error",),
)
