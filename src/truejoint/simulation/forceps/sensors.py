"""Sensors of the forceps: noise, harmonic error, zero and quantisation (yan2020, IV-A)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from truejoint.array_types import Array
from truejoint.errors import TruejointError
from truejoint.simulation.forceps.parameters import ForcepsParameters, ReferenceEncoder


@dataclass(frozen=True)
class ZeroShift:
    """By how much one homing set the zeros wrong; it is added to what a sensor reads.

    `motor` [rad] is at the motor shaft, `drive` and `reset` [m] at the encoders of both cables.
    """

    motor: float = 0.0
    drive: float = 0.0
    reset: float = 0.0

    @classmethod
    def drawn(cls, deviation: float, seed: int | Sequence[int]) -> ZeroShift:
        """Zeros of one homing of the cables' encoders, normal with `deviation` [m].

        The motor shares the drive cable's limit switch and keeps its zero here.
        """
        if not (math.isfinite(deviation) and deviation >= 0.0):
            raise TruejointError(f"a homing deviation of {deviation} m; it must be 0 or more")
        drive, reset = np.random.default_rng(seed).normal(0.0, deviation, 2)
        return cls(0.0, float(drive), float(reset))


def quantised(values: Array, resolution: float) -> Array:
    """`values` (n,) rounded to multiples of `resolution`, both in one unit."""
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


class Sensors:
    """The forceps' four encoders.

    Each has a stream of noise of its own, so that changing one leaves the others alone, and the
    readings do not depend on how a motion is cut.
    """

    def __init__(self, parameters: ForcepsParameters, seed: int) -> None:
        p, turn = parameters, 2.0 * math.pi
        self._jaw = p.reference_encoder
        spawned = np.random.SeedSequence(seed).spawn(4)
        self.streams = [np.random.default_rng(child) for child in spawned]  # of noise
        self._noise_and_step = (
            (p.motor_encoder.noise, turn / p.motor_encoder.counts),
            (p.drive_encoder.noise, p.drive_encoder.resolution),
            (p.reset_encoder.noise, p.reset_encoder.resolution),
            (self._jaw.noise, turn / self._jaw.counts),
        )

    def read(self, exact: Array, zero: ZeroShift) -> Array:
        """Read motor [rad], drive, reset [m] and jaw [rad], (4, n), at the exact values (4, n)."""
        shift = (zero.motor, zero.drive, zero.reset, reference_error(exact[3], self._jaw))
        per_encoder = zip(exact, shift, self.streams, self._noise_and_step, strict=True)
        return np.stack(
            [
                quantised(values + off + rng.normal(0.0, noise, values.size), step)
                for values, off, rng, (noise, step) in per_encoder
            ]
        )
