"""A physical filter with features of its own, and what learns its residual from the same."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from truejoint.estimators.family import Params, find_family
from truejoint.estimators.stack import combination_with_memory
from truejoint.estimators.stack.run import members


def _inputs(params: Params) -> tuple[str, ...]:
    """Features of the first member that takes any of its own."""
    for data, _ in members(params, {}):
        own = find_family(data.family).inputs
        if own is not None:
            return own(data.params)
    return ()


FAMILY: Final = replace(
    combination_with_memory.FAMILY,
    name="stack.combination_with_filter",
    inputs=_inputs,
    targets=("position",),
)
