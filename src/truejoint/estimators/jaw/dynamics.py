"""The estimator's own model of the forceps: equations (9)-(14) of yan2020."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from truejoint.array_types import Array
from truejoint.errors import CalibrationError
from truejoint.filters.linear import discretise, van_loan


@dataclass(frozen=True)
class ForcepsModel:
    """Nominal values that the filter takes the forceps to have, all finite and above 0."""

    drive_stiffness: float = 14e3  # K_d [N/m]
    reset_stiffness: float = 14e3  # K_r [N/m]
    spring_stiffness: float = 656.6  # K_sp [N/m]
    jaw_inertia: float = 1e-6  # J_e [kg m2]
    slider_mass: float = 0.05  # m_g2 [kg]
    gear_ratio: float = 35.0  # z_i
    wheel_radius: float = 9.75e-3  # R [m]
    jaw_radius: float = 4e-3  # r [m]

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (math.isfinite(value) and value > 0.0):
                raise CalibrationError(f"{name} is {value!r}; give a number above 0 in SI units")

    @property
    def system(self) -> Array:
        """``A`` (4, 4) of (13), for the state jaw angle and speed, slider place and speed."""
        k_d, k_r, k_sp = self.drive_stiffness, self.reset_stiffness, self.spring_stiffness
        r, inertia, mass = self.jaw_radius, self.jaw_inertia, self.slider_mass
        return np.array(
            [
                [0.0, 1.0, 0.0, 0.0],
                [-(k_r + k_d) * r**2 / inertia, 0.0, k_r * r / inertia, 0.0],
                [0.0, 0.0, 0.0, 1.0],
                [k_r * r / mass, 0.0, -(k_sp + k_r) / mass, 0.0],
            ]
        )

    @property
    def input(self) -> Array:
        """``B`` (4, 1) of (13), for the motor's angle [rad]."""
        gain = self.drive_stiffness * self.wheel_radius * self.jaw_radius
        return np.array([[0.0], [gain / (self.gear_ratio * self.jaw_inertia)], [0.0], [0.0]])

    def noise_density(self, jaw: float, slider: float, correlation_time: float) -> Array:
        """Spectral density (4, 4) of the accelerations that neglected friction makes.

        Of a torque `jaw` [Nm] and a force `slider` [N] that count as one draw for
        `correlation_time` [s].
        """
        torque = (jaw / self.jaw_inertia) ** 2
        force = (slider / self.slider_mass) ** 2
        return np.diag([0.0, torque, 0.0, force]) * correlation_time

    def discrete(self, density: Array, dt: float) -> tuple[Array, Array, Array]:
        """Exact ``A_d`` (4, 4) and ``B_d`` (4, 1) of (14), Van Loan's ``Q`` (4, 4), over `dt`."""
        transition, gain = discretise(self.system, self.input, dt)
        return transition, gain, van_loan(self.system, density, dt)[1]

    def at_rest(self, motor: float, reset: float) -> Array:
        """State (4,) in balance at a motor angle [rad] and a slider place [m]: (9), no friction."""
        k_d, k_r = self.drive_stiffness, self.reset_stiffness
        drive = motor * self.wheel_radius / self.gear_ratio
        angle = (k_d * drive + k_r * reset) / ((k_d + k_r) * self.jaw_radius)
        return np.array([angle, 0.0, reset, 0.0])

    def modes(self) -> tuple[Array, Array]:
        """Angular frequencies (2,) [rad/s] and shapes (2, 2, as columns) of jaw and slider."""
        acceleration = -self.system[1::2, 0::2]
        scale = np.sqrt([self.jaw_inertia, self.slider_mass])
        values, vectors = np.linalg.eigh(acceleration * np.outer(scale, 1.0 / scale))
        return np.sqrt(values), vectors / scale[:, None]


def steady_gain(transition: Array, noise: Array, observed: Array, sensor: Array) -> Array:
    """Kalman gain (n, m) that a filter with constant matrices settles to.

    Of transition and its noise (n, n), what is `observed` (m, n), and the `sensor`'s covariance.
    """
    from scipy.linalg import solve_discrete_are  # noqa: PLC0415  # a control loop needs it not

    # Scaled to variances of order one: the accelerations here are 1e6 of the angles.
    size = np.sqrt(np.maximum(np.diag(noise), np.finfo(float).tiny))
    a = transition * np.outer(1.0 / size, size)
    q = noise / np.outer(size, size)
    unit = np.sqrt(np.diag(sensor))
    c = observed * np.outer(1.0 / unit, size)
    r = sensor / np.outer(unit, unit)
    predicted = solve_discrete_are(a.T, c.T, q, r)
    gain = predicted @ c.T @ np.linalg.inv(c @ predicted @ c.T + r)
    return np.asarray(gain * np.outer(size, 1.0 / unit))


def injection_gain(transition: Array, observed: Array, gain: Array) -> float:
    """How much of a constant added to the angle in every step shows in the estimate, (26).

    A filter that adds ``c G`` to its state after each correction settles at ``g c`` in its first
    state, ``g = [(I - (I - K C) A)^-1 G]_1``, since the next measurement takes some of it back.
    """
    n = len(transition)
    loop = (np.eye(n) - gain @ observed) @ transition
    return float(np.linalg.solve(np.eye(n) - loop, np.eye(n)[:, 0])[0])
