# ruff: noqa: ARG001 - numba reads the types of an intrinsic's arguments from its parameter names
"""One filter's memory: two flat arrays, their layout, and calls through addresses.

A filter keeps its integers in `numbers` and everything else in `memory`; `numbers` says at which
offset of `memory` each vector and matrix starts. Passing two arrays keeps a call from Python near a
microsecond, and a C structure can mirror the layout field by field. A model's functions are called
through their addresses, so that one compiled filter, cached on disk, serves every model.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.experimental.function_type import _get_wrapper_address
from numba.extending import intrinsic
from numba.np.arrayobj import make_array, populate_array

from truejoint.compiled import compiled

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

_VECTOR = types.float64[::1]
_MATRIX = types.float64[:, ::1]
TRANSITION: Final = types.void(_VECTOR, _VECTOR, types.float64, _VECTOR, _VECTOR)
MEASUREMENT: Final = types.void(_VECTOR, _VECTOR, _VECTOR, _VECTOR)
PROCESS_NOISE: Final = types.void(_VECTOR, _VECTOR, types.float64, _VECTOR, _MATRIX)

# Fields of `numbers`.
N: Final = 0  # states
M: Final = 1  # measurements
INPUTS: Final = 2
PARAMETERS: Final = 3
F: Final = 4  # address of the transition
H: Final = 5  # address of the measurement function
G: Final = 6  # address of the process noise function, 0 for a constant matrix
SECOND: Final = 7  # 1: draw sigma points again after the prediction
ROOT: Final = 8  # 1: square-root form
PATIENCE: Final = 9  # measurements gated in a row before one is taken all the same
REJECTED: Final = 10  # measurements gated in a row so far
POINTS: Final = 11  # points around the centre now in DEVIATIONS
OBSERVED: Final = 12  # components of the measurement in use in this step
_OFFSETS: Final = 13

# Fields of `memory`.
REACH: Final = 0
ROOT_WEIGHT: Final = 1  # square root of a point's weight, sqrt(1/2) / reach
CORRECTION: Final = 2
ROOT_CORRECTION: Final = 3  # square root of its magnitude
DT: Final = 4
NIS: Final = 5
LOGLIK: Final = 6
INFLATION: Final = 7
_BLOCKS: Final = 8

# Blocks of `memory`; numbers[BLOCK] is where one starts.
X: Final = _OFFSETS
P: Final = _OFFSETS + 1
S: Final = _OFFSETS + 2  # lower factor of P
Z: Final = _OFFSETS + 3
U: Final = _OFFSETS + 4
THETA: Final = _OFFSETS + 5  # parameters
INNOVATION: Final = _OFFSETS + 6
Q: Final = _OFFSETS + 7  # lower factor of the process noise
R: Final = _OFFSETS + 8  # lower factor of the measurement noise
GATE: Final = _OFFSETS + 9  # NIS limit for 0, 1, ... m components, all 0 without a gate
X_MEAN: Final = _OFFSETS + 10  # predicted state
P_MEAN: Final = _OFFSETS + 11
S_MEAN: Final = _OFFSETS + 12
CENTRE: Final = _OFFSETS + 13  # image of the centre point
SHIFT: Final = _OFFSETS + 14  # predicted state minus centre
DEVIATIONS: Final = _OFFSETS + 15  # points minus centre, as rows
Z_DEVIATIONS: Final = _OFFSETS + 16
Z_SHIFT: Final = _OFFSETS + 17
Z_MEAN: Final = _OFFSETS + 18
P_ZZ: Final = _OFFSETS + 19
S_ZZ: Final = _OFFSETS + 20
GAIN: Final = _OFFSETS + 21
WHITE: Final = _OFFSETS + 22  # innovation divided by its factor
STACK: Final = _OFFSETS + 23
DEFICIT: Final = _OFFSETS + 24
POINT: Final = _OFFSETS + 25
IMAGE: Final = _OFFSETS + 26
NOISE: Final = _OFFSETS + 27
ANGLES: Final = _OFFSETS + 28  # in `numbers`: 1 for each state that is an angle, then measurements
CHOSEN: Final = _OFFSETS + 29  # in `numbers`: which components of the measurement are in use
_LISTS: Final = _OFFSETS + 30


def allocate(n: int, m: int, inputs: int, parameters: int) -> tuple[Integers, Array]:
    """Memory of a filter, zero but for sizes and offsets.

    Parameters
    ----------
    n, m, inputs, parameters : int
        Numbers of states, measurements, control inputs and model parameters.

    Returns
    -------
    numbers : (k,) int64 array
        Sizes, addresses, switches, counters and offsets.
    memory : (l,) array
        Scalars, then every vector and matrix, row by row.
    """
    widest = max(n, m)
    sizes = {
        X: n, P: n * n, S: n * n, Z: m, U: inputs, THETA: parameters, INNOVATION: m,
        Q: n * n, R: m * m, GATE: m + 1, X_MEAN: n, P_MEAN: n * n, S_MEAN: n * n,
        CENTRE: n, SHIFT: n, DEVIATIONS: 4 * n * n, Z_DEVIATIONS: 4 * n * m, Z_SHIFT: m,
        Z_MEAN: m, P_ZZ: m * m, S_ZZ: m * m, GAIN: n * m, WHITE: m,
        STACK: (5 * n + m + 1) * widest, DEFICIT: widest, POINT: n, IMAGE: widest, NOISE: n * n,
    }  # fmt: skip
    numbers = np.zeros(_LISTS + n + 2 * m, dtype=np.int64)
    numbers[[N, M, INPUTS, PARAMETERS]] = n, m, inputs, parameters
    numbers[ANGLES] = _LISTS
    numbers[CHOSEN] = _LISTS + n + m
    offset = _BLOCKS
    for block, size in sizes.items():
        numbers[block] = offset
        offset += size
    memory = np.zeros(offset)
    memory[INFLATION] = 1.0
    return numbers, memory


def address(function: Any, signature: Any) -> int:
    """Address at which a compiled function can be called; compiles it if it is not yet.

    Parameters
    ----------
    function : numba dispatcher
        Made with `numba.njit`.
    signature : numba signature
        Types of its arguments.

    Returns
    -------
    int
        Valid as long as `function` lives.
    """
    function.compile(signature)
    return int(_get_wrapper_address(function, signature))


def _call(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    parameters = [context.get_value_type(kind) for kind in signature.args[1:]]
    pointer = ir.FunctionType(ir.VoidType(), parameters).as_pointer()
    builder.call(builder.inttoptr(args[0], pointer), list(args[1:]))
    return context.get_dummy_value()


@intrinsic
def call_transition(
    _typing: Any, function: Any, x: Any, u: Any, dt: Any, parameters: Any, out: Any
) -> Any:
    """Call the transition at an address."""
    return types.void(types.int64, *TRANSITION.args), _call


@intrinsic
def call_measurement(_typing: Any, function: Any, x: Any, u: Any, parameters: Any, out: Any) -> Any:
    """Call the measurement function at an address."""
    return types.void(types.int64, *MEASUREMENT.args), _call


@intrinsic
def call_process_noise(
    _typing: Any, function: Any, x: Any, u: Any, dt: Any, parameters: Any, out: Any
) -> Any:
    """Call the process noise function at an address."""
    return types.void(types.int64, *PROCESS_NOISE.args), _call


def _view(context: Any, builder: Any, signature: Any, args: Any, lengths: list[Any]) -> Any:
    source = make_array(signature.args[0])(context, builder, args[0])
    view = make_array(signature.return_type)(context, builder)
    width = context.get_constant(types.intp, 8)
    strides = [width] if len(lengths) == 1 else [builder.mul(lengths[1], width), width]
    populate_array(
        view,
        data=builder.gep(source.data, [args[1]]),
        shape=lengths,
        strides=strides,
        itemsize=width,
        meminfo=None,
    )
    return view._getvalue()


@intrinsic
def vector(_typing: Any, memory: Any, offset: Any, length: Any) -> Any:
    """View of `length` numbers of a 1-D array from `offset` on, without counting references."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return _view(context, builder, signature, args, [args[2]])

    return types.Array(memory.dtype, 1, "C")(memory, types.intp, types.intp), generate


