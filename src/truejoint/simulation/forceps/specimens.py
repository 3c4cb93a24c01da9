"""Virtual forceps to compare methods on: the nominal one, two like the paper's, a population.

Results differ more between specimens than between seeds of the noise, so a method is judged on
many of them.
"""

import math
from functools import cache
from operator import attrgetter
from typing import Final

import numpy as np

from truejoint.errors import TruejointError, unknown
from truejoint.simulation.forceps.parameters import ForcepsParameters
from truejoint.simulation.parameter_file import random_streams, shipped_spreads

PRIORS: Final = ("lugre", "capstan", "between", "mixed")


@cache
def specimen(name: str = "nominal") -> ForcepsParameters:
    """Parameters of ``"nominal"``, ``"A"`` or ``"B"``; raises TruejointError for another name."""
    return ForcepsParameters.read(name)


def population(count: int, seed: int = 0, prior: str = "lugre") -> list[ForcepsParameters]:
    """`count` virtual forceps drawn from a prior; a larger population begins with the smaller one.

    The prior ``"lugre"`` has the friction law of the paper's twin and the mechanism of Table 1.
    ``"capstan"`` has capstan friction at the cables' guides, Maxwell slip at the contacts, creep,
    backlash, some stick-slip, radii and spring off by up to a fifth. ``"between"`` is anywhere
    between the two, with either law at the contacts. ``"mixed"`` is one of the three, evenly.

    Raises TruejointError if the count is not 1 to 100000, or there is no such prior.
    """
    streams = random_streams(count, seed)
    if prior not in PRIORS:
        raise TruejointError(unknown("prior", prior, PRIORS))
    return [_drawn(rng, prior) for rng in streams]


def _drawn(rng: np.random.Generator, prior_name: str) -> ForcepsParameters:
    # A name without a dot is a property that several parameters are made of.
    spreads, nominal = shipped_spreads("forceps/lugre_prior.toml"), specimen()
    v = {name: spread.draw(rng) for name, spread in spreads.items()}
    second_tolerance = spreads["cable_tolerance"].draw(rng)
    phases = rng.uniform(-math.pi, math.pi, 4)
    if prior_name == "mixed":
        prior_name = str(rng.choice(PRIORS[:-1]))
    law = "lugre"
    if prior_name != "lugre":
        ranges = shipped_spreads("forceps/capstan_prior.toml")
        second = {name: spread.draw(rng) for name, spread in ranges.items()}
        share, law = 1.0, "maxwell_slip"
        if prior_name == "between":
            share, law = rng.uniform(), str(rng.choice(["lugre", "maxwell_slip"]))
        for name, value in second.items():
            first = v[name] if name in v else attrgetter(name)(nominal)
            v[name] = (1.0 - share) * first + share * value
    r = v.get("mechanism.jaw_radius", nominal.mechanism.jaw_radius)
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
    numbers = {name: float(value) for name, value in values.items()}
    return nominal.with_values({**numbers, "contact.law": law})
