"""How evenly a loop runs, a paced arm that keeps when its passes started, and processor time."""

import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from truejoint.crtk import PacedBackend
from truejoint.simulation import Twin

_KEPT: Final = 1_200_000  # periods, twenty minutes
_LATE: Final = 1.5  # periods


@dataclass(frozen=True)
class LoopTiming:
    """Times between the starts of two passes of a loop [s], and the share that were late."""

    periods: int
    median: float
    p99: float
    worst: float
    late_share: float

    @classmethod
    def of(cls, starts: np.ndarray, period: float) -> "LoopTiming":
        """Judge a loop of a `period` [s] whose passes started at `starts` (n,) [s], n >= 2."""
        periods = np.diff(starts)
        median, p99 = np.quantile(periods, [0.5, 0.99])
        late = float((periods > _LATE * period).mean())
        return cls(len(periods), float(median), float(p99), float(periods.max()), late)


class TimedBackend(PacedBackend):
    """A paced arm that keeps when its latest passes started."""

    def __init__(self, twin: Twin) -> None:
        self._starts = np.full(_KEPT, 0.0)  # a ring, in memory from the beginning
        self.passes = 0
        super().__init__(twin)

    def timing(self, first: int = 0) -> LoopTiming:
        """How evenly the loop has run since its pass number `first`."""
        passes = np.arange(max(first, self.passes - _KEPT + 1), self.passes)
        return LoopTiming.of(self._starts[passes % _KEPT], self.period)

    def _pass(self, most: int) -> int:
        self._starts[self.passes % _KEPT] = time.perf_counter()
        self.passes += 1
        return super()._pass(most)


def processor_time(stat: Path) -> float:
    """Processor time [s] that the kernel states of a thread or process in its file ``stat``."""
    fields = stat.read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
