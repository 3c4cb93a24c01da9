"""da Vinci Maryland grasper on a test bench, driver and jaw both measured (1 kHz).

Column order and scales: MRDLab/mis-tool-characterization:RAL-2018/compileData.m, and the header
lines of the files. Published with O'Neill, Stephens, Kowalewski, IEEE RA-L 3(4), 2018.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Final

from truejoint.recordings.read.numeric_text import TextLayout, read_numbers
from truejoint.recordings.table.recording import Recording, recordings_of_file

COLUMNS: Final = 10
HEADER_MARK: Final = "Front-end Maxon Encoder"  # stands in the header line of every file

# MRDLab/mis-tool-characterization: README and the headers of the recordings.
# Turn per count of each encoder [rad]: of the instrument's driven spindle, of the jaw, and of the
# spindle by the motor's encoder, before the gearbox.
GEAR_RATIO: Final = 35.0  # turns of the motor per turn of the spindle
DRIVER_COUNT: Final = 2 * math.pi / 8192
JAW_COUNT: Final = 2 * math.pi / 4000
MOTOR_COUNT: Final = 2 * math.pi / (4096 * 35)
TORQUE_COUNT: Final = 3.9811e-5  # [Nm] per count of either torque sensor
# Nominal transmission: the jaw turns against the driver and a little less, from a round number
# amid the published files (62-72 deg). The benches' zeros mean nothing, so the error of the
# uncorrected position does not either: compare with a fixed offset.
JAW_PER_DRIVER: Final = -0.9
JAW_AT_DRIVER_ZERO: Final = math.radians(67.0)


def read(path: Path) -> list[Recording]:
    """Read one file of the grasper bench, text or gzip.

    Columns: ``measured/jaw`` [rad], the jaw angle that the driver angle stands for nominally
    (`JAW_AT_DRIVER_ZERO` + `JAW_PER_DRIVER` x driver); ``setpoint/jaw`` likewise from the driver's
    target; ``driver/jaw`` [rad], the driver angle as recorded; ``motor/jaw`` [rad], motor shaft
    before the gearbox; ``effort/jaw`` [Nm], torque at the driver's spindle, in the driver's
    direction; ``current/jaw`` [A]; ``command/jaw``, motor command in -1..1; ``truth/jaw`` [rad];
    ``truth_effort/jaw`` [Nm], torque at the jaw; ``brake/jaw`` [A], command of the motor that
    resists the jaw.
    """
    table = read_numbers(path, TextLayout(COLUMNS, comment="%"), range(COLUMNS))
    time, driver, spindle, current, jaw, jaw_torque, brake, command, motor, target = table.values.T
    driver_angle = driver * DRIVER_COUNT
    columns = {
        "t": time,
        "measured/jaw": JAW_AT_DRIVER_ZERO + JAW_PER_DRIVER * driver_angle,
        "setpoint/jaw": JAW_AT_DRIVER_ZERO + JAW_PER_DRIVER * target * DRIVER_COUNT,
        "driver/jaw": driver_angle,
        "motor/jaw": motor * MOTOR_COUNT * GEAR_RATIO,
        "effort/jaw": spindle * TORQUE_COUNT,
        "current/jaw": current,
        "command/jaw": command,
        "brake/jaw": brake,
        "truth/jaw": jaw * JAW_COUNT,
        "truth_effort/jaw": jaw_torque * TORQUE_COUNT,
    }
    stem = path.name.partition(".")[0]
    return recordings_of_file(
        path,
        "davinci_grasper",
        columns,
        {"truth_effort/jaw": "Nm", "brake/jaw": "A"},
        rate=1000.0,
        sha256=table.sha256,
        session=f"{path.parent.name}/{stem}",
        dropped={"last line cut short": table.incomplete},
        notes=_conditions(stem)
        + "measured is the driver angle times a nominal ratio; the jaw's zero drifts by 1-3 deg "
        "between files",
    )


def _conditions(stem: str) -> str:
    """Say what the digits of a file name stand for: frequency or jaw stop, and load."""
    if not stem.isdigit() or len(stem) not in {2, 3}:
        return ""
    first, load = int(stem[0]), int(stem[-1])
    varied = f"sine of 0.{first + 1} Hz" if len(stem) == 2 else f"jaw stop index {first}"
    return f"{varied}, load index {load}; "
