"""What the rows of filters share: a step, and whether its estimate is one."""

from __future__ import annotations

from typing import Final

from truejoint.compiled import Array, Integers, compiled
from truejoint.filters import FilterStatus
from truejoint.filters import fields as at
from truejoint.filters.kernels import step

FAULTS: Final = int(
    FilterStatus.INVALID_INPUT
    | FilterStatus.INVALID_MEASUREMENT
    | FilterStatus.TRANSITION_FAILED
    | FilterStatus.MEASUREMENT_FAILED
    | FilterStatus.OUT_OF_RANGE
    | FilterStatus.SINGULAR
)
"""What makes a filter's estimate none: its row is then NaN, and the sample IMPLAUSIBLE."""


@compiled
def advance(numbers: Integers, memory: Array, dt: float) -> bool:
    """Advance the filter; whether its estimate is one."""
    memory[at.DT] = dt
    return (step(numbers, memory) & FAULTS) == 0
