"""KUKA KR300 with secondary encoders behind the gears of axes 1-3 (250 Hz).

Layout: JonasWeigand/Robot_Identification:data/recorded_trajectories.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from truejoint.errors import RecordingError
from truejoint.recordings.files import read_bounded
from truejoint.recordings.mat_file import Array, read_mat
from truejoint.recordings.recording import Provenance, Recording

AXES: Final = 6
# The file has zeros in place of the secondary encoders of the other axes.
AXES_WITH_TRUTH: Final = 3

_QUANTITIES: Final = (
    ("measured", "act_pos_mot_deg", AXES),
    ("velocity", "act_vel_mot_deg_per_s", AXES),
    ("setpoint", "ref_pos_deg", AXES),
    ("effort", "act_torque_abs_nm", AXES),
    ("truth", "act_pos_se_deg", AXES_WITH_TRUTH),
)


def read(path: Path) -> Recording:
    """Read one recorded trajectory, a MATLAB file with a struct ``rec``.

    Columns of the recording: ``measured``, ``velocity``, ``setpoint`` and ``effort`` [rad, rad/s,
    rad, Nm] of ``axis1`` to ``axis6``, ``truth`` [rad] of ``axis1`` to ``axis3``. The zero of the
    secondary encoders was set anew before each recording, so each counts as a homing of its own.

    Raises
    ------
    RecordingError
        If the file is damaged or a field is missing or of another shape.
    """
    data, digest = read_bounded(path)
    rec = read_mat(data, str(path)).get("rec")
    if not isinstance(rec, dict):
        raise RecordingError(f"{path}: has no struct 'rec'; is it a recorded trajectory?")
    time = _field(path, rec, "time_cont").reshape(-1)
    columns = {"t": time}
    for quantity, name, axes in _QUANTITIES:
        values = _field(path, rec, name)
        if values.shape != (AXES, time.size):
            raise RecordingError(
                f"{path}: rec.{name} is of shape {values.shape}, expected {(AXES, time.size)}"
            )
        scaled = values if quantity == "effort" else np.radians(values)
        columns |= {f"{quantity}/axis{i + 1}": scaled[i] for i in range(axes)}
    session = path.parent.name if path.stem == "data" else path.stem
    provenance = Provenance(
        robot="kuka_kr300",
        source=path.name,
        sha256=digest,
        session=session,
        homing_id=session,
        rates={"state": 250.0, "truth": 250.0},
    )
    units = {f"effort/axis{i + 1}": "Nm" for i in range(AXES)}
    return Recording.from_columns(columns, provenance, units)


def _field(path: Path, rec: dict[str, Array], name: str) -> Array:
    if name not in rec:
        raise RecordingError(f"{path}: struct 'rec' has no field {name!r}; it has {', '.join(rec)}")
    return rec[name]
