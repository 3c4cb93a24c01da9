"""A filter, and a model of another family that learns what it leaves from what it says.

The filter knows how loads and friction make each other at any speed, so that the model need not
find that out; it makes up for what the filter's equations lack.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from math import isnan
from typing import Any, Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.compiled import address, compiled, unrolled
from truejoint.estimators.family import (
    ROW,
    EstimatorData,
    Family,
    Params,
    Rule,
    Shape,
    call_row,
    find_family,
)
from truejoint.estimators.stack.run import are_members, members
from truejoint.layout import Layout, Memory, part_memory, part_numbers

LAYOUT: Final = Layout()
LAYOUT.scalar("deviations", "of the filter's own that a half-width is; 0: none")
STARTED: Final = LAYOUT.scalar("started", "whether there is a row before; 0: start anew")
LAYOUT.integer("filter_deviations", "where the filter keeps its own")
LAYOUT.integer("beside", "where it has the first quantity beside the position")
LAYOUT.array("inputs", "of the model", "n_inputs")
LAYOUT.array("added", "by the model to positions, then to quantities beside", "n_added")
LAYOUT.array("width", "of these, which is not used", "n_added")
FILTER_ROW: Final = LAYOUT.address("filter_row", "prediction of the filter")
SIGHT: Final = LAYOUT.address("sight", "what the model sees")
MODEL_ROW: Final = LAYOUT.address("model_row", "prediction of the model")
FILTER: Final = LAYOUT.part("filter", "whose states the model sees")
SIGNALS: Final = LAYOUT.part("signals", "what the model sees of them beside the filter")
MODEL: Final = LAYOUT.part("model", "of what the filter leaves")
unpack = LAYOUT.unpacker()


@compiled
def hybrid_row(
    numbers: Integers, memory: Array, dt: float, x: Array, out: Array, half_width: Array
) -> None:
    """Predict by the filter, and by the model on what it says."""
    m = unpack(numbers, memory)
    sizes, state = part_numbers(numbers, FILTER), part_memory(numbers, memory, FILTER)
    state[m.filter_deviations] = m.deviations
    if m.started == 0.0:
        dt = 0.0
    call_row(numbers[FILTER_ROW], sizes, state, dt, x, out, half_width)
    memory[STARTED] = 0.0 if isnan(out[0]) else 1.0
    if isnan(out[0]):
        return  # the model's plays would remember it
    call_row(numbers[SIGHT], numbers, memory, dt, x, out, m.inputs)
    sizes_of_model, model = part_numbers(numbers, MODEL), part_memory(numbers, memory, MODEL)
    call_row(numbers[MODEL_ROW], sizes_of_model, model, dt, m.inputs, m.added, m.width)
    n = out.shape[0]
    for j in range(n):
        out[j] += m.added[j]
    for j in range(unrolled(m.n_added - n)):
        state[sizes[m.beside + j]] += m.added[n + j]


def model_of(params: Params, arrays: Mapping[str, Array]) -> EstimatorData:
    """Give the model as data, of arrays that `joined` made."""
    ((data, _),) = members({"members": (params["model"],)}, arrays)
    return data


def joined(filtered: Mapping[str, Array], model: Mapping[str, Array]) -> dict[str, Array]:
    """Arrays of a hybrid, of those of its filter and of its model."""
    return {**filtered, **{f"0/{name}": array for name, array in model.items()}}


def hybrid_family(
    name: str,
    filtered: Family,
    sight: Any,
    beside: str,
    sizes: Callable[[Params], tuple[int, int]],
    *,
    rules: Mapping[str, Rule] | None = None,
    scales: Mapping[str, Shape] | None = None,
    signals: Callable[[Params, Mapping[str, Array]], Memory] = lambda _params, _: Layout().pack(),
) -> Family:
    """Family of a filter's family, called `filtered`, with a model.

    `sight` is a compiled row on the memory of the hybrid: it fills the model's inputs (its last
    argument), and may put something else in place of what the filter says, which the model then
    adds to: of positions, and of quantities beside, whose first field is called `beside`. `sizes`
    gives the numbers of inputs and outputs of the model; `signals` the memory of what `sight`
    remembers, of further parameters with these `rules` and arrays of these shapes, its `scales`.
    """

    def shapes(params: Params, n_features: int, n_outputs: int) -> dict[str, Shape]:
        data = model_of(params, {})
        family = find_family(data.family)
        family.check_params(data.params)
        own = filtered.shapes(params, n_features, n_outputs) | dict(scales or {})
        learnt = family.shapes(data.params, *sizes(params))
        return own | {f"0/{name}": shape for name, shape in learnt.items()}

    def pack(
        params: Params, arrays: Mapping[str, Array], n_features: int, n_outputs: int
    ) -> Memory:
        data, (n_inputs, n_added) = model_of(params, arrays), sizes(params)
        family = find_family(data.family)
        data_of_filter = EstimatorData(filtered.name, params, arrays)
        inner = filtered.memory(data_of_filter, n_features, n_outputs)
        return LAYOUT.pack(
            {"filter_row": filtered.row, "sight": sight, "model_row": family.row},
            filter_deviations=inner.layout.fields["deviations"].index,
            beside=inner.layout.fields[beside].index,
            inputs=np.zeros(n_inputs),
            added=np.zeros(n_added),
            width=np.zeros(n_added),
            filter_row=filtered.row_address(),
            sight=address(sight, ROW),
            model_row=family.row_address(),
            filter=inner,
            signals=signals(params, arrays),
            model=family.memory(data, n_inputs, n_added),
        )

    model_rule = Rule(lambda value: are_members((value,)), "a family, its parameters, and ()")
    return replace(
        filtered,
        name=name,
        rules={**filtered.rules, **(rules or {}), "model": model_rule},
        shapes=shapes,
        pack=pack,
        row=hybrid_row,
        beside=lambda params: dict.fromkeys(filtered.beside(params), ("filter",)),
    )
