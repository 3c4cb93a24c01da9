"""Binary files of arrays, .npy and MATLAB's, read within bounds and without pickle.

NumPy and SciPy believe the sizes that a file announces. They are compared here, before any memory
is taken, with the bytes that stand for them (MathWorks, "MAT-File Format", R2023b, chapter 1).
"""

from __future__ import annotations

import io
import math
import struct
import warnings
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.io import loadmat

from truejoint.array_types import Array
from truejoint.errors import RecordingError, words
from truejoint.recordings.bounded_file import MAX_BINARY_BYTES, most_unpacked, read_bounded

MatValue = Array | dict[str, Array]

NPY_MAGIC: Final = b"\x93NUMPY"
MAX_MAT_BYTES: Final = 2**28  # that the variables of one file may unpack to

_MAX_NESTED: Final = 1000
_HEADER_BYTES: Final = 128
_INT32, _MATRIX, _COMPRESSED = 5, 14, 15
# Classes of array that are read; SciPy cannot list what is in a file with some of the others.
_STRUCTS_AND_NUMBERS: Final = (2, *range(6, 16))
_PLAIN: Final = range(4, 16)  # classes of array that hold no others
_COMPLEX: Final = 8  # bit of the flags: a second part follows
_DATA: Final = (*range(1, 8), 9, 12, 13, 16, 17, 18)  # types of element; others crash SciPy


class _MatError(Exception):
    """A rule of the format that the file breaks."""


def read_npy(path: Path) -> tuple[Array, str]:
    """Array of a .npy file of real numbers as float64, and the file's SHA-256."""
    data, digest = read_bounded(path)
    file = io.BytesIO(data)
    try:
        version = np.lib.format.read_magic(file)
        with warnings.catch_warnings(action="error"):
            first, later = np.lib.format.read_array_header_1_0, np.lib.format.read_array_header_2_0
            shape, fortran_order, dtype = (first if version == (1, 0) else later)(file)
    except Exception as error:  # noqa: BLE001  # NumPy evaluates the header, which fails in many ways
        raise RecordingError(
            f"{path}: is not a .npy file ({words(error, 80)}); was it cut short?"
        ) from None
    flat = len(shape) <= 4 and min(shape, default=0) >= 0
    if dtype.kind not in "fiu" or dtype.itemsize > 8 or not flat:
        raise RecordingError(
            f"{path}: its header does not announce an array of real numbers; save it as float64"
        )
    expected, size = math.prod(shape) * dtype.itemsize, len(data) - file.tell()
    if expected != size or not expected:
        raise RecordingError(
            f"{path}: holds {size} bytes, its header announces {expected}; "
            "the file is empty, cut short or damaged"
        )
    if 8 * math.prod(shape) > MAX_BINARY_BYTES:
        raise RecordingError(
            f"{path}: {math.prod(shape)} numbers take more than {MAX_BINARY_BYTES} bytes as "
            "float64, the most that is read; cut the recording into parts"
        )
    values = np.frombuffer(data, dtype, offset=file.tell()).astype(np.float64)
    return values.reshape(shape, order="F" if fortran_order else "C"), digest


def read_mat(data: bytes, source: str) -> dict[str, MatValue]:
    """Variables of a MATLAB file by name: arrays of numbers (rows, columns), or structs of them.

    Everything else in a file, objects and functions above all, is left out. A RecordingError that
    names `source` says if it is damaged, of version 7.3 (HDF5), or unpacks to more than is read.
    """
    if data[:8] == b"\x89HDF\r\n\x1a\n" or b"HDF5 schema" in data[:_HEADER_BYTES]:
        raise RecordingError(f"{source}: is a version 7.3 MAT file; save it with -v7 instead")
    try:
        with warnings.catch_warnings(action="error"):
            return _variables(data)
    except Exception as error:  # noqa: BLE001  # SciPy trips over damage in many ways
        raise RecordingError(
            f"{source}: cannot be read as a MAT file ({words(error, 120)}); is it whole?"
        ) from None


