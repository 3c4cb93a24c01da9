"""How far off positions are: the numbers that every table and verdict is made of.

An error is the estimated position minus the true one, in the joint's SI unit (rad or m).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from truejoint.array_types import Array, floats
from truejoint.errors import CalibrationError, other_kind
from truejoint.robots import Kinematics


def rmse(error: ArrayLike) -> Array:
    """Root mean square of errors over time, shape () or (n_joints,): ``sqrt(mean(error**2))``.

    Parameters
    ----------
    error : array_like, shape (n,) or (n, n_joints)
        Estimated minus true position [rad or m].

    Raises
    ------
    CalibrationError
        If there is no row, or a value that is not finite.

    Examples
    --------
    >>> print(rmse([0.3, -0.4, 0.0]).round(3))
    0.289
    """
    return np.asarray(np.sqrt(np.mean(np.square(_checked(error)), axis=0)))


def percent_of(value: ArrayLike, whole: ArrayLike) -> Array:
    """`value` as a percentage of `whole`, as peng2024, Table I, states it; NaN of zero.

    Parameters
    ----------
    value, whole : array_like, same shape
        RMSE of an estimator and of the fixed offset, in one unit.

    Examples
    --------
    >>> print(percent_of(0.1, 0.4))
    25.0
    """
    value, whole = np.asarray(value, dtype=float), np.asarray(whole, dtype=float)
    safe = np.where(whole > 0.0, whole, np.nan)
    return 100.0 * value / safe


def tool_positions(kinematics: Kinematics, joint: ArrayLike) -> Array:
    """Tool positions (n, 3) [m] in the base frame, of joint positions (n, n_joints) [rad, m]."""
    return kinematics.forward(joint)[..., :3, 3]


def tool_error(kinematics: Kinematics, estimated: ArrayLike, true: ArrayLike) -> Array:
    """Error (n, 3) of the tool position [m], x, y, z in the base frame, by errors of the joints.

    Both joint vectors go through the same forward kinematics, so errors of the geometry itself
    cancel, as in peng2024, Table IV.

    Parameters
    ----------
    kinematics : Kinematics
    estimated, true : array_like, shape (n, n_joints)
        Joint positions [rad or m] of all joints of the robot; joints without truth hold the
        same value in both.

    Raises
    ------
    CalibrationError
        If the kinematics are none.

    Examples
    --------
    >>> robot = truejoint.get_robot("raven2")
    >>> moved = robot.home + [0, 0, 0.001, 0, 0, 0, 0]
    >>> print(np.linalg.norm(tool_error(robot.kinematics, moved, robot.home)).round(6))
    0.001
    """
    if not hasattr(kinematics, "forward"):
        advice = "give the `kinematics` of a robot of which they are known"
        raise CalibrationError(other_kind(kinematics, "Kinematics", advice))
    return tool_positions(kinematics, estimated) - tool_positions(kinematics, true)


def _checked(error: ArrayLike) -> Array:
    values = floats(error, "errors", CalibrationError)
    if values.shape[:1] in ((), (0,)):
        raise CalibrationError(
            "no row has both an estimate and a true position; evaluate on recordings with truth"
        )
    if not np.isfinite(values).all():
        raise CalibrationError(
            "an error is not finite; select the rows with truth before computing metrics"
        )
    return values
