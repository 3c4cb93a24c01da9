"""The row of every estimator with a filter, with or without a model of what it leaves.

A filter's own kernels have the signature of a row: `take_inputs` fills the filter's measurement and
inputs from the features; `tell` fills outputs, half-widths and quantities beside from the filter's
state. A model of another family may stand on top: `sight` fills what it sees (its last argument),
and may replace what the filter tells by something else that the model then adds to. All of them
work on the memory of a layout that begins as `filter_layout`.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from itertools import pairwise
from math import nan
from typing import Any, Final, NamedTuple

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.compiled import address, borrow, compiled, copy, fill, inlined, unrolled
from truejoint.estimators.family import ROW, EstimatorData, Family, Shape, call_row, find_family
from truejoint.estimators.rules import Params, Rule
from truejoint.estimators.stack.run import are_members, member_shapes, members
from truejoint.filters import FilterStatus
from truejoint.filters import fields as at
from truejoint.filters.fields import call_step, unpack_filter
from truejoint.filters.kernels import restart
from truejoint.filters.smoother import smooth
from truejoint.layout import Layout, Memory, part_memory, part_numbers

FAULTS: Final = int(
    FilterStatus.INVALID_INPUT
    | FilterStatus.INVALID_MEASUREMENT
    | FilterStatus.TRANSITION_FAILED
    | FilterStatus.MEASUREMENT_FAILED
    | FilterStatus.OUT_OF_RANGE
    | FilterStatus.SINGULAR
)
"""What makes a filter's estimate none: its row is then NaN, and the sample IMPLAUSIBLE."""


def filter_layout() -> Layout:
    """Begin the layout of an estimator with a filter."""
    return Layout().declare(__package__, "filtered")


_LAYOUT: Final = filter_layout()
_INDEX: Final = {name: field.index for name, field in _LAYOUT.fields.items()}
DEVIATIONS, BESIDE_DEVIATIONS = _INDEX["deviations"], _INDEX["beside_deviations"]
STARTED, TAKE_INPUTS, TELL = _INDEX["started"], _INDEX["take_inputs"], _INDEX["tell"]
SIGHT, MODEL_ROW = _INDEX["sight"], _INDEX["model_row"]
FILTER, SIGNALS, MODEL = _INDEX["filter"], _INDEX["signals"], _INDEX["model"]
unpack = _LAYOUT.unpacker()


def pack_filter(layout: Layout, **values: Any) -> Memory:
    """Memory of `filter_row`, of kernels and other fields by name; no model unless given."""
    nothing: dict[str, Any] = dict.fromkeys(("signals", "model"), Layout().pack())
    nothing |= {"n_sighted": 1, "n_added": 1}  # C has no array without elements
    functions = {n: value for n, value in values.items() if layout.fields[n].kind == "address"}
    addresses = {name: address(kernel, ROW) for name, kernel in functions.items()}
    return layout.pack(functions, **{**nothing, **values, **addresses})


@inlined
def _begin(
    numbers: Integers, memory: Array, dt: float, x: Array, out: Array, half_width: Array
) -> float:
    """Take a row's inputs; the time that the filter is to advance, 0 where it starts anew."""
    if dt == 0.0 or memory[STARTED] == 0.0:
        restart(part_numbers(numbers, FILTER), part_memory(numbers, memory, FILTER))
        dt = 0.0
    call_row(numbers[TAKE_INPUTS], numbers, memory, dt, x, out, half_width)
    return dt


@inlined
def _advance(numbers: Integers, memory: Array, dt: float) -> None:
    """Advance the filter; after an estimate that is none, the next row starts anew.

    What happened meanwhile nobody saw, so that the covariance must be that of a start.
    """
    sizes, state = part_numbers(numbers, FILTER), part_memory(numbers, memory, FILTER)
    state[at.DT] = dt
    status = call_step(sizes[at.ADVANCE], sizes, state)
    memory[STARTED] = 1.0 if (status & FAULTS) == 0 else 0.0


