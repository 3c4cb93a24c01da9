"""Recordings as a calibration knows them: which one it is, and whether they go together."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from truejoint.errors import CalibrationError, meant
from truejoint.robots.robot import Robot, as_robot

if TYPE_CHECKING:
    from truejoint.recordings import Recording

_SHOWN: Final = 12  # columns in a message


def trained_on(metadata: Mapping[str, Any], recording: Recording, key: str = "sessions") -> bool:
    """Whether rows of a recording were in the training, or in what metadata list under `key`.

    Two recordings are the same when their hashes are equal or, where neither has one, source,
    session, homing and start. Parts of one count as the same when their times overlap.
    """
    own = recording.provenance.to_dict()
    for session in metadata.get(key, ()):
        if own["sha256"] or session["sha256"]:
            same = own["sha256"] == session["sha256"]
        else:
            keys = ("source", "session", "homing_id", "start")
            same = all(own[key] == session.get(key, own[key]) for key in keys)
        if same and recording.t[0] <= session["last"] and recording.t[-1] >= session["first"]:
            return True
    return False


def distinct(recordings: Sequence[Recording]) -> list[Recording]:
    """Leave out what is another recording's copy: a fit without it would still have seen it."""
    found: dict[str, Recording] = {}
    for one in recordings:
        digest = hashlib.sha256()
        for name in ("t", *one.units):
            digest.update(np.ascontiguousarray(one.table[name]).tobytes())
        found.setdefault(digest.hexdigest(), one)
    return list(found.values())


def session_of(recording: Recording) -> dict[str, Any]:
    """Tell a recording from others, as JSON values."""
    kept = ("source", "sha256", "session", "homing_id", "load", "start")
    origin = recording.provenance.to_dict()
    return {key: origin[key] for key in kept} | {
        "first": float(recording.t[0]),
        "last": float(recording.t[-1]),
    }


def check_columns(recording: Recording, columns: Sequence[str], whose: str) -> None:
    """Raise CalibrationError, naming them, when columns are missing that something needs."""
    missing = [column for column in columns if column not in recording.table.columns]
    if missing:
        quantity = missing[0].partition("/")[0] + "/"  # of another one nothing can be meant
        alike = [name for name in recording.units if name.startswith(quantity)]
        raise CalibrationError(
            f"{source_of(recording)} lacks {listed(missing)}, which the {whose};"
            f"{meant(missing[0], alike)} it has {listed(list(recording.units))}"
        )


def listed(columns: Sequence[str]) -> str:
    """First columns by name, and how many more there are."""
    more = len(columns) - _SHOWN
    return ", ".join([*columns[:_SHOWN], *[f"{more} more"] * (more > 0)])


def check_unit(recording: Recording, column: str, unit: str, where: str) -> None:
    """Raise CalibrationError unless a column is in the unit that it has elsewhere."""
    if recording.units[column] != unit:
        raise CalibrationError(
            f"{source_of(recording)}: {column!r} is in {recording.units[column]}, {where} {unit}; "
            "convert it where the file is read"
        )


def check_arm(recording: Recording, arm: tuple[str, str], other: str) -> None:
    """Raise CalibrationError unless a recording is of the robot and arm that another is of."""
    robot = recording.robot
    if (robot.name, robot.arm) != arm:
        raise CalibrationError(
            f"{source_of(recording)} is of {robot.title}, {other}; calibrate each arm on its own "
            "recordings"
        )


def check_robot(made_for: tuple[str, str], robot: Robot) -> None:
    """Raise CalibrationError unless an arm is the one that a calibration was `made_for`."""
    if (as_robot(robot).name, robot.arm) != made_for:
        raise CalibrationError(
            f"the calibration of {Robot(made_for[0], (), made_for[1]).title} is not for "
            f"{robot.title}; give one that was made on recordings of this arm"
        )


def source_of(recording: Recording) -> str:
    """File or robot that a recording is of, for a message."""
    return recording.provenance.source or "recording"