def _variables(data: bytes) -> dict[str, MatValue]:
    # A file of version 4 has a zero among its first four bytes, and sizes that SciPy checks.
    file: Any = io.BytesIO(data if b"\0" in data[:4] else _unpacked(data))
    values: dict[str, MatValue] = {}
    for name, value in loadmat(file).items():
        if name.startswith("__"):
            continue
        if _is_real(value):
            values[name] = value.astype(np.float64)
        elif isinstance(value, np.ndarray) and value.dtype.names and value.shape == (1, 1):
            fields = {field: value[0, 0][field] for field in value.dtype.names}
            values[name] = {k: v.astype(np.float64) for k, v in fields.items() if _is_real(v)}
    return values


def _is_real(value: Any) -> bool:
    return isinstance(value, np.ndarray) and value.ndim == 2 and value.dtype.kind in "fiub"


def _unpacked(data: bytes) -> bytes:
    """Version 5 file without compression and with sizes that its bytes can fill."""
    if data[126:128] not in (b"IM", b"MI"):
        raise _MatError("its header is cut short")
    order = "<" if data[126:128] == b"IM" else ">"
    pieces: list[bytes | memoryview] = [data[:_HEADER_BYTES]]
    limit = room = min(MAX_MAT_BYTES, most_unpacked(len(data)))
    for element in _elements(memoryview(data)[_HEADER_BYTES:], order, aligned=False):
        kind, body = element
        if kind == _COMPRESSED:
            unpack = zlib.decompressobj()
            content = unpack.decompress(body, room + 1)
            room -= len(content)
            if room < 0:
                raise _MatError(f"unpacks to more than {limit} bytes")
            if not unpack.eof:
                raise _MatError("a variable is cut short")
            kind, body = next(_elements(memoryview(content), order), (0, body))
        flags = next(_elements(body, order), (0, b""))[1] if kind == _MATRIX else b""
        if len(flags) == 8 and _class_of(flags, order) in _STRUCTS_AND_NUMBERS:
            _check(body, order)
            pieces += [struct.pack(order + "2I", _MATRIX, len(body)), body]
    return b"".join(pieces)


def _elements(
    data: memoryview, order: str, *, aligned: bool = True
) -> Iterator[tuple[int, memoryview]]:
    """Type and content of the data elements that stand one after the other in `data`."""
    at = 0
    while at + 8 <= len(data):
        kind, size = struct.unpack_from(order + "2I", data, at)
        start = at + 8
        if kind >> 16:
            # A small element: size and type share one word, up to 4 bytes of content follow.
            kind, size, start = kind & 0xFFFF, kind >> 16, at + 4
        if start + size > len(data) or (start == at + 4 and size > 4):
            raise _MatError("a data element is cut short")
        yield kind, data[start : start + size]
        # Elements are padded to 8 bytes, only compressed ones are not.
        at = start + size
        if aligned or kind != _COMPRESSED:
            at += -at % 8


def _class_of(flags: bytes | memoryview, order: str) -> int:
    """Class of array that its first element tells."""
    return int(struct.unpack(order + "2I", flags)[0] & 0xFF)


def _check(variable: memoryview, order: str) -> None:
    """Refuse more arrays than anyone keeps, and what SciPy would read past the end of."""
    waiting, nested = [variable], 0
    while waiting:
        body = waiting.pop()
        parts = list(_elements(body, order))
        flags = parts[0][1] if parts else b""
        plain = len(flags) == 8 and _class_of(flags, order) in _PLAIN
        if plain and len(parts) < 4 + bool(bytes(flags)[1 if order == "<" else 2] & _COMPLEX):
            raise _MatError("an array is cut short")
        for place, (kind, part) in enumerate(parts):
            if kind not in (_DATA if plain else (*_DATA, _MATRIX)):
                raise _MatError(f"a data element of type {kind}")
            # Second come the dimensions; an object without any has its name there.
            if place == 1 and kind == _INT32:
                shape = struct.unpack(f"{order}{len(part) // 4}i", part)
                if min(shape, default=0) < 0 or math.prod(shape) > len(body):
                    raise _MatError(f"{len(body)} bytes cannot hold an array of shape {shape}")
            if kind == _MATRIX:
                waiting.append(part)
                nested += 1
        if nested > _MAX_NESTED:
            raise _MatError(f"a variable holds more than {_MAX_NESTED} others")
