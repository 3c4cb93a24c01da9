"""The virtual forceps: jaw angles wanted in, what its sensors and an oracle would show out."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truejoint.errors import TruejointError
from truejoint.simulation.forceps.constants import plant_constants
from truejoint.simulation.forceps.load import LoadTest
from truejoint.simulation.forceps.parameters import STEP, ForcepsParameters
from truejoint.simulation.forceps.plant import INPUT_STEP, run_plant
from truejoint.simulation.forceps.sensors import ZeroShift, read_sensors

Array = NDArray[np.float64]

SETTLING: Final = 0.5  # [s] at rest before the first row
MAX_SAMPLES: Final = 3_600_000  # an hour at 1 kHz
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
    lower, upper = parameters.jaw.stop_lower, parameters.jaw.stop_upper
    if not (lower <= angles.min() and angles.max() <= upper):
        worst = angles.min() if angles.min() < lower else angles.max()
        raise TruejointError(
            f"the setpoint reaches {math.degrees(worst):.1f} deg; the jaw's stops are at "
            f"{math.degrees(lower):.1f} and {math.degrees(upper):.1f} deg: scale it down"
        )
    force = np.zeros_like(angles) if tip_force is None else _samples(tip_force, "tip_force")
    if force.size != angles.size:
        raise TruejointError(f"tip_force has {force.size} samples, setpoint {angles.size}")
    per_row = 1.0 / (STEP * log_rate) if log_rate > 0.0 else math.nan
    if not (per_row >= 1.0 and abs(per_row - round(per_row)) < 1e-9):
        raise TruejointError(f"a log rate of {log_rate} Hz; it must divide {1 / STEP:.0f} Hz")
    log = run_plant(
        parameters.mechanism.motor_from_jaw(angles),
        force,
        float(line_angle),
        plant_constants(parameters),
        STEP,
        round(SETTLING / STEP),
        round(per_row),
    )
    return _run(log, angles, parameters, seed, float(log_rate), zero_shift)


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
    t = np.arange(round(test.end / INPUT_STEP) + 1, dtype=np.float64) * INPUT_STEP
    run = simulate_forceps(
        parameters,
        test.angles(t),
        tip_force=test.force(t, seed),
        line_angle=test.angle,
        seed=seed,
        log_rate=log_rate,
        zero_shift=zero_shift,
    )
    return ForcepsRun(**{**vars(run), "load": test})


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


def _run(
    log: Array,
    angles: Array,
    parameters: ForcepsParameters,
    seed: int,
    log_rate: float,
    zero_shift: ZeroShift,
) -> ForcepsRun:
    t = np.arange(log.shape[0]) / log_rate
    if not np.isfinite(log).all():
        row = int(np.argmax(~np.isfinite(log).all(axis=1)))
        raise TruejointError(
            f"the simulated forceps diverged at {t[row]:.3f} s; its parameters or the force at the "
            "tip are beyond what a step of 0.1 ms can follow"
        )
    motor, drive, reset, jaw = (log[:, i] - log[0, i] for i in range(4))
    seen = read_sensors(motor, drive, reset, jaw, parameters, zero_shift, seed)
    grid = np.arange(angles.size) * INPUT_STEP
    return ForcepsRun(
        t=t,
        setpoint=np.interp(t, grid, angles),
        motor=seen[0],
        drive=seen[1],
        reset=seen[2],
        reference=seen[3],
        jaw=jaw,
        motor_exact=motor,
        drive_exact=drive,
        reset_exact=reset,
        external_torque=log[:, 4].copy(),
        drive_tension=log[:, 5].copy(),
        reset_tension=log[:, 6].copy(),
        parameters=parameters,
        seed=seed,
        zero_shift=zero_shift,
        load=None,
    )
