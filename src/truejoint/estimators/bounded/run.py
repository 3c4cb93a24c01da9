"""An estimator on some of the features, held to the range that it was fitted to.

Beyond that range its prediction stays, or goes on along a straight line: polynomials, products of
plays and trees know nothing of it. Within the range nothing changes.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import Any, Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled
from truejoint.errors import CalibrationError
from truejoint.estimators.family import (
    Family,
    Params,
    Path,
    Rule,
    Shape,
    call_row,
    find_family,
    is_integer,
)
from truejoint.estimators.stack.run import are_members, members
from truejoint.layout import Layout, Memory, part_memory, part_numbers

MAX_FEATURES: Final = 1000

LAYOUT: Final = Layout()
LAYOUT.integers("columns", "features that the estimator sees", "n_seen")
LAYOUT.array("lower", "end of the range of each in training", "n_seen")
LAYOUT.array("upper", "other end", "n_seen")
LAYOUT.array("seen", "by the estimator", "n_seen")
LAYOUT.array("slope", "of the line beyond", "n_seen", "n_outputs")
LAYOUT.array("direct", "what each feature adds to the outputs", "n_features", "n_outputs")
ROW: Final = LAYOUT.address("row", "prediction of the estimator")
MEMBER: Final = LAYOUT.part("member", "that is held to its range")
unpack = LAYOUT.unpacker()


@compiled
def bounded_row(
    numbers: Integers, memory: Array, dt: float, x: Array, out: Array, half_width: Array
) -> None:
    """Predict within the range, and go on straight beyond it."""
    m = unpack(numbers, memory)
    for i in range(m.n_seen):
        m.seen[i] = min(max(x[m.columns[i]], m.lower[i]), m.upper[i])
    state = part_memory(numbers, memory, MEMBER)
    call_row(numbers[ROW], part_numbers(numbers, MEMBER), state, dt, m.seen, out, half_width)
    for j in range(m.n_outputs):
        for i in range(m.n_seen):
            out[j] += m.slope[i, j] * (x[m.columns[i]] - m.seen[i])
        for i in range(m.n_features):
            out[j] += m.direct[i, j] * x[i]


def _are_columns(value: object) -> bool:
    return (
        isinstance(value, (tuple, list))
        and 0 < len(value) == len(set(value)) <= MAX_FEATURES
        and all(is_integer(place, 0, MAX_FEATURES - 1) for place in value)
    )


def _shapes(params: Params, n_features: int, n_outputs: int) -> dict[str, Shape]:
    ((member, _),) = members(params, {})
    n_seen = len(params["columns"])
    if max(params["columns"]) >= n_features:
        raise CalibrationError(
            f"bounded parameter columns has place {max(params['columns'])}; there are "
            f"{n_features} features"
        )
    family = find_family(member.family)
    family.check_params(member.params)
    family.check_size(member.params, n_seen)
    shapes = family.shapes(member.params, n_seen, n_outputs)
    return {
        **dict.fromkeys(("lower", "upper"), (n_seen,)),
        "slope": (n_seen, n_outputs),
        "direct": (n_features, n_outputs),
        **{f"0/{name}": shape for name, shape in shapes.items()},
    }


def _pack(params: Params, arrays: Mapping[str, Array], n_features: int, n_outputs: int) -> Memory:
    ((member, _),) = members(params, arrays)
    family, n_seen = find_family(member.family), len(params["columns"])
    own = {name: arrays[name] for name in ("lower", "upper", "slope", "direct")}
    return LAYOUT.pack(
        {"row": family.row}, columns=params["columns"], seen=np.zeros(n_seen),
        row=family.row_address(), member=family.memory(member, n_seen, n_outputs), **own,
    )  # fmt: skip


def _beside(params: Params) -> dict[str, Path]:
    """Find what the estimator tells beside the position."""
    ((member, _),) = members(params, {})
    told = find_family(member.family).beside(member.params)
    return {name: ("member", *path) for name, path in told.items()}


def _specialised(params: Params) -> dict[str, Any]:
    """Fields of the family that the estimator decides."""
    ((member, _),) = members(params, {})
    with suppress(CalibrationError):  # not fitted yet, it may become any that remembers nothing
        kind = member.kind
        return {name: getattr(kind, name) for name in ("remembers", "counts_samples", "targets")}
    return {}


FAMILY: Final = Family(
    "bounded",
    rules={
        "members": Rule(
            lambda value: are_members(value) and len(value) == 1,
            "one member: family, its parameters and no outputs",
        ),
        "columns": Rule(_are_columns, f"1 to {MAX_FEATURES} different places of features"),
    },
    shapes=_shapes,
    pack=_pack,
    row=bounded_row,
    beside=_beside,
    specialise=_specialised,
)
