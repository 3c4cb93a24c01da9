"""Arms with an encoder on each side of what gives way, recorded in MATLAB.

BROS, a two-joint haptic arm driven by cables (1 kHz):
niekbeckers/bi-robot-setup:main-projects/data/transmission-ratio. KUKA KR300 with secondary encoders
behind the gears of axes 1-3 (250 Hz): JonasWeigand/Robot_Identification:data/recorded_trajectories.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final, cast

import numpy as np

from truejoint.errors import RecordingError
from truejoint.recordings.bounded_file import read_bounded
from truejoint.recordings.read.array_files import read_mat
from truejoint.recordings.table.recording import Recording, recordings_of_file
from truejoint.robots import Transmission, get_robot

KUKA_AXES: Final = 6
# Field, quantity, axes; it has zeros in place of the secondary encoders of the other axes.
_KUKA_FIELDS: Final = (
    ("act_pos_mot_deg", "measured", KUKA_AXES),
    ("act_vel_mot_deg_per_s", "velocity", KUKA_AXES),
    ("ref_pos_deg", "setpoint", KUKA_AXES),
    ("act_torque_abs_nm", "effort", KUKA_AXES),
    ("act_pos_se_deg", "truth", 3),
)


def read_bros(path: Path) -> list[Recording]:
    """Read one part of a measurement of BROS, a MATLAB file with one variable ``data_<k>`` (5, n).

    Columns, for ``joint1`` and ``joint2``: ``motor`` [rad], ``measured`` [rad], the motor angle
    over the ratio, and ``truth`` [rad], the absolute encoder on the joint. The zeros of the two
    encoders differ by a constant.
    """
    data, digest = read_bounded(path)
    variables = read_mat(data, str(path))
    found = [name for name in variables if re.fullmatch(r"data_\d+", name)]
    values = variables[found[0]] if len(found) == 1 else None
    if not isinstance(values, np.ndarray) or values.shape[0] != 5:
        raise RecordingError(
            f"{path}: expected one variable data_<k> of 5 rows, found {', '.join(variables)}"
        )
    time, *rows = values
    motor, truth = rows[::2], rows[1::2]
    ratios = np.diag(cast("Transmission", get_robot("bros").transmission).matrix)
    measured = [angle / ratio for angle, ratio in zip(motor, ratios, strict=True)]
    columns = {"t": time}
    for quantity, both in (("measured", measured), ("motor", motor), ("truth", truth)):
        columns |= {f"{quantity}/joint{k}": angle for k, angle in enumerate(both, 1)}
    return recordings_of_file(path, "bros", columns, rate=1000.0, sha256=digest, session=path.stem)


def read_kuka(path: Path) -> list[Recording]:
    """Read one recorded trajectory of the KUKA, a MATLAB file with a struct ``rec``.

    Columns: ``measured``, ``velocity``, ``setpoint`` and ``effort`` [rad, rad/s, rad, Nm] of
    ``axis1`` to ``axis6``, ``truth`` [rad] of ``axis1`` to ``axis3``. The zero of the secondary
    encoders was set anew before each recording, so each counts as a homing of its own.
    """
    data, digest = read_bounded(path)
    rec = read_mat(data, str(path)).get("rec")
    if not isinstance(rec, dict):
        raise RecordingError(f"{path}: has no struct 'rec'; is it a recorded trajectory?")
    for name in ("time_cont", *(field for field, _, _ in _KUKA_FIELDS)):
        if name not in rec:
            known = ", ".join(rec)
            raise RecordingError(f"{path}: struct 'rec' has no field {name!r}; it has {known}")
    columns = {"t": rec["time_cont"].reshape(-1)}
    shape = (KUKA_AXES, columns["t"].size)
    for name, quantity, axes in _KUKA_FIELDS:
        values = rec[name]
        if values.shape != shape:
            raise RecordingError(f"{path}: rec.{name} is of shape {values.shape}, expected {shape}")
        scaled = np.radians(values) if "_deg" in name else values
        columns |= {f"{quantity}/axis{i + 1}": scaled[i] for i in range(axes)}
    session = path.parent.name if path.stem == "data" else path.stem
    return recordings_of_file(
        path, "kuka_kr300", columns, rate=250.0, sha256=digest, session=session, homing_id=session
    )
