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
from numpy.typing import NDArray

from truejoint.errors import RecordingError
from truejoint.recordings.numeric_text import (
    NumericTable,
    TextLayout,
    first_line,
    read_numbers,
    split_fields,
)
from truejoint.recordings.recording import (
    Array,
    Provenance,
    Recording,
    since_first,
    state_rate,
)
from truejoint.robots import Robot, get_robot

STATE_COLUMNS: Final = 240
TRAINING_COLUMNS: Final = 252
STATE_START: Final = 12
"""First column of the robot's state in the 252-column layout."""
EXTERNAL: Final = (1, 2, 3)
"""Columns of the external encoders of shoulder, elbow and insertion in the 252-column layout."""

CHANNELS: Final = 8
"""Of one arm in every block of 16: the gold (left) arm's, then the green (right) arm's."""
RUN_LEVEL: Final = 17
HOMING: Final = 1
"""Run level while the arm explores its hard stops: positions mean nothing."""

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

TRUTH_UNITS: Final[Mapping[str, tuple[float, float, float]]] = {
    "rad_m": (1.0, 1.0, 1.0),
    "deg_m": (_DEG, _DEG, 1.0),
    "deg_mm": (_DEG, _DEG, 1e-3),
    "ravenstate": (_DEG, _DEG, _DEG),
}
"""Units that the external encoders may be written in: shoulder, elbow, insertion.

The encoders' driver counts in 2 pi/80000 rad and 5 um
(uw-biorobotics/raven2_CRTK_Python_controller:joint_encoder/func_raven_joint_encodersIII.py), so rad
and m is what it publishes; files that were worked on since may differ.
"""
# Truth further from measured than this is in another unit: the raw error of the arm is about
# 8 deg and 12 mm (peng2024, Table I), a home-made zero a little more.
_PLAUSIBLE: Final = (math.radians(25.0), math.radians(25.0), 0.06)

# The truth stands still for this long while a motor goes this far: the sensor has stopped.
_FROZEN_TIME: Final = 1.0
_FROZEN_TRAVEL: Final = (math.radians(5.0), math.radians(5.0), 0.005)


def read_240(path: Path, arm: str = "left") -> Recording:
    """Read the robot's state, 240 columns, no header, no truth.

    Parameters
    ----------
    path : Path
        Text or gzip.
    arm : str
        ``"left"`` (gold) or ``"right"`` (green).

    Returns
    -------
    Recording
        ``measured``, ``velocity``, ``effort`` [Nm at the motor's capstan], ``setpoint``,
        ``motor`` and ``motor_velocity`` of the arm's 8 channels. Rows recorded while homing are
        left out and counted.

    Raises
    ------
    RecordingError
        Naming file, column count, line or time stamp that is wrong.
    """
    robot = get_robot("raven2", arm)
    use = [0, RUN_LEVEL, *_state_columns(robot, 0)]
    table = _read(path, STATE_COLUMNS, use)
    return _recording(path, robot, table, {}, {})


def read_252(path: Path, arm: str = "left", truth_unit: str = "rad_m") -> Recording:
    """Read a training file: external encoders, CRTK's joint state, the robot's state.

    Parameters
    ----------
    path : Path
        Text or gzip.
    arm : str
        The arm that carries the encoders.
    truth_unit : str
        One of `TRUTH_UNITS`; rad and m by default. A unit that cannot be right, by the measured
        positions, is refused.

    Returns
    -------
    Recording
        As `read_240`, and ``truth`` of shoulder, elbow and insertion [rad, rad, m]. The file
        repeats the nearest reading for every row, so a sensor that stopped shows as a truth that
        stands still while the motors turn: such stretches become NaN and are counted.

    Raises
    ------
    RecordingError
        As `read_240`, or if the truth cannot be in `truth_unit`.
    """
    if truth_unit not in TRUTH_UNITS:
        raise RecordingError(
            f"truth unit {truth_unit!r} is not known; choose from {', '.join(TRUTH_UNITS)}"
        )
    robot = get_robot("raven2", arm)
    states = [STATE_START, STATE_START + RUN_LEVEL, *_state_columns(robot, STATE_START)]
    table = _read(path, TRAINING_COLUMNS, [*states, *EXTERNAL], EXTERNAL)
    raw = table.values[:, len(states) :]
    # The positioning joints are the first channels, right behind time and run level.
    measured = table.values[:, 2 : 2 + len(EXTERNAL)] * _DEG
    _check_truth_unit(path, robot, raw, measured, truth_unit)
    truth = raw * TRUTH_UNITS[truth_unit]
    dropped = {}
    if np.isnan(truth).any():
        dropped["truth: value missing"] = int(np.isnan(truth).any(axis=1).sum())
    frozen = frozen_rows(table.values[:, 0], truth, measured)
    if frozen.any():
        truth[frozen] = np.nan
        dropped["no truth: its sensor stands still"] = int(frozen.sum())
    columns = {f"truth/{joint}": truth[:, i] for i, joint in enumerate(robot.positioning)}
    return _recording(path, robot, table, columns, dropped)


