"""What the unscented filter of a wrist's cables is made of: angles and loads, and their deviations.

Its model is `cable_loops`. Radii, zeros and eccentric pulleys are what is added to the joints as a
linear function of where cables that give nowhere would have them.
"""

import math
from collections.abc import Mapping
from math import sqrt
from typing import Any, Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled, local_vector, unrolled, vector
from truejoint.errors import CalibrationError
from truejoint.estimators import filtered as at
from truejoint.estimators.cables import loops
from truejoint.estimators.cables.loops import LOAD, PARAMETERS, PIN, RIGID, STATES, N
from truejoint.estimators.family import Shape
from truejoint.estimators.rules import Params, Rule, is_list
from truejoint.filters import StateSpaceModel, UnscentedFilter
from truejoint.filters.fields import unpack_filter
from truejoint.layout import Memory, part_memory, part_numbers
from truejoint.toml_file import shipped_table

TERMS: Final = 1 + 3 * N
"""Terms of what geometry adds: a constant, each raw joint, its sine and its cosine."""
QUIET: Final = 4e-4
"""Motor angle [rad] within which what trembles moves no friction."""
DECAY: Final = 3.0
"""Time [s] in which a load fades that nothing shows any more."""
ERROR_TIME: Final = 0.1
"""Time [s] for which the misfit of an effort stays the same."""

SOUGHT: Final[Mapping[str, tuple[str, float, float, float, float]]] = shipped_table(
    __package__, "identified.toml"
)
"""Unit, bounds and starts of what is identified, as `identified.toml` says."""

_FARTHEST: Final = 50.0  # [rad] of a motor
_STRONGEST: Final = 1e3  # [N] or [Nm], of anything


@compiled
def raw_joints(motor: Array, p: Array, out: Array) -> None:
    """Joints (N,) [rad] of cables that give nowhere."""
    for j in range(N):
        out[j] = 0.0
        for m in range(N):
            out[j] += p[RIGID + N * j + m] * motor[m]


@compiled
def add_geometry(motor: Array, p: Array, added: Array, out: Array) -> None:
    """Add what geometry does, `added` (TERMS, N), to joints `out` (N,)."""
    raw = local_vector(N)
    raw_joints(motor, p, raw)
    for j in range(N):
        total = added[0, j]
        for k in range(N):
            total += added[1 + k, j] * raw[k] + added[1 + N + k, j] * math.sin(raw[k])
            total += added[1 + 2 * N + k, j] * math.cos(raw[k])
        out[j] += total


def angles_by_state(parameters: Array) -> Array:
    """Give the derivative (N, STATES) of the joints by the state, of cables that are taut."""
    rows, zero, still = np.empty((STATES, N)), np.empty(N), np.zeros(N)
    loops.joints(np.zeros(STATES), still, parameters, zero)
    for row, unit in zip(rows, 1e-6 * np.eye(STATES), strict=True):
        loops.joints(unit, still, parameters, row)
    return np.ascontiguousarray((rows - zero).T / 1e-6)


def cable_filter(arrays: Mapping[str, Array]) -> UnscentedFilter:
    """Build the filter of a fitted `CableFilter`; raises CalibrationError or FilterError."""
    parameters, dt = arrays["parameters"], float(arrays["dt"][0])
    misfit = arrays["effort_misfit"]
    if not (1e-9 < dt < 1e9 and ((misfit > 0.0) & (misfit < _STRONGEST)).all()):
        raise CalibrationError("cable_filter: dt or effort_misfit is not above 0; fit it again")
    kinds = ("guide", "wrist", "motor", "pin", "load")
    inputs = [f"{kind}_{k}" for kind in ("angle", "change", "speed") for k in range(N)]
    model = StateSpaceModel(
        transition=loops.transition,
        measurement=loops.measurement,
        process_noise=loops.process_noise,
        # A misfit that lasts for a time tells in each row what it told in the row before.
        measurement_noise=np.diag(misfit**2 * max(ERROR_TIME / dt, 1.0)),
        states=tuple(f"{kind}_{k}" for kind in kinds for k in range(N)),
        measurements=tuple(f"effort_{k}" for k in range(N)),
        inputs=tuple(inputs),
        parameters=parameters,
        possible={
            **{name: (-_FARTHEST, _FARTHEST) for name in inputs if not name.startswith("speed")},
            **{f"{kind}_{k}": (-_STRONGEST, _STRONGEST) for kind in ("effort", *kinds)
               for k in range(N)},
        },
    )  # fmt: skip
    return UnscentedFilter(model)


def cable_prior(parameters: Array) -> tuple[Array, Array]:
    """State and covariance of an instrument of which nothing is known yet."""
    variance = np.empty(STATES)
    variance[: loops.MOTOR] = parameters[loops.LEVEL : loops.LEVEL + 2 * N] ** 2 / 3.0
    variance[loops.MOTOR : loops.PIN] = 1.0 / 3.0
    variance[loops.PIN : LOAD] = parameters[loops.PIN_LEVEL : loops.PIN_LEVEL + N] ** 2 / 3.0
    variance[LOAD:] = parameters[loops.LOAD_RATE : loops.LOAD_RATE + N] * 0.5 * DECAY
    return np.zeros(STATES), np.diag(variance)


LOADS: Final = "grip", "tip_first", "tip_second"
"""What the row tells beside the joints."""

LAYOUT: Final = at.filter_layout().declare(__package__, "filter", N=N, TERMS=TERMS, STATES=STATES)
GRIP: Final = LAYOUT.at("grip")
unpack = LAYOUT.unpacker()


