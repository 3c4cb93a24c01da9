"""The virtual forceps: jaw angles wanted in, what its sensors and an oracle would show out."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truejoint.errors import CommandRefused, TruejointError
from truejoint.robots import Robot, get_robot
from truejoint.robots.blocks import TruthBlock
from truejoint.robots.joint_rows import SETPOINT_DT, checked_rows
from truejoint.simulation.forceps.constants import plant_constants
from truejoint.simulation.forceps.load import GRAVITY, MAX_MASS, LoadTest
from truejoint.simulation.forceps.parameters import DT, ForcepsParameters
from truejoint.simulation.forceps.plant import advance, settled
from truejoint.simulation.forceps.sensors import Sensors, ZeroShift
from truejoint.simulation.twin import (
    TwinOutput,
    checked_load,
    checked_seed,
    checked_ticks,
    glide,
    hold,
)

Array = NDArray[np.float64]

SETTLING: Final = 0.5  # [s] at rest before the first row
MAX_SAMPLES: Final = 3_600_000  # an hour at 1 kHz
_PER_SETPOINT: Final = round(SETPOINT_DT / DT)
_HOMING_SPEED: Final = math.radians(15.0)  # [rad/s] of the jaw, the paper's own speed in (27)
_NO_SHIFT: Final = ZeroShift()


@dataclass(frozen=True, eq=False)
class ForcepsRun:
    """One run of the virtual forceps; arrays (n,) at the log rate, SI units.

    All displacements and angles count from the settled position at the motor's zero, where the
    paper sets them to zero; a jaw opens towards positive angles.

    Attributes
    ----------
    t : ndarray
        [s], from 0.
    setpoint : ndarray
        Jaw angle wanted [rad].
    motor, drive, reset : ndarray
        Readings of the motor encoder ``phi_m`` [rad] and of the encoders on both cables ``x1``,
        ``x2`` [m].
    reference : ndarray
        Reading of the encoder at the jaw ``theta_M`` [rad], the paper's truth.
    jaw : ndarray
        Jaw angle ``theta`` [rad], exact.
    motor_exact, drive_exact, reset_exact : ndarray
        What perfect sensors would have read.
    external_torque : ndarray
        Torque on the jaw from outside [Nm], positive where it opens the jaw.
    drive_tension, reset_tension : ndarray
        ``F_wd``, ``F_wr`` [N].
    parameters : ForcepsParameters
    seed : int
    zero_shift : ZeroShift
    load : LoadTest or None
    """

    t: Array
    setpoint: Array
    motor: Array
    drive: Array
    reset: Array
    reference: Array
    jaw: Array
    motor_exact: Array
    drive_exact: Array
    reset_exact: Array
    external_torque: Array
    drive_tension: Array
    reset_tension: Array
    parameters: ForcepsParameters
    seed: int
    zero_shift: ZeroShift
    load: LoadTest | None

    @property
    def log_rate(self) -> float:
        """Rows per second [Hz]."""
        return 1.0 / float(self.t[1] - self.t[0])

    @property
    def extra(self) -> dict[str, Array]:
        """What stands beside the motor and the truth in a recording, by column; each (n,)."""
        installed = {
            "cable/drive": (self.parameters.drive_encoder.installed, self.drive),
            "cable/reset": (self.parameters.reset_encoder.installed, self.reset),
        }
        return {name: values for name, (there, values) in installed.items() if there} | {
            "truth_exact/jaw": self.jaw,
            "truth_load/jaw": self.external_torque,
            "truth_tension/drive": self.drive_tension,
            "truth_tension/reset": self.reset_tension,
        }


class ForcepsTwin:
    """Digital twin of the one-jaw forceps of yan2020; a `truejoint.simulation.Twin`.

    The paper's forceps measures no motor torque, so `effort` is empty; the encoders on its
    cables (``cable/drive``, ``cable/reset`` [m]) and what only a simulation knows are in `extra`.

    Parameters
    ----------
    parameters : ForcepsParameters, optional
        The instrument; the nominal one by default.
    arm : str
        Empty: there is one.
    seed : int
        Of everything random: sensors and homing. The plant itself has nothing random.
    load : float
        Mass that hangs on the jaw's tip [kg] and shuts it, at right angles to the jaw at zero.

    Attributes
    ----------
    tip_force : callable, optional
        Force at the tip (n,) [N] besides the load, positive where it opens the jaw, at times
        (n,) [s] of the twin; a `LoadTest` gives one.
    line_angle : float
        Jaw angle [rad] at which load and force are perpendicular to the jaw.

    Raises
    ------
    TruejointError
        If the seed or the load is out of range.

    Examples
    --------
    >>> twin = ForcepsTwin(seed=1)
    >>> twin.run(glide(np.zeros(1), np.full(1, 0.2), 0.5)).extra["cable/reset"].shape
    (500,)
    """

    PARAMETERS: ClassVar[type[ForcepsParameters]] = ForcepsParameters

    def __init__(
        self,
        parameters: ForcepsParameters | None = None,
        *,
        arm: str = "",
        seed: int = 0,
        load: float = 0.0,
    ) -> None:
        self.robot: Final[Robot] = get_robot("forceps", arm)
        self.parameters: Final = ForcepsParameters.load() if parameters is None else parameters
        self.seed: Final = checked_seed(seed)
        self.load = load
        self.tip_force: Callable[[Array], Array] | None = None
        self.line_angle = 0.0
        self.homing_count = 0
        self._constants = plant_constants(self.parameters)
        self._state, self._motor = settled(self._constants, _PER_SETPOINT, SETTLING)
        self._sensors = Sensors(self.parameters, seed)
        self._zero = _NO_SHIFT
        self._ticks = 0
        self._command = 0.0
        self._reading = 0.0  # of the motor's encoder, at the latest row
        # Where the exact motor, x1, x2 and jaw were when the encoders were last set to zero.
        self._exact = self._advance(np.zeros(1), np.zeros(1), _PER_SETPOINT)[0, :4]
        self._origin = self._exact

    @property
    def load(self) -> float:
        """Mass that hangs on the jaw's tip [kg]."""
        return self._load

    @load.setter
    def load(self, mass: float) -> None:
        self._load = checked_load(mass, MAX_MASS)

    @property
    def time(self) -> float:
        """Time since the forceps was switched on [s]."""
        return self._ticks * SETPOINT_DT

    def home(self) -> TwinOutput:
        """Turn the motor to its limit switch and set the cables' encoders to zero there.

        Friction leaves the jaw a little elsewhere each time, and the zeros have an error of
        their own (``homing.registration_sd``); the motor's zero is the switch's.
        """
        start, zero = np.array([self._command]), np.zeros(1)
        self.run(glide(start, zero, 0.1 + math.pi / 2 * abs(self._command) / _HOMING_SPEED))
        self.run(hold(zero, SETTLING))
        self.homing_count += 1
        self._origin = np.array([self._origin[0], *self._exact[1:3], self._origin[3]])
        deviation = self.parameters.homing.registration_sd
        self._zero = ZeroShift.drawn(deviation, (self.seed, self.homing_count))
        return self.run(hold(zero, SETTLING))

    def run(self, setpoint: ArrayLike) -> TwinOutput:
        """Follow jaw angles, one row a millisecond; each is reached at the end of its own.

        Parameters
        ----------
        setpoint : array_like, shape (n, 1)
            [rad], between the jaw's stops.

        Raises
        ------
        CommandRefused
            If the shape is wrong, or a value is not finite or beyond a stop.
        TruejointError
            If the plant leaves the finite numbers.
        """
        angles = checked_rows(self.robot, setpoint, "run")[:, 0]
        _check_stops(self.parameters, angles)
        t = np.arange(self._ticks, self._ticks + len(angles) + 1, dtype=np.float64) * SETPOINT_DT
        force = np.full(t.shape, -GRAVITY * self._load)
        if self.tip_force is not None:
            pushed = np.asarray(self.tip_force(t), dtype=np.float64)
            if pushed.shape != t.shape:
                raise TruejointError(
                    f"tip_force gave shape {pushed.shape} for times {t.shape}; give one a time"
                )
            force += pushed
        log = self._advance(np.concatenate([[self._command], angles]), force, _PER_SETPOINT)
        run = self._sensed(log[1:], t[1:], angles)
        ratio = self.parameters.mechanism.motor_per_jaw
        speed = np.diff(run.motor, prepend=self._reading) / SETPOINT_DT
        if len(angles):
            self._command, self._reading = float(angles[-1]), float(run.motor[-1])
        self._exact = log[-1, :4]
        self._ticks += len(angles)
        column = (slice(None), None)
        return TwinOutput(
            t=run.t,
            name=self.robot.channels,
            measured=run.motor[column] / ratio,
            velocity=speed[column] / ratio,
            effort=np.empty((len(angles), 0)),
            setpoint=angles[column],
            motor=run.motor[column],
            motor_velocity=speed[column],
            extra=run.extra,
            truth=TruthBlock(run.t, self.robot.positioning, run.reference[column]),
            joint=run.jaw[column],
        )

    def idle(self, duration: float) -> None:
        """Let time pass with the motor held; nothing moves.

        Raises
        ------
        TruejointError
            If the duration is negative or not finite.
        """
        self._ticks += checked_ticks(duration)

    def _advance(self, angles: Array, force: Array, log_every: int) -> Array:
        """Rows (m, 7) of the plant along jaw angles (n,) [rad], the first one before it moves."""
        return np.asarray(
            advance(
                self._state,
                self._motor,
                self.parameters.mechanism.motor_from_jaw(angles),
                force,
                float(self.line_angle),
                self._constants,
                _PER_SETPOINT,
                log_every,
            )
        )

    def _sensed(self, log: Array, t: Array, setpoint: Array) -> ForcepsRun:
        """Read the sensors at the plant's rows."""
        if not np.isfinite(log).all():
            row = int(np.argmax(~np.isfinite(log).all(axis=1)))
            raise TruejointError(
                f"the simulated forceps diverged at {t[row]:.3f} s; its parameters or the force "
                "at the tip are beyond what a step of 0.1 ms can follow"
            )
        exact = (log[:, :4] - self._origin).T
        motor, drive, reset, reference = self._sensors.read(exact, self._zero)
        return ForcepsRun(
            t=t,
            setpoint=setpoint,
            motor=motor,
            drive=drive,
            reset=reset,
            reference=reference,
            jaw=exact[3],
            motor_exact=exact[0],
            drive_exact=exact[1],
            reset_exact=exact[2],
            external_torque=log[:, 4].copy(),
            drive_tension=log[:, 5].copy(),
            reset_tension=log[:, 6].copy(),
            parameters=self.parameters,
            seed=self.seed,
            zero_shift=self._zero,
            load=None,
        )


