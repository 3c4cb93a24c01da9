"""A weighted sum of other estimators, each for some of the outputs: their rows in turn."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import Any, Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled, fill, unrolled, vector
from truejoint.errors import CalibrationError
from truejoint.estimators.family import (
    TARGETS,
    EstimatorData,
    Family,
    Params,
    Path,
    Rule,
    Shape,
    call_row,
    find_family,
    is_integer,
)
from truejoint.layout import PART_SIZE, Layout, Memory, part_memory, part_numbers

MAX_MEMBERS: Final = 10
MAX_OUTPUTS: Final = 64
DEPTH: Final = 4
"""How deep a sum may stand within sums."""

LAYOUT: Final = Layout()
LAYOUT.integers("count", "outputs of each member", "n_members")
LAYOUT.integers("first", "of the outputs of each member", "n_members")
LAYOUT.integers("output", "that each output of the members adds to", "n_weights")
LAYOUT.array("weights", "of each output of the members", "n_weights")
LAYOUT.array("predicted", "by one member", "n_outputs")
_ROWS: Final = [LAYOUT.address(f"row_{i}", "prediction of a member") for i in range(MAX_MEMBERS)]
_PARTS: Final = [LAYOUT.part(f"member_{i}", "of the sum") for i in range(MAX_MEMBERS)]
ROW, MEMBER = _ROWS[0], _PARTS[0]
unpack = LAYOUT.unpacker()


@compiled
def stack_row(
    numbers: Integers, memory: Array, dt: float, x: Array, out: Array, half_width: Array
) -> None:
    """Predict a weighted sum of what the members predict."""
    m = unpack(numbers, memory)
    fill(out, out.shape[0], 0.0)
    for i in range(unrolled(m.n_members)):
        first, count = m.first[i], m.count[i]
        predicted = vector(m.predicted, 0, count)
        member = MEMBER + PART_SIZE * i
        sizes, state = part_numbers(numbers, member), part_memory(numbers, memory, member)
        call_row(numbers[ROW + i], sizes, state, dt, x, predicted, half_width)
        for j in range(count):
            out[m.output[first + j]] += m.weights[first + j] * predicted[j]


def are_members(value: object, depth: int = DEPTH) -> bool:
    """Whether `value` is a sequence of (family, its parameters, outputs), sums not too deep."""
    return (
        isinstance(value, (tuple, list))
        and 1 <= len(value) <= MAX_MEMBERS
        and all(_is_member(member, depth) for member in value)
    )


def _is_member(value: object, depth: int) -> bool:
    match value:
        case [str(), Mapping() as params, [*outputs]]:
            inner = params.get("members")
            return (
                all(is_integer(output, 0, MAX_OUTPUTS - 1) for output in outputs)
                and len(set(outputs)) == len(outputs)
                and ("members" not in params or (depth > 1 and are_members(inner, depth - 1)))
            )
    return False


def members(params: Params, arrays: Mapping[str, Any]) -> Iterator[tuple[EstimatorData, list[int]]]:
    """Give each member as data, of arrays called ``<number>/<name>``, and its outputs."""
    for number, (family, member_params, outputs) in enumerate(params["members"]):
        prefix = f"{number}/"
        own = {n.removeprefix(prefix): a for n, a in arrays.items() if n.startswith(prefix)}
        yield EstimatorData(family, member_params, own), list(outputs)


def _shapes(params: Params, n_features: int, n_outputs: int) -> dict[str, Shape]:
    shapes: dict[str, Shape] = {}
    used: list[int] = []
    for number, (data, outputs) in enumerate(members(params, {})):
        family = find_family(data.family)
        family.check_params(data.params)
        family.check_size(data.params, n_features)
        member_shapes = family.shapes(data.params, n_features, len(outputs))
        shapes |= {f"{number}/{name}": shape for name, shape in member_shapes.items()}
        used += outputs
    covered = set(used)
    if covered != set(range(n_outputs)):
        raise CalibrationError(
            f"the members of a stack are for outputs {sorted(covered)}; it must be each of "
            f"{n_outputs}"
        )
    return {"weights": (len(used),), **shapes}


def _pack(params: Params, arrays: Mapping[str, Array], n_features: int, n_outputs: int) -> Memory:
    table: dict[str, Any] = {f"member_{i}": Layout().pack() for i in range(MAX_MEMBERS)}
    functions: dict[str, Any] = {}
    for i, (data, outputs) in enumerate(members(params, arrays)):
        family = find_family(data.family)
        table[f"member_{i}"] = family.memory(data, n_features, len(outputs))
        table[f"row_{i}"], functions[f"row_{i}"] = family.row_address(), family.row
    used = [outputs for _family, _params, outputs in params["members"]]
    count = [len(outputs) for outputs in used]
    return LAYOUT.pack(
        functions, count=count, first=np.cumsum([0, *count[:-1]]), output=np.concatenate(used),
        weights=arrays["weights"], predicted=np.zeros(n_outputs), **table,
    )  # fmt: skip


def _beside(params: Params) -> dict[str, Path]:
    """Find what members tell beside the position, each quantity in the first that does."""
    paths: dict[str, Path] = {}
    for i, (data, _) in enumerate(members(params, {})):
        for name, path in find_family(data.family).beside(data.params).items():
            paths.setdefault(name, (f"member_{i}", *path))
    return paths


def _specialised(params: Params) -> dict[str, Any]:
    """Fields of the family that the members decide: of those with a memory, and with features."""
    kinds = []
    for data, _ in members(params, {}):
        with suppress(CalibrationError):  # not fitted yet, it may become any that has neither
            kinds.append((data.kind, data.params))
    remembers = any(kind.remembers for kind, _ in kinds)
    inputs = next((kind.inputs(kind_params) for kind, kind_params in kinds if kind.inputs), None)
    return {
        "remembers": remembers,
        "counts_samples": any(kind.counts_samples for kind, _ in kinds),
        "inputs": None if inputs is None else lambda _params: inputs,
        "targets": TARGETS if inputs is None else ("position",),
    }


FAMILY: Final = Family(
    "stack",
    rules={
        "members": Rule(
            are_members, f"1 to {MAX_MEMBERS} members: family, its parameters and outputs"
        )
    },
    shapes=_shapes,
    pack=_pack,
    row=stack_row,
    beside=_beside,
    specialise=_specialised,
)
