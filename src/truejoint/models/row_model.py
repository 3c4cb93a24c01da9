"""What the loop knows of an estimator: two flat arrays and one compiled function."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from truejoint.filters.memory import address

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

_INTEGERS = types.int64[::1]
_ARRAY = types.float64[::1]
ROW: Final = types.void(_INTEGERS, _ARRAY, types.float64, _ARRAY, _ARRAY, _ARRAY)
"""Signature of a row function: see `row_models.offset_row` for its arguments."""


@dataclass(frozen=True, eq=False)
class RowModel:
    """A fitted estimator as a row function takes it.

    Attributes
    ----------
    function : object
        Compiled, of signature `ROW`.
    numbers : ndarray of int, 1-D
    memory : ndarray, 1-D
        Coefficients, room to work in and, for a model that remembers, its state.
    deviations : int, optional
        Where in `memory` stands how many standard deviations of its own the model puts out as
        half-width, 0 for none; None for a model that knows no standard deviation.
    """

    function: Any
    numbers: Integers
    memory: Array
    deviations: int | None = None

    def address(self) -> int:
        """Address of the compiled function; compiles it, or takes it from disk."""
        return address(self.function, ROW)


def _call(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    parameters = [context.get_value_type(kind) for kind in signature.args[1:]]
    pointer = ir.FunctionType(ir.VoidType(), parameters).as_pointer()
    builder.call(builder.inttoptr(args[0], pointer), list(args[1:]))
    return context.get_dummy_value()


@intrinsic
def call_row(
    _typing: Any,
    function: Any,  # noqa: ARG001 - numba reads the arguments of an intrinsic from its parameters
    numbers: Any,  # noqa: ARG001
    memory: Any,  # noqa: ARG001
    interval: Any,  # noqa: ARG001
    features: Any,  # noqa: ARG001
    out: Any,  # noqa: ARG001
    half_width: Any,  # noqa: ARG001
) -> Any:
    """Call the row function at an address."""
    return types.void(types.int64, *ROW.args), _call