@intrinsic
def integers(_typing: Any, numbers: Any, offset: Any, length: Any) -> Any:
    """View of `length` integers of `numbers` from `offset` on, without counting references."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return _view(context, builder, signature, args, [args[2]])

    return types.int64[::1](numbers, types.intp, types.intp), generate


@intrinsic
def matrix(_typing: Any, memory: Any, offset: Any, rows: Any, columns: Any) -> Any:
    """View of `memory` from `offset` on as a matrix, row by row, without counting references."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return _view(context, builder, signature, args, [args[2], args[3]])

    return _MATRIX(memory, types.intp, types.intp, types.intp), generate


@intrinsic
def borrow(_typing: Any, array: Any) -> Any:
    """Lend an array without its reference count, which every call would change atomically.

    The caller holds on to the array while the borrowed one is in use.
    """

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        borrowed = make_array(signature.args[0])(context, builder, args[0])
        borrowed.meminfo = ir.Constant(borrowed.meminfo.type, None)
        borrowed.parent = ir.Constant(borrowed.parent.type, None)
        return borrowed._getvalue()

    return array(array), generate


@compiled
def copy(source: Array, target: Array, count: int) -> None:
    """Copy numbers one by one; NumPy's `target[:] = source` compiles for seconds."""
    for i in range(count):
        target[i] = source[i]


@compiled
def fill(target: Array, count: int, value: float) -> None:
    """Write one value into `count` elements."""
    for i in range(count):
        target[i] = value
