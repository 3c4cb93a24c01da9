"""Values that are made of arrays, as a model file holds them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any, TypeVar

import numpy as np

from truejoint.array_types import Array
from truejoint.errors import ModelFileError

Value = TypeVar("Value")


def encode_arrays(value: Any) -> dict[str, Array]:
    """Fields of a dataclass by name, numbers as arrays of one element."""
    return {
        field.name: np.atleast_1d(np.asarray(getattr(value, field.name), dtype=np.float64))
        for field in fields(value)
    }


def decode_arrays(
    kind: type[Value], what: str, arrays: Mapping[str, Array], shapes: Mapping[str, tuple[int, ...]]
) -> Value:
    """Inverse of `encode_arrays`; a field that `shapes` does not name is a number.

    Raises ModelFileError, of `what`, when names or shapes are not these, or a number is not finite.
    """
    types = {field.name: str(field.type) for field in fields(kind)}  # type: ignore[arg-type]
    if {name: a.shape for name, a in arrays.items()} != {n: shapes.get(n, (1,)) for n in types}:
        raise ModelFileError(f"the arrays of the {what} are not those of the model")
    if not all(np.isfinite(array).all() for array in arrays.values()):
        raise ModelFileError(f"the {what} is not finite")
    values: dict[str, Any] = dict(arrays)
    for name, of in types.items():
        if of in ("float", "int"):
            number = float(arrays[name][0])
            values[name] = number if of == "float" else int(min(number, 1e9))
    return kind(**values)
