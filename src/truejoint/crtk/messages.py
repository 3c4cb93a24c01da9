"""What an arm reports: CRTK's payloads, with time stamps and SI units."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from truejoint.array_types import Array

State = Literal["DISABLED", "ENABLED", "PAUSED", "FAULT"]


@dataclass(frozen=True)
class OperatingState:
    """CRTK's operating state.

    Attributes
    ----------
    state : {"DISABLED", "ENABLED", "PAUSED", "FAULT"}
    is_homed : bool
        The motor encoders are registered to the joints: positions mean something.
    is_busy : bool
        A move or the homing is under way.
    t : float
        Time stamp on the robot's clock [s].

    References
    ----------
    collaborative-robotics/documentation:docs/pages/api-operating-state.rst

    Examples
    --------
    >>> arm.operating_state().is_homed
    True
    """

    state: State
    is_homed: bool
    is_busy: bool
    t: float

    @property
    def is_ready(self) -> bool:
        """Whether the arm takes motion commands: enabled and homed."""
        return self.state == "ENABLED" and self.is_homed


@dataclass(frozen=True, eq=False)
class JointState:
    """Joint state at one instant, in the robot's joint order.

    Attributes
    ----------
    t : float
        Time stamp on the robot's clock [s].
    name : tuple of str
    position : ndarray, shape (n_joints,)
        [rad or m].
    velocity : ndarray, shape (n_joints,)
        [rad/s or m/s].
    effort : ndarray, shape (n_joints,)
        Torque command at the motor capstan [Nm]; empty where the robot measures none.

    Examples
    --------
    >>> arm.measured_js().name[:2]
    ('shoulder', 'elbow')
    """

    t: float
    name: tuple[str, ...]
    position: Array
    velocity: Array
    effort: Array
