"""Rows made of those of others: a weighted sum, and one held to the range of its training.

Each of a sum is for some of the outputs. Beyond its range, the prediction of what is bounded stays,
or goes on along a straight line: polynomials, products of plays and trees know nothing of it.
"""

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
MAX_COLUMNS: Final = 1000
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


ONE_MEMBER: Final = Rule(
    lambda value: are_members(value) and len(value) == 1 and not value[0][2],
    "one member: family, its parameters and no outputs",
)


def members(params: Params, arrays: Mapping[str, Any]) -> Iterator[tuple[EstimatorData, list[int]]]:
    """Give each member as data, of arrays called ``<number>/<name>``, and its outputs."""
    for number, (family, member_params, outputs) in enumerate(params["members"]):
        prefix = f"{number}/"
        own = {n.removeprefix(prefix): a for n, a in arrays.items() if n.startswith(prefix)}
        yield EstimatorData(family, member_params, own), list(outputs)


def member_shapes(
    data: EstimatorData, n_features: int, n_outputs: int, number: int = 0
) -> dict[str, Shape]:
    """Shapes of a member's arrays, by their names among all; raises CalibrationError."""
    family = find_family(data.family)
    family.check_params(data.params)
    family.check_size(data.params, n_features)
    shapes = family.shapes(data.params, n_features, n_outputs)
    return {f"{number}/{name}": shape for name, shape in shapes.items()}


def _shapes(params: Params, n_features: int, n_outputs: int) -> dict[str, Shape]:
    shapes: dict[str, Shape] = {}
    used: list[int] = []
    for number, (data, outputs) in enumerate(members(params, {})):
        shapes |= member_shapes(data, n_features, len(outputs), number)
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


def _kinds(params: Params) -> list[tuple[Family, Params]]:
    """Families of the members; one that is not fitted yet may become any without a memory."""
    kinds = []
    for data, _ in members(params, {}):
        with suppress(CalibrationError):
            kinds.append((data.kind, data.params))
    return kinds


def _specialised(params: Params) -> dict[str, Any]:
    """Fields of the family that the members decide: of those with a memory, and with features."""
    kinds = _kinds(params)
    inputs = next((kind.inputs(member) for kind, member in kinds if kind.inputs), None)
    return {
        "remembers": any(kind.remembers for kind, _ in kinds),
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

BOUNDED_LAYOUT: Final = Layout()
BOUNDED_LAYOUT.integers("columns", "features that the estimator sees", "n_seen")
BOUNDED_LAYOUT.array("lower", "end of the range of each in training", "n_seen")
BOUNDED_LAYOUT.array("upper", "other end", "n_seen")
BOUNDED_LAYOUT.array("seen", "by the estimator", "n_seen")
BOUNDED_LAYOUT.array("slope", "of the line beyond", "n_seen", "n_outputs")
BOUNDED_LAYOUT.array("direct", "what each feature adds to the outputs", "n_features", "n_outputs")
BOUNDED_ROW: Final = BOUNDED_LAYOUT.address("row", "prediction of the estimator")
BOUNDED_MEMBER: Final = BOUNDED_LAYOUT.part("member", "that is held to its range")
unpack_bounded = BOUNDED_LAYOUT.unpacker()


@compiled
def bounded_row(
    numbers: Integers, memory: Array, dt: float, x: Array, out: Array, half_width: Array
) -> None:
    """Predict within the range, and go on straight beyond it."""
    m = unpack_bounded(numbers, memory)
    for i in range(m.n_seen):
        m.seen[i] = min(max(x[m.columns[i]], m.lower[i]), m.upper[i])
    sizes = part_numbers(numbers, BOUNDED_MEMBER)
    state = part_memory(numbers, memory, BOUNDED_MEMBER)
    call_row(numbers[BOUNDED_ROW], sizes, state, dt, m.seen, out, half_width)
    for j in range(m.n_outputs):
        for i in range(m.n_seen):
            out[j] += m.slope[i, j] * (x[m.columns[i]] - m.seen[i])
        for i in range(m.n_features):
            out[j] += m.direct[i, j] * x[i]


def _bounded_shapes(params: Params, n_features: int, n_outputs: int) -> dict[str, Shape]:
    ((member, _),), n_seen = members(params, {}), len(params["columns"])
    if max(params["columns"]) >= n_features:
        raise CalibrationError(
            f"bounded parameter columns has place {max(params['columns'])}; there are "
            f"{n_features} features"
        )
    return {
        **dict.fromkeys(("lower", "upper"), (n_seen,)),
        "slope": (n_seen, n_outputs),
        "direct": (n_features, n_outputs),
        **member_shapes(member, n_seen, n_outputs),
    }


def _pack_bounded(
    params: Params, arrays: Mapping[str, Array], _n_features: int, n_outputs: int
) -> Memory:
    ((member, _),), n_seen = members(params, arrays), len(params["columns"])
    row = find_family(member.family)
    return BOUNDED_LAYOUT.pack(
        {"row": row.row}, columns=params["columns"], seen=np.zeros(n_seen),
        row=row.row_address(), member=row.memory(member, n_seen, n_outputs),
        **{name: arrays[name] for name in ("lower", "upper", "slope", "direct")},
    )  # fmt: skip


BOUNDED: Final = Family(
    "bounded",
    rules={
        "members": ONE_MEMBER,
        "columns": Rule(
            lambda value: (
                isinstance(value, (tuple, list))
                and 0 < len(value) == len(set(value)) <= MAX_COLUMNS
                and all(is_integer(place, 0, MAX_COLUMNS - 1) for place in value)
            ),
            f"1 to {MAX_COLUMNS} different places of features",
        ),
    },
    shapes=_bounded_shapes,
    pack=_pack_bounded,
    row=bounded_row,
    beside=lambda params: {n: ("member", *path[1:]) for n, path in _beside(params).items()},
    specialise=lambda params: {
        name: getattr(kind, name)
        for kind, _ in _kinds(params)
        for name in ("remembers", "counts_samples", "targets")
    },
)
