"""Friction laws that several digital twins share, compiled into their plants."""

import math
from typing import NamedTuple

from truejoint.array_types import Array
from truejoint.compiled import inlined

N_ELEMENTS = 4  # of Maxwell slip at each contact
_FIRST_SHARE = 1.0 / sum(1.0 / (i + 1) for i in range(N_ELEMENTS))


class ContactLaw(NamedTuple):
    """Friction of a contact where it slides, in the units of its place."""

    viscous: float  # friction per speed [N s/m or Nm s/rad]
    presliding: float  # way in which friction builds up [m or rad]
    stribeck_ratio: float  # of friction at rest over that of sliding
    stribeck_velocity: float  # speed within which the one becomes the other [m/s or rad/s]
    damping: float  # of what sticks [N s/m or Nm s/rad]


@inlined
def guide_travel(
    before: float, behind: float, ratio: float, stiffness_before: float, stiffness_behind: float
) -> float:
    """By how much a cable slides over a guide, towards what lies before it [m].

    Tensions [N] before and behind stand at most in `ratio`, exp(mu phi) of the capstan equation;
    stiffnesses [N/m] are those of the two pieces. Closed form, so that no stiffness is too high.
    """
    if before > ratio * behind:
        return (before - ratio * behind) / (stiffness_before + ratio * stiffness_behind)
    if behind > ratio * before:
        return (ratio * before - behind) / (stiffness_behind + ratio * stiffness_before)
    return 0.0


@inlined
def stribeck_peak(speed: float, f: ContactLaw) -> float:
    """Friction at a speed over Coulomb friction, but for its viscous part."""
    ratio = speed / f.stribeck_velocity
    if abs(ratio) < 6.0:
        return 1.0 + (f.stribeck_ratio - 1.0) * math.exp(-ratio * ratio)
    return 1.0


@inlined
def maxwell_slip(
    position: float, speed: float, level: float, f: ContactLaw, stuck: Array, first: int, keep: bool
) -> float:
    """Friction [N or Nm] of `N_ELEMENTS` springs in parallel, each with a slip of its own.

    They share the Coulomb `level` evenly and slip at distances like 1 : 2 : 3 : 4, such that
    together they begin as stiff as a bristle of LuGre. ``stuck[first:]`` is where each would be
    without force, which `keep` moves.
    """
    peak = stribeck_peak(speed, f)
    pull, sticking = 0.0, 0.0
    for i in range(N_ELEMENTS):
        share = _FIRST_SHARE / (i + 1)  # of the stiffness
        distance = f.presliding / (N_ELEMENTS * share)
        strain = (position - stuck[first + i]) / distance
        if abs(strain) < peak:
            sticking += share
        else:
            strain = math.copysign(peak, strain)
        if keep:
            stuck[first + i] = position - strain * distance
        pull += strain
    return level / N_ELEMENTS * pull + (f.damping * sticking + f.viscous) * speed
