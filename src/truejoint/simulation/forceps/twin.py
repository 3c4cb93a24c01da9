"""The virtual forceps: jaw angles wanted in, what its sensors and an oracle would show out."""

import math
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Final

import numpy as np
from numpy.typing import ArrayLike

from truejoint.array_types import Array
from truejoint.errors import TruejointError
from truejoint.robots.blocks import SETPOINT_DT, TruthBlock
from truejoint.simulation.forceps.load import MAX_MASS, LoadTest, SwingingLoad
from truejoint.simulation.forceps.parameters import (
    DT,
    ForcepsParameters,
    ReferenceEncoder,
    plant_constants,
)
from truejoint.simulation.forceps.plant import advance, settled
from truejoint.simulation.parameter_file import random_streams
from truejoint.simulation.twin import Twin, TwinOutput, glide_at, hold, shaped
from truejoint.units import GRAVITY

SETTLING: Final = 0.5  # [s] at rest before the first row
MAX_SAMPLES: Final = 3_600_000  # an hour at 1 kHz
_PER_SETPOINT: Final = round(SETPOINT_DT / DT)
_HOMING_SPEED: Final = math.radians(15.0)  # [rad/s] of the jaw, the paper's own speed in (27)


@dataclass(frozen=True)
class ZeroShift:
    """By how much one homing set the zeros wrong; it is added to what a sensor reads.

    `motor` [rad] is at the motor shaft, `drive` and `reset` [m] at the encoders of both cables.
    """

    motor: float = 0.0
    drive: float = 0.0
    reset: float = 0.0

    @classmethod
    def drawn(cls, deviation: float, seed: int | Sequence[int]) -> "ZeroShift":
        """Zeros of one homing of the cables' encoders, normal with `deviation` [m].

        The motor shares the drive cable's limit switch and keeps its zero here.
        """
        if not (math.isfinite(deviation) and deviation >= 0.0):
            raise TruejointError(f"a homing deviation of {deviation} m; it must be 0 or more")
        drive, reset = np.random.default_rng(seed).normal(0.0, deviation, 2)
        return cls(0.0, float(drive), float(reset))


def quantised(values: Array, resolution: float | Array) -> Array:
    """`values` rounded to multiples of `resolution`, both in one unit."""
    return np.asarray(np.round(values / resolution) * resolution)


def reference_error(angle: Array | float, encoder: ReferenceEncoder) -> Array:
    """Harmonic error [rad] of the reference encoder at jaw angles `angle` [rad]; zero at zero.

    Once per turn from a magnet off centre, twice from a magnet or chip that is tilted.
    """
    first, second = encoder.first_phase, encoder.second_phase
    return np.asarray(
        encoder.first_harmonic * (np.sin(angle + first) - math.sin(first))
        + encoder.second_harmonic * (np.sin(2.0 * np.asarray(angle) + second) - math.sin(second))
    )


def read_encoders(
    p: ForcepsParameters, streams: Sequence[np.random.Generator], exact: Array, zero: ZeroShift
) -> Array:
    """Read motor [rad], drive, reset [m] and jaw [rad], (4, n), at the exact values (4, n).

    Each has a stream of noise of its own, so that changing one leaves the others alone, and the
    readings do not depend on how a motion is cut.
    """
    motor, drive, reset = p.motor_encoder, p.drive_encoder, p.reset_encoder
    jaw, turn = p.reference_encoder, 2.0 * math.pi
    steps = turn / motor.counts, drive.resolution, reset.resolution, turn / jaw.counts
    read = exact + np.array([[zero.motor], [zero.drive], [zero.reset], [0.0]])
    read[3] += reference_error(exact[3], jaw)
    for k, noise in enumerate((motor.noise, drive.noise, reset.noise, jaw.noise)):
        read[k] += streams[k].normal(0.0, noise, read.shape[1])
    return quantised(read, np.array(steps)[:, None])


_NO_SHIFT: Final = ZeroShift()


