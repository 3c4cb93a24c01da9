"""KUKA KR300 with secondary encoders behind the gears of axes 1-3 (250 Hz).

Layout: JonasWeigand/Robot_Identification:data/recorded_trajectories.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from truejoint.errors import RecordingError
from truejoint.recordings.files import read_bounded
from truejoint.recordings.mat_file import read_mat
from truejoint.recordings.recording import Recording, recording_of_file

AXES: Final = 6
# Field, quantity, axes; it has zeros in place of the secondary encoders of the other axes.
_FIELDS: Final = (
    ("act_pos_mot_deg", "measured", AXES),
    ("act_vel_mot_deg_per_s", "velocity", AXES),
    ("ref_pos_deg", "setpoint", AXES),
    ("act_torque_abs_nm", "effort", AXES),
    ("act_pos_se_deg", "truth", 3),
)


def read(path: Path) -> Recording:
    """Read one recorded trajectory, a MATLAB file with a struct ``rec``.

    Columns: ``measured``, ``velocity``, ``setpoint`` and ``effort`` [rad, rad/s, rad, Nm] of
    ``axis1`` to ``axis6``, ``truth`` [rad] of ``axis1`` to ``axis3``. The zero of the secondary
    encoders was set anew before each recording, so each counts as a homing of its own.
    """
    data, digest = read_bounded(path)
    rec = read_mat(data, str(path)).get("rec")
    if not isinstance(rec, dict):
        raise RecordingError(f"{path}: has no struct 'rec'; is it a recorded trajectory?")
    for name in ("time_cont", *(field for field, _, _ in _FIELDS)):
        if name not in rec:
            known = ", ".join(rec)
            raise RecordingError(f"{path}: struct 'rec' has no field {name!r}; it has {known}")
    columns = {"t": rec["time_cont"].reshape(-1)}
    shape = (AXES, columns["t"].size)
    for name, quantity, axes in _FIELDS:
        values = rec[name]
        if values.shape != shape:
            raise RecordingError(f"{path}: rec.{name} is of shape {values.shape}, expected {shape}")
        scaled = np.radians(values) if "_deg" in name else values
        columns |= {f"{quantity}/axis{i + 1}": scaled[i] for i in range(axes)}
    session = path.parent.name if path.stem == "data" else path.stem
    return recording_of_file(
        path, "kuka_kr300", columns, rate=250.0, sha256=digest, session=session, homing_id=session
    )
