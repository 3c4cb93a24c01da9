"""The unscented filter of yan2020 for the jaw, (15)-(24), without and with its compensation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from truejoint.estimators.base import Progress
from truejoint.estimators.jaw import MOTOR, RESET, JawEstimator
from truejoint.estimators.rational import RationalModel, fit_rational
from truejoint.estimators.sequence import regular_steps
from truejoint.filters import FilterState
from truejoint.models.jaw_dynamics import ForcepsModel, injection_gain, steady_gain
from truejoint.models.jaw_families import Method, Reading
from truejoint.models.jaw_filter import (
    jaw_filter,
    mechanics,
    rest_spread,
    sensor_noise,
)

Array = NDArray[np.float64]

_OBSERVED: Final = np.array([[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


@dataclass
class FilterMemory:
    """What a filter remembers between rows: its state, and the last row's inputs."""

    state: FilterState | None = None
    motor: float = 0.0
    reset: float = 0.0
    injected: float = 0.0


class JawFilter(JawEstimator):
    """Unscented filter on the linear model (12), with a constant correction: yan2020, (15)-(23).

    The measured speed is the difference of displacements. Friction, which (12) leaves out, is what
    the process noise stands for: it sets how far the filter trusts motor and slider. Since (12) is
    linear, this is a Kalman filter.

    Parameters
    ----------
    drive_stiffness, reset_stiffness, spring_stiffness : float
        ``K_d``, ``K_r``, ``K_sp`` [N/m].
    jaw_inertia, slider_mass : float
        ``J_e`` [kg m2], ``m_g2`` [kg].
    gear_ratio, wheel_radius, jaw_radius : float
        ``z_i``, ``R``, ``r`` [m]: Table 1.
    jaw_friction, slider_friction : float
        Size of the neglected friction [Nm, N].
    correlation_time : float
        Time over which friction counts as one draw [s].
    displacement_noise, speed_noise : float
        Standard deviations of the measured displacement [m] and speed [m/s].
    lambda_ : float
        ``lambda`` of (15), above -4.
    """

    family: ClassVar[str] = "ukf"
    inputs: ClassVar[tuple[str, ...]] = (MOTOR, RESET)
    # The gain depends on the step, and what is left to compensate depends on the gain.
    counts_samples: ClassVar[bool] = True

    def __init__(
        self,
        drive_stiffness: float = 14e3,
        reset_stiffness: float = 14e3,
        spring_stiffness: float = 656.6,
        jaw_inertia: float = 1e-6,
        slider_mass: float = 0.05,
        gear_ratio: float = 35.0,
        wheel_radius: float = 9.75e-3,
        jaw_radius: float = 4e-3,
        jaw_friction: float = 1.5e-3,
        slider_friction: float = 0.2,
        correlation_time: float = 5e-3,
        displacement_noise: float = 4e-7,
        speed_noise: float = 1e-4,
        lambda_: float = -1.0,
    ) -> None:
        self.drive_stiffness = drive_stiffness
        self.reset_stiffness = reset_stiffness
        self.spring_stiffness = spring_stiffness
        self.jaw_inertia = jaw_inertia
        self.slider_mass = slider_mass
        self.gear_ratio = gear_ratio
        self.wheel_radius = wheel_radius
        self.jaw_radius = jaw_radius
        self.jaw_friction = jaw_friction
        self.slider_friction = slider_friction
        self.correlation_time = correlation_time
        self.displacement_noise = displacement_noise
        self.speed_noise = speed_noise
        self.lambda_ = lambda_

    @property
    def mechanics(self) -> ForcepsModel:
        """The model (12) that it takes the forceps for."""
        return mechanics(self.get_params())

    def loop_gain(self, interval: float) -> float:
        """``g`` of `model.injection_gain` for rows `interval` [s] apart."""
        transition, _gain, noise = self.mechanics.discrete(self._density(), interval)
        kalman = steady_gain(transition, noise, _OBSERVED, self._sensor())
        return injection_gain(transition, _OBSERVED, kalman)

    def filtered(self, X: Array, steps: Array) -> Array:
        """Angle of the bare filter (n,) [rad]: (23) without any compensation."""
        return self._run(X, steps, np.zeros(len(X)))[:, 0]

    def to_arrays(self) -> dict[str, Array]:
        """Constant (1,) [rad] that is added, from (23)."""
        return {"constant": self.constant_}

    def _set_arrays(self, arrays: Mapping[str, Array]) -> None:
        self.constant_ = arrays["constant"]
        self._prepare()

    def _fit_jaw(
        self, X: Array, y: Array, steps: Array, known: NDArray[np.bool_], progress: Progress
    ) -> None:
        self._prepare()
        error = self.filtered(X, steps) - y
        progress(0.5)
        self.constant_ = np.array([-float(np.mean(error[known]))])

    def evaluate(self, X: Array, steps: Array | None = None) -> Array:
        """Jaw angle (n, 1) [rad] for rows `X` (n, 2) in the order of time."""
        intervals = regular_steps(len(X)) if steps is None else steps
        injected, added = self._compensation(X)
        angle = self._run(X, intervals, injected)[:, 0] + added
        return angle[:, None]

    def start(self) -> FilterMemory:
        """Memory before the first row."""
        return FilterMemory()

    def step(self, state: FilterMemory, interval: float, row: Array) -> Array:
        """Jaw angle (1,) [rad] of one row; see `SequenceRegressor.step`."""
        motor, reset = float(row[0]), float(row[1])
        if state.state is None or interval == 0.0:
            state.state = self._filter.initial_state(
                self.mechanics.at_rest(motor, reset), self._spread()
            )
            state.motor, state.injected = motor, 0.0
            speed, interval = np.nan, 0.0
        else:
            speed = (reset - state.reset) / interval
        self._filter.step(state.state, (reset, speed), (state.motor, state.injected), interval)
        injected, added = self._compensation(row[None])
        state.motor, state.reset, state.injected = motor, reset, float(injected[0])
        return np.array([float(state.state.x[0]) + float(injected[0]) + float(added[0])])

    def _compensation(self, X: Array) -> tuple[Array, Array]:
        """Give what is added to the state and what to the output after each row, (n,) [rad]."""
        return np.zeros(len(X)), np.full(len(X), float(self.constant_[0]))

    def _run(self, X: Array, steps: Array, injected: Array) -> Array:
        """States (n, 4) after each row, the first with what was added to it."""
        motor, reset = X[:, 0], X[:, 1]
        states = np.empty((len(X), 4))
        speed = np.full(len(X), np.nan)
        moved = steps > 0.0
        speed[moved] = np.diff(reset, prepend=reset[:1])[moved] / steps[moved]
        edges = [*np.flatnonzero(~moved).tolist(), len(X)]
        for first, last in pairwise(edges):
            rows = slice(first, last)
            control = np.empty((last - first, 2))
            control[:, 0] = np.concatenate([motor[first : first + 1], motor[first : last - 1]])
            control[:, 1] = np.concatenate([[0.0], injected[first : last - 1]])
            states[rows] = self._filter.run(
                np.column_stack([reset[rows], speed[rows]]),
                control,
                x0=self.mechanics.at_rest(float(motor[first]), float(reset[first])),
                P0=self._spread(),
                dt=steps[rows],
            ).x
        states[:, 0] += injected
        return states

    def _prepare(self) -> None:
        self._filter = jaw_filter(self.get_params())

    def _density(self) -> Array:
        return self.mechanics.noise_density(
            self.jaw_friction, self.slider_friction, self.correlation_time
        )

    def _sensor(self) -> Array:
        return sensor_noise(self.get_params())

    def _spread(self) -> Array:
        return rest_spread(self.get_params())


