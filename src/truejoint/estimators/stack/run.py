"""A row made of those of others: a weighted sum, each for some of the outputs.

Members may see some features alone, held to the range of their training. Beyond it, a prediction
stays, or goes on along a straight line: polynomials, products of plays and trees know nothing of
it.
"""

from collections.abc import Iterator, Mapping, Sequence
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
    Path,
    Shape,
    call_row,
    find_family,
)
from truejoint.estimators.rules import Params, Rule, integer, is_integer, is_list
from truejoint.layout import PART_SIZE, Layout, Memory, part_memory, part_numbers

MAX_MEMBERS: Final = 10
MAX_OUTPUTS: Final = 64
MAX_COLUMNS: Final = 1000
DEPTH: Final = 4
"""How deep a sum may stand within sums."""

LAYOUT: Final = Layout().declare(__package__, "stack")
_ROWS: Final = [LAYOUT.add(f"row_{i}", "address", "of a member's row") for i in range(MAX_MEMBERS)]
_PARTS: Final = [LAYOUT.add(f"member_{i}", "part", "of the sum") for i in range(MAX_MEMBERS)]
ROW, MEMBER = _ROWS[0], _PARTS[0]
unpack = LAYOUT.unpacker()


@compiled
def stack_row(
    numbers: Integers, memory: Array, dt: float, x: Array, out: Array, half_width: Array
) -> None:
    """Predict a weighted sum of what the members predict, those of a range straight beyond it."""
    m = unpack(numbers, memory)
    fill(out, out.shape[0], 0.0)
    for i in range(unrolled(m.n_members)):
        first, count = m.first[i], m.count[i]
        predicted = vector(m.predicted, 0, count)
        member = MEMBER + PART_SIZE * i
        sizes, state = part_numbers(numbers, member), part_memory(numbers, memory, member)
        if m.n_seeing == 0:
            call_row(numbers[ROW + i], sizes, state, dt, x, predicted, half_width)
        else:
            begin, n_seen, k = m.first_seen[i], m.n_seen[i], x.shape[0]
            for p in range(begin, begin + n_seen):
                m.seen[p] = min(max(x[m.columns[p]], m.lower[p]), m.upper[p])
            seen = vector(m.seen, begin, n_seen)
            call_row(numbers[ROW + i], sizes, state, dt, seen, predicted, half_width)
            for j in range(count):
                at = m.output[first + j]
                for p in range(begin, begin + n_seen):
                    predicted[j] += m.slope[p, at] * (x[m.columns[p]] - m.seen[p])
                for p in range(k):
                    predicted[j] += m.direct[i * k + p, at] * x[p]
        for j in range(count):
            out[m.output[first + j]] += m.weights[first + j] * predicted[j]


def are_members(value: object, depth: int = DEPTH) -> bool:
    """Whether `value` is a sequence of (family, its parameters, outputs), sums not too deep."""
    return is_list(value, 1, MAX_MEMBERS, lambda member: _is_member(member, depth))


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


def _are_different(places: Any) -> bool:
    """Whether `places` is a sequence of different places of features."""
    good = is_list(places, 1, MAX_COLUMNS, integer(0, MAX_COLUMNS - 1).holds)
    return good and len(places) == len(set(places))


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


def columns_of(params: Params, n_features: int) -> list[Sequence[int]]:
    """Places of the features that each member sees; CalibrationError if one is not there."""
    columns, n_members = params["columns"], len(params["members"])
    if len(columns) not in (0, n_members):
        raise CalibrationError(
            f"stack parameter columns is for {len(columns)} members; there are {n_members}"
        )
    largest = max((max(places) for places in columns), default=-1)
    if largest >= n_features:
        raise CalibrationError(
            f"stack parameter columns has place {largest}; there are {n_features} features"
        )
    return list(columns) or [range(n_features)] * n_members


def _shapes(params: Params, n_features: int, n_outputs: int) -> dict[str, Shape]:
    shapes: dict[str, Shape] = {}
    used: list[int] = []
    columns = columns_of(params, n_features)
    for number, (data, outputs) in enumerate(members(params, {})):
        shapes |= member_shapes(data, len(columns[number]), len(outputs), number)
        used += outputs
    if params["columns"]:
        n_columns, n_direct = sum(map(len, columns)), len(columns) * n_features
        shapes |= {
            **dict.fromkeys(("lower", "upper"), (n_columns,)),
            "slope": (n_columns, n_outputs),
            "direct": (n_direct, n_outputs),
        }
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
    columns, seeing = columns_of(params, n_features), params["columns"]
    for i, (data, outputs) in enumerate(members(params, arrays)):
        family = find_family(data.family)
        table[f"member_{i}"] = family.memory(data, len(columns[i]), len(outputs))
        table[f"row_{i}"], functions[f"row_{i}"] = family.row_address(), family.row
    used = [outputs for _family, _params, outputs in params["members"]]
    count, n_seen = [len(outputs) for outputs in used], [*map(len, seeing)]
    none = np.zeros((0, n_outputs))
    limits = {"lower": (), "upper": (), "slope": none, "direct": none}
    return LAYOUT.pack(
        functions, count=count, first=np.cumsum([0, *count[:-1]]), output=np.concatenate(used),
        weights=arrays["weights"], n_seen=n_seen,
        first_seen=np.cumsum(n_seen) - n_seen, columns=[p for places in seeing for p in places],
        **{name: arrays.get(name, value) for name, value in limits.items()}, **table,
    )  # fmt: skip


def _beside(params: Params) -> dict[str, Path]:
    """Find what members tell beside the position, each quantity in the first that does."""
    paths: dict[str, Path] = {}
    for i, (data, _) in enumerate(members(params, {})):
        for name, path in find_family(data.family).beside(data.params).items():
            paths.setdefault(name, (f"member_{i}", *path))
    return paths


def _specialised(params: Params) -> dict[str, Any]:
    """Fields of the family that the members decide: of those with a memory, and with features.

    A member that is not fitted yet may become any without a memory.
    """
    kinds = list[tuple[Family, Params]]()
    for data, _ in members(params, {}):
        with suppress(CalibrationError):
            kinds.append((data.kind, data.params))
    own = (kind.inputs(member) for kind, member in kinds if kind.inputs and not params["columns"])
    inputs = next(own, None)
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
        ),
        "columns": Rule(
            lambda value: is_list(value, 0, MAX_COLUMNS, _are_different),
            f"for each member, 1 to {MAX_COLUMNS} different places of features",
        ),
    },
    shapes=_shapes,
    pack=_pack,
    row=stack_row,
    beside=_beside,
    specialise=_specialised,
)
