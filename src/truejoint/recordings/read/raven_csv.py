"""The RAVEN-II laboratory's CSV layouts, of 240, 252 and 256 columns.

The first is the robot's state; in the second the external joint encoders and CRTK's joint state
stand before it; in the third a force gauge's readings behind it, which are left out.

Column ranges: uw-biorobotics/raven2_CRTK_Python_controller:bag_reader/func_raven_bag_reader.py
and HaonanPeng/RAVEN-2-Feature-Ablation:README.md. The state message multiplies every position by
180/pi, the insertion in metres included (uw-biorobotics/raven2:src/raven/local_io.cpp), so one
factor brings all of them to rad and m.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from truejoint.array_types import Array, Mask
from truejoint.crtk.messages import PROFILES, RAVEN_FIELDS, RUN_LEVELS
from truejoint.errors import RecordingError
from truejoint.recordings.bounded_file import Head
from truejoint.recordings.read.mapped import (
    CUT_SHORT,
    ColumnMap,
    Header,
    MappedColumn,
    Table,
    read_text,
)
from truejoint.recordings.read.numeric_text import text_layout
from truejoint.recordings.table.recording import Recording, runs
from truejoint.robots import Robot, get_robot

STATE_COLUMNS: Final = 240
# First columns in the 252-column layout: external encoders of shoulder, elbow and insertion, the
# seven joints of CRTK's measured_js, the robot's state.
TRAINING_COLUMNS: Final = 252
WITH_FORCE_COLUMNS: Final = 256
FORMATS: Final = {240: "raven_csv_240", 252: "raven_csv_252", 256: "raven_csv_252"}
"""Name of the format by the number of its columns."""
EXTERNAL, CRTK, STATE_START = 1, 5, 12
AMID: Final = "homing, after rows that are kept"

_DEG: Final = math.pi / 180.0
# First column of each block of 16 in the 240-column layout, by the message's field: 8 channels of
# the gold arm (left), then 8 of the green one (right).
_FIRST: Final = {
    "jpos": 1, "encVals": 70, "dac_val": 86, "tau": 102, "mpos": 118, "mvel": 134, "jvel": 150,
    "mpos_d": 166, "jpos_d": 182, "encoffsets": 200,
}  # fmt: skip
_AXES: Final = ("x", "y", "z")
_ENTRIES: Final = tuple(f"{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3))
# Quantity: first column, what each arm has of it (first the gold one), factor to SI.
_OF_ARM: Final[dict[str, tuple[int, tuple[str, ...], float]]] = {
    "tool": (22, _AXES, 1e-6),
    "tool_setpoint": (64, _AXES, 1e-6),
    "rotation": (28, _ENTRIES, 1.0),
    "rotation_setpoint": (46, _ENTRIES, 1.0),
    "grasp_setpoint": (198, ("jaw",), 1.0),
    "jacobian_velocity": (216, ("x", "y", "z", "rx", "ry", "rz"), 1.0),
    "jacobian_force": (228, ("x", "y", "z", "rx", "ry", "rz"), 1.0),
    "arm": (20, ("type",), 1.0),
}
_OF_STATE: Final = {"state/run_level": 17, "state/sub_level": 18, "state/last_seq": 19}

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
ENCODER_ZERO: Final = "encoders"
TRUTH_ZEROS: Final = (ENCODER_ZERO, "robot")
"""Zeros that the external encoders may count from: that of their driver, or that of the robot."""
# Truth further from measured than this is in another unit: the raw error of the arm is about
# 8 deg and 12 mm (peng2024, Table I), a home-made zero a little more.
_PLAUSIBLE: Final = (math.radians(25.0), math.radians(25.0), 0.06)

# The truth stands still for this long while a motor goes this far: the sensor has stopped.
_FROZEN_TIME: Final = 1.0
_FROZEN_TRAVEL: Final = (math.radians(5.0), math.radians(5.0), 0.005)


def read_240(path: Path, arm: str = "left", head: Head | None = None) -> list[Recording]:
    """Read the robot's state, 240 columns, no header, no truth; text or gzip.

    Every field of the state, for the `arm`: of its 8 channels ``measured``, ``velocity``,
    ``effort`` [Nm at the motor's capstan], ``setpoint``, ``motor``, ``motor_velocity``,
    ``motor_setpoint``, ``encoder`` and ``encoder_offset`` [counts], ``dac``; ``tool`` [m] and
    ``rotation`` with their setpoints, ``jacobian_velocity``, ``jacobian_force`` (which repeats the
    velocity), ``state``.
    Rows recorded while homing are left out and counted.
    """
    robot = get_robot("raven2", arm)
    return _recordings(path, _read(head or Head.of(path), robot, _state(robot), STATE_COLUMNS))


def read_252(
    path: Path,
    arm: str = "left",
    truth_unit: str = "rad_m",
    truth_zero: str = ENCODER_ZERO,
    head: Head | None = None,
) -> list[Recording]:
    """Read a training file of the arm that carries external encoders, 252 or 256 columns.

    As `read_240`, ``crtk``, the joint state that CRTK publishes [rad, m], and ``truth`` of
    shoulder, elbow and insertion [rad, rad, m], which the file has in one of `TRUTH_UNITS`; one
    that cannot be right, by the measured positions, is refused. It counts from one of
    `TRUTH_ZEROS`; from that of the encoders' driver, what RAVEN-II's profile says is added, as it
    is to the truth of bags and topics. The file repeats the nearest reading for every row, so a
    sensor that stopped shows as a truth that stands still while the motors turn: such stretches
    become NaN and are counted.
    """
    choices = {"unit": (truth_unit, [*TRUTH_UNITS]), "zero": (truth_zero, [*TRUTH_ZEROS])}
    for name, (value, names) in choices.items():
        if value not in names:
            raise RecordingError(
                f"truth {name} {value!r:.60} is not known; choose from {', '.join(names)}"
            )
    robot = get_robot("raven2", arm)
    columns = _state(robot, STATE_START)
    for k, joint in enumerate(robot.joint_names):
        columns[f"crtk/{joint}"] = MappedColumn(CRTK + k, robot.joint(joint).unit)
    sensors = {f"truth/{j}": MappedColumn(EXTERNAL + k) for k, j in enumerate(robot.positioning)}
    counts = TRAINING_COLUMNS, WITH_FORCE_COLUMNS
    table = _read(head or Head.of(path), robot, columns | sensors, *counts)
    raw = np.column_stack([table.columns[name] for name in sensors])
    measured = np.column_stack([table.columns[f"measured/{j}"] for j in robot.positioning])
    _check_truth_unit(path, robot, raw, measured, truth_unit)
    truth = raw * TRUTH_UNITS[truth_unit]
    frozen = frozen_rows(table.columns["t"], truth, measured)
    truth[frozen] = np.nan
    notes, profile = "", PROFILES[robot.name]
    if truth_zero == ENCODER_ZERO:
        truth += [profile.truth_offsets.get(joint, 0.0) for joint in robot.positioning]
        notes = profile.truth_note
    dropped = {**table.dropped, "no truth: its sensor stands still": int(frozen.sum())}
    columns_of_truth = dict(zip(sensors, truth.T, strict=True))
    table = replace(table, columns={**table.columns, **columns_of_truth}, dropped=dropped)
    return _recordings(path, table, notes)


def frozen_rows(t: Array, truth: Array, measured: Array) -> Mask:
    """Rows (n,) in which no truth changes while a motor-side position travels.

    Stretches of more than 1 s of `t` (n,) [s] and 5 deg (5 mm) of `measured`, whose first row is
    still a reading; `truth` and `measured` (n, 3) are shoulder, elbow, insertion [rad, rad, m].
    """
    frozen = np.zeros(t.size, dtype=np.bool_)
    for first, last in runs((np.diff(truth, axis=0) == 0).all(axis=1)):
        span = np.ptp(measured[first : last + 1], axis=0)
        if t[last] - t[first] > _FROZEN_TIME and (span > _FROZEN_TRAVEL).any():
            frozen[first + 1 : last + 1] = True
    return frozen


def without_homing(levels: Array) -> tuple[Mask, dict[str, int]]:
    """Rows (n,) in which the arm does not explore its hard stops, and how many it does, if any.

    `levels` (n,) are the state's run levels. Positions after a homing amid them have another zero.
    """
    keep = np.asarray(levels != RUN_LEVELS["homing"])
    amid = ~keep & np.logical_or.accumulate(keep)
    counts = {"homing": int((~keep & ~amid).sum()), AMID: int(amid.sum())}
    return keep, {reason: count for reason, count in counts.items() if count}


def _state(robot: Robot, start: int = 0) -> dict[str, MappedColumn]:
    """Columns of the robot's state, which begins at column `start`, by name."""
    blocks = {q: (_FIRST[name], robot.channels, f) for q, (name, f) in RAVEN_FIELDS.items()}
    columns = {"t": MappedColumn(start)}
    for quantity, (first, names, factor) in (blocks | _OF_ARM).items():
        begin = start + first + (len(names) if robot.arm == "right" else 0)
        for k, name in enumerate(names, begin):
            columns[f"{quantity}/{name}"] = MappedColumn(k, scale=factor)
    return columns | {name: MappedColumn(start + k) for name, k in _OF_STATE.items()}


def _read(head: Head, robot: Robot, columns: dict[str, MappedColumn], *counts: int) -> Table:
    """Columns of a file that has one of `counts` of them, any of which may be empty."""
    layout = replace(text_layout(head, "", ",")[0], skip=0)
    if layout.columns not in counts:
        raise RecordingError(
            f"{head.path}: {layout.columns} columns, expected {counts[0]}; the RAVEN layouts have "
            f"{STATE_COLUMNS}, {TRAINING_COLUMNS} or {WITH_FORCE_COLUMNS}: for another one give a "
            "column map"
        )
    positions = {name: int(mapped.column) for name, mapped in columns.items()}
    header = Header(head.path, ColumnMap(columns), positions, layout)
    return read_text(header, robot, may_miss=True)


def _recordings(path: Path, table: Table, notes: str = "") -> list[Recording]:
    keep, homing = without_homing(table.columns["state/run_level"])
    columns = {name: rows[keep] for name, rows in table.columns.items()}
    dropped = dict(table.dropped)
    cut_short = {CUT_SHORT: dropped.pop(CUT_SHORT)}
    table = replace(table, columns=columns, dropped=dropped | homing | cut_short)
    return table.recordings(path, notes=notes)


def _check_truth_unit(
    path: Path, robot: Robot, raw: Array, measured: Array, truth_unit: str
) -> None:
    finite = np.isfinite(raw).all(axis=1)
    if not finite.any():
        raise RecordingError(f"{path}: the external encoders have no reading; read it as no truth")
    distances = {
        unit: np.median(np.abs(raw[finite] * factors - measured[finite]), axis=0)
        for unit, factors in TRUTH_UNITS.items()
    }
    fits = {unit: distance < _PLAUSIBLE for unit, distance in distances.items()}
    if not fits[truth_unit].all():
        joint = robot.positioning[int(np.argmin(fits[truth_unit]))]
        other = next((unit for unit in TRUTH_UNITS if fits[unit].all()), "")
        advice = (
            f"it would fit truth_unit={other!r} (--metadata)" if other else "check units and arm"
        )
        raise RecordingError(
            f"{path}: truth of {joint} is far from its measured position when read as "
            f"{truth_unit!r}; {advice}"
        )
