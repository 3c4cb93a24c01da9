"""A fixed offset, whatever the features: peng2024, II-C."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from truejoint.compiled import Array, Integers, compiled, vector
from truejoint.layout import Layout, Memory
from truejoint.models.family import Family, Params

LAYOUT: Final = Layout()
OFFSET: Final = LAYOUT.array("offset", "what is predicted")


@compiled
def offset_row(
    numbers: Integers, memory: Array, dt: float, x: Array, out: Array, half_width: Array
) -> None:
    """Predict a fixed offset."""
    offset = vector(memory, numbers[OFFSET], out.shape[0])
    for j in range(out.shape[0]):
        out[j] = offset[j]


def _pack(_params: Params, arrays: Mapping[str, Array], _k: int, _n: int) -> Memory:
    return LAYOUT.pack(offset=arrays["offset"])


FAMILY: Final = Family(
    "offset",
    rules={},
    shapes=lambda _params, _n_features, n_outputs: {"offset": (n_outputs,)},
    pack=_pack,
    row=offset_row,
    targets=("error",),
    moved_by="offset",
)
