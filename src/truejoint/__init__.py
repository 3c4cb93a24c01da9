"""truejoint tells where a cable-driven joint really is.

Read recordings, calibrate, correct and judge::

    import truejoint

    training = [truejoint.read_recording("zigzag.parquet")]
    model = truejoint.calibrate(training, "dnn")
    corrected = model.correct(truejoint.read_recording("motion.parquet"))
"""

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from truejoint.errors import TruejointError

if TYPE_CHECKING:
    from truejoint.calibration import Calibration, calibrate, read_calibration
    from truejoint.evaluation import evaluate, write_report
    from truejoint.recordings import Recording, read_recording, write_parquet
    from truejoint.robots import get_robot

__version__ = version("truejoint")

__all__ = [
    "Calibration",
    "Recording",
    "TruejointError",
    "__version__",
    "calibrate",
    "evaluate",
    "get_robot",
    "read_calibration",
    "read_recording",
    "write_parquet",
    "write_report",
]

# Where each public name lives; imported on first use, so that a control loop that needs one
# package does not wait for the training stack and the plots.
_HOMES = {
    "Calibration": "truejoint.calibration",
    "Recording": "truejoint.recordings",
    "calibrate": "truejoint.calibration",
    "evaluate": "truejoint.evaluation",
    "get_robot": "truejoint.robots",
    "read_calibration": "truejoint.calibration",
    "read_recording": "truejoint.recordings",
    "write_parquet": "truejoint.recordings",
    "write_report": "truejoint.evaluation",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'truejoint' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
