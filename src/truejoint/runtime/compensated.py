"""An arm whose joints go where they are wanted, row by row through a compensator."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from truejoint.array_types import Array, Integers, floats
from truejoint.crtk.arm import Arm
from truejoint.errors import CommandRefused
from truejoint.robots.joint_rows import checked_rows
from truejoint.runtime.compensator import Compensator


@dataclass(frozen=True, eq=False)
class CompensatedMotion:
    """What `compensated_motion` did, a row for each step of the compensator.

    Attributes
    ----------
    t : ndarray, shape (n,)
        Stamps of the samples [s].
    wanted, setpoint, corrected : ndarray, shape (n, n_joints)
        Where the joints were wanted, set-points sent, and `Corrector.position` [rad or m].
    status : ndarray, shape (n,)
        Bits of `Status`.

    Examples
    --------
    >>> CompensatedMotion(np.zeros(1), *np.zeros((3, 1, 1)), np.zeros(1, int)).status
    array([0])
    """

    t: Array
    wanted: Array
    setpoint: Array
    corrected: Array
    status: Integers


def compensated_motion(arm: Arm, compensator: Compensator, wanted: ArrayLike) -> CompensatedMotion:
    """Put an arm's joints where they are wanted, row by row through a compensator; blocks.

    Joints that the calibration does not correct hold still. What the arm measures reaches its
    subscribers, for instance a `Recorder`, meanwhile. The way to the first row, which is not made
    here, is `Compensator.approach`; for a trajectory, `truejoint.motion.follow` makes both.

    Parameters
    ----------
    arm : Arm
        Enabled and homed, and the compensator's corrector told so.
    compensator : Compensator
    wanted : array_like, shape (n, n_joints)
        True positions of the corrector's joints at `Arm.rate` [rad or m].

    Raises
    ------
    CommandRefused
        If the arm is not ready or does not report a signal, a row is not finite or of other joints,
        or the compensator's rate does not divide the arm's.

    Examples
    --------
    >>> arm = truejoint.crtk.simulated_arm("forceps", seed=1)
    >>> arm.enable()
    >>> arm.home()
    >>> compensator = Compensator(Corrector(model), arm.robot)  # doctest: +SKIP
    >>> compensated_motion(arm, compensator, np.zeros((8, 1))).t.shape  # doctest: +SKIP
    (2,)
    """
    rows = floats(wanted, "compensated_motion", CommandRefused)
    joints = compensator.corrector.joints
    if rows.ndim != 2 or rows.shape[1] != len(joints) or not len(rows):
        raise CommandRefused(
            f"compensated_motion: wanted positions of shape {rows.shape}; give a row or more of "
            f"{', '.join(joints)}"
        )
    full = np.tile(arm.setpoint_js(math.inf).position, (len(rows), 1))
    full[:, arm.robot.index(joints)] = rows
    checked_rows(arm.robot, full, "compensated_motion")
    told: list[tuple[float, Array, Array, Array, int]] = []

    def tell(t: float, goal: Array, corrected: Array) -> None:
        status = int(compensator.status)
        told.append((t, goal, compensator.setpoint.copy(), corrected.copy(), status))

    pieces = compensator.setpoints(arm, [full], tell)
    arm.stream(pieces, len(rows) / arm.rate, "compensated_motion").wait()
    return CompensatedMotion(*(np.array(part) for part in zip(*told, strict=True)))
