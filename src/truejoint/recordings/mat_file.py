"""The few kinds of MATLAB file that recordings come in: numbers, and structs of numbers.

Only what a recording needs is read: real full arrays, and structs of one element that hold
such arrays, in version 4 files and in version 5 files (also written by versions 6 and 7).
Everything else in a file, objects and functions above all, is stepped over. Layout: MathWorks,
"MAT-File Format" (R2023b), chapters 1 and 2.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from truejoint.errors import RecordingError

Array = NDArray[np.float64]
VERSION5_MARK: Final = b"MATLAB 5.0 MAT-file"

MatValue = Array | dict[str, Array]

MAX_MAT_BYTES: Final = 2**28
"""Most bytes that the variables of one file may unpack to."""

# Types of data element and classes of array, tables 1-1 and 1-3 of the format's description.
_DTYPES: Final = {
    1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8",
}  # fmt: skip
_MATRIX: Final = 14
_COMPRESSED: Final = 15
_STRUCT_CLASS: Final = 2
_NUMERIC_CLASSES: Final = range(6, 16)
_COMPLEX_FLAG: Final = 0x0800
_HEADER_BYTES: Final = 128
# Version 4: precision digit of the type code, and the bytes of its header.
_V4_DTYPES: Final = ("f8", "f4", "i4", "i2", "u2", "u1")
_V4_HEADER: Final = 20


class _MatError(Exception):
    """A rule of the format that the file breaks."""


def read_mat(data: bytes, source: str) -> dict[str, MatValue]:
    """Variables of a MATLAB file that are arrays of numbers, or structs of them.

    Parameters
    ----------
    data : bytes
        The whole file.
    source : str
        Its name, for errors.

    Returns
    -------
    dict
        Name to array (rows, columns), or to a dict of such arrays for a struct.

    Raises
    ------
    RecordingError
        If the file is cut short, damaged, of version 7.3 (HDF5), or unpacks to more than is read.
    """
    if data[:8] == b"\x89HDF\r\n\x1a\n" or b"HDF5 schema" in data[:_HEADER_BYTES]:
        raise RecordingError(f"{source}: is a version 7.3 MAT file; save it with -v7 instead")
    try:
        if data.startswith(VERSION5_MARK):
            return dict(_variables5(data))
        return dict(_variables4(data))
    except (_MatError, struct.error, zlib.error) as error:
        raise RecordingError(
            f"{source}: cannot be read as a MAT file ({error}); is it whole?"
        ) from None


def _variables4(data: bytes) -> Iterator[tuple[str, Array]]:
    at = 0
    while at < len(data):
        code, rows, columns, imaginary, name_length = struct.unpack_from("<5i", data, at)
        at += _V4_HEADER
        machine, zero, precision, kind = code // 1000, code // 100 % 10, code // 10 % 10, code % 10
        if code < 0 or machine != 0 or zero != 0 or precision >= len(_V4_DTYPES) or kind > 2:
            raise _MatError(f"no MAT file starts with {code}")
        if min(rows, columns) < 0 or not 0 < name_length < 256:
            raise _MatError("a variable has a negative size or no name")
        name = data[at : at + name_length].rstrip(b"\0").decode("latin-1")
        at += name_length
        dtype = np.dtype("<" + _V4_DTYPES[precision])
        size = rows * columns * dtype.itemsize
        if at + size * (2 if imaginary else 1) > len(data):
            raise _MatError(f"variable {name!r} is cut short")
        if kind == 0 and not imaginary:
            values = np.frombuffer(data, dtype, rows * columns, at).astype(np.float64)
            yield name, values.reshape((rows, columns), order="F")
        at += size * (2 if imaginary else 1)


def _variables5(data: bytes) -> Iterator[tuple[str, MatValue]]:
    if data[126:128] not in (b"IM", b"MI"):
        raise _MatError("its header is cut short")
    order = "<" if data[126:128] == b"IM" else ">"
    left = MAX_MAT_BYTES
    for kind, body in _elements(data[_HEADER_BYTES:], order, aligned=False):
        content = body
        if kind == _COMPRESSED:
            unpack = zlib.decompressobj()
            content = unpack.decompress(body, left + 1)
            left -= len(content)
            if left < 0:
                raise _MatError(f"unpacks to more than {MAX_MAT_BYTES} bytes")
            if not unpack.eof:
                raise _MatError("a variable is cut short")
            inner = next(_elements(content, order), None)
            if inner is None or inner[0] != _MATRIX:
                continue
            content = inner[1]
        elif kind != _MATRIX:
            continue
        name, value = _matrix(content, order, nested=False)
        if name and value is not None:
            yield name, value


def _elements(data: bytes, order: str, *, aligned: bool = True) -> Iterator[tuple[int, bytes]]:
    """Type and content of the data elements that stand one after the other in `data`."""
    at = 0
    while at + 8 <= len(data):
        kind, size = struct.unpack_from(order + "2I", data, at)
        if kind >> 16:
            # A small element: size and type share one word, up to 4 bytes of content follow.
            kind, size = kind & 0xFFFF, kind >> 16
            if size > 4:
                raise _MatError("a small data element is too large")
            yield kind, data[at + 4 : at + 4 + size]
            at += 8
            continue
        if at + 8 + size > len(data):
            raise _MatError("a data element is cut short")
        yield kind, data[at + 8 : at + 8 + size]
        # Elements are padded to 8 bytes, only compressed ones are not.
        padded = aligned or kind != _COMPRESSED
        at += 8 + (-(-size // 8) * 8 if padded else size)


def _matrix(body: bytes, order: str, *, nested: bool) -> tuple[str, MatValue | None]:
    """Name and value of one matrix element; value None for a kind that is not read."""
    parts = _elements(body, order)
    try:
        flags = _numbers(next(parts), order)
        if flags.size < 1:
            raise _MatError("a variable has no flags")
        # An opaque object has no dimensions here: step over it.
        klass = int(flags[0]) & 0xFF
        if klass != _STRUCT_CLASS and klass not in _NUMERIC_CLASSES:
            return "", None
        shape = tuple(int(n) for n in _numbers(next(parts), order))
        name = next(parts)[1].decode("latin-1")
        if len(shape) != 2 or min(shape) < 0 or int(flags[0]) & _COMPLEX_FLAG:
            return name, None
        if klass == _STRUCT_CLASS:
            return name, None if nested or shape != (1, 1) else _struct(parts, order)
        values = _numbers(next(parts), order)
    except StopIteration:
        raise _MatError("a variable lacks a part") from None
    if values.size != shape[0] * shape[1]:
        raise _MatError(f"variable {name!r} holds {values.size} numbers, not {shape}")
    return name, values.astype(np.float64).reshape(shape, order="F")


def _struct(parts: Iterator[tuple[int, bytes]], order: str) -> dict[str, Array]:
    widths = _numbers(next(parts), order)
    names = next(parts)[1]
    width = int(widths[0]) if widths.size else 0
    if not 0 < width <= 256:
        raise _MatError("a struct's field names have no length")
    fields: dict[str, Array] = {}
    for start in range(0, len(names), width):
        field = names[start : start + width].split(b"\0")[0].decode("latin-1")
        kind, body = next(parts)
        if kind != _MATRIX:
            raise _MatError(f"field {field!r} is not an array")
        if body:
            _, value = _matrix(body, order, nested=True)
            if isinstance(value, np.ndarray):
                fields[field] = value
    return fields


def _numbers(element: tuple[int, bytes], order: str) -> NDArray[np.generic]:
    kind, body = element
    if kind not in _DTYPES:
        raise _MatError(f"numbers of type {kind} are not known")
    dtype = np.dtype(order + _DTYPES[kind])
    if len(body) % dtype.itemsize:
        raise _MatError("numbers are cut short")
    return np.frombuffer(body, dtype)