def frozen_rows(t: Array, truth: Array, measured: Array) -> NDArray[np.bool_]:
    """Rows in which no truth changes while a motor-side position travels.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Time stamps [s].
    truth, measured : ndarray, shape (n, 3)
        Shoulder, elbow, insertion [rad, rad, m].

    Returns
    -------
    ndarray of bool, shape (n,)
        Stretches of more than 1 s and 5 deg (5 mm); their first row is still a reading.
    """
    frozen = np.zeros(t.size, dtype=np.bool_)
    still = (np.diff(truth, axis=0) == 0).all(axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], still, [False])).astype(np.int8)))
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        span = np.ptp(measured[first : last + 1], axis=0)
        if t[last] - t[first] > _FROZEN_TIME and (span > _FROZEN_TRAVEL).any():
            frozen[first + 1 : last + 1] = True
    return frozen


def _read(path: Path, columns: int, use: list[int], may_miss: tuple[int, ...] = ()) -> NumericTable:
    found = len(split_fields(first_line(path)[1], ","))
    if found != columns:
        raise RecordingError(
            f"{path}: {found} columns, expected {columns}; the RAVEN layouts have "
            f"{STATE_COLUMNS} or {TRAINING_COLUMNS}: for another one give a column map"
        )
    return read_numbers(path, TextLayout(columns), use, may_miss)


def _state_columns(robot: Robot, start: int) -> list[int]:
    first = start + (CHANNELS if robot.arm == "right" else 0)
    return [first + block + i for block, _ in BLOCKS.values() for i in range(CHANNELS)]


def _recording(
    path: Path,
    robot: Robot,
    table: NumericTable,
    truth: Mapping[str, Array],
    dropped: Mapping[str, int],
) -> Recording:
    time, run_level = table.values[:, 0], table.values[:, 1]
    keep = run_level != HOMING
    counts = {
        **dropped,
        "homing": int((~keep).sum()),
        "last line cut short": table.incomplete,
    }
    stamps, start = since_first(time)
    columns: dict[str, Array] = {"t": stamps[keep]}
    at = 2
    for quantity, (_, factor) in BLOCKS.items():
        for channel in robot.channels:
            columns[f"{quantity}/{channel}"] = table.values[keep, at] * factor
            at += 1
    columns |= {name: values[keep] for name, values in truth.items()}
    provenance = Provenance(
        robot=robot.name,
        arm=robot.arm,
        source=path.name,
        sha256=table.sha256,
        session=path.name.split(".", maxsplit=1)[0],
        rates=state_rate(time),
        dropped=counts,
        start=start,
    )
    units = {f"effort/{channel}": "Nm" for channel in robot.channels}
    return Recording.from_columns(columns, provenance, units)


def _check_truth_unit(
    path: Path, robot: Robot, raw: Array, measured: Array, truth_unit: str
) -> None:
    known = np.isfinite(raw).all(axis=1)
    if not known.any():
        raise RecordingError(f"{path}: the external encoders have no reading; read it as no truth")

    def fits(unit: str) -> NDArray[np.bool_]:
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
