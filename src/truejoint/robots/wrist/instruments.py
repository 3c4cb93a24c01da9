"""Wristed instruments by model number, as mechanisms of cables."""

import math
from collections.abc import Mapping
from functools import cache
from typing import Any, Final

import numpy as np

from truejoint.array_types import Array
from truejoint.robots.catalogue import INSTRUMENTS
from truejoint.robots.robot import Robot
from truejoint.toml_file import shipped_table

JOINTS: Final = ("pitch", "jaw1", "jaw2")
"""The yaw is the mean of the two jaws, the opening ``jaw2 - jaw1``."""

_LAST_DIGIT: Final = 1e-4  # [rad/rad] of the files; a disc that turns a jaw by less does not
_JAW_RADIUS: Final = 2.8e-3  # [m] of the cables' path on the jaws: a guess from a shaft of 8 mm
_SPEEDS: Final = math.radians(180.0), math.radians(60.0)  # [rad/s] at most, and in a calibration
_HALF_OPEN: Final = math.radians(10.0)  # [rad] of either jaw at home
_GAP: Final = math.radians(5.0)  # a calibration's jaws never meet


def _mechanism(values: Mapping[str, Any], alike: Mapping[str, Any]) -> dict[str, Any]:
    """Mechanism of an instrument of the table: two cables from each disc to what it turns."""
    pitch, yaw, jaw = np.array([values[key] for key in ("pitch", "yaw", "jaw")], dtype=np.float64)
    # Of pitch, yaw and opening per disc, those of the joints.
    turned = np.array([pitch, yaw - 0.5 * jaw, yaw + 0.5 * jaw])
    # Else a disc would be said to turn the other jaw by 5e-5, and its cables to press on that pin.
    turned[np.abs(turned) < _LAST_DIGIT] = 0.0
    discs: Array = np.linalg.inv(turned).astype(np.float64)
    # All discs are alike, and as large as makes the jaws' radius.
    radius = _JAW_RADIUS / float(np.abs(discs[:, 1:]).max())
    cables = [
        {
            "name": f"{motor}_{end}",
            "moments": {j: sign * float(m) for j, m in zip(JOINTS, row, strict=True) if m},
            "motor": motor,
            "sign": sign,
            **alike["cable"],
        }
        for motor, row in zip(JOINTS, discs * radius, strict=True)
        for end, sign in (("a", 1), ("b", -1))  # one winds up as the motor lets the other go
    ]
    return {**alike["mechanism"], "motors": dict.fromkeys(JOINTS, radius), "cables": cables}


@cache
def build(name: str) -> Robot:
    """Robot of the instrument called `name`, which is a model number or one of RAVEN's tools."""
    rows, alike = shipped_table(__package__, INSTRUMENTS), shipped_table(__package__, "alike.toml")
    row = next(row for row in rows.values() if name in map(str, row["names"]))
    row = {**alike["instrument"], **row}
    limit = {key: math.radians(value) for key, value in row["limits_deg"].items()}
    jaw = limit["yaw"] + 0.5 * limit["jaw"]
    ends, homes = (limit["pitch"], jaw, jaw), (0.0, -_HALF_OPEN, _HALF_OPEN)
    turn, opening = 0.75 * limit["pitch"], 0.4 * jaw
    boxes = (-turn, turn), (-opening, -_GAP), (_GAP, opening)
    *axes, last = alike["kinematics"]["axes"]
    axes.append({**last, "a": 1e-3 * row["link_mm"]})
    return Robot.from_dict({
        "name": "wrist",
        "arm": name,
        "joints": [
            {"name": n, "lower": -end, "upper": end, "home": home, "max_speed": _SPEEDS[0]}
            for n, end, home in zip(JOINTS, ends, homes, strict=True)
        ],
        "effort": "motor",
        "kinematics": {**alike["kinematics"], "axes": axes},
        "workspace": {
            n: {"lower": low, "upper": high, "speed": _SPEEDS[1]}
            for n, (low, high) in zip(JOINTS, boxes, strict=True)
        },
        "mechanism": _mechanism(row, alike),
    })  # fmt: skip