@inlined
def _tell(
    numbers: Integers, memory: Array, dt: float, x: Array, out: Array, half_width: Array
) -> None:
    """Tell of the filter's state, with what the model adds."""
    call_row(numbers[TELL], numbers, memory, dt, x, out, half_width)
    m = unpack(numbers, memory)
    if numbers[SIGHT] != 0:
        call_row(numbers[SIGHT], numbers, memory, dt, x, out, m.sighted)
    if numbers[MODEL_ROW] != 0:
        sizes, model = part_numbers(numbers, MODEL), part_memory(numbers, memory, MODEL)
        call_row(numbers[MODEL_ROW], sizes, model, dt, m.sighted, m.added, m.width)
        n = out.shape[0]
        for j in range(n):
            out[j] += m.added[j]
        for j in range(unrolled(m.n_added - n)):
            memory[numbers[m.beside + j]] += m.added[n + j]


@compiled
def filter_row(
    numbers: Integers, memory: Array, dt: float, x: Array, out: Array, half_width: Array
) -> None:
    """Predict by a filter."""
    numbers, memory = borrow(numbers), borrow(memory)
    x, out, half_width = borrow(x), borrow(out), borrow(half_width)
    dt = _begin(numbers, memory, dt, x, out, half_width)
    _advance(numbers, memory, dt)
    _tell(numbers, memory, dt, x, out, half_width)
    if memory[STARTED] == 0.0:
        fill(out, out.shape[0], nan)


filter_family: Final = partial(
    Family, row=filter_row, remembers=True, targets=("position",), states_deviation=lambda _: True
)
"""Family of an estimator with a filter, of what else it has."""


@compiled
def quadratic(weights: Array, spread: Array, n: int) -> float:
    """Variance of the weighted sum of the first n numbers of a covariance, not negative."""
    variance = 0.0
    for i in range(n):
        for j in range(n):
            variance += weights[i] * spread[i, j] * weights[j]
    return max(variance, 0.0)


class FilterRun(NamedTuple):
    """What a filter makes of N rows, each from the rows up to it or, smoothed, from all.

    Rows after one that has no estimate start anew, as in the loop.
    """

    x: Array  # (N, n) states
    P: Array  # (N, n, n) their covariances
    u: Array  # (N, inputs) of the filter
    outputs: Array  # (N, n_outputs)
    deviations: Array  # (N, n_outputs)
    beside: Array  # (N, 2, k) values and deviations of quantities beside
    sighted: Array  # (N, n_sighted) what a model on top sees, or would see


class Estimate(NamedTuple):
    """What a filter says about each row of a record."""

    angle: Array  # (n,) or (n, k) [rad]; with a torque behind it, where that was learnt [Nm]
    angle_deviation: Array  # of the state, and of what the model misses
    load: Array  # (n,) or (n, k) [Nm]
    load_deviation: Array
    states: Array  # (n, m) of the filter


@compiled
def _run_rows(
    numbers: Integers,
    memory: Array,
    replays: bool,
    X: Array,
    dt: Array,
    places: Integers,
    status: Integers,
    noted: FilterRun,
) -> None:
    """Run every row of `X` and note what it makes, or tell of the states that are given.

    Times `dt` become 0 where the filter starts anew.
    """
    sizes, state = part_numbers(numbers, FILTER), part_memory(numbers, memory, FILTER)
    f, m = unpack_filter(sizes, state), unpack(numbers, memory)
    for i in range(X.shape[0]):
        dt[i] = _begin(numbers, memory, dt[i], X[i], noted.outputs[i], noted.deviations[i])
        if not replays:
            _advance(numbers, memory, dt[i])
            status[i] = sizes[at.STATUS]
            copy(f.u, noted.u[i], f.n_inputs)
        for k in range(f.n_states):
            row, noted_row = f.covariance[k], noted.P[i, k]
            if replays:
                f.x[k] = noted.x[i, k]
                copy(noted_row, row, f.n_states)
            else:
                noted.x[i, k] = f.x[k]
                copy(row, noted_row, f.n_states)
        _tell(numbers, memory, dt[i], X[i], noted.outputs[i], noted.deviations[i])
        copy(m.sighted, noted.sighted[i], m.n_sighted)
        for k in range(places.shape[0]):
            noted.beside[i, 0, k] = memory[places[k]]
            noted.beside[i, 1, k] = memory[places[k] + 1]