class CompensatedJawFilter(JawFilter):
    """The filter of yan2020 with its error model (25), in one of four readings of (26).

    The error model is fitted to estimate minus truth (24). (26) adds it to the state; since it is
    the error, it must be subtracted, and since the next measurement takes part of it back, what is
    added must be divided by the loop's gain ``g`` for the whole of it to show.

    Parameters
    ----------
    reading : {"output", "scaled", "signed", "literal"}
        Subtracted from the output only; subtracted in the loop and divided by ``g``; subtracted in
        the loop; or added in the loop as (26) is printed.
    fit_method : {"projection", "quasi_newton", "global"}
        How (25) is fitted: see `fit_rational`.

    Other Parameters
    ----------------
    drive_stiffness, ... : float
        As in `JawFilter`.
    """

    family: ClassVar[str] = "ukf_compensated"

    def __init__(
        self,
        reading: Reading = "output",
        fit_method: Method = "projection",
        drive_stiffness: float = 14e3,
        reset_stiffness: float = 14e3,
        spring_stiffness: float = 656.6,
        jaw_inertia: float = 1e-6,
        slider_mass: float = 0.05,
        gear_ratio: float = 35.0,
        wheel_radius: float = 9.75e-3,
        jaw_radius: float = 4e-3,
        jaw_friction: float = 1.5e-3,
        slider_friction: float = 0.2,
        correlation_time: float = 5e-3,
        displacement_noise: float = 4e-7,
        speed_noise: float = 1e-4,
        lambda_: float = -1.0,
    ) -> None:
        super().__init__(
            drive_stiffness, reset_stiffness, spring_stiffness, jaw_inertia, slider_mass,
            gear_ratio, wheel_radius, jaw_radius, jaw_friction, slider_friction,
            correlation_time, displacement_noise, speed_noise, lambda_,
        )  # fmt: skip
        self.reading = reading
        self.fit_method = fit_method

    def to_arrays(self) -> dict[str, Array]:
        """Scale (2,) and coefficients (11,) of (25), and the loop's gain (1,)."""
        return {
            "scale": self.error_model_.scale,
            "coefficients": self.error_model_.coefficients,
            "loop_gain": self.loop_gain_,
        }

    def _set_arrays(self, arrays: Mapping[str, Array]) -> None:
        self.error_model_ = RationalModel(arrays["scale"], arrays["coefficients"])
        self.loop_gain_ = arrays["loop_gain"]
        self._prepare()

    def _fit_jaw(
        self, X: Array, y: Array, steps: Array, known: NDArray[np.bool_], progress: Progress
    ) -> None:
        self._prepare()
        error = self.filtered(X, steps)[known] - y[known]
        progress(0.3)
        self.error_model_ = fit_rational(X[known, 0], X[known, 1], error, self.fit_method)
        interval = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 5e-3
        self.loop_gain_ = np.array([self.loop_gain(interval)])

    def _compensation(self, X: Array) -> tuple[Array, Array]:
        model = self.error_model_
        error = model(np.ascontiguousarray(X[:, 0]), np.ascontiguousarray(X[:, 1]))
        zero = np.zeros(len(X))
        if self.reading == "output":
            return zero, -error
        if self.reading == "scaled":
            return -error / self.loop_gain_[0], zero
        return (-error if self.reading == "signed" else error), zero
