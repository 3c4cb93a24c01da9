"""The filter of a wrist's cables, and plays that learn what it leaves.

The filter knows how loads and friction make each other; plays of its estimate, of the motors and of
their efforts make up for what its model does not have. What the filter says of its own accuracy
stays, as far as it was then found to hold.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import isnan
from typing import Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled
from truejoint.errors import CalibrationError
from truejoint.estimators.cables import run as cable_filter
from truejoint.estimators.cables.loops import LOAD, PIN, RIGID, N
from truejoint.estimators.cables.run import LOADS, cable_filter_row, raw_joints, state_load
from truejoint.estimators.family import EstimatorData, Params, Rule, Shape
from truejoint.estimators.plays import run as play_bank
from truejoint.estimators.plays.run import play_bank_row
from truejoint.filters.fields import unpack_filter
from truejoint.layout import Layout, Memory, part_memory, part_numbers

SEEN: Final = 6 * N
"""What plays see: raw joints, motors, efforts, what the filter adds to the joints, loads, pins."""
TOLD: Final = 2 * N
"""What they tell: joints less raw joints, and loads."""
_BANK: Final = "bank/"  # begins the names of their arrays

LAYOUT: Final = Layout()
DEVIATIONS: Final = LAYOUT.scalar("deviations", "of its own that a half-width is; 0: none")
LAYOUT.scalar("beside_deviations", "that a load's half-width is")
STARTED: Final = LAYOUT.scalar("started", "whether there is a row before; 0: start anew")
LAYOUT.array("inputs", "of the plays", SEEN)
LAYOUT.array("outputs", "of the plays", TOLD)
LAYOUT.array("width", "of these, which is not used", TOLD)
LAYOUT.array("grip", "of the jaws on what they hold, and its half-width [Nm]", 2)
LAYOUT.array("tip_first", "torque of the tip's first arm, its half-width [Nm]", 2)
LAYOUT.array("tip_second", "torque of its second arm, its half-width [Nm]", 2)
FILTER: Final = LAYOUT.part("filter", "of friction of loops, motors and pins, and loads")
BANK: Final = LAYOUT.part("bank", "plays of what the filter says")
unpack = LAYOUT.unpacker()


def sight(X: Array, angle: Array, states: Array, parameters: Array) -> Array:
    """Give what plays see (n, SEEN) of motors and efforts `X` (n, 2 N).

    With the filter's joints `angle` (n, N) and states (n, STATES).
    """
    raw = raw_rows(X, parameters)
    return np.hstack([raw, X, angle - raw, states[:, LOAD:], states[:, PIN:LOAD]])


def raw_rows(X: Array, parameters: Array) -> Array:
    """Joints (n, N) [rad] of cables that give nowhere, of motors in the first columns of `X`."""
    return X[:, :N] @ parameters[RIGID : RIGID + N * N].reshape(N, N).T


@compiled
def take_sight(numbers: Integers, memory: Array, x: Array, angle: Array, inputs: Array) -> None:
    """Fill `inputs` (SEEN,) as `sight`, of the memory of the filter of the cables."""
    sizes = part_numbers(numbers, cable_filter.FILTER)
    f = unpack_filter(sizes, part_memory(numbers, memory, cable_filter.FILTER))
    raw_joints(x, f.theta, inputs)
    for j in range(N):
        inputs[N + j], inputs[2 * N + j] = x[j], x[N + j]
        inputs[3 * N + j] = angle[j] - inputs[j]
        inputs[4 * N + j], inputs[5 * N + j] = f.x[LOAD + j], f.x[PIN + j]


@compiled
def cable_hybrid_row(
    numbers: Integers, memory: Array, dt: float, x: Array, out: Array, half_width: Array
) -> None:
    """Predict by the filter of the cables, and by plays of what it says."""
    m = unpack(numbers, memory)
    sizes, state = part_numbers(numbers, FILTER), part_memory(numbers, memory, FILTER)
    if m.started == 0.0:
        dt = 0.0
    state[cable_filter.DEVIATIONS] = m.deviations
    state[cable_filter.BESIDE] = m.beside_deviations
    cable_filter_row(sizes, state, dt, x, out, half_width)
    memory[STARTED] = 0.0 if isnan(out[0]) else 1.0
    if isnan(out[0]):
        return  # plays would remember it
    take_sight(sizes, state, x, out, m.inputs)
    play_bank_row(
        part_numbers(numbers, BANK), part_memory(numbers, memory, BANK), dt, m.inputs,
        m.outputs, m.width,
    )  # fmt: skip
    for j in range(N):
        out[j] = m.inputs[j] + m.outputs[j]
    state_load(m.grip, m.outputs[N], state[sizes[cable_filter.GRIP] + 1])
    state_load(m.tip_first, m.outputs[N + 1], state[sizes[cable_filter.TIP_FIRST] + 1])
    state_load(m.tip_second, m.outputs[N + 2], state[sizes[cable_filter.TIP_SECOND] + 1])


def parts(arrays: Mapping[str, Array]) -> tuple[dict[str, Array], dict[str, Array]]:
    """Arrays of the filter, whose `structure` is that of the plays' errors, and of the plays."""
    bank = {n.removeprefix(_BANK): a for n, a in arrays.items() if n.startswith(_BANK)}
    return {n: a for n, a in arrays.items() if not n.startswith(_BANK)}, bank


def joined(filtered: Mapping[str, Array], bank: Mapping[str, Array]) -> dict[str, Array]:
    """Arrays of the family, of those of a filter and of plays."""
    return {**filtered, **{_BANK + name: array for name, array in bank.items()}}


def _shapes(params: Params, n_features: int, n_outputs: int) -> dict[str, Shape]:
    of_filter = cable_filter.FAMILY.shapes(params, n_features, n_outputs)
    bank = play_bank.FAMILY.shapes(params["bank"], SEEN, TOLD)
    return {**of_filter, **{_BANK + name: shape for name, shape in bank.items()}}


def _pack(params: Params, arrays: Mapping[str, Array], n_features: int, n_outputs: int) -> Memory:
    filtered, bank = parts(arrays)
    plays = EstimatorData(play_bank.FAMILY.name, params["bank"], bank)
    return LAYOUT.pack(
        beside_deviations=1.0,
        inputs=np.zeros(SEEN),
        outputs=np.zeros(TOLD),
        width=np.zeros(TOLD),
        **dict.fromkeys(LOADS, np.zeros(2)),
        filter=cable_filter.FAMILY.memory(
            EstimatorData(cable_filter.FAMILY.name, params, filtered), n_features, n_outputs
        ),
        bank=play_bank.FAMILY.memory(plays, SEEN, TOLD),
    )


def _is_bank(value: object) -> bool:
    """Whether these are parameters of plays."""
    try:
        play_bank.FAMILY.check_params(value)  # type: ignore[arg-type]  # it may be anything
    except (CalibrationError, TypeError):
        return False
    return True


FAMILY: Final = replace(
    cable_filter.FAMILY,
    name="cables.hybrid_rows",
    rules={
        **cable_filter.FAMILY.rules,
        "bank": Rule(_is_bank, "the parameters of play_bank, by name"),
    },
    shapes=_shapes,
    pack=_pack,
    row=cable_hybrid_row,
)
