"""What yan2020 reports, in degrees as printed: Table 2, Table 3 and figure 6(b)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class Reported:
    """Largest, smallest and RMS error [deg]; None where the paper prints none."""

    rms: float
    largest: float | None = None
    smallest: float | None = None


TABLE_2: Final = {
    "lsm": Reported(0.57, 1.45, -1.08),
    "lsm_compensated": Reported(0.26, 0.84, -0.79),
    "ukf_compensated": Reported(0.12, 0.39, -0.44),
}
"""Trajectory (28), by estimator."""

FIGURE_6B: Final = {"ukf_compensated": Reported(0.06, 0.27, -0.20)}
"""Trajectory (27), on which the error model was fitted."""

TABLE_3: Final = {
    0.03: {"I": Reported(0.07, 0.25, -0.23), "II": Reported(0.15), "IV": Reported(0.05)},
    0.05: {"I": Reported(0.09, 0.31, -0.24), "II": Reported(0.07), "IV": Reported(0.05)},
    0.1: {"I": Reported(0.13, 0.21, -0.25), "II": Reported(0.05), "IV": Reported(0.38)},
    0.2: {"I": Reported(0.15, 0.37, -0.24), "II": Reported(0.06), "IV": Reported(0.40)},
    0.25: {"I": Reported(0.12, 0.33, -0.22), "II": Reported(0.05), "IV": Reported(0.29)},
}
"""Filter with compensation, by load [kg] and phase."""
