"""Binary files of arrays, .npy and MATLAB's, read within bounds and without pickle.

NumPy and SciPy believe the sizes that a file announces, and SciPy crashes on damaged ones. They are
compared here, before any memory is taken, with the bytes that stand for them (MathWorks, "MAT-File
Format", R2023b, chapter 1).
"""

import io
import math
import struct
import warnings
import zlib
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Final

import numpy as np
from scipy.io import loadmat

from truejoint.array_types import Array
from truejoint.errors import RecordingError, words
from truejoint.recordings.bounded_file import (
    MAX_BINARY_BYTES,
    Allowance,
    DamagedError,
    read_bounded,
)

NPY_MAGIC: Final = b"\x93NUMPY"
MAX_MAT_BYTES: Final = 2**28  # that the variables of one file may unpack to

_MOST_FIELDS: Final = 1000  # of a struct
_HEADER_BYTES: Final = 128
_INT32, _MATRIX, _COMPRESSED = 5, 14, 15
_STRUCT, _NUMBERS, _COMPLEX = 2, range(6, 16), 8  # classes of array, and a bit of its flags
_NUMBER_TYPES: Final = {
    1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8",
}  # fmt: skip


def read_npy(path: Path) -> tuple[Array, str]:
    """Array (rows, columns) of a .npy file of real numbers, and the file's SHA-256."""
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
    values = values.reshape(shape, order="F" if fortran_order else "C")
    return values.reshape(shape[0] if shape else 1, -1), digest


def read_mat(data: bytes, source: str) -> dict[str, Array]:
    """Arrays of numbers (rows, columns) of a MATLAB file by ``variable`` or ``struct.field``.

    Everything else in a file, objects and functions above all, is left out. A RecordingError that
    names `source` says if it is damaged, of version 7.3 (HDF5), or unpacks to more than is read.
    """
    if data[:8] == b"\x89HDF\r\n\x1a\n" or b"HDF5 schema" in data[:_HEADER_BYTES]:
        raise RecordingError(f"{source}: is HDF5, as version 7.3 MAT files are; save it with -v7")
    try:
        with warnings.catch_warnings(action="error"):
            if b"\0" not in data[:4]:
                return _read_version_5(data, source)
            # A file of version 4, whose sizes SciPy checks.
            arrays = loadmat(io.BytesIO(data)).items()  # type: ignore[arg-type]
            return {
                name: value.astype(np.float64)
                for name, value in arrays
                if isinstance(value, np.ndarray) and value.dtype.kind in "fiub"
            }
    except RecordingError:
        raise
    except Exception as error:  # noqa: BLE001  # damage shows in many ways
        raise RecordingError(
            f"{source}: cannot be read as a MAT file ({words(error, 120)}); is it whole?"
        ) from None


def _read_version_5(data: bytes, source: str) -> dict[str, Array]:
    if data[126:128] not in (b"IM", b"MI"):
        raise DamagedError("its header is cut short")
    order = "<" if data[126:128] == b"IM" else ">"
    room = Allowance.of_size(source, len(data))
    room.most = min(MAX_MAT_BYTES, room.most)
    variables: dict[str, Array] = {}
    for element in _elements(memoryview(data)[_HEADER_BYTES:], order, aligned=False):
        kind, body = element
        if kind == _COMPRESSED:
            unpack = zlib.decompressobj()
            content = unpack.decompress(body, room.most - room.taken + 1)
            room.take(len(content))
            if not unpack.eof:
                raise DamagedError("a variable is cut short")
            kind, body = next(_elements(memoryview(content), order), (0, body))
        if kind == _MATRIX:
            variables |= _read_matrix(body, order)
    return variables


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
            raise DamagedError("a data element is cut short")
        yield kind, data[start : start + size]
        # Elements are padded to 8 bytes, only compressed ones are not.
        at = start + size
        if aligned or kind != _COMPRESSED:
            at += -at % 8


def _read_matrix(body: memoryview, order: str, prefix: str = "") -> dict[str, Array]:
    """Numbers of a variable by its name, or of a struct's fields; empty where it has none."""
    parts = list(islice(_elements(body, order), 5 + _MOST_FIELDS))
    flags = struct.unpack_from(order + "I", parts[0][1])[0] if parts and parts[0][1] else 0
    kind, is_complex = flags & 0xFF, flags >> 8 & _COMPLEX
    if kind not in (_STRUCT, *_NUMBERS) or is_complex or (kind == _STRUCT and prefix):
        return {}
    if len(parts) < 4 or parts[1][0] != _INT32:
        raise DamagedError("an array is cut short")
    shape = struct.unpack(f"{order}{len(parts[1][1]) // 4}i", parts[1][1])
    name = prefix or bytes(parts[2][1]).decode()
    if kind == _STRUCT and shape == (1, 1):
        (length,), texts = struct.unpack(order + "i", parts[3][1]), bytes(parts[4][1])
        arrays: dict[str, Array] = {}
        starts = range(0, len(texts), length)
        for at, (_, part) in zip(starts, parts[5:], strict=True):
            field = texts[at : at + length].partition(b"\0")[0].decode()
            arrays |= _read_matrix(part, order, f"{name}.{field}")
        return arrays
    if kind == _STRUCT or len(shape) != 2 or not name:
        return {}
    element, data = parts[3]
    if element not in _NUMBER_TYPES:
        raise DamagedError(f"numbers of type {element}")
    values = np.frombuffer(data, order + _NUMBER_TYPES[element])
    if min(shape) < 0 or values.size != math.prod(shape):
        raise DamagedError(f"{len(body)} bytes cannot hold an array of shape {shape}")
    return {name: values.astype(np.float64).reshape(shape, order="F")}
