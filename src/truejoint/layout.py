"""Named fields of the two flat arrays that a compiled kernel works on.

A kernel keeps integers in `numbers` and everything else in `memory`. Passing two arrays keeps a
call from Python near a microsecond, and a C structure can mirror the fields by name. Fields are
declared once, in a package's ``layout.toml``, for a `Layout`. A kernel begins with
``m = unpack(numbers, memory)``, of ``unpack = LAYOUT.unpacker()``, and reads ``m.mean``: views of
the arrays that have a shape, and numbers as they were then. What a kernel changes, and parts, it
reaches by the index that a declaration, or `Layout.at`, gives:

====================  ===========================================================
declared by           reached by
====================  ===========================================================
``integer``, address  ``numbers[FIELD]``
``scalar``            ``memory[FIELD]``
``array``             ``vector(memory, numbers[FIELD], length)``, or ``matrix(...)``
``integers``          ``vector(numbers, numbers[FIELD], length)``
``part``              ``part_numbers(numbers, FIELD)``, ``part_memory(numbers, memory, FIELD)``
====================  ===========================================================
"""

import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from importlib import resources
from itertools import chain
from typing import Any, Final, Literal, NoReturn, Self

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled, unpacker, vector

Kind = Literal["integer", "address", "scalar", "array", "integers", "part"]

Shape = tuple[str | int, ...]
_DTYPES: Final[Mapping[str, Any]] = {"array": np.float64, "integers": np.int64}

PART_SIZE: Final = 4
"""Numbers of a part: where its numbers and memory begin, and how long they are."""


class Index(int):
    """Index of a field, which the C source has no name for."""


@dataclass(frozen=True)
class Field:
    """What a kernel knows by one name."""

    name: str  # an identifier in Python and in C
    meaning: str  # for a person, with its unit
    kind: Kind  # how it is declared
    index: int  # by which kernels reach it
    is_time: bool = False  # of time stamps, which keep double precision whatever the others have
    shape: Shape = ()  # of an array that `Layout.unpacker` knows: names of integers, or numbers


@cache
def _rows(package: str) -> dict[str, dict[str, Any]]:
    return tomllib.loads(resources.files(package).joinpath("layout.toml").read_text("utf-8"))


