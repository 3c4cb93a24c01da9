"""A weight hung on the jaw's tip by hand, as in yan2020, section IV-D."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, Literal

import numpy as np

from truejoint.array_types import Array
from truejoint.errors import TruejointError
from truejoint.units import GRAVITY

MAX_MASS: Final = 2.0  # [kg]
MAX_FREQUENCY: Final = 20.0  # [Hz] of a load that swings
MAX_END: Final = 3600.0  # [s]
_WOBBLE_TONES: Final = 6
_WOBBLE_BAND: Final = (1.0, 6.0)  # [Hz] of an unsteady hand
_WOBBLE_SIZE: Final = 0.2  # of the weight, while it is being let go


@dataclass(frozen=True)
class LoadTest:
    """One load experiment: turn at constant speed, stop, hang a weight of `mass` [kg] by hand.

    It pulls ``"opposing"`` the motion before it, which stretches the drive cable, or ``"along"``,
    which slackens that. The jaw goes to `angle` [rad] at `speed` [rad/s], from `start` [s] on; the
    hand touches the weight from `loaded_from` to `loaded_to` [s]. From phase IV on the jaw may go
    back by `rock` [rad] and forth, again and again, at the same speed.
    """

    mass: float
    direction: Literal["opposing", "along"] = "opposing"
    angle: float = math.radians(30.0)
    speed: float = math.radians(1.875)
    start: float = 2.0
    loaded_from: float = 24.0
    loaded_to: float = 26.5
    end: float = 36.0
    rock: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.mass <= MAX_MASS:
            raise TruejointError(f"a load of {self.mass:g} kg; it must lie in [0, {MAX_MASS:g}] kg")
        if self.direction not in ("opposing", "along"):
            raise TruejointError(
                f"load direction {self.direction!r}; write 'opposing' or 'along' (the motion)"
            )
        moves = 0.0 < abs(self.speed) < math.inf and math.isfinite(self.angle)
        if not (moves and 0.0 <= self.rock <= abs(self.angle)):
            raise TruejointError(
                f"a load test to {self.angle} rad at {self.speed} rad/s that rocks by {self.rock} "
                "rad; the angle must be finite, the speed not 0, and it rocks by 0 to the angle"
            )
        times = (0.0, self.start, self.stop, self.loaded_from, self.loaded_to, self.end, MAX_END)
        if not all(before <= after for before, after in pairwise(times)):
            raise TruejointError(
                f"a load test moves from {self.start:g} to {self.stop:g} s, is loaded from "
                f"{self.loaded_from:g} to {self.loaded_to:g} s and ends at {self.end:g} s: these "
                f"times must not decrease, nor exceed {MAX_END:g} s"
            )

    @property
    def stop(self) -> float:
        """Time at which the motion ends [s]."""
        return self.start + abs(self.angle) / abs(self.speed)

    @property
    def phases(self) -> Mapping[str, tuple[float, float]]:
        """First and last time [s] of the paper's phases I (moving), II (still), III, IV (loaded).

        II begins half a second after the stop, IV a second and a half after the hand has let go, so
        that both are still.
        """
        return {
            "I": (self.start, self.stop),
            "II": (min(self.stop + 0.5, self.loaded_from), self.loaded_from),
            "III": (self.loaded_from, self.loaded_to),
            "IV": (min(self.loaded_to + 1.5, self.end), self.end),
        }

    def angles(self, t: Array) -> Array:
        """Jaw angles wanted (n,) [rad] at times `t` (n,) [s]."""
        travelled = np.clip(abs(self.speed) * (t - self.start), 0.0, abs(self.angle))
        if self.rock > 0.0:
            rocked = np.maximum(abs(self.speed) * (t - self.phases["IV"][0]), 0.0)
            travelled -= self.rock - np.abs(rocked % (2.0 * self.rock) - self.rock)
        return np.asarray(math.copysign(1.0, self.angle) * travelled)

    def force(self, t: Array, seed: int) -> Array:
        """Force at the tip (n,) [N] at times `t` (n,) [s], positive where it opens the jaw.

        The hand lets go smoothly, wobbling by a fifth of the weight between 1 and 6 Hz, drawn from
        `seed`; the line never pushes. The weight's inertia is left out: in phase IV it hangs still,
        or goes slowly.
        """
        share = np.clip((t - self.loaded_from) / max(self.loaded_to - self.loaded_from, 1e-3), 0, 1)
        released = share * share * (3.0 - 2.0 * share)
        rng = np.random.default_rng(seed)
        frequency = rng.uniform(*_WOBBLE_BAND, _WOBBLE_TONES)
        phase = rng.uniform(0.0, 2.0 * math.pi, _WOBBLE_TONES)
        tones = np.sin(2.0 * math.pi * np.multiply.outer(t, frequency) + phase).sum(axis=1)
        wobble = math.sqrt(2.0 / _WOBBLE_TONES) * tones * 4.0 * share * (1.0 - share)
        weight = self.mass * GRAVITY * np.maximum(released + _WOBBLE_SIZE * wobble, 0.0)
        along = math.copysign(1.0, self.angle)
        return np.asarray(weight * (along if self.direction == "along" else -along))


@dataclass(frozen=True)
class SwingingLoad:
    """A weight of `mass` [kg] at the jaw's tip, steady or swinging between nothing and all of it.

    It swings at `frequency` [Hz], 0 for one that hangs still, and opens the jaw or shuts it; it is
    put on within a second.
    """

    mass: float
    frequency: float = 0.0
    opens: bool = False

    def __post_init__(self) -> None:
        if not (0.0 <= self.mass <= MAX_MASS and 0.0 <= self.frequency <= MAX_FREQUENCY):
            raise TruejointError(
                f"a load of {self.mass:g} kg that swings at {self.frequency:g} Hz; they must lie "
                f"in [0, {MAX_MASS:g}] kg and [0, {MAX_FREQUENCY:g}] Hz"
            )

    def force(self, t: Array) -> Array:
        """Force at the tip (n,) [N] from 0 s on, positive where it opens the jaw."""
        share = np.clip(t, 0.0, 1.0)
        if self.frequency > 0.0:
            share = 0.5 * share * (1.0 - np.cos(2.0 * math.pi * self.frequency * t))
        return np.asarray((1.0 if self.opens else -1.0) * GRAVITY * self.mass * share)
