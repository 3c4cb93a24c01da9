"""Two-joint haptic arm with an encoder on each side of its cables (1 kHz).

Layout: niekbeckers/bi-robot-setup:main-projects/data/transmission-ratio.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import cast

import numpy as np

from truejoint.errors import RecordingError
from truejoint.recordings.files import read_bounded
from truejoint.recordings.mat_file import read_mat
from truejoint.recordings.recording import Recording, recording_of_file
from truejoint.robots import Transmission, get_robot


def read(path: Path) -> Recording:
    """Read one part of the measurement, a MATLAB file with one variable ``data_<k>`` (5, n).

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
    time, motor1, truth1, motor2, truth2 = values
    ratios = np.diag(cast("Transmission", get_robot("bros").transmission).matrix)
    columns = {
        "t": time,
        "measured/joint1": motor1 / ratios[0],
        "measured/joint2": motor2 / ratios[1],
        "motor/joint1": motor1,
        "motor/joint2": motor2,
        "truth/joint1": truth1,
        "truth/joint2": truth2,
    }
    return recording_of_file(path, "bros", columns, rate=1000.0, sha256=digest, session=path.stem)