class Layout:
    """Fields in the order of their declaration."""

    def __init__(self) -> None:
        self.fields: dict[str, Field] = {}
        self._sizes = [0, 0]  # of the numbers, and of the scalars

    def declare(self, package: str, *tables: str, **lengths: int) -> Self:
        """Declare the fields of tables of a package's ``layout.toml``, in their order.

        A row is a kind, a meaning and, of an array, the lengths: numbers, names of integers, or
        those that `lengths` says. A ``"time"`` or ``"times"`` is a scalar or an array of stamps.
        """
        times: dict[str, Kind] = {"time": "scalar", "times": "array"}
        rows = chain.from_iterable(_rows(package)[table].items() for table in tables)
        for name, (kind, meaning, *shape) in rows:
            sizes = tuple(lengths.get(length, length) for length in shape)
            self.add(name, times.get(kind, kind), meaning, *sizes, is_time=kind in times)
        return self

    def at(self, name: str) -> int:
        """Index of a field, for kernels."""
        return Index(self.fields[name].index)

    def places(self, names: str) -> Iterator[int]:
        """Give the indices of fields, for kernels; their names stand with blanks between them."""
        return map(self.at, names.split())

    def add(
        self, name: str, kind: Kind, meaning: str, *shape: str | int, is_time: bool = False
    ) -> int:
        """Declare one field: its index for kernels.

        The `shape` of an array, of numbers and of names of integers, is what `unpacker` needs. An
        integer that is not declared yet is declared here; `pack` takes it from the array. The
        address of a compiled function is 0 where there is none. A part is a memory of another
        layout within this one.
        """
        for length in shape:
            if isinstance(length, str) and length not in self.fields:
                self.add(length, "integer", "length of arrays")
        if name in self.fields or not name.isidentifier():
            raise ValueError(f"field {name!r} is no name, or stands twice")
        side = int(kind == "scalar")
        index = self._sizes[side]
        self._sizes[side] += PART_SIZE if kind == "part" else 1
        self.fields[name] = Field(name, meaning, kind, index, is_time, shape)
        return Index(index)

    def unpacker(self) -> Any:
        """Make ``m = unpack(numbers, memory)`` for kernels: numbers, and arrays as views, by name.

        It knows the numbers, and the arrays with a shape, that have been declared so far.
        """
        fields = (f for f in self.fields.values() if f.shape or f.kind in ("integer", "scalar"))
        return unpacker(tuple((f.name, f.kind, f.index, f.shape) for f in fields))

    def pack(self, functions: Mapping[str, Any] | None = None, /, **values: Any) -> "Memory":
        """Lay values out, by the names of their fields; `functions` stand at the addresses.

        A value is a number (or an array of one), an array_like of one or two dimensions, or the
        `Memory` of a part. A field that is not given is 0. An array that is not given is zeros, if
        other values state each length of its declared shape; it must be given otherwise. Raises
        ValueError for a name that is no field, a missing array or part, or another shape.
        """
        arrays = self._arrays(values)
        values |= arrays
        needed = {f.name for f in self.fields.values() if f.kind in (*_DTYPES, "part")}
        if not needed <= values.keys() <= self.fields.keys():
            raise ValueError(f"fields {sorted(needed ^ values.keys())} are missing or unknown")
        parts: dict[str, Memory] = {}
        numbers, memory = [np.zeros(self._sizes[0], np.int64)], [np.zeros(self._sizes[1])]
        ends = [*self._sizes]

        def append(side: int, flat: Any) -> int:
            (numbers, memory)[side].append(flat)
            ends[side] += len(flat)
            return ends[side] - len(flat)

        for name, value in values.items():
            kind, index = self.fields[name].kind, self.fields[name].index
            if kind == "scalar":
                memory[0][index] = np.asarray(value).item()
            elif kind == "part":
                parts[name] = value
                sizes = len(value.numbers), len(value.memory)
                starts = append(0, value.numbers), append(1, value.memory)
                numbers[0][index : index + PART_SIZE] = (*starts, *sizes)
            elif name in arrays:
                numbers[0][index] = append(int(kind == "array"), value.ravel())
                for length, n in zip(self.fields[name].shape, value.shape, strict=False):
                    if isinstance(length, str):
                        numbers[0][self.fields[length].index] = n
            else:
                numbers[0][index] = value
        shapes = {name: array.shape for name, array in arrays.items()}
        numbers_, memory_ = np.concatenate(numbers), np.concatenate(memory)
        return Memory(self, numbers_, memory_, shapes, parts, functions or {})

    def _arrays(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Arrays by field: the given ones, then zeros; ValueError if shapes disagree."""
        kinds = {name: self.fields[name].kind for name in values if name in self.fields}
        lengths: dict[str | int, int] = {
            name: values[name] for name, kind in kinds.items() if kind == "integer" and values[name]
        }
        lengths |= {n: n for f in self.fields.values() for n in f.shape if isinstance(n, int)}
        arrays: dict[str, Any] = {
            name: np.asarray(values[name], _DTYPES[kind])
            for name, kind in kinds.items()
            if kind in _DTYPES
        }
        for name, array in arrays.items():
            shape = self.fields[name].shape
            sizes = zip(shape, array.shape, strict=False)
            wanted = tuple(lengths.setdefault(length, n) for length, n in sizes)
            if shape and (wanted != array.shape or len(shape) != array.ndim):
                wanted = tuple(lengths.get(length, length) for length in shape)  # type: ignore[arg-type]
                raise ValueError(f"field {name!r} has shape {array.shape}; it must be {wanted}")
        for f in self.fields.values():
            if f.shape and f.name not in arrays and lengths.keys() >= set(f.shape):
                arrays[f.name] = np.zeros([lengths[n] for n in f.shape], _DTYPES[f.kind])
        return arrays


def refuse_copy(instance: object) -> NoReturn:
    """Stand for `__reduce__` where a copy would share memory, or call addresses of old.

    Raises TypeError, as whatever else cannot be pickled.
    """
    raise TypeError(
        f"a {type(instance).__name__} cannot be copied or pickled: it holds addresses of compiled "
        "functions and views of its memory; make another from the same model"
    )


@dataclass(frozen=True, eq=False)
class Memory:
    """What `Layout.pack` made: numbers and memory (n,), and what they hold, by field."""

    layout: Layout
    numbers: Integers
    memory: Array
    shapes: Mapping[str, tuple[int, ...]] = field(repr=False)  # of arrays of floats and integers
    parts: "Mapping[str, Memory]" = field(repr=False)  # as before they were copied into this one
    functions: Mapping[str, Any] = field(repr=False)  # what stands at each address

    def view(self, name: str) -> Any:
        """Array field as an array that shares this memory."""
        kind, index = self.layout.fields[name].kind, self.layout.fields[name].index
        start, shape = int(self.numbers[index]), self.shapes[name]
        source: Any = self.memory if kind == "array" else self.numbers
        return source[start : start + int(np.prod(shape))].reshape(shape)

    def part(self, *names: str) -> "Memory":
        """Part, of a part and so on if there are several `names`, that shares this memory."""
        part = self
        for name in names:
            inner, index = part.parts[name], part.layout.fields[name].index
            first, start = part.numbers[index : index + 2]
            part = replace(
                inner,
                numbers=part.numbers[first : first + len(inner.numbers)],
                memory=part.memory[start : start + len(inner.memory)],
            )
        return part

    __reduce__ = refuse_copy

    def copy(self) -> "Memory":
        """Give the same with arrays of its own."""
        return replace(self, numbers=self.numbers.copy(), memory=self.memory.copy())


@compiled
def part_numbers(numbers: Integers, part: int) -> Integers:
    """View of the numbers of a part."""
    view: Integers = vector(numbers, numbers[part], numbers[part + 2])
    return view


@compiled
def part_memory(numbers: Integers, memory: Array, part: int) -> Array:
    """View of the memory of a part."""
    view: Array = vector(memory, numbers[part + 1], numbers[part + 3])
    return view
