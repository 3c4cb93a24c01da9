"""Plays on both sides while they agree, on the reset cable alone under a load.

While the motor stands, what the two sides come to differ by is a load's doing, or friction's that a
load has turned round. So what is believed of the difference may then fall, and not grow.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import sqrt
from typing import Any, Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled, vector
from truejoint.estimators.family import POSITIVE, Family, Params, Shape, only_joint
from truejoint.estimators.jaw.signals import MECHANISM_RULES, MOTOR, RESET, stand
from truejoint.estimators.plays import jaw_bank as play
from truejoint.layout import Layout, Memory, part_memory, part_numbers

LAYOUT: Final = Layout()
GATE: Final = LAYOUT.scalar("gate", "difference that still counts as agreement [rad]")
CONSTANT: Final = LAYOUT.scalar("constant", "added to the angle, agreement or not [rad]")
MISFIT: Final = LAYOUT.scalar("misfit", "standard deviation while both sides agree [rad]")
ALONE: Final = LAYOUT.scalar("alone", "standard deviation of the reset cable's own estimate [rad]")
DEVIATIONS: Final = LAYOUT.scalar("deviations", "of its own that a half-width is; 0: none")
GEARED: Final = LAYOUT.scalar("geared", "displacement of the drive cable per motor angle [m/rad]")
BELIEVED: Final = LAYOUT.scalar("believed", "of what both sides differed by at the last row [rad]")
HOLD: Final = LAYOUT.array("hold", "where the reset cable stands [m]; how far friction can hide")
MOTOR_HOLD: Final = LAYOUT.array("motor_hold", "the same of the drive cable, by the motor")
RESET_PART: Final = LAYOUT.part("reset", "estimate from the reset cable")
BOTH_PART: Final = LAYOUT.part("both", "estimate from both sides")

DOUBT: Final = 0.5
"""Share of what both sides differ by, and is believed, that may be a load's doing. It was chosen on
eighty virtual forceps of a mixed population; docs/forceps.md judges it on others."""

_SIDES: Final = {"reset": ("reset",), "both": ("reset", "motor")}


@compiled
def gated_play_row(
    numbers: Integers, memory: Array, dt: float, x: Array, out: Array, half_width: Array
) -> None:
    """Predict by the reset cable, corrected by both sides as far as the two agree.

    Its deviation grows with what is believed of what the two differ by, as the reset cable is left
    alone, and, by as much as that one's friction makes it err, while it stands: a load may turn the
    jaw unseen.
    """
    fresh = dt == 0.0
    own, state = part_numbers(numbers, RESET_PART), part_memory(numbers, memory, RESET_PART)
    reset = play.weigh_banks(own, state, fresh, x)
    own, state = part_numbers(numbers, BOTH_PART), part_memory(numbers, memory, BOTH_PART)
    both = play.weigh_banks(own, state, fresh, x)
    difference = both - reset
    believed = redescending(difference, memory[GATE])
    motor_stands = stand(dt, x[0] * memory[GEARED], vector(memory, numbers[MOTOR_HOLD], 2)) >= 1.0
    if motor_stands and not fresh:
        believed = no_more(believed, memory[BELIEVED])
    memory[BELIEVED] = believed
    out[0] = reset + believed + memory[CONSTANT]
    standing = stand(dt, x[1], vector(memory, numbers[HOLD], 2))
    if memory[DEVIATIONS] > 0.0:
        left = 1.0 - believed / difference if believed != difference else 0.0
        alone = memory[ALONE] ** 2 * (left**2 + standing**2)
        variance = memory[MISFIT] ** 2 + (DOUBT * believed) ** 2 + alone
        half_width[0] = memory[DEVIATIONS] * sqrt(variance)


@compiled
def no_more(value: float, before: float) -> float:
    """`value` where it lies from 0 to what it was `before`, else the nearer of these two."""
    return min(max(value, min(before, 0.0)), max(before, 0.0))


@compiled
def redescending(difference: float, gate: float) -> float:
    """Hampel's function: the difference itself within the gate, falling to 0 at twice the gate."""
    size = abs(difference)
    if size <= gate:
        return difference
    if size >= 2.0 * gate:
        return 0.0
    return difference * (2.0 * gate - size) / size


def side_params(params: Params, side: str) -> dict[str, Any]:
    """Parameters of one of the two estimates, ``"reset"`` or ``"both"``."""
    return {
        "displacements": _SIDES[side], "degree": play.POWERS, "reset_widths": play.RESET_WIDTHS,
        "drive_widths": play.DRIVE_WIDTHS, "penalty": 1e-5,
        **{name: params[name] for name in ("gear_ratio", "wheel_radius")},
    }  # fmt: skip


def _shapes(params: Params, _n_features: int, n_outputs: int) -> dict[str, Shape]:
    shapes: dict[str, Shape] = {"gate": (1,), "constant": (1,), "misfit": (2,)}
    for side in _SIDES:
        own = play.FAMILY.shapes(side_params(params, side), 1, 1)
        shapes |= {f"{side}_{name}": shape for name, shape in own.items()}
    return only_joint("plays.gated_rows", shapes, n_outputs)


def _pack(params: Params, arrays: Mapping[str, Array], _k: int, _n: int) -> Memory:
    both = side_params(params, "both")

    def part(side: str) -> Memory:
        own = {k.removeprefix(f"{side}_"): a for k, a in arrays.items() if k.startswith(side)}
        return play.pack_banks(side_params(params, side), own, {"motor": 0, "reset": 1})

    return LAYOUT.pack(
        gate=arrays["gate"][0], constant=arrays["constant"][0], misfit=arrays["misfit"][0],
        alone=arrays["misfit"][1], deviations=0.0, hold=np.zeros(2), motor_hold=np.zeros(2),
        geared=play.bank_factors(both)[both["displacements"].index("motor")], believed=0.0,
        reset=part("reset"), both=part("both"),
    )  # fmt: skip


FAMILY: Final = Family(
    "plays.gated_rows",
    rules={
        **dict.fromkeys(("gate", "smallest_gate"), POSITIVE),
        **{name: MECHANISM_RULES[name] for name in ("gear_ratio", "wheel_radius")},
    },
    shapes=_shapes,
    pack=_pack,
    row=gated_play_row,
    remembers=True,
    inputs=lambda _params: (MOTOR, RESET),
    targets=("position", "error"),
    bears_load=lambda _params: True,
    states_deviation=lambda _params: True,
)