def simulate_forceps(
    parameters: ForcepsParameters,
    setpoint: ArrayLike,
    *,
    tip_force: ArrayLike | None = None,
    line_angle: float = 0.0,
    seed: int = 0,
    log_rate: float = 200.0,
    zero_shift: ZeroShift = _NO_SHIFT,
) -> ForcepsRun:
    """Drive the forceps along jaw angles, with a force at its tip if wanted.

    Parameters
    ----------
    parameters : ForcepsParameters
    setpoint : array_like, shape (n,)
        Jaw angle wanted [rad] at 1 kHz, n >= 2; it must stay between the mechanical stops. The
        jaw starts at rest at zero, wherever the setpoint does.
    tip_force : array_like, shape (n,), optional
        Force at the tip [N] at 1 kHz, along a line of fixed direction.
    line_angle : float
        Jaw angle at which that line is perpendicular to the jaw [rad].
    seed : int
        Of the sensors' noise. The plant itself has none.
    log_rate : float
        Rows per second [Hz]; must divide 10 kHz.
    zero_shift : ZeroShift
        What this homing got wrong.

    Returns
    -------
    ForcepsRun

    Raises
    ------
    TruejointError
        If an input breaks one of these rules, or the plant leaves the finite numbers.
    """
    angles = _samples(setpoint, "setpoint")
    _check_stops(parameters, angles)
    force = np.zeros_like(angles) if tip_force is None else _samples(tip_force, "tip_force")
    if force.size != angles.size:
        raise TruejointError(f"tip_force has {force.size} samples, setpoint {angles.size}")
    per_row = 1.0 / (DT * log_rate) if log_rate > 0.0 else math.nan
    if not (per_row >= 1.0 and abs(per_row - round(per_row)) < 1e-9):
        raise TruejointError(f"a log rate of {log_rate} Hz; it must divide {1 / DT:.0f} Hz")
    twin = ForcepsTwin(parameters, seed=seed)
    twin.line_angle, twin._zero = float(line_angle), zero_shift
    log = twin._advance(angles, force, round(per_row))
    t = np.arange(len(log)) / log_rate
    return twin._sensed(log, t, np.interp(t, np.arange(angles.size) * SETPOINT_DT, angles))