class ForcepsTwin(Twin):
    """Digital twin of the one-jaw forceps of yan2020; a `truejoint.simulation.Twin`.

    The paper's forceps measures no motor torque, so `effort` is empty; the encoders on its
    cables (``cable/drive``, ``cable/reset`` [m]) and what only a simulation knows are in `extra`.

    The weight `load` [kg] hangs on the jaw's tip and shuts it. Besides it, `tip_force` may give the
    force there (n,) [N], positive where it opens the jaw, at times (n,) [s] of the twin, as a
    `LoadTest` does; both are perpendicular to the jaw at the angle `line_angle` [rad]. The seed is
    that of sensors and homing; the plant itself has nothing random.
    """

    ROBOT: ClassVar[str] = "forceps"
    PARAMETERS: ClassVar[type[ForcepsParameters]] = ForcepsParameters
    MAX_LOAD: ClassVar[float] = MAX_MASS
    _NOTED: ClassVar[tuple[str, ...]] = (
        "_state", "_motor", "_ticks", "_command", "_reading", "_exact",
    )  # fmt: skip

    parameters: ForcepsParameters

    def _build(self) -> None:
        cables = self.parameters.mechanism.mechanism()
        self.robot = replace(self.robot, mechanism=cables, transmission=None)
        self.tip_force: Callable[[Array], Array] | None = None
        self.line_angle = 0.0
        jaw = self.parameters.jaw
        self._reach = np.array([jaw.stop_lower]), np.array([jaw.stop_upper])
        self._constants = plant_constants(self.parameters)
        self._state, self._motor = settled(self._constants, _PER_SETPOINT, SETTLING)
        self._streams = random_streams(4, self.seed)
        self._zero = _NO_SHIFT
        self._command = 0.0
        self._reading = 0.0  # of the motor's encoder, at the latest row
        # Exact motor, x1, x2 and jaw when the encoders were last set to zero.
        self._exact = self._advance(np.zeros(1), np.zeros(1), _PER_SETPOINT)[0, :4]
        self._origin = self._exact

    def homing(self) -> Generator[TwinOutput]:
        """Turn the motor to its limit switch and set the cables' encoders to zero there.

        Friction leaves the jaw a little elsewhere each time, and the zeros have an error of
        their own (``homing.registration_sd``); the motor's zero is the switch's.
        """
        zero = np.zeros(1)
        settling = hold(zero, SETTLING)
        yield from self._go(glide_at(_HOMING_SPEED, np.array([self._command]), zero), settling)
        self.homing_count += 1
        self._origin = np.array([self._origin[0], *self._exact[1:3], self._origin[3]])
        deviation = self.parameters.homing.registration_sd
        self._zero = ZeroShift.drawn(deviation, (self.seed, self.homing_count))
        yield from self._go(settling)

    def _follow(self, rows: Array) -> TwinOutput:
        angles = rows[:, 0]
        t = self._times(len(angles))
        force = np.full(t.shape, -GRAVITY * self._load)
        if self.tip_force is not None:
            force += shaped(self.tip_force(t), t.shape, "tip_force")
        log = self._advance(np.concatenate([[self._command], angles]), force, _PER_SETPOINT)
        output = self._output(log[1:], t[1:], angles, SETPOINT_DT)
        if len(angles):
            self._command, self._reading = float(angles[-1]), float(output.motor[-1, 0])
        self._exact = log[-1, :4]
        self._ticks += len(angles)
        return output

    def _advance(self, angles: Array, force: Array, log_every: int) -> Array:
        """Rows (m, 7) of the plant along jaw angles (n,) [rad], the first one before it moves."""
        goal, line = angles * self.parameters.mechanism.motor_per_jaw, float(self.line_angle)
        plant = self._state, self._motor, goal, force, line, self._constants
        return np.asarray(advance(*plant, _PER_SETPOINT, log_every))

    def _output(self, log: Array, t: Array, setpoint: Array, dt: float) -> TwinOutput:
        """Read the sensors at the plant's rows, `dt` [s] apart."""
        self._check_finite(log, t, "a step of 0.1 ms")
        p, exact = self.parameters, (log[:, :4] - self._origin).T
        motor, drive, reset, reference = read_encoders(p, self._streams, exact, self._zero)
        cables = {"cable/drive": (p.drive_encoder, drive), "cable/reset": (p.reset_encoder, reset)}
        exact_names = ("truth_load/jaw", "truth_tension/drive", "truth_tension/reset")
        motor, ratio = motor[:, None], p.mechanism.motor_per_jaw
        speed = np.diff(motor, axis=0, prepend=self._reading) / dt
        return TwinOutput(
            t=t,
            name=self.robot.channels,
            measured=motor / ratio,
            velocity=speed / ratio,
            effort=np.empty((len(t), 0)),
            setpoint=setpoint[:, None],
            motor=motor,
            motor_velocity=speed,
            extra={
                **{name: reads for name, (encoder, reads) in cables.items() if encoder.installed},
                "truth_exact/jaw": exact[3],
                **{name: log[:, 4 + k].copy() for k, name in enumerate(exact_names)},
            },
            truth=TruthBlock(t, self.robot.positioning, reference[:, None]),
            joint=exact[3][:, None],
        )


def simulate_forceps(
    parameters: ForcepsParameters,
    motion: ArrayLike | LoadTest,
    *,
    seed: int = 0,
    log_rate: float = 200.0,
    zero_shift: ZeroShift = _NO_SHIFT,
    load: SwingingLoad = SwingingLoad(0.0),  # noqa: B008  # frozen
) -> TwinOutput:
    """Drive a fresh forceps through a motion, as a table at a rate of its own.

    The motion is a `LoadTest`, or jaw angles (n,) [rad] at 1 kHz, n >= 2, between the mechanical
    stops; the jaw starts at rest at zero wherever those do. The seed is that of the sensors' noise
    and the hand's wobble; `log_rate` [Hz] must divide 10 kHz; homing got `zero_shift` wrong. A
    `load` may swing at the tip while the jaw follows angles.

    Raises TruejointError if an input breaks a rule, or the plant leaves the finite numbers.
    """
    twin = ForcepsTwin(parameters, seed=seed)
    twin._zero = zero_shift
    if isinstance(motion, LoadTest):  # the line is perpendicular to the jaw where it stops
        times = np.arange(round(motion.end / SETPOINT_DT) + 1, dtype=np.float64) * SETPOINT_DT
        twin.line_angle, force = motion.angle, motion.force(times, seed)
        motion = motion.angles(times)
    else:
        force = load.force(np.arange(np.size(motion), dtype=np.float64) * SETPOINT_DT)
    angles = np.ascontiguousarray(motion, dtype=np.float64)
    if angles.ndim != 1 or not 2 <= angles.size <= MAX_SAMPLES:
        raise TruejointError(
            f"setpoint has shape {angles.shape}; it must be (n,) at 1 kHz with 2 <= n <= "
            f"{MAX_SAMPLES}"
        )
    twin._checked(angles[:, None], "setpoint")
    per_row = 1.0 / (DT * log_rate) if log_rate > 0.0 else math.nan
    if not (per_row >= 1.0 and abs(per_row - round(per_row)) < 1e-9):
        raise TruejointError(f"a log rate of {log_rate} Hz; it must divide {1 / DT:.0f} Hz")
    log = twin._advance(angles, force, round(per_row))
    t = np.arange(len(log)) / log_rate
    wanted = np.interp(t, np.arange(angles.size) * SETPOINT_DT, angles)
    return twin._output(log, t, wanted, 1.0 / log_rate)
