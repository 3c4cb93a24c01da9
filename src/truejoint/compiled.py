# ruff: noqa: ARG001 - numba reads the types of an intrinsic's arguments from its parameter names
"""How kernels are compiled, see parts of flat arrays, and are called through their addresses."""

import hashlib
import importlib
import inspect
import logging
import math
import re
import sys
import time
from collections import namedtuple
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any, Final, TypeVar, cast

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import njit, types
from numba.core import cgutils, event
from numba.core.caching import FunctionCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.extending import _Intrinsic
from numba.core.registry import CPUDispatcher
from numba.experimental.function_type import _get_wrapper_address
from numba.extending import intrinsic, typeof_impl
from numba.np.arrayobj import make_array, populate_array

from truejoint.array_types import Array, Integers

Kernel = TypeVar("Kernel", bound=Callable[..., object])

VECTOR = types.float64[::1]
INTEGERS = types.int64[::1]
MATRIX = types.float64[:, ::1]


class _PartLibrary(JITCodeLibrary):  # type: ignore[misc]  # numba has no types
    """Code of a kernel for its callers alone, which optimise it with their own.

    numba would optimise a kernel, and turn it into machine code, before it goes into a caller where
    all of that is done again: of kernels within kernels, most of the time to compile.
    """

    @property
    def codegen(self) -> Any:
        return self

    def set_env(self, name: str, environment: Any) -> None:
        """Do nothing: kernels have no Python objects among their constants."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


class _PartCompiler(Compiler):  # type: ignore[misc]  # numba has no types
    def define_pipelines(self) -> Any:
        state = self.state
        state.library = _PartLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        return super().define_pipelines()


@typeof_impl.register(CPUDispatcher)
def _as_called(kernel: Any, context: Any) -> Any:
    """Type of a kernel where another calls it: that of its part, if it has one."""
    return types.Dispatcher(getattr(kernel, "part", kernel))


@cache
def _take_blas_for_granted() -> None:
    """Let numba import scipy's BLAS when a kernel first calls it, not to see whether it is there.

    The first kernel that is loaded makes numba look, which takes longer than loading a model: a
    control loop needs none of it.
    """
    blas = "scipy.linalg.cython_blas"
    if blas not in sys.modules:
        sys.modules[blas] = ModuleType(blas)
        try:
            importlib.import_module("numba.np.arraymath")
        finally:
            del sys.modules[blas]


class _KernelCache(FunctionCache):  # type: ignore[misc]  # numba has no types
    """Machine code on disk, made anew when anything has changed that went into it.

    numba asks for the source file of the kernel alone, but callees and constants of other files
    are in the code as well: it would be wrong, or fail, where memory is laid out anew.
    """

    def __init__(self, kernel: Any) -> None:
        super().__init__(kernel)
        self._own_stamp = self._cache_file._source_stamp
        _content(kernel.__code__.co_filename)  # what has been imported, whoever edits it later

    def load_overload(self, signature: Any, target: Any) -> Any:
        _take_blas_for_granted()
        # Not when it is declared: it may call what its module declares further down.
        self._cache_file._source_stamp = self._own_stamp, _ingredients(self._py_func)
        try:
            return super().load_overload(signature, target)
        except (ImportError, AttributeError):  # it names a type that has moved since: it is stale
            self._cache_file.flush()
            return None


def _ingredients(kernel: FunctionType) -> str:
    """Digest of all that goes into the code of a kernel, the same in every process.

    These are the source files of the kernels and intrinsics that it calls, and of theirs, and the
    constants, and the fields of named tuples and members of enumerations, that any of them takes.
    """
    digest = hashlib.sha256(_content(__file__))
    functions = [kernel]
    for function in functions:  # which grow
        digest.update(_content(function.__code__.co_filename))
        for name, value in _taken(function):
            match value:
                case CPUDispatcher() | _Intrinsic():
                    callee = value.py_func if isinstance(value, CPUDispatcher) else value._defn
                    if callee not in functions:
                        functions.append(callee)
                case np.ndarray():
                    digest.update(f"{name}={value.dtype}{value.shape}".encode() + value.tobytes())
                case type():
                    fields = getattr(value, "_fields", getattr(value, "__members__", None))
                    digest.update(f"{name}={fields}".encode())
                case bool() | int() | float() | complex() | str() | np.generic():
                    digest.update(f"{name}={value!r}".encode())
    return digest.hexdigest()


def _taken(function: FunctionType) -> Iterator[tuple[str, Any]]:
    """Give what a function names of its closure, of its module, and of modules that it names."""
    codes = [function.__code__]
    for code in codes:  # which grow
        codes += [constant for constant in code.co_consts if isinstance(constant, CodeType)]
    names = {name for code in codes for name in (*code.co_names, *code.co_freevars)}
    names.update(re.findall(r"\w+", " ".join(map(str, function.__annotations__.values()))))
    scopes = [inspect.getclosurevars(function).nonlocals, function.__globals__]
    for scope in scopes:  # which grow
        named = [(name, scope[name]) for name in sorted(names & scope.keys())]
        for name, value in named:  # which grow
            if isinstance(value, tuple):
                named += [(name, element) for element in value]
            elif not isinstance(value, ModuleType):
                yield name, value
            elif all(vars(value) is not other for other in scopes):
                scopes.append(vars(value))


@cache
def _content(path: str) -> bytes:
    """Digest of a source file when its first kernel was declared."""
    try:
        return hashlib.sha256(Path(path).read_bytes()).digest()
    except OSError:  # not a file: a notebook's cell, a part of an archive
        return path.encode()


def jit(**options: Any) -> Callable[[Kernel], Kernel]:
    """Compile a kernel on its first call and keep the machine code on disk: makes a decorator.

    Where no folder for it can be written (the package's, the user's cache), it is compiled anew in
    every process, and that is said once. Divisions follow IEEE 754 (no ZeroDivisionError out of a
    loop), and sums are never reordered, so that a kernel gives the same bits for one row as for a
    whole recording. `options` are numba's.
    """
    options["error_model"] = "numpy"

    def decorate(kernel: Kernel) -> Kernel:
        made = njit(**options)(kernel)
        try:
            made._cache = _KernelCache(kernel)
        except RuntimeError:  # numba's word for a cache without a place
            _say_uncached()
        unwrapped = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
        made.part = njit(pipeline_class=_PartCompiler, **unwrapped, **options)(kernel)
        return cast("Kernel", made)

    return decorate


_COMPILING: Final = event.TimingListener()
event.register("numba:compiler_lock", _COMPILING)


def working_times() -> Array:
    """Processor and wall time (2,) [s], without what compiling and loading kernels took.

    Since any start. The smaller difference is what work takes on a quiet machine: threads side by
    side count once, and so does work while others have the processors.
    """
    compiling = _COMPILING.duration if _COMPILING.done else 0.0
    return np.array([time.process_time(), time.perf_counter()]) - compiling


@cache
def _say_uncached() -> None:
    logging.getLogger("truejoint").warning(
        "kernels are compiled anew each time, which takes a while: no folder for them can be "
        "written; set NUMBA_CACHE_DIR to one of yours"
    )


compiled = jit()
inlined = jit(forceinline=True)  # into its callers: passing many arrays costs more


@cache
def address(function: Any, signature: Any) -> int:
    """Address of a numba function, which lives as long as the process, for that signature."""
    function.compile(signature)
    return int(_get_wrapper_address(function, signature))


def call_address(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    """Code of an intrinsic whose first argument is the address of what the others go to."""
    parameters = [context.get_value_type(kind) for kind in signature.args[1:]]
    nothing = signature.return_type == types.void
    result = ir.VoidType() if nothing else context.get_value_type(signature.return_type)
    pointer = ir.FunctionType(result, parameters).as_pointer()
    result_value = builder.call(builder.inttoptr(args[0], pointer), list(args[1:]))
    return context.get_dummy_value() if nothing else result_value


def _view(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    source = make_array(signature.args[0])(context, builder, args[0])
    data = builder.gep(source.data, [args[1]])
    return _array_at(context, builder, signature.return_type, data, list(args[2:]))


def _array_at(context: Any, builder: Any, kind: Any, data: Any, lengths: list[Any]) -> Any:
    """Array of that shape over numbers that something else owns."""
    view = make_array(kind)(context, builder)
    width = context.get_constant(types.intp, 8)
    strides = [width] if len(lengths) == 1 else [builder.mul(lengths[1], width), width]
    how = {"shape": lengths, "strides": strides, "itemsize": width, "meminfo": None}
    populate_array(view, data=data, **how)
    return view._getvalue()


@intrinsic
def vector(_typing: Any, memory: Any, offset: Any, length: Any) -> Any:
    """View of `length` numbers of a 1-D array from `offset` on, without counting references."""
    return types.Array(memory.dtype, 1, "C")(memory, types.intp, types.intp), _view


@intrinsic
def matrix(_typing: Any, memory: Any, offset: Any, rows: Any, columns: Any) -> Any:
    """View of a 1-D array from `offset` on as a matrix, row by row, without counting references."""
    kind = types.Array(memory.dtype, 2, "C")
    return kind(memory, types.intp, types.intp, types.intp), _view


def unpacker(fields: tuple[tuple[str, str, int, tuple[str | int, ...]], ...]) -> Any:
    """Make an intrinsic that gives the fields of a memory by name, of `numbers` and `memory`.

    Of each field: its name; whether it is an ``integer``, a ``scalar``, an ``array`` or an array of
    ``integers``; its index; and the shape of an array, of names of integers before it and of
    numbers. Arrays are views. A number is what it was when it was unpacked.
    """
    record = namedtuple("record", [name for name, *_ in fields])  # type: ignore[misc]

    @intrinsic
    def unpack(_typing: Any, numbers: Any, memory: Any) -> Any:
        kinds = [
            types.Array(memory.dtype if kind == "array" else numbers.dtype, len(shape), "C")
            if shape else memory.dtype if kind == "scalar" else numbers.dtype
            for _, kind, _, shape in fields
        ]  # fmt: skip
        result = types.NamedTuple(kinds, record)

        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            integers, reals = (
                make_array(kind)(context, builder, array).data
                for kind, array in zip(signature.args, args, strict=True)
            )
            items: dict[str | int, Any] = {}
            for (name, kind, index, shape), made in zip(fields, kinds, strict=True):
                source = reals if kind in ("scalar", "array") else integers
                place = context.get_constant(types.intp, index)
                if not shape:
                    items[name] = builder.load(builder.gep(source, [place]))
                    continue
                start = builder.gep(source, [builder.load(builder.gep(integers, [place]))])
                lengths = [
                    context.get_constant(types.intp, n) if isinstance(n, int) else items[n]
                    for n in shape
                ]
                items[name] = _array_at(context, builder, made, start, lengths)
            return context.make_tuple(builder, result, list(items.values()))

        return result(numbers, memory), generate

    unpack.gives_fields = True  # for the C source
    return unpack


# `numpy.empty` asks the heap, which takes longer than what a kernel of a small mechanism computes.
def _local(kind: Any, *lengths: Any) -> Any:
    """Type and code of an array on the stack, whose lengths are literals."""
    shape = [length.literal_value for length in lengths]

    def generate(context: Any, builder: Any, signature: Any, _args: Any) -> Any:
        number = context.get_value_type(types.float64)
        data = cgutils.alloca_once(builder, number, size=math.prod(shape))
        sizes = [context.get_constant(types.intp, n) for n in shape]
        return _array_at(context, builder, signature.return_type, data, sizes)

    return kind(*lengths), generate


@intrinsic(prefer_literal=True)
def local_vector(_typing: Any, length: Any) -> Any:
    """Room for `length` numbers, a constant, until the kernel returns, on its stack."""
    return _local(VECTOR, length)


@intrinsic(prefer_literal=True)
def local_matrix(_typing: Any, rows: Any, columns: Any) -> Any:
    """Room for a matrix as `local_vector`, its sizes constants."""
    return _local(MATRIX, rows, columns)


@intrinsic
def borrow(_typing: Any, array: Any) -> Any:
    """Lend an array, or a tuple's, without reference counts, which every call would change.

    The caller holds on to the array while the borrowed one is in use.
    """

    def lend(context: Any, builder: Any, kind: Any, value: Any) -> Any:
        if isinstance(kind, types.BaseTuple):
            members = [
                lend(context, builder, member, builder.extract_value(value, k))
                for k, member in enumerate(kind)
            ]
            return context.make_tuple(builder, kind, members)
        if not isinstance(kind, types.Array):
            return value
        borrowed = make_array(kind)(context, builder, value)
        borrowed.meminfo = ir.Constant(borrowed.meminfo.type, None)
        borrowed.parent = ir.Constant(borrowed.parent.type, None)
        return borrowed._getvalue()

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return lend(context, builder, signature.args[0], args[0])

    return array(array), generate


# NumPy's `target[:] = source` compiles for seconds.
@compiled
def copy(source: Array | Integers, target: Array | Integers, count: int) -> None:
    """Copy the first `count` elements."""
    for i in range(count):
        target[i] = source[i]


@compiled
def fill(target: Array, count: int, value: float) -> None:
    """Write one value into the first `count` elements."""
    for i in range(count):
        target[i] = value


def wide(kernel: Kernel) -> Kernel:
    """Mark a kernel that wide vectors speed up, for the C source: both versions go into it."""
    kernel.is_wide = True  # type: ignore[attr-defined]
    return kernel


@compiled
def unrolled(n: int) -> int:
    """Give `n`: a mark for the C source, whose rounds of such a loop are printed one by one."""
    return n
