"""Plays on both sides while they agree, on the reset cable alone under a load.

While the motor stands, a difference between the two sides that changes is a load's doing, or that
of friction which a load has turned round. So what is believed of the difference may then fall, and
not grow.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import sqrt
from typing import Final

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled, vector
from truejoint.estimators.family import POSITIVE, Family, Params, Shape, only_joint
from truejoint.estimators.jaw.signals import MOTOR, RESET, stand
from truejoint.estimators.plays import run as plays
from truejoint.estimators.plays.run import jaw_bank, play_bank_row
from truejoint.layout import Layout, Memory, part_memory, part_numbers

LAYOUT: Final = Layout()
LAYOUT.scalar("gate", "difference that still counts as agreement [rad]")
LAYOUT.scalar("misfit", "standard deviation while both sides agree [rad]")
LAYOUT.scalar("alone", "standard deviation of the reset cable's own estimate [rad]")
LAYOUT.scalar("deviations", "of its own that a half-width is; 0: none")
LAYOUT.scalar("geared", "motion of the reset cable per motor angle [m/rad]")
BELIEVED: Final = LAYOUT.scalar("believed", "of what both sides differed by at the last row [rad]")
LAYOUT.array("hold", "where the reset cable stands [m]; how far friction can hide", 2)
LAYOUT.array("motor_hold", "the same of the motor, geared", 2)
LAYOUT.array("estimate", "of one side [rad]", 1)
RESET_PART: Final = LAYOUT.part("reset", "estimate from the reset cable")
BOTH_PART: Final = LAYOUT.part("both", "estimate from both sides")
unpack = LAYOUT.unpacker()

DOUBT: Final = 0.5
"""Share of what both sides differ by, and is believed, that may be a load's doing. It was chosen on
eighty virtual forceps of a mixed population; docs/forceps.md judges it on others."""

SIDES: Final[Mapping[str, int]] = {"reset": 1, "both": 2}
"""Number of features of each estimate, the last ones."""


@compiled
def gated_row(
    numbers: Integers, memory: Array, dt: float, x: Array, out: Array, half_width: Array
) -> None:
    """Predict by the reset cable, corrected by both sides as far as the two agree.

    Its deviation grows with what is believed of what the two differ by, as the reset cable is left
    alone, and, by as much as that one's friction makes it err, while it stands: a load may turn the
    jaw unseen.
    """
    m = unpack(numbers, memory)
    bank, state = part_numbers(numbers, RESET_PART), part_memory(numbers, memory, RESET_PART)
    play_bank_row(bank, state, dt, vector(x, 1, 1), m.estimate, half_width)
    reset = m.estimate[0]
    bank, state = part_numbers(numbers, BOTH_PART), part_memory(numbers, memory, BOTH_PART)
    play_bank_row(bank, state, dt, x, m.estimate, half_width)
    difference = m.estimate[0] - reset
    believed = redescending(difference, m.gate)
    if stand(dt, x[0] * m.geared, m.motor_hold) >= 1.0 and dt != 0.0:
        believed = no_more(believed, m.believed)
    memory[BELIEVED] = believed
    out[0] = reset + believed
    standing = stand(dt, x[1], m.hold)
    if m.deviations > 0.0:
        doubted = 1.0 - believed / difference if believed != difference else 0.0
        alone = m.alone**2 * (doubted**2 + standing**2)
        half_width[0] = m.deviations * sqrt(m.misfit**2 + (DOUBT * believed) ** 2 + alone)


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


def _shapes(params: Params, _n_features: int, n_outputs: int) -> dict[str, Shape]:
    shapes: dict[str, Shape] = {"gate": (1,), "misfit": (2,)}
    for side, k in SIDES.items():
        learnt = plays.shapes(jaw_bank(tuple(params["plays"]), k), k, 1)
        shapes |= {f"{side}/{name}": shape for name, shape in learnt.items()}
    return only_joint("jaw_load.gated", shapes, n_outputs)


def _pack(params: Params, arrays: Mapping[str, Array], _k: int, _n: int) -> Memory:
    def part(side: str, k: int) -> Memory:
        learnt = {n.removeprefix(f"{side}/"): a for n, a in arrays.items() if n.startswith(side)}
        return plays.pack(jaw_bank(tuple(params["plays"]), k), learnt, k, 1)

    motor, reset = arrays["both/inverse_half_range"]
    return LAYOUT.pack(
        gate=arrays["gate"][0],
        misfit=arrays["misfit"][0],
        alone=arrays["misfit"][1],
        geared=motor / reset if reset > 0.0 else 0.0,
        **{side: part(side, k) for side, k in SIDES.items()},
    )


FAMILY: Final = Family(
    "jaw_load.gated",
    rules={
        **dict.fromkeys(("gate", "smallest_gate"), POSITIVE),
        "plays": plays.FAMILY.rules["plays"],
    },
    shapes=_shapes,
    pack=_pack,
    row=gated_row,
    remembers=True,
    inputs=lambda _params: (MOTOR, RESET),
    targets=("position", "error"),
    bears_load=lambda _params: True,
    states_deviation=lambda _params: True,
)
