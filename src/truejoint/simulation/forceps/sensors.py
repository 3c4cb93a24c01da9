"""What the forceps' sensors read: noise, harmonic error, zero and quantisation (yan2020, IV-A)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truejoint.errors import TruejointError
from truejoint.simulation.forceps.parameters import ForcepsParameters, ReferenceEncoder

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ZeroShift:
    """By how much one homing set the zeros wrong; it is added to what a sensor reads.

    Attributes
    ----------
    motor : float
        [rad] at the motor shaft.
    drive, reset : float
        [m] at the encoders of the drive and of the reset cable.
    """

    motor: float = 0.0
    drive: float = 0.0
    reset: float = 0.0

    @classmethod
    def drawn(cls, deviation: float, seed: int) -> ZeroShift:
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


def read_sensors(
    motor: Array,
    drive: Array,
    reset: Array,
    jaw: Array,
    parameters: ForcepsParameters,
    zero: ZeroShift,
    seed: int,
) -> tuple[Array, Array, Array, Array]:
    """Read motor, drive, reset and reference encoder, each (n,), at the exact values (n,).

    Each sensor has its own stream of noise under `seed`, so that changing one leaves the others.
    """
    p = parameters
    streams = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(4)]
    noise = (p.motor_encoder.noise, p.drive_encoder.noise, p.reset_encoder.noise)
    shifts = (zero.motor, zero.drive, zero.reset)
    resolutions = (
        2.0 * math.pi / p.motor_encoder.counts,
        p.drive_encoder.resolution,
        p.reset_encoder.resolution,
    )
    seen = [
        quantised(exact + shift + rng.normal(0.0, deviation, exact.size), resolution)
        for exact, shift, rng, deviation, resolution in zip(
            (motor, drive, reset), shifts, streams[:3], noise, resolutions, strict=True
        )
    ]
    encoder = p.reference_encoder
    angle = jaw + reference_error(jaw, encoder) + streams[3].normal(0.0, encoder.noise, jaw.size)
    return seen[0], seen[1], seen[2], quantised(angle, 2.0 * math.pi / encoder.counts)
