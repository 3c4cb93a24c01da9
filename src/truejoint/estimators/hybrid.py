"""Families of a filter, and of a model of another family that learns what it leaves.

The filter knows how loads and friction make each other at any speed, so that the model need not
find that out; it makes up for what the filter's equations lack.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from truejoint.array_types import Array
from truejoint.estimators.family import EstimatorData, Family, Params, Rule, Shape, find_family
from truejoint.estimators.stack.run import are_members, members
from truejoint.layout import Layout, Memory


def model_of(params: Params, arrays: Mapping[str, Array]) -> EstimatorData:
    """Give the model as data, of arrays that `joined` made."""
    ((data, _),) = members({"members": (params["model"],)}, arrays)
    return data


def joined(filtered: Mapping[str, Any], model: Mapping[str, Any]) -> dict[str, Any]:
    """Arrays of a hybrid, or their shapes, of those of its filter and of its model."""
    return {**filtered, **{f"0/{name}": array for name, array in model.items()}}


def hybrid_family(
    name: str,
    filtered: Family,
    pack_filter: Callable[..., Memory],
    sight: Any,
    beside: int,
    sizes: Callable[[Params], tuple[int, int]],
    *,
    rules: Mapping[str, Rule] | None = None,
    scales: Mapping[str, Shape] | None = None,
    signals: Callable[[Params, Mapping[str, Array]], Memory] = lambda _params, _: Layout().pack(),
) -> Family:
    """Family of a filter's family, called `filtered`, with a model.

    `pack_filter` is that of the filter's family, which takes fields of `filter_layout` besides;
    `sight` one of them, and `beside` the index of the first quantity beside the outputs. `sizes`
    gives the numbers of inputs and outputs of the model; `signals` the memory of what `sight`
    remembers, of further parameters with these `rules` and arrays of these shapes, its `scales`.
    Of arrays that have no model yet, the memory is that of the filter, and of what a model will
    see.
    """

    def shapes(params: Params, n_features: int, n_outputs: int) -> dict[str, Shape]:
        data = model_of(params, {})
        family = find_family(data.family)
        family.check_params(data.params)
        own = filtered.shapes(params, n_features, n_outputs) | dict(scales or {})
        return joined(own, family.shapes(data.params, *sizes(params)))

    def pack(
        params: Params, arrays: Mapping[str, Array], n_features: int, n_outputs: int
    ) -> Memory:
        data, (n_sighted, n_added) = model_of(params, arrays), sizes(params)
        on_top = {
            "sight": sight, "sighted": np.zeros(n_sighted), "signals": signals(params, arrays)
        }  # fmt: skip
        if data.arrays:
            family = find_family(data.family)
            on_top |= {
                "beside": beside,
                "added": np.zeros(n_added),
                "width": np.zeros(n_added),
                "model_row": family.row,
                "model": family.memory(data, n_sighted, n_added),
            }
        return pack_filter(params, arrays, n_features, n_outputs, **on_top)

    model_rule = Rule(lambda value: are_members((value,)), "a family, its parameters, and ()")
    return replace(
        filtered,
        name=name,
        rules={**filtered.rules, **(rules or {}), "model": model_rule},
        shapes=shapes,
        pack=pack,
    )
