"""The filter of an elastic joint, and trees that learn what it leaves.

The trees see plays of the filter's two signals, its state and its angle.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled, copy, vector
from truejoint.estimators import hybrid
from truejoint.estimators.family import Params
from truejoint.estimators.motor_side import run as elastic_joint
from truejoint.estimators.motor_side.run import n_told
from truejoint.estimators.plays import run as play_bank
from truejoint.estimators.plays.run import expand
from truejoint.filters.fields import unpack_filter
from truejoint.layout import part_memory, part_numbers

N_SIGNALS: Final = 2
"""Driver and torque, of which trees see plays."""
_SEEN: Final = "plays", "time_constants"


def bank(params: Params) -> Params:
    """Parameters of `play_bank`, of those of the family."""
    return {**play_bank.BARE, **{name: params[name] for name in _SEEN}}


def n_plays(params: Params) -> int:
    """Count what the trees see of the signals: themselves, their plays and low-passes."""
    return play_bank.n_seen(bank(params), N_SIGNALS)


@compiled
def take_sight(
    numbers: Integers, memory: Array, dt: float, x: Array, out: Array, inputs: Array
) -> None:
    """Fill `inputs`: signals, their plays and low-passes, states and angle of the filter."""
    signals = part_numbers(numbers, hybrid.SIGNALS)
    expand(signals, part_memory(numbers, memory, hybrid.SIGNALS), dt, x, inputs)
    sizes = part_numbers(numbers, hybrid.FILTER)
    state = part_memory(numbers, memory, hybrid.FILTER)
    inner = part_numbers(sizes, elastic_joint.FILTER)
    f = unpack_filter(inner, part_memory(sizes, state, elastic_joint.FILTER))
    n_inputs, n_states = inputs.shape[0], f.n_states
    copy(f.x, vector(inputs, n_inputs - 1 - n_states, n_states), n_states)
    inputs[n_inputs - 1] = out[0]


FAMILY: Final = replace(
    hybrid.hybrid_family(
        "motor_side.hybrid_rows",
        elastic_joint.FAMILY,
        take_sight,
        elastic_joint.BESIDE_NAME,
        lambda params: (n_plays(params) + int(params["elements"]) + 3, n_told(params)),
        rules={name: play_bank.FAMILY.rules[name] for name in _SEEN},
        scales={"centre": (N_SIGNALS,), "inverse_half_range": (N_SIGNALS,)},
        signals=lambda params, arrays: play_bank.pack(bank(params), arrays, N_SIGNALS, 0),
    ),
    states_deviation=lambda _params: False,
)
