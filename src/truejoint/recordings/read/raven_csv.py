"""The RAVEN-II laboratory's CSV layouts, of 240, 252 and 256 columns.

The first is the robot's state; in the second the external joint encoders and CRTK's joint state
stand before it; in the third a force gauge's readings behind it, which are left out.

Column ranges: uw-biorobotics/raven2_CRTK_Python_controller:bag_reader/func_raven_bag_reader.py
and HaonanPeng/RAVEN-2-Feature-Ablation:README.md. The state message multiplies every position by
180/pi, the insertion in metres included (uw-biorobotics/raven2:src/raven/local_io.cpp), so one
factor brings all of them to rad and m.
"""

import math
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from truejoint.array_types import Array, Mask
from truejoint.crtk.messages import PROFILES, RAVEN_FIELDS, RUN_LEVELS
from truejoint.errors import RecordingError, unknown
from truejoint.recordings.bounded_file import Head
from truejoint.recordings.read import mapped
from truejoint.recordings.read.numeric_text import text_layout
from truejoint.recordings.table.recording import Recording, runs
from truejoint.robots import Robot, get_robot
from truejoint.toml_file import shipped_table

STATE_COLUMNS: Final = 240
COUNTS: Final = (STATE_COLUMNS, 252, 256)
"""Numbers of columns that such files have."""
EXTERNAL, CRTK, STATE_START = 1, 5, 12
AMID: Final = "homing, after rows that are kept"

_LAYOUT: Final = shipped_table(__package__, "layouts.toml")

ENCODER_ZERO: Final = "encoders"
TRUTH_ZEROS: Final = (ENCODER_ZERO, "robot")
"""Zeros that the external encoders may count from: that of their driver, or that of the robot."""
# The encoders' driver counts in 2 pi/80000 rad and 5 um (uw-biorobotics/
# raven2_CRTK_Python_controller:joint_encoder/func_raven_joint_encodersIII.py), so it publishes rad
# and m. Truth further from measured than this is in another unit: the raw error of the arm is about
# 8 deg and 12 mm (peng2024, Table I), a home-made zero a little more.
_PLAUSIBLE: Final = (math.radians(25.0), math.radians(25.0), 0.06)

# The truth stands still for this long while a motor goes this far: the sensor has stopped.
_FROZEN_TIME: Final = 1.0
_FROZEN_TRAVEL: Final = (math.radians(5.0), math.radians(5.0), 0.005)


def read(
    path: Path, arm: str = "left", truth_zero: str = "", head: Head | None = None
) -> list[Recording]:
    """Read a file of the robot's state, with the external encoders or without; text or gzip.

    Every field of the state, for the `arm`: of its 8 channels ``measured``, ``velocity``,
    ``effort`` [Nm at the motor's capstan], ``setpoint``, ``motor``, ``motor_velocity``,
    ``motor_setpoint``, ``encoder`` and ``encoder_offset`` [counts], ``dac``; ``tool`` [m] and
    ``rotation`` with their setpoints, ``jacobian_velocity``, ``jacobian_force`` (which repeats the
    velocity), ``state``. Rows recorded while homing are left out and counted.

    A training file, of 252 or 256 columns, has ``crtk`` besides, the joint state that CRTK
    publishes [rad, m], and ``truth`` of shoulder, elbow and insertion [rad, rad, m]; one in another
    unit, by the measured positions, is refused. It counts from one of `TRUTH_ZEROS`; from that of
    the encoders' driver, the default, what RAVEN-II's profile says is added, as it is to the truth
    of bags and topics. The file repeats the nearest reading for every row, so a sensor that stopped
    shows as a truth that stands still while the motors turn: such stretches become NaN and are
    counted.
    """
    robot, layout = get_robot("raven2", arm), text_layout(head or Head.of(path), "", ",")[0]
    if layout.columns not in COUNTS:
        raise RecordingError(
            f"{path}: {layout.columns} columns, expected {' or '.join(map(str, COUNTS))}; for "
            "another layout give a column map"
        )
    if truth_zero not in ("", *TRUTH_ZEROS):
        raise RecordingError(f"{path}: {unknown('truth zero', truth_zero, TRUTH_ZEROS)}")
    if truth_zero and layout.columns == STATE_COLUMNS:
        raise RecordingError(f"{path}: has no truth; leave truth_zero out")
    has_truth = layout.columns > STATE_COLUMNS
    columns = _state(robot, STATE_START) | _training(robot) if has_truth else _state(robot)
    positions = {name: int(mapped.column) for name, mapped in columns.items()}
    table = mapped.read_text(
        mapped.Header(path, mapped.ColumnMap(columns), positions, replace(layout, skip=0)), robot
    )
    if has_truth:
        table = _with_truth(path, table, truth_zero or ENCODER_ZERO)
    keep, homing = without_homing(table.columns["state/run_level"] == RUN_LEVELS["homing"])
    kept = {name: rows[keep] for name, rows in table.columns.items()}
    dropped = dict(table.dropped)
    cut_short = {mapped.CUT_SHORT: dropped.pop(mapped.CUT_SHORT)}
    return replace(table, columns=kept, dropped=dropped | homing | cut_short).recordings(path)


