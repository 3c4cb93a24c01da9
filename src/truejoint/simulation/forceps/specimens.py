"""Virtual forceps to compare methods on: the nominal one, two like the paper's, a population.

Results differ more between specimens than between seeds of the noise, so a method is judged on
many of them.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Final, NamedTuple

import numpy as np

from truejoint.errors import TruejointError
from truejoint.simulation.forceps.parameters import ForcepsParameters
from truejoint.simulation.parameter_file import shipped_sections

SPECIMENS: Final = tuple(ForcepsParameters.SPECIMENS)
MAX_POPULATION: Final = 100_000


class Spread(NamedTuple):
    """Range [low, high] of one property; drawn evenly, or evenly in its logarithm."""

    low: float
    high: float
    scale: str

    def draw(self, rng: np.random.Generator) -> float:
        """One value."""
        if self.scale == "log":
            return float(np.exp(rng.uniform(math.log(self.low), math.log(self.high))))
        return float(rng.uniform(self.low, self.high))


def specimen(name: str = "nominal") -> ForcepsParameters:
    """Parameters of ``"nominal"``, ``"A"`` or ``"B"``; raises TruejointError for another name."""
    if name not in SPECIMENS:
        raise TruejointError(f"no forceps specimen {name!r}; known: {', '.join(SPECIMENS)}")
    return ForcepsParameters.read(name)


@cache
def prior() -> dict[str, Spread]:
    """Ranges that a population is drawn from, by parameter, in the order of the draws.

    A name without a dot is a property that several parameters are made of.
    """
    return {name: Spread(**v) for name, v in shipped_sections("forceps/prior.toml").items()}


def population(count: int, seed: int = 0) -> list[ForcepsParameters]:
    """`count` virtual forceps drawn from `prior`.

    The same seed gives the same instruments, and a larger population begins with the smaller one.
    Raises TruejointError unless 1 <= count <= 100000.
    """
    if not 1 <= count <= MAX_POPULATION:
        raise TruejointError(f"a population of {count}; it must be 1 to {MAX_POPULATION}")
    return [_drawn(stream) for stream in np.random.SeedSequence(seed).spawn(count)]


def _drawn(stream: np.random.SeedSequence) -> ForcepsParameters:
    rng = np.random.default_rng(stream)
    v = {name: spread.draw(rng) for name, spread in prior().items()}
    second_tolerance = prior()["cable_tolerance"].draw(rng)
    phases = rng.uniform(-math.pi, math.pi, 4)
    nominal = ForcepsParameters.read()
    r = nominal.mechanism.jaw_radius
    jaw_level, jaw_share = v["jaw_friction"], v["jaw_friction_from_tension"]
    slider_level, slider_share = v["slider_friction"], v["slider_friction_from_tension"]
    values = {name: value for name, value in v.items() if "." in name} | {
        "drive_cable.stiffness": v["cable_stiffness"] * v["cable_tolerance"],
        "reset_cable.stiffness": v["cable_stiffness"] * second_tolerance,
        "assembly.wheel_phase": phases[0],
        "jaw.eccentricity_phase": phases[1],
        "jaw_friction.constant": jaw_level * (1.0 - jaw_share),
        "jaw_friction.tension_share": jaw_level * jaw_share / (2.0 * v["assembly.pretension"] * r),
        "jaw_friction.stribeck_ratio": v["stribeck_ratio"],
        "slider_friction.constant": slider_level * (1.0 - slider_share),
        "slider_friction.tension_share": slider_level * slider_share / v["assembly.pretension"],
        "slider_friction.stribeck_ratio": v["stribeck_ratio"],
        "reference_encoder.first_phase": phases[2],
        "reference_encoder.second_phase": phases[3],
    }
    for cable in ("drive_cable", "reset_cable"):
        for key in ("stiffening", "elastic_share", "hysteresis_distance", "damping"):
            values[f"{cable}.{key}"] = v[f"cable_{key}"]
    return nominal.with_values({name: float(value) for name, value in values.items()})
