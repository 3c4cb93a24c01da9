"""What an arm reports: CRTK's payloads, with time stamps and SI units."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

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
        Torque command at the motor capstan [Nm].

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


@dataclass(frozen=True, eq=False)
class StateBlock:
    """Consecutive state messages of an arm; every array is (n, n_channels) unless said.

    Attributes
    ----------
    t : ndarray, shape (n,)
        Time stamps on the robot's clock [s], strictly increasing.
    name : tuple of str
        The channels (`Robot.channels`); an unused channel is zero.
    measured, setpoint : ndarray
        Positions [rad or m].
    velocity : ndarray
        [rad/s or m/s].
    effort : ndarray
        Torque command at the motor capstan [Nm].
    motor : ndarray
        Motor-shaft angle [rad].
    motor_velocity : ndarray
        [rad/s].

    Examples
    --------
    >>> arm.measured_js().position.shape
    (7,)
    """

    t: Array
    name: tuple[str, ...]
    measured: Array
    velocity: Array
    effort: Array
    setpoint: Array
    motor: Array
    motor_velocity: Array


@dataclass(frozen=True, eq=False)
class TruthBlock:
    """Consecutive readings of temporary joint encoders, with stamps of their own.

    Attributes
    ----------
    t : ndarray, shape (m,)
        Time stamps on the robot's clock [s], strictly increasing.
    name : tuple of str
        The joints that carry an encoder.
    position : ndarray, shape (m, len(name))
        [rad or m].

    Examples
    --------
    >>> TruthBlock(np.zeros(1), ("elbow",), np.zeros((1, 1))).name
    ('elbow',)
    """

    t: Array
    name: tuple[str, ...]
    position: Array
