"""A fitted estimator with all that is needed to use it: fit, correct, file, interval, zero."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from truejoint.calibration.calibration import Calibration, OnlineState, read_calibration
    from truejoint.calibration.conformal import with_interval
    from truejoint.calibration.fitting import calibrate
    from truejoint.calibration.interval import Interval, needed_trajectories
    from truejoint.calibration.interval_coverage import (
        Coverage,
        CrossCheck,
        cross_check,
        measure_coverage,
    )
    from truejoint.calibration.zero import Zero, find_zero, rezeroed

__all__ = [
    "Calibration",
    "Coverage",
    "CrossCheck",
    "Interval",
    "OnlineState",
    "Zero",
    "calibrate",
    "cross_check",
    "find_zero",
    "measure_coverage",
    "needed_trajectories",
    "read_calibration",
    "rezeroed",
    "with_interval",
]

_HOMES = {
    "Calibration": "truejoint.calibration.calibration",
    "Coverage": "truejoint.calibration.interval_coverage",
    "CrossCheck": "truejoint.calibration.interval_coverage",
    "Interval": "truejoint.calibration.interval",
    "OnlineState": "truejoint.calibration.calibration",
    "Zero": "truejoint.calibration.zero",
    "calibrate": "truejoint.calibration.fitting",
    "cross_check": "truejoint.calibration.interval_coverage",
    "find_zero": "truejoint.calibration.zero",
    "measure_coverage": "truejoint.calibration.interval_coverage",
    "needed_trajectories": "truejoint.calibration.interval",
    "read_calibration": "truejoint.calibration.calibration",
    "rezeroed": "truejoint.calibration.zero",
    "with_interval": "truejoint.calibration.conformal",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'truejoint.calibration' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
