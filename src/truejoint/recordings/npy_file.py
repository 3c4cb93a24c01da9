"""NumPy's .npy files, without pickle and with the header checked before memory is taken."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Final

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from truejoint.errors import RecordingError
from truejoint.recordings.files import read_bounded

_MAX_HEADER: Final = 4096


def read_npy(path: Path) -> tuple[NDArray[np.float64], str]:
    """Array of a .npy file as float64, and the file's SHA-256.

    Raises
    ------
    RecordingError
        If the file is not there, is no .npy file of real numbers, or does not hold exactly the
        numbers that its header announces.
    """
    data, digest = read_bounded(path)
    stream = io.BytesIO(data)
    try:
        version = npy.read_magic(stream)
        read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
        shape, fortran, dtype = read(stream, max_header_size=_MAX_HEADER)
    except (ValueError, EOFError, SyntaxError) as error:
        raise RecordingError(
            f"{path}: is not a .npy file ({str(error).splitlines()[0][:80]})"
        ) from None
    if dtype.kind not in "fiu" or min(shape, default=0) < 0:
        raise RecordingError(f"{path}: holds {dtype} of shape {shape}, not real numbers")
    count = int(np.prod(shape, dtype=object)) if shape else 1
    left = len(data) - stream.tell()
    if count * dtype.itemsize != left:
        raise RecordingError(
            f"{path}: holds {left} bytes, its header announces {count * dtype.itemsize}; "
            "the file is cut short or damaged"
        )
    values = np.frombuffer(data, dtype, count, stream.tell()).astype(np.float64)
    return values.reshape(shape, order="F" if fortran else "C"), digest
