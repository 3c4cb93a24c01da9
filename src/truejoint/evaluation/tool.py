"""From joint positions of a recording to tool positions: which joints matter, what is missing."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import PurePath

import numpy as np
from numpy.typing import NDArray

from truejoint.recordings.recording import Recording
from truejoint.robots import Robot

Array = NDArray[np.float64]

_STILL = 1e-9  # m per rad or m per m; below, a joint does not move the tool
_PROBES = 20


def why_no_cartesian(robot: Robot, recordings: Sequence[Recording]) -> str:
    """Give the reason why tool positions cannot be computed; empty when they can.

    A joint may be missing from a recording if it does not move the tool, such as a jaw.
    """
    if robot.kinematics is None:
        return f"The kinematics of {robot.name} are not known, so errors stay in joint space."
    for recording in recordings:
        missing = [j for j in robot.joint_names if j not in recording.joints_of("measured")]
        rows = np.linspace(0, len(recording) - 1, _PROBES).astype(np.int64)
        probes = all_joints(recording, robot)[rows]
        linear = robot.kinematics.jacobian(probes)[..., :3, :]
        needed = [j for j in missing if np.abs(linear[..., robot.index([j])]).max() > _STILL]
        if needed:
            return (
                f"{PurePath(recording.provenance.source).name or 'A recording'} lacks the "
                f"measured position of {', '.join(needed)}, which moves the tool."
            )
    return ""


def all_joints(recording: Recording, robot: Robot) -> Array:
    """Measured positions (n, n_joints) [rad or m] of all joints; home where there is no column."""
    known = recording.joints_of("measured")
    positions = np.tile(robot.home, (len(recording), 1))
    for column, joint in enumerate(robot.joint_names):
        if joint in known:
            positions[:, column] = recording.column(f"measured/{joint}")
    return positions
