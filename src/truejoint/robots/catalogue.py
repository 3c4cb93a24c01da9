"""Every robot by name."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Final, Protocol, cast

from truejoint.errors import RobotError, unknown

if TYPE_CHECKING:  # a list of the names needs no NumPy
    from truejoint.robots.robot import Robot


class _RobotModule(Protocol):
    """What the module of a robot offers to the catalogue."""

    ARMS: Mapping[str, str]
    """Arm by every name it goes by, in lower case; the empty name is the default."""

    def build(self, arm: str) -> Robot:
        """Build the robot's arm, one of the values of `ARMS`."""


# A robot's module is the one of its name, imported when the robot is first asked for: the
# compiler behind the kinematics takes longer to import than the rest of the package.
_ROBOTS: Final = (
    "raven2",
    "dvrk_psm",
    "davinci_grasper",
    "bros",
    "kuka_kr300",
    "kflex",
    "forceps",
)


def robot_names() -> tuple[str, ...]:
    """Names that `get_robot` knows.

    Examples
    --------
    >>> "raven2" in robot_names()
    True
    """
    return _ROBOTS


@cache
def get_robot(name: str, arm: str = "") -> Robot:
    """Robot arm by name; the same object each time.

    Parameters
    ----------
    name : str
        One of `robot_names`, in any case.
    arm : str
        Name of the arm in any case; empty for the robot's default. The arms of ``raven2`` are
        ``left`` (or ``gold``, the default) and ``right`` (or ``green``), those of ``dvrk_psm``
        ``psm1`` to ``psm3``.

    Raises
    ------
    RobotError
        If there is no such robot or arm; the message names those that exist.

    Examples
    --------
    >>> get_robot("dvrk_psm", "psm2").joint_names[:3]
    ('outer_yaw', 'outer_pitch', 'outer_insertion')
    """
    known = name.strip().lower()
    if known not in _ROBOTS:
        raise RobotError(unknown("robot", name, _ROBOTS))
    module = cast("_RobotModule", import_module(f"truejoint.robots.{known}"))
    wanted = arm.strip().lower()
    if wanted not in module.ARMS:
        names = ", ".join(n for n in module.ARMS if n) or "none: leave the arm empty"
        raise RobotError(f"{known} has no arm called {arm!r}; its arms: {names}")
    return _build(known, module.ARMS[wanted])


@cache
def _build(name: str, arm: str) -> Robot:
    module = cast("_RobotModule", import_module(f"truejoint.robots.{name}"))
    return module.build(arm)
