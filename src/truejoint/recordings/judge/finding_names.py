"""Names of what the judge can find in a recording, each under the heading that a person reads."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

_BY_HEADING: Final[Mapping[str, Mapping[str, str]]] = {
    "link": {"link": "a topic stopped, or its stamps are of another clock"},
    "rate": {"rate": "stamps are hardly in seconds", "clock": "stamps are irregular"},
    "stamps": {"stamps": "stamps repeat, go back or are 0"},
    "lost messages": {
        "gap": "rows are missing",
        "dropped": "rows were lost when the file was read",
    },
    "arm": {"arm": "the truth is of the other arm"},
    "unit": {
        "unit": "degrees for radians, millimetres for metres",
        "limits": "a position is outside the joint's limits",
    },
    "effort": {
        "effort": "there is no effort, or it was never set",
        "constant": "a signal never changes",
    },
    "effort sign": {"effort-sign": "efforts brake what they should drive"},
    "encoder wrap": {"wrap": "an encoder wraps around", "jump": "a position steps far"},
    "frozen signal": {
        "frozen": "a sensor repeats one value while the joint moves",
        "saturated": "a sensor stands at its end while the joint moves on",
    },
    "truth": {
        "missing": "truth is missing",
        "sign": "truth falls where the measured position rises",
        "outliers": "rows are far off those beside them",
        "start": "a position jumps in the first second",
    },
    "delay": {"delay": "the truth is late or early"},
    "homing": {
        "homing": "recordings are of several homings, or one has a homing within",
        "zero": "the zero moved within or between recordings",
        "redundant": "two sensors of one joint disagree",
        "instrument": "a recording is unlike all others",
    },
    "excitation": {
        "standstill": "the joint hardly moves",
        "directions": "one direction of motion is rare",
    },
    "coverage": {
        "travel": "little of the joint's travel is covered",
        "hole": "a part of the range was hardly visited",
        "range": "rows are outside the range seen in training",
        "load": "the load at the tool is unknown, or one only",
    },
}

HEADINGS: Final = tuple(_BY_HEADING)
"""Headings in the order in which a person reads them."""

FINDINGS: Final[Mapping[str, str]] = dict(
    sorted((name, text) for names in _BY_HEADING.values() for name, text in names.items())
)
"""Meaning of each name; ``--accept`` takes the names."""

HEADING_OF: Final[Mapping[str, str]] = {
    name: heading for heading, names in _BY_HEADING.items() for name in names
}
"""Heading of each name."""
