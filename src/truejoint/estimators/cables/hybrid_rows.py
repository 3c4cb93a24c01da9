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
from truejoint.compiled import compiled, vector
from truejoint.errors import CalibrationError
from truejoint.estimators.cables import run as cable_filter
from truejoint.estimators.cables.loops import LOAD, PARAMETERS, PIN, RIGID, STATES, N
from truejoint.estimators.cables.run import LOADS, cable_filter_row, raw_joints, state_load
from truejoint.estimators.family import EstimatorData, Params, Rule, Shape
from truejoint.estimators.plays import run as play_bank
from truejoint.estimators.plays.run import play_bank_row
from truejoint.filters import fields as at
from truejoint.layout import Layout, Memory, part_memory, part_numbers

SEEN: Final = 6 * N
"""What plays see: raw joints, motors, efforts, what the filter adds to the joints, loads, pins."""
TOLD: Final = 2 * N
"""What they tell: joints less raw joints, and loads."""
_BANK: Final = "bank/"  # begins the names of their arrays

LAYOUT: Final = Layout()
DEVIATIONS: Final = LAYOUT.scalar("deviations", "of its own that a half-width is; 0: none")
BESIDE: Final = LAYOUT.scalar("beside_deviations", "that a load's half-width is")
STARTED: Final = LAYOUT.scalar("started", "whether there is a row before; 0: start anew")
SIGHT: Final = LAYOUT.array("sight", "what plays see")
SPEECH: Final = LAYOUT.array("speech", "what they tell")
WIDTH: Final = LAYOUT.array("width", "of it, which is not used")
GRIP: Final = LAYOUT.array("grip", "of the jaws on what they hold, and its half-width [Nm]")
TIP_FIRST: Final = LAYOUT.array("tip_first", "torque of the tip's first arm, its half-width [Nm]")
TIP_SECOND: Final = LAYOUT.array("tip_second", "torque of its second arm, its half-width [Nm]")
FILTER: Final = LAYOUT.part("filter", "of friction of loops, motors and pins, and loads")
BANK: Final = LAYOUT.part("bank", "plays of what the filter says")


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
def take_sight(numbers: Integers, memory: Array, x: Array, angle: Array, seen: Array) -> None:
    """Fill `seen` (SEEN,) as `sight`, of the memory of the filter of the cables."""
    own = part_numbers(numbers, cable_filter.FILTER)
    state = part_memory(numbers, memory, cable_filter.FILTER)
    estimate = vector(state, own[at.X], STATES)
    raw_joints(x, vector(state, own[at.THETA], PARAMETERS), seen)
    for j in range(N):
        seen[N + j], seen[2 * N + j] = x[j], x[N + j]
        seen[3 * N + j] = angle[j] - seen[j]
        seen[4 * N + j], seen[5 * N + j] = estimate[LOAD + j], estimate[PIN + j]


@compiled
def cable_hybrid_row(
    numbers: Integers, memory: Array, dt: float, x: Array, out: Array, half_width: Array
) -> None:
    """Predict by the filter of the cables, and by plays of what it says."""
    own, state = part_numbers(numbers, FILTER), part_memory(numbers, memory, FILTER)
    if memory[STARTED] == 0.0:
        dt = 0.0
    state[cable_filter.DEVIATIONS], state[cable_filter.BESIDE] = memory[DEVIATIONS], memory[BESIDE]
    cable_filter_row(own, state, dt, x, out, half_width)
    memory[STARTED] = 0.0 if isnan(out[0]) else 1.0
    if memory[STARTED] == 0.0:
        return  # plays would remember it
    seen = vector(memory, numbers[SIGHT], SEEN)
    told = vector(memory, numbers[SPEECH], TOLD)
    take_sight(own, state, x, out, seen)
    width = vector(memory, numbers[WIDTH], TOLD)
    play_bank_row(
        part_numbers(numbers, BANK), part_memory(numbers, memory, BANK), dt, seen, told, width
    )
    for j in range(N):
        out[j] = seen[j] + told[j]
    first, second = cable_filter.TIP_FIRST, cable_filter.TIP_SECOND
    state_load(vector(memory, numbers[GRIP], 2), told[N], state[own[cable_filter.GRIP] + 1])
    state_load(vector(memory, numbers[TIP_FIRST], 2), told[N + 1], state[own[first] + 1])
    state_load(vector(memory, numbers[TIP_SECOND], 2), told[N + 2], state[own[second] + 1])


def parts(arrays: Mapping[str, Array]) -> tuple[dict[str, Array], dict[str, Array]]:
    """Arrays of the filter, whose `structure` is that of the plays' errors, and of the plays."""
    bank = {n.removeprefix(_BANK): a for n, a in arrays.items() if n.startswith(_BANK)}
    return {n: a for n, a in arrays.items() if not n.startswith(_BANK)}, bank


def joined(filtered: Mapping[str, Array], bank: Mapping[str, Array]) -> dict[str, Array]:
    """Arrays of the family, of those of a filter and of plays."""
    return {**filtered, **{_BANK + name: array for name, array in bank.items()}}


def _shapes(params: Params, n_features: int, n_outputs: int) -> dict[str, Shape]:
    own = cable_filter.FAMILY.shapes(params, n_features, n_outputs)
    bank = play_bank.FAMILY.shapes(params["bank"], SEEN, TOLD)
    return {**own, **{_BANK + name: shape for name, shape in bank.items()}}


def _pack(params: Params, arrays: Mapping[str, Array], n_features: int, n_outputs: int) -> Memory:
    filtered, bank = parts(arrays)
    own = EstimatorData(play_bank.FAMILY.name, params["bank"], bank)
    return LAYOUT.pack(
        beside_deviations=1.0,
        sight=np.zeros(SEEN),
        speech=np.zeros(TOLD),
        width=np.zeros(TOLD),
        **dict.fromkeys(LOADS, np.zeros(2)),
        filter=cable_filter.FAMILY.memory(
            EstimatorData(cable_filter.FAMILY.name, params, filtered), n_features, n_outputs
        ),
        bank=play_bank.FAMILY.memory(own, SEEN, TOLD),
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
