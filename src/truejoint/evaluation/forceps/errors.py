"""Errors of jaw estimates, against the paper's truth and against the truth itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from truejoint.simulation.forceps.twin import ForcepsRun

Array = NDArray[np.float64]


@dataclass(frozen=True)
class JawError:
    """Estimate minus truth over some rows [rad].

    Attributes
    ----------
    rms, largest, smallest : float
        Against the reference encoder at the jaw, which the paper takes for the truth.
    exact_rms : float
        RMS against the jaw itself, which includes the encoder's own error that every calibrated
        method learns.
    """

    rms: float
    largest: float
    smallest: float
    exact_rms: float

    @classmethod
    def of(cls, estimate: Array, run: ForcepsRun, rows: NDArray[np.bool_]) -> JawError:
        """Error of an estimate (n,) [rad] over the rows (n,) that count."""
        error = (estimate - run.reference)[rows]
        exact = (estimate - run.jaw)[rows]
        return cls(
            rms=float(np.sqrt(np.mean(error**2))),
            largest=float(error.max()),
            smallest=float(error.min()),
            exact_rms=float(np.sqrt(np.mean(exact**2))),
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain values [deg]."""
        return {f"{name}_deg": float(np.degrees(value)) for name, value in vars(self).items()}


def phase_rows(run: ForcepsRun, first: float, last: float) -> NDArray[np.bool_]:
    """Rows (n,) from `first` to `last` [s]."""
    return np.asarray((run.t >= first) & (run.t <= last))
