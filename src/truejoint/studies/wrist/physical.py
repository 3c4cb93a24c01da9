"""Joints and loads of a wrist, and how honest its physical filter is about them."""

from __future__ import annotations

from statistics import NormalDist
from typing import Final

import numpy as np

from truejoint.estimators.cables.learn import CableStates
from truejoint.recordings import Recording
from truejoint.robots.wrist.instruments import JOINTS

LOADS: Final = ("grip", "pitch", "yaw")
"""Of jaws on what they hold, and of forces at the tip about pitch and yaw."""

_NINETY: Final = NormalDist().inv_cdf(0.95)  # deviations that hold 90 % of a normal's draws


def honesty(found: CableStates, test: Recording, settled: float) -> dict[str, dict[str, float]]:
    """NEES per number, and share within the stated 90 %, of angles and loads `settled` s on."""
    rows = test.t - test.t[0] > settled
    out = {}
    for name, error, deviation in (
        ("angle", found.angle - test.columns("truth_exact", JOINTS), found.angle_deviation),
        ("load", found.load - test.columns("truth_load", LOADS), found.load_deviation),
    ):
        scaled = (error / deviation)[rows]
        covered = float(np.mean(np.abs(scaled) < _NINETY))
        out[name] = {"nees": float(np.mean(scaled**2)), "covered": covered}
    return out
