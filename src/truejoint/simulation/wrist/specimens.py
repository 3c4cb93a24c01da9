"""Populations of wristed instruments, to judge methods on many of them."""

from typing import Final

import numpy as np

from truejoint.errors import TruejointError, unknown
from truejoint.simulation.parameter_file import random_streams, shipped_spreads
from truejoint.simulation.wrist.parameters import WristParameters

FAMILIES: Final = ("cable_only", "endowrist", "measured")
MIXED: Final = "mixed"


def population(count: int, seed: int = 0, family: str = MIXED) -> list[WristParameters]:
    """`count` virtual instruments of a family, or ``"mixed"``: of the families by turns.

    A larger population begins with the smaller one.
    ``"cable_only"`` has bare cables, ``"endowrist"`` rods in the shaft, ``"measured"`` is like the
    tool of MRDLab/mis-tool-characterization.

    Raises TruejointError if the count is not 1 to 100000, or there is no such family.
    """
    streams = random_streams(count, seed)
    if family not in (*FAMILIES, MIXED):
        raise TruejointError(unknown("family", family, (*FAMILIES, MIXED)))
    return [_drawn(rng, family_of(n, family)) for n, rng in enumerate(streams)]


def family_of(number: int, family: str = MIXED) -> str:
    """Family of instrument `number` of a population."""
    return FAMILIES[number % len(FAMILIES)] if family == MIXED else family


def _drawn(rng: np.random.Generator, family: str) -> WristParameters:
    spreads = shipped_spreads("wrist/prior.toml") | shipped_spreads(f"wrist/{family}_prior.toml")
    values: dict[str, float] = {name: spread.draw(rng) for name, spread in spreads.items()}
    seed = int(rng.integers(2**31))
    name = family if family in WristParameters.SPECIMENS else "nominal"
    return WristParameters.read(name).with_values({**values, "variation.seed": seed})
