"""A calibration in use: the corrector of the control loop, what watches it, and its export."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from truejoint.runtime.check import CalibrationCheck, check_calibration
    from truejoint.runtime.corrector import Corrector
    from truejoint.runtime.monitor import Alarm, Monitor, Reason
    from truejoint.runtime.rezero import ReZero
    from truejoint.runtime.status import Status

__all__ = [
    "Alarm",
    "CalibrationCheck",
    "Corrector",
    "Monitor",
    "ReZero",
    "Reason",
    "Status",
    "check_calibration",
]

# Where each public name lives; imported on first use, so that a control loop loads what it needs.
_HOMES = {
    "Alarm": "truejoint.runtime.monitor",
    "CalibrationCheck": "truejoint.runtime.check",
    "Corrector": "truejoint.runtime.corrector",
    "Monitor": "truejoint.runtime.monitor",
    "ReZero": "truejoint.runtime.rezero",
    "Reason": "truejoint.runtime.monitor",
    "Status": "truejoint.runtime.status",
    "check_calibration": "truejoint.runtime.check",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'truejoint.runtime' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
