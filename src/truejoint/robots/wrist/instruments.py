"""Wristed instruments by model number, as mechanisms of cables."""

import math
import tomllib
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import Any, Final, Literal

import numpy as np

from truejoint.array_types import Array
from truejoint.robots.cable_mechanism import Cable, CableMechanism, Contact, Motor, Node, Pin
from truejoint.robots.catalogue import INSTRUMENTS
from truejoint.robots.chain import SerialChain
from truejoint.robots.parts import Axis, Joint, Workspace
from truejoint.robots.robot import Robot

JOINTS: Final = ("pitch", "jaw1", "jaw2")
"""The yaw is the mean of the two jaws, the opening ``jaw2 - jaw1``."""

_LAST_DIGIT: Final = 1e-4  # [rad/rad] of the files; a disc that turns a jaw by less does not

# No file states these. The jaw's radius is a guess from a shaft of 8 mm; the pins', and what turns
# on them, are of the size that makes the frictions and frequencies of such a wrist.
_JAW_RADIUS: Final = 2.8e-3  # [m] of the cables' path on the jaws
_PITCH_PIN: Final = Pin(inertia=1.5e-6, radius=0.9e-3, friction=1.5e-3)
_JAW_PIN: Final = Pin(inertia=4e-7, radius=0.9e-3, friction=0.6e-3)
# With rods in the shaft, three tenths of the compliance are before the guides, as much in the
# shaft, the rest behind the wrist's pulleys, around which a cable wraps 1.6 rad; with bare cable
# the shaft has more (`cables.shaft_compliance` of a virtual one). The guides' angle counts as
# 1 rad: what is known is the friction of all of them.
_SEGMENTS: Final = (0.3, 0.3, 0.4)
_NODES: Final = (Node(1.0), Node(1.6, "pitch"))
# A push at the tip turns the pitch by 19 mm and the yaw, half of either jaw, by 10 mm.
_ARMS: Final = {"pitch": {"pitch": 19e-3}, "yaw": {"jaw1": 5e-3, "jaw2": 5e-3}}
_SHAFT: Final = 0.03  # [m] of it, from the origin of all poses to the wrist
_TOP_SPEED: Final = math.radians(180.0)  # [rad/s]
_HALF_OPEN: Final = math.radians(10.0)  # [rad] of either jaw at home


def instrument(values: Mapping[str, Any]) -> CableMechanism:
    """Mechanism of an instrument of the table: two cables from each disc to what it turns."""
    pitch, yaw, jaw = np.array([values[key] for key in ("pitch", "yaw", "jaw")], dtype=np.float64)
    # Of pitch, yaw and opening per disc, those of the joints.
    turned = np.array([pitch, yaw - 0.5 * jaw, yaw + 0.5 * jaw])
    # Else a disc would be said to turn the other jaw by 5e-5, and its cables to press on that pin.
    turned[np.abs(turned) < _LAST_DIGIT] = 0.0
    discs: Array = np.linalg.inv(turned).astype(np.float64)
    # All discs are alike, and as large as makes the jaws' radius.
    radius = _JAW_RADIUS / float(np.abs(discs[:, 1:]).max())
    ends: tuple[tuple[str, Literal[1, -1]], ...] = (("a", 1), ("b", -1))
    cables = [
        Cable(
            f"{motor}_{end}",
            {j: sign * float(m) for j, m in zip(JOINTS, row, strict=True) if m},
            motor,
            sign,
            segments=_SEGMENTS,
            nodes=_NODES,
        )
        for motor, row in zip(JOINTS, discs * radius, strict=True)
        for end, sign in ends  # one that the motor winds up as it lets the other go
    ]
    return CableMechanism(
        dict(zip(JOINTS, (_PITCH_PIN, _JAW_PIN, _JAW_PIN), strict=True)),
        dict.fromkeys(JOINTS, Motor(radius)),
        tuple(cables),
        Contact({"jaw1": -1.0, "jaw2": 1.0}),
        _ARMS,
    )


def kinematics(link: float) -> SerialChain:
    """Pose of the jaws' axis at the end of a straight shaft, `link` [m] beyond that of the pitch.

    Modified Denavit-Hartenberg parameters of the instruments' files, z along the shaft; the last
    axis is the direction in which the closed jaws point, the mean of both.

    Examples
    --------
    >>> print(kinematics(0.01).forward([0.0, 0.0, 0.0])[:3, 3])
    [0.   0.   0.04]
    """
    quarter = 0.5 * math.pi
    axes = (Axis(0.0, 0.0, _SHAFT, 0.0), Axis(-quarter, 0.0, 0.0, -quarter),
            Axis(-quarter, link, 0.0, 0.0))  # fmt: skip
    return SerialChain(axes, np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.5, 0.5]]))


@cache
def build(name: str) -> Robot:
    """Robot of the instrument called `name`, which is a model number or one of RAVEN's tools."""
    text = files(__package__).joinpath(INSTRUMENTS).read_text(encoding="utf-8")
    row = next(r for r in tomllib.loads(text).values() if name in map(str, r["names"]))
    limit = {key: math.radians(value) for key, value in row["limits_deg"].items()}
    jaw = limit["yaw"] + 0.5 * limit["jaw"]
    reach = np.array([0.75 * limit["pitch"], 0.4 * jaw, 0.4 * jaw])
    gap = np.radians(5.0)  # a calibration's jaws never meet
    return Robot(
        "wrist",
        (
            Joint("pitch", "revolute", -limit["pitch"], limit["pitch"], 0.0, _TOP_SPEED),
            Joint("jaw1", "revolute", -jaw, jaw, -_HALF_OPEN, _TOP_SPEED),
            Joint("jaw2", "revolute", -jaw, jaw, _HALF_OPEN, _TOP_SPEED),
        ),
        arm=name,
        kinematics=kinematics(1e-3 * row["link_mm"]),
        effort="motor",
        workspace=Workspace(
            JOINTS,
            np.array([-reach[0], -reach[1], gap]),
            np.array([reach[0], -gap, reach[2]]),
            np.full(3, math.radians(60.0)),
        ),
        mechanism=instrument(row),
    )