def run_filter(
    data: EstimatorData, X: Array, dt: Array, *, n_outputs: int = 1, smoothed: bool = False
) -> FilterRun:
    """Run the filter over rows `X` (N, k), `dt` (N,) [s] after those before, 0 at a start.

    `data` is of a family whose row is `filter_row`; quantities beside the outputs are in its order.
    """
    model = data.kind.memory(data, X.shape[1], n_outputs)
    fields, beside = model.layout.fields, data.kind.beside(data.params)
    numbers, memory, part = model.numbers, model.memory, model.part("filter")
    memory[[DEVIATIONS, BESIDE_DEVIATIONS]] = 1.0
    places = np.array([numbers[fields[name].index] for name in beside], dtype=np.int64)
    N, n = len(X), len(part.view("x"))
    noted = FilterRun(
        x=np.zeros((N, n)),
        P=np.zeros((N, n, n)),
        u=np.zeros((N, *part.shapes["u"])),
        outputs=np.zeros((N, n_outputs)),
        deviations=np.zeros((N, n_outputs)),
        beside=np.zeros((N, 2, len(beside))),
        sighted=np.zeros((N, *model.shapes["sighted"])),
    )
    rows, times, status = np.ascontiguousarray(X), np.array(dt), np.zeros(N, dtype=np.int64)
    for replays in (False, True)[: 1 + smoothed]:
        _run_rows(numbers, memory, replays, rows, times, places, status, noted)
        if smoothed and not replays:
            for history in histories(times):
                prior = part.view("x_prior").copy(), part.view("covariance_prior").copy()
                u, x, P = noted.u[history], noted.x[history], noted.P[history]
                ones, bits = np.ones(len(x)), status[history]
                smooth(part.numbers, part.memory, u, times[history], ones, bits, *prior, x, P)
    return noted


def histories(dt: Array) -> list[slice]:
    """Rows of each history, of the time (n,) since the row before, 0 where one starts."""
    return [slice(*ends) for ends in pairwise([*np.flatnonzero(dt == 0.0).tolist(), len(dt)])]


def joined(filtered: Mapping[str, Any], model: Mapping[str, Any]) -> dict[str, Any]:
    """Arrays of a hybrid, of those of its filter and of its model."""
    return {**filtered, **{f"0/{name}": array for name, array in model.items()}}


def hybrid_family(
    name: str,
    filtered: Family,
    pack_filtered: Callable[..., Memory],
    sight: Any,
    beside: int,
    sizes: Callable[[Params], tuple[int, int]],
    *,
    rules: Mapping[str, Rule] | None = None,
    scales: Mapping[str, Shape] | None = None,
    signals: Callable[[Params, Mapping[str, Array]], Memory] = lambda _params, _: Layout().pack(),
) -> Family:
    """Family of a filter's family, called `filtered`, with a model of what it leaves.

    The filter knows how loads and friction make each other at any speed, so that the model need not
    find that out; it makes up for what the filter's equations lack.

    `pack_filtered` is that of the filter's family, which takes fields of `filter_layout` besides;
    `sight` one of them, and `beside` the index of the first quantity beside the outputs. `sizes`
    gives the numbers of inputs and outputs of the model; `signals` the memory of what `sight`
    remembers, of further parameters with these `rules` and arrays of these shapes, its `scales`.
    Of arrays that have no model yet, the memory is that of the filter, and of what a model will
    see.
    """

    def model_of(params: Params, arrays: Mapping[str, Array]) -> EstimatorData:
        return next(members({"members": (params["model"],)}, arrays))[0]

    def shapes(params: Params, n_features: int, n_outputs: int) -> dict[str, Shape]:
        of_filter = filtered.shapes(params, n_features, n_outputs) | dict(scales or {})
        return of_filter | member_shapes(model_of(params, {}), *sizes(params))

    def pack(
        params: Params, arrays: Mapping[str, Array], n_features: int, n_outputs: int
    ) -> Memory:
        data, (n_sighted, n_added) = model_of(params, arrays), sizes(params)
        on_top = {"sight": sight, "n_sighted": n_sighted, "signals": signals(params, arrays)}
        if data.arrays:
            family = find_family(data.family)
            model = family.memory(data, n_sighted, n_added)
            on_top |= {"model_row": family.row, "model": model}
            on_top |= {"n_added": n_added, "beside": beside}
        return pack_filtered(params, arrays, n_features, n_outputs, **on_top)

    model_rule = Rule(lambda value: are_members((value,)), "a family, its parameters, and ()")
    return replace(
        filtered,
        name=name,
        rules={**filtered.rules, **(rules or {}), "model": model_rule},
        shapes=shapes,
        pack=pack,
    )