def simulate_load_test(
    parameters: ForcepsParameters,
    test: LoadTest,
    *,
    seed: int = 0,
    log_rate: float = 200.0,
    zero_shift: ZeroShift = _NO_SHIFT,
) -> ForcepsRun:
    """Run the load experiment `test`; `seed` also draws the hand's wobble.

    The line is perpendicular to the jaw where it stops. Raises TruejointError as
    `simulate_forceps`.
    """
    t = np.arange(round(test.end / SETPOINT_DT) + 1, dtype=np.float64) * SETPOINT_DT
    run = simulate_forceps(
        parameters,
        test.angles(t),
        tip_force=test.force(t, seed),
        line_angle=test.angle,
        seed=seed,
        log_rate=log_rate,
        zero_shift=zero_shift,
    )
    return replace(run, load=test)


def _samples(values: ArrayLike, name: str) -> Array:
    array = np.ascontiguousarray(values, dtype=np.float64)
    if array.ndim != 1 or not 2 <= array.size <= MAX_SAMPLES:
        raise TruejointError(
            f"{name} has shape {array.shape}; it must be (n,) at 1 kHz with 2 <= n <= {MAX_SAMPLES}"
        )
    if not np.isfinite(array).all():
        row = int(np.argmax(~np.isfinite(array)))
        raise TruejointError(f"{name}[{row}] is {array[row]}; every sample must be finite")
    return array


def _check_stops(parameters: ForcepsParameters, angles: Array) -> None:
    lower, upper = parameters.jaw.stop_lower, parameters.jaw.stop_upper
    beyond = (angles < lower) | (angles > upper)
    if beyond.any():
        worst = max(angles[beyond], key=abs)
        raise CommandRefused(
            f"the setpoint reaches {math.degrees(worst):.1f} deg; the jaw's stops are at "
            f"{math.degrees(lower):.1f} and {math.degrees(upper):.1f} deg: scale it down"
        )
