"""Types of numpy arrays, by their short names, and numbers of others as one."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truejoint.errors import TruejointError

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]


def floats(values: ArrayLike, what: str, error: type[TruejointError]) -> Array:
    """Numbers as an array, the same one if it is; raises `error`, saying `what` they are not."""
    try:
        return np.asarray(values, dtype=np.float64)
    except (OverflowError, TypeError, ValueError) as fault:
        raise error(f"{what}: {fault}; give numbers") from None
