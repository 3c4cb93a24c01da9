"""How the kernels of this package are compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

from numba import njit

Kernel = TypeVar("Kernel", bound=Callable[..., object])


def compiled(kernel: Kernel) -> Kernel:
    """Compile a kernel on its first call and keep the machine code on disk.

    Divisions follow IEEE 754 (no ZeroDivisionError out of a loop), and sums are never reordered,
    so that a kernel gives the same bits for one row as for a whole recording.
    """
    return cast("Kernel", njit(cache=True, error_model="numpy")(kernel))
