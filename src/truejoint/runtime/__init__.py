"""A calibration in use: the corrector of the control loop, what watches it, and its export."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from truejoint.runtime.corrector import Corrector
    from truejoint.runtime.status import Status

__all__ = [
    "Corrector",
    "Status",
]

# Where each public name lives; imported on first use, so that a control loop loads what it needs.
_HOMES = {
    "Corrector": "truejoint.runtime.corrector",
    "Status": "truejoint.runtime.status",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'truejoint.runtime' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
