"""NumPy's .npy files, without pickle and with the header checked before memory is taken."""

from __future__ import annotations

import math
import re
import struct
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from truejoint.errors import RecordingError
from truejoint.recordings.files import read_bounded

# numpy/numpy:doc/neps/nep-0001-npy-format.rst: magic, version, length of the header, a Python
# literal padded with blanks. Only headers of plain arrays of real numbers match.
_MAGIC: Final = b"\x93NUMPY"
_HEADER: Final = re.compile(
    rb"\{'descr': '([<>|=][fiu][1248])', 'fortran_order': (True|False), "
    rb"'shape': \(((?:\d{1,18}, ?){0,4}(?:\d{1,18})?)\), ?\} *\n?"
)


def read_npy(path: Path) -> tuple[NDArray[np.float64], str]:
    """Array of a .npy file as float64, and the file's SHA-256.

    Raises
    ------
    RecordingError
        If the file is not there, is no .npy file of real numbers, or does not hold exactly the
        numbers that its header announces.
    """
    data, digest = read_bounded(path)
    # The header's length takes 2 bytes in version 1, 4 bytes after.
    width = 2 if data[6:7] == b"\x01" else 4
    start = 8 + width
    if not data.startswith(_MAGIC) or len(data) < start:
        raise RecordingError(f"{path}: is not a .npy file; was it cut short?")
    (length,) = struct.unpack_from("<H" if width == 2 else "<I", data, 8)
    header = _HEADER.fullmatch(data, start, min(start + length, len(data)))
    if header is None:
        raise RecordingError(
            f"{path}: its header does not announce an array of real numbers; save it as float64"
        )
    dtype = np.dtype(header[1].decode())
    shape = tuple(int(n) for n in header[3].split(b",") if n.strip())
    expected, left = math.prod(shape) * dtype.itemsize, len(data) - start - length
    if expected != left or not expected:
        raise RecordingError(
            f"{path}: holds {left} bytes, its header announces {expected}; "
            "the file is empty, cut short or damaged"
        )
    values = np.frombuffer(data, dtype, math.prod(shape), start + length).astype(np.float64)
    return values.reshape(shape, order="F" if header[2] == b"True" else "C"), digest
