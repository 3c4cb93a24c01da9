"""The RAVEN-II laboratory's CSV layouts, of 240 and 252 columns.

The first is the robot's state; in the second the external joint encoders and CRTK's joint state
stand before it.

Column ranges: uw-biorobotics/raven2_CRTK_Python_controller:bag_reader/func_raven_bag_reader.py
and HaonanPeng/RAVEN-2-Feature-Ablation:README.md. The state message multiplies every position by
180/pi, the insertion in metres included (uw-biorobotics/raven2:src/raven/local_io.cpp), so one
factor brings all of them to rad and m.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np

from truejoint.array_types import Array, Mask
from truejoint.errors import RecordingError
from truejoint.recordings.numeric_text import NumericTable, TextLayout, count_fields, read_numbers
from truejoint.recordings.recording import (
    Recording,
    nominal_rates,
    recording_of_file,
    runs,
    since_first,
)
from truejoint.robots import Robot, get_robot

# In the 252-column layout the external encoders of shoulder, elbow and insertion stand in columns 1
# to 3, and the robot's state from column 12 on.
STATE_COLUMNS: Final = 240
TRAINING_COLUMNS: Final = 252
STATE_START: Final = 12
EXTERNAL: Final = (1, 2, 3)

CHANNELS: Final = 8  # of one arm in every block of 16: gold (left), then green (right)
RUN_LEVEL: Final = 17
HOMING: Final = 1  # run level while the arm explores its hard stops: positions mean nothing

_DEG: Final = math.pi / 180.0
# Quantity: first column of its block of 16 in the 240-column layout, factor to SI.
BLOCKS: Final[Mapping[str, tuple[int, float]]] = {
    "measured": (1, _DEG),
    "velocity": (150, _DEG),
    "effort": (102, 1.0),
    "setpoint": (182, _DEG),
    "motor": (118, _DEG),
    "motor_velocity": (134, _DEG),
}

# Units that the external encoders may be written in: shoulder, elbow, insertion. Their driver
# counts in 2 pi/80000 rad and 5 um (uw-biorobotics/raven2_CRTK_Python_controller:joint_encoder/
# func_raven_joint_encodersIII.py), so rad and m is what it publishes; files that were worked on
# since may differ.
TRUTH_UNITS: Final[Mapping[str, tuple[float, float, float]]] = {
    "rad_m": (1.0, 1.0, 1.0),
    "deg_m": (_DEG, _DEG, 1.0),
    "deg_mm": (_DEG, _DEG, 1e-3),
    "ravenstate": (_DEG, _DEG, _DEG),
}
# Truth further from measured than this is in another unit: the raw error of the arm is about
# 8 deg and 12 mm (peng2024, Table I), a home-made zero a little more.
_PLAUSIBLE: Final = (math.radians(25.0), math.radians(25.0), 0.06)

# The truth stands still for this long while a motor goes this far: the sensor has stopped.
_FROZEN_TIME: Final = 1.0
_FROZEN_TRAVEL: Final = (math.radians(5.0), math.radians(5.0), 0.005)


def read_240(path: Path, arm: str = "left") -> Recording:
    """Read the robot's state, 240 columns, no header, no truth; text or gzip.

    ``measured``, ``velocity``, ``effort`` [Nm at the motor's capstan], ``setpoint``, ``motor`` and
    ``motor_velocity`` of the 8 channels of the `arm`. Rows recorded while homing are left out and
    counted.
    """
    robot = get_robot("raven2", arm)
    return _recording(path, robot, _read(path, robot, STATE_COLUMNS), {}, {})


def read_252(path: Path, arm: str = "left", truth_unit: str = "rad_m") -> Recording:
    """Read a training file of the arm that carries external encoders, 252 columns.

    As `read_240`, and ``truth`` of shoulder, elbow and insertion [rad, rad, m], which the file has
    in one of `TRUTH_UNITS`; one that cannot be right, by the measured positions, is refused. The
    file repeats the nearest reading for every row, so a sensor that stopped shows as a truth that
    stands still while the motors turn: such stretches become NaN and are counted.
    """
    if truth_unit not in TRUTH_UNITS:
        raise RecordingError(
            f"truth unit {truth_unit!r} is not known; choose from {', '.join(TRUTH_UNITS)}"
        )
    robot = get_robot("raven2", arm)
    table = _read(path, robot, TRAINING_COLUMNS, STATE_START, EXTERNAL)
    raw = table.values[:, -len(EXTERNAL) :]
    # The positioning joints are the first channels, right behind time and run level.
    measured = table.values[:, 2 : 2 + len(EXTERNAL)] * _DEG
    _check_truth_unit(path, robot, raw, measured, truth_unit)
    truth = raw * TRUTH_UNITS[truth_unit]
    missing = np.isnan(truth).any(axis=1)
    frozen = frozen_rows(table.values[:, 0], truth, measured)
    truth[frozen] = np.nan
    dropped = {
        "truth: value missing": int(missing.sum()),
        "no truth: its sensor stands still": int(frozen.sum()),
    }
    columns = {f"truth/{joint}": truth[:, i] for i, joint in enumerate(robot.positioning)}
    return _recording(path, robot, table, columns, dropped)


def frozen_rows(t: Array, truth: Array, measured: Array) -> Mask:
    """Rows (n,) in which no truth changes while a motor-side position travels.

    Stretches of more than 1 s of `t` (n,) [s] and 5 deg (5 mm) of `measured`, whose first row is
    still a reading; `truth` and `measured` (n, 3) are shoulder, elbow, insertion [rad, rad, m].
    """
    frozen = np.zeros(t.size, dtype=np.bool_)
    still = (np.diff(truth, axis=0) == 0).all(axis=1)
    for first, last in runs(still):
        span = np.ptp(measured[first : last + 1], axis=0)
        if t[last] - t[first] > _FROZEN_TIME and (span > _FROZEN_TRAVEL).any():
            frozen[first + 1 : last + 1] = True
    return frozen


def _read(
    path: Path, robot: Robot, columns: int, start: int = 0, external: tuple[int, ...] = ()
) -> NumericTable:
    """Time, run level, `BLOCKS` of the arm's channels, external encoders."""
    found = count_fields(path)
    if found != columns:
        raise RecordingError(
            f"{path}: {found} columns, expected {columns}; the RAVEN layouts have "
            f"{STATE_COLUMNS} or {TRAINING_COLUMNS}: for another one give a column map"
        )
    first = start + (CHANNELS if robot.arm == "right" else 0)
    channels = [first + block + i for block, _ in BLOCKS.values() for i in range(CHANNELS)]
    use = [start, start + RUN_LEVEL, *channels, *external]
    return read_numbers(path, TextLayout(columns), use, external)


def _recording(
    path: Path,
    robot: Robot,
    table: NumericTable,
    truth: Mapping[str, Array],
    dropped: Mapping[str, int],
) -> Recording:
    time, run_level, *values = table.values.T
    keep = run_level != HOMING
    stamps, start = since_first(time)
    names = [f"{quantity}/{channel}" for quantity in BLOCKS for channel in robot.channels]
    factors = np.repeat([factor for _, factor in BLOCKS.values()], CHANNELS)
    state = {n: rows * factor for n, rows, factor in zip(names, values, factors, strict=False)}
    columns = {name: rows[keep] for name, rows in {"t": stamps, **state, **truth}.items()}
    missing = {"homing": int((~keep).sum()), "last line cut short": table.incomplete}
    return recording_of_file(
        path,
        robot,
        columns,
        sha256=table.sha256,
        rates=nominal_rates(state=time),
        dropped={**dropped, **missing},
        start=start,
    )


def _check_truth_unit(
    path: Path, robot: Robot, raw: Array, measured: Array, truth_unit: str
) -> None:
    known = np.isfinite(raw).all(axis=1)
    if not known.any():
        raise RecordingError(f"{path}: the external encoders have no reading; read it as no truth")

    def fits(unit: str) -> Mask:
        distance = np.median(np.abs(raw[known] * TRUTH_UNITS[unit] - measured[known]), axis=0)
        return np.asarray(distance < _PLAUSIBLE)

    if fits(truth_unit).all():
        return
    joint = robot.positioning[int(np.argmin(fits(truth_unit)))]
    others = [unit for unit in TRUTH_UNITS if fits(unit).all()]
    advice = f"it would fit truth_unit={others[0]!r}" if others else "check units and arm"
    raise RecordingError(
        f"{path}: truth of {joint} is far from its measured position when read as "
        f"{truth_unit!r}; {advice}"
    )
