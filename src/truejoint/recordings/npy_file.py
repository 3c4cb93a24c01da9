"""NumPy's .npy files, without pickle and with the header checked before memory is taken."""

from __future__ import annotations

import io
import math
import warnings
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from truejoint.errors import RecordingError
from truejoint.recordings.files import read_bounded

NPY_MAGIC: Final = b"\x93NUMPY"


def read_npy(path: Path) -> tuple[NDArray[np.float64], str]:
    """Array of a .npy file of real numbers as float64, and the file's SHA-256.

    Raises RecordingError too if it does not hold exactly the numbers that its header announces.
    """
    data, digest = read_bounded(path)
    file = io.BytesIO(data)
    try:
        version = np.lib.format.read_magic(file)
        with warnings.catch_warnings(action="error"):
            read_header = (
                np.lib.format.read_array_header_1_0
                if version == (1, 0)
                else np.lib.format.read_array_header_2_0
            )
            shape, fortran_order, dtype = read_header(file)
    except Exception as error:  # noqa: BLE001  # NumPy evaluates the header, which fails in many ways
        reason = " ".join(str(error).split())[:80]
        raise RecordingError(f"{path}: is not a .npy file ({reason}); was it cut short?") from None
    flat = len(shape) <= 4 and min(shape, default=0) >= 0
    if dtype.kind not in "fiu" or dtype.itemsize > 8 or not flat:
        raise RecordingError(
            f"{path}: its header does not announce an array of real numbers; save it as float64"
        )
    expected, left = math.prod(shape) * dtype.itemsize, len(data) - file.tell()
    if expected != left or not expected:
        raise RecordingError(
            f"{path}: holds {left} bytes, its header announces {expected}; "
            "the file is empty, cut short or damaged"
        )
    values = np.frombuffer(data, dtype, offset=file.tell()).astype(np.float64)
    return values.reshape(shape, order="F" if fortran_order else "C"), digest