@compiled
def take_motors(dt: float, x: Array, last: Array, played: Array, u: Array) -> None:
    """Fill the filter's inputs from the motor angles in `x`, and note them; `dt` 0 starts."""
    for m in range(N):
        before = played[m]
        if dt == 0.0:
            played[m] = before = last[m] = x[m]
        played[m] = min(max(played[m], x[m] - QUIET), x[m] + QUIET)
        u[loops.ANGLE + m] = played[m]
        u[loops.CHANGE + m] = played[m] - before
        u[loops.SPEED + m] = (x[m] - last[m]) / dt if dt > 0.0 else 0.0
        last[m] = x[m]


@compiled
def input_rows(X: Array, dt: Array, out: Array) -> None:
    """Fill the filter's inputs (n, INPUTS) from motor angles in the first N columns of `X`."""
    last, played = local_vector(N), local_vector(N)
    for i in range(X.shape[0]):
        take_motors(dt[i], X[i], last, played, out[i])


@compiled
def take_inputs(
    numbers: Integers, memory: Array, dt: float, x: Array, _out: Array, _half_width: Array
) -> None:
    """Measure the motors' efforts; the motors act."""
    m = unpack(numbers, memory)
    f = unpack_filter(part_numbers(numbers, at.FILTER), part_memory(numbers, memory, at.FILTER))
    take_motors(dt, x, m.last, m.played, f.u)
    for j in range(N):
        f.z[j] = x[N + j]


@compiled
def tell(
    numbers: Integers, memory: Array, _dt: float, _x: Array, out: Array, half_width: Array
) -> None:
    """Tell joints and loads.

    `structure` is by what variances of angles and loads are multiplied, and what is added to them
    in proportion to the loads that are seen.
    """
    m = unpack(numbers, memory)
    f = unpack_filter(part_numbers(numbers, at.FILTER), part_memory(numbers, memory, at.FILTER))
    loops.joints(f.x, m.played, f.theta, out)
    add_geometry(m.played, f.theta, m.geometry, out)
    loads = 0.0
    for k in range(N):
        loads += abs(f.x[LOAD + k])
    for j in range(unrolled(N)):
        by_load = loads * m.structure[1, j]
        if m.deviations > 0.0:
            variance = at.quadratic(m.by_state[j], f.covariance, STATES) * m.structure[0, j]
            half_width[j] = m.deviations * sqrt(variance + by_load)
        variance = max(f.covariance[LOAD + j, LOAD + j], 0.0) * m.structure[2, j]
        load = vector(memory, numbers[GRIP + j], 2)
        load[0] = f.x[LOAD + j]
        load[1] = m.beside_deviations * sqrt(variance + loads * m.structure[3, j])


def _shapes(_params: Params, _n_features: int, n_outputs: int) -> dict[str, Shape]:
    if n_outputs != N:
        raise CalibrationError(
            f"cable_filter estimates the {N} joints of a wrist at once, not {n_outputs}"
        )
    return {
        "parameters": (PARAMETERS,),
        "added": (TERMS, N),
        "effort_misfit": (N,),
        "structure": (4, N),
        "identified": (len(SOUGHT), 2),
        "dt": (1,),
    }


def pack(_params: Params, arrays: Mapping[str, Array], _k: int, _n: int, **on_top: Any) -> Memory:
    """Memory of `filter_row`, with fields of a model on top or without."""
    parameters = arrays["parameters"]
    return at.pack_filter(
        LAYOUT,
        take_inputs=take_inputs,
        tell=tell,
        beside_deviations=1.0,
        geometry=arrays["added"],
        by_state=angles_by_state(parameters),
        structure=arrays["structure"],
        filter=cable_filter(arrays).memory(*cable_prior(parameters)),
        **on_top,
    )


@compiled
def sight(
    numbers: Integers, memory: Array, _dt: float, x: Array, out: Array, sighted: Array
) -> None:
    """Show a model raw joints, motors, efforts, what the filter adds to the joints, loads, pins.

    It adds to raw joints, and to loads of nothing.
    """
    f = unpack_filter(part_numbers(numbers, at.FILTER), part_memory(numbers, memory, at.FILTER))
    raw_joints(x, f.theta, sighted)
    for j in range(N):
        sighted[N + j], sighted[2 * N + j] = x[j], x[N + j]
        sighted[3 * N + j] = out[j] - sighted[j]
        sighted[4 * N + j], sighted[5 * N + j] = f.x[LOAD + j], f.x[PIN + j]
        out[j] = sighted[j]
    for j in range(unrolled(N)):
        memory[numbers[GRIP + j]] = 0.0


FAMILY: Final = at.filter_family(
    "cables",
    rules={
        "channels": Rule(
            lambda value: is_list(value, N, N, lambda name: isinstance(name, str) and name != ""),
            f"the names of {N} motors",
        )
    },
    shapes=_shapes,
    pack=pack,
    inputs=lambda params: tuple(
        f"{kind}/{name}" for kind in ("motor", "effort") for name in params["channels"]
    ),
    beside=lambda _params: dict.fromkeys(LOADS, ()),
    bears_load=lambda _params: True,
)
HYBRID_ROWS: Final = at.hybrid_family(
    "cables.hybrid_rows", FAMILY, pack, sight, GRIP, lambda _params: (6 * N, 2 * N)
)
"""The filter, and plays of what `sight` shows of it."""
