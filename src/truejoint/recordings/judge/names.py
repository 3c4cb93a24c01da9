"""Names of what a data check can find."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

FINDINGS: Final[Mapping[str, str]] = {
    "clock": "stamps are irregular",
    "constant": "a signal never changes",
    "delay": "the truth is late or early",
    "directions": "one direction of motion is rare",
    "dropped": "rows were lost when the file was read",
    "frozen": "a sensor repeats one value while the joint moves",
    "gap": "rows are missing",
    "hole": "a part of the range was hardly visited",
    "homing": "recordings are of several homings",
    "instrument": "a recording is unlike all others",
    "jump": "a position steps far",
    "limits": "a position is outside the joint's limits",
    "load": "the load at the tool is unknown, or one only",
    "missing": "truth is missing",
    "outliers": "rows are far off those beside them",
    "range": "rows are outside the range seen in training",
    "rate": "stamps are hardly in seconds",
    "redundant": "two sensors of one joint disagree",
    "saturated": "a sensor stands at its end while the joint moves on",
    "sign": "truth falls where the measured position rises",
    "standstill": "the joint hardly moves",
    "start": "a position jumps in the first second",
    "travel": "little of the joint's travel is covered",
    "unit": "degrees for radians, millimetres for metres",
    "wrap": "an encoder wraps around",
    "zero": "the zero moved within or between recordings",
}
"""What each name stands for; ``--accept`` takes the names."""