def _with_truth(path: Path, table: mapped.Table, truth_zero: str) -> mapped.Table:
    """Give the truth its zero, and none where its sensor stood still; refuse another unit."""
    joints = table.robot.positioning
    truth, measured = (
        np.column_stack([table.columns[f"{quantity}/{joint}"] for joint in joints])
        for quantity in ("truth", "measured")
    )
    finite = np.isfinite(truth).all(axis=1)
    if not finite.any():
        raise RecordingError(f"{path}: the external encoders have no reading; read it as no truth")
    plausible = np.median(np.abs(truth[finite] - measured[finite]), axis=0) < _PLAUSIBLE
    if not plausible.all():
        joint = joints[int(np.argmin(plausible))]
        raise RecordingError(
            f"{path}: truth of {joint} is far from its measured position when read in rad and m; "
            "check units and arm"
        )
    frozen = frozen_rows(table.columns["t"], truth, measured)
    truth[frozen] = np.nan
    notes, profile = "", PROFILES[table.robot.name]
    if truth_zero == ENCODER_ZERO:
        truth += [profile.truth_offsets.get(joint, 0.0) for joint in joints]
        notes = profile.truth_note
    dropped = {**table.dropped, "no truth: its sensor stands still": int(frozen.sum())}
    columns = dict(zip((f"truth/{joint}" for joint in joints), truth.T, strict=True))
    return replace(table, columns={**table.columns, **columns}, dropped=dropped, notes=notes)


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


def without_homing(is_homing: Mask) -> tuple[Mask, dict[str, int]]:
    """Rows (n,) in which the arm does not explore its hard stops, and how many it does.

    Positions after a homing amid them have another zero.
    """
    amid = is_homing & np.logical_or.accumulate(~is_homing)
    counts = {"homing": int((is_homing & ~amid).sum()), AMID: int(amid.sum())}
    return ~is_homing, counts


def _state(robot: Robot, start: int = 0) -> dict[str, mapped.MappedColumn]:
    """Columns of the robot's state, which begins at column `start`, by name."""
    first_of = _LAYOUT["raven_first"]
    blocks = {q: (first_of[name], robot.channels, f) for q, (name, f) in RAVEN_FIELDS.items()}
    columns = {"t": mapped.MappedColumn(start)}
    for quantity, (first, names, factor) in (blocks | _LAYOUT["raven_of_arm"]).items():
        begin = start + first + (len(names) if robot.arm == "right" else 0)
        for k, name in enumerate(names, begin):
            columns[f"{quantity}/{name}"] = mapped.MappedColumn(k, scale=factor)
    states = _LAYOUT["raven_of_state"].items()
    return columns | {f"state/{name}": mapped.MappedColumn(start + k) for name, k in states}


def _training(robot: Robot) -> dict[str, mapped.MappedColumn]:
    """Columns of a training file that stand before the robot's state."""
    joints, sensors = enumerate(robot.joints, CRTK), enumerate(robot.positioning, EXTERNAL)
    columns = {f"crtk/{joint.name}": mapped.MappedColumn(k, joint.unit) for k, joint in joints}
    return columns | {f"truth/{joint}": mapped.MappedColumn(k) for k, joint in sensors}
