"""An elastic joint with friction, seen from its motor: what its unscented filter is made of.

Everything is in units of the calibration: the driver's angle ``d`` from the middle of its range in
half ranges, torques in standard deviations of the driver's torque.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from math import nan, sqrt
from typing import Any, Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled, copy, vector
from truejoint.errors import CalibrationError
from truejoint.estimators import filtered as at
from truejoint.estimators.family import Shape, only_joint
from truejoint.estimators.plays import run as play_bank
from truejoint.estimators.plays.run import expand
from truejoint.estimators.rules import Params, integer, number, one_of
from truejoint.filters import StateSpaceModel, UnscentedFilter
from truejoint.filters.fields import unpack_filter
from truejoint.layout import Memory, part_memory, part_numbers

DRIVER: Final = "driver/jaw"
TORQUE: Final = "effort/jaw"
JAW_TORQUE: Final = "truth_effort/jaw"
"""What the torque beside the angle is learnt of."""

CUBIC: Final = (0, 0), (1, 0), (2, 0), (3, 0), (0, 1), (0, 2), (0, 3), (1, 1), (1, 2), (2, 1)
"""Powers of driver angle and load in each term of a cubic in both."""
QUADRATIC: Final = (0, 0), (1, 0), (2, 0), (0, 1), (0, 2), (1, 1)
"""The same of a quadratic, by which each friction element is weighed."""
POLYNOMIAL, PER_ELEMENT = len(CUBIC), len(QUADRATIC)
LOAD_TERMS: Final = [place for place, (angle, _) in enumerate(CUBIC) if angle == 0]
"""Terms of the load alone."""
SCALES: Final = ("angle_middle", "angle_scale", "torque_scale", "dt")
"""What turns radians and newton metres into units of the calibration, and its time step [s]."""
NOISE: Final = (
    "load_density",  # variance that the load gains in a second
    "rest_deviation",  # of the friction that the elements do not explain
    "rest_travel",  # over which it forgets itself
    "noise_density",  # of the measured torque: variance times the time step [s]
    "load_mean",  # of the loads calibrated with: what the filter expects at first
    "load_deviation",
)
"""What is identified of load and noise, in units of the calibration."""

_LARGEST: Final = 1e30
_FARTHEST: Final = 3.0
"""Half ranges from the middle, beyond which no driver is: further out by its whole range."""
_STRONGEST: Final = 100.0
"""Standard deviations of the torque beyond which none is."""

# Parameters of the compiled functions; then come the widths and the coefficients.
_ELEMENTS, _LOAD_DENSITY, _REST_VARIANCE, _REST_TRAVEL, _WIDTHS = range(5)


def count_terms(elements: int) -> int:
    """Count the coefficients of a response with so many friction elements."""
    return POLYNOMIAL + PER_ELEMENT * elements


@compiled
def response(angle: float, load: float, x: Array, elements: int, coefficients: Array) -> float:
    """Respond as the joint does at rest to ``d`` and ``B``: with a torque, or an angle.

    A cubic in both plus, for each friction element, its deflection ``z``, in `x` and from -1 to 1,
    times a quadratic in both: the ratio of the linkage changes over its travel, the cable stiffens
    with load, and friction grows with the cable's tension.
    """
    c = coefficients
    total: float = c[0] + angle * (c[1] + angle * (c[2] + angle * c[3]))
    total += load * (c[4] + load * (c[5] + load * c[6]))
    total += angle * load * (c[7] + load * c[8] + angle * c[9])
    for i in range(elements):
        place = POLYNOMIAL + PER_ELEMENT * i
        deflection = min(max(x[i], -1.0), 1.0)
        weight = c[place] + angle * (c[place + 1] + angle * c[place + 2])
        weight += load * (c[place + 3] + load * c[place + 4] + angle * c[place + 5])
        total += deflection * weight
    return total


def terms(angle: Array, load: Array, deflections: Array) -> Array:
    """Terms (n, count_terms) that `response` weighs, for ``d`` (n,), ``B`` (n,), ``z`` (n, m)."""
    angles, loads = ([1.0, x, x**2, x**3] for x in (angle, load))
    elements = np.clip(deflections, -1.0, 1.0).T
    weighed = [(np.ones_like(angle), CUBIC), *((z, QUADRATIC) for z in elements)]
    return np.column_stack([z * angles[a] * loads[b] for z, powers in weighed for a, b in powers])


@compiled
def output(angle: float, x: Array, elements: int, coefficients: Array) -> float:
    """Tell the jaw's angle or torque at ``d`` of a state `x` (m + 2,) of the filter.

    The last two `coefficients` weigh the rest of friction ``w`` and ``w d``, those before
    `response`.
    """
    last = POLYNOMIAL + PER_ELEMENT * elements
    rest: float = x[elements + 1] * (coefficients[last] + angle * coefficients[last + 1])
    return response(angle, x[elements], x, elements, coefficients) + rest


def output_terms(angle: Array, states: Array) -> Array:
    """Terms (n, count_terms + 2) that `output` weighs, for ``d`` (n,) and states (n, m + 2)."""
    elements = states.shape[1] - 2
    rest = states[:, -1]
    static = terms(angle, states[:, elements], states[:, :elements])
    return np.column_stack([static, rest, rest * angle])


@compiled
def transition(x: Array, u: Array, _dt: float, parameters: Array, out: Array) -> None:
    """Drag the friction elements along; the load stays; the rest of friction fades with travel.

    State `x` (m + 2,): deflections, load ``B``, friction that they do not explain; `u`: ``d``,
    travel.
    """
    elements = int(parameters[_ELEMENTS])
    for i in range(elements):
        moved = x[i] + u[1] / parameters[_WIDTHS + i]
        out[i] = min(max(moved, -1.0), 1.0)
    out[elements] = x[elements]
    out[elements + 1] = x[elements + 1] * math.exp(-abs(u[1]) / parameters[_REST_TRAVEL])


@compiled
def process_noise(_x: Array, u: Array, dt: float, parameters: Array, out: Array) -> None:
    """Covariance of the load's random walk over `dt` and of the rest of friction over a travel."""
    elements = int(parameters[_ELEMENTS])
    out[elements, elements] = parameters[_LOAD_DENSITY] * dt
    fade = -math.expm1(-2.0 * abs(u[1]) / parameters[_REST_TRAVEL])
    out[elements + 1, elements + 1] = parameters[_REST_VARIANCE] * fade


@compiled
def measurement(x: Array, u: Array, parameters: Array, out: Array) -> None:
    """Torque at the driver: load, the friction that the elements explain, and the rest of it."""
    elements = int(parameters[_ELEMENTS])
    coefficients = parameters[_WIDTHS + elements :]
    out[0] = x[elements + 1] + response(u[0], x[elements], x, elements, coefficients)


def elastic_filter(arrays: Mapping[str, Array]) -> UnscentedFilter:
    """Build the filter of what was identified; raises CalibrationError if it makes no sense."""
    (_middle, *scales), noise, widths = (arrays[n].tolist() for n in ("scales", "noise", "widths"))
    load_density, rest_deviation, rest_travel, noise_density, *_ = noise
    bounded = all(abs(value) <= _LARGEST for value in (_middle, *scales, *noise))
    if min(*scales, *noise[1:4], *widths) <= 0.0 or load_density < 0.0 or not bounded:
        raise CalibrationError(
            f"elastic_joint: a scale, width or noise is not above 0, up to {_LARGEST:g}; fit "
            "it again"
        )
    head = [len(widths), load_density, rest_deviation**2, rest_travel]
    model = StateSpaceModel(
        transition=transition,
        measurement=measurement,
        process_noise=process_noise,
        measurement_noise=[[noise_density / scales[-1]]],
        states=(*(f"friction{i + 1}" for i in range(len(widths))), "load", "rest"),
        measurements=("torque",),
        inputs=("driver", "travel"),
        parameters=np.concatenate([head, widths, arrays["torque"]]),
        possible={
            "driver": (-_FARTHEST, _FARTHEST),
            "travel": (-2.0 * _FARTHEST, 2.0 * _FARTHEST),
            **dict.fromkeys(("torque", "load", "rest"), (-_STRONGEST, _STRONGEST)),
        },
    )
    return UnscentedFilter(model)


LAYOUT: Final = at.filter_layout().declare(__package__, "filter")
LAST, BESIDE = LAYOUT.places("last torque")
unpack = LAYOUT.unpacker()


@compiled
def take_inputs(
    numbers: Integers, memory: Array, dt: float, x: Array, _out: Array, _half_width: Array
) -> None:
    """Measure the driver's torque; its angle and travel act."""
    m = unpack(numbers, memory)
    f = unpack_filter(part_numbers(numbers, at.FILTER), part_memory(numbers, memory, at.FILTER))
    angle = (x[0] - m.middle) / m.half_range
    f.z[0] = x[1] / m.torque_scale
    f.u[0], f.u[1] = angle, angle - m.last if dt != 0.0 else 0.0
    memory[LAST] = angle


@compiled
def tell(
    numbers: Integers, memory: Array, _dt: float, _x: Array, out: Array, half_width: Array
) -> None:
    """Tell the jaw's angle and, where it was learnt, its torque."""
    m = unpack(numbers, memory)
    f = unpack_filter(part_numbers(numbers, at.FILTER), part_memory(numbers, memory, at.FILTER))
    angle = f.u[0]
    for j in range(m.n_told):
        coefficients = m.responses[j]
        value = output(angle, f.x, m.elements, coefficients)
        deviations = m.deviations if j == 0 else m.beside_deviations
        width = 0.0
        if deviations > 0.0:
            variance = output_variance(angle, f.x, f.covariance, coefficients, m.near, m.slope)
            width = deviations * sqrt(variance + m.misfit[j] ** 2)
        if j > 0:
            m.torque[0], m.torque[1] = value if m.started == 1.0 else nan, width
        else:
            out[0] = value
            if deviations > 0.0:
                half_width[0] = width


@compiled
def output_variance(
    angle: float, x: Array, spread: Array, coefficients: Array, near: Array, slope: Array
) -> float:
    """Variance of what a state (n,) of covariance `spread` (n, n) says of one output.

    By differences over a deviation each way, since responses bend where an element slides; `near`
    and `slope` (n,) are room to work in.
    """
    n = spread.shape[0]
    elements = n - 2
    copy(x, near, n)
    for i in range(n):
        width = sqrt(max(spread[i, i], 1e-12))
        near[i] = x[i] + width
        ahead = output(angle, near, elements, coefficients)
        near[i] = x[i] - width
        slope[i] = (ahead - output(angle, near, elements, coefficients)) / (2.0 * width)
        near[i] = x[i]
    return float(at.quadratic(slope, spread, n))


@compiled
def output_rows(
    angles: Array, states: Array, spread: Array, coefficients: Array, out: Array, variance: Array
) -> None:
    """`output` and `output_variance` of every row for each of `coefficients` (k, ...): (n, k)."""
    near, slope = np.empty(states.shape[1]), np.empty(states.shape[1])
    for i in range(states.shape[0]):
        x, P = states[i], spread[i]
        for j in range(coefficients.shape[0]):
            c = coefficients[j]
            out[i, j] = output(angles[i], x, len(x) - 2, c)
            variance[i, j] = output_variance(angles[i], x, P, c, near, slope)


def n_told(params: Params) -> int:
    """Count what is told of the jaw: its angle, and its torque where that was learnt."""
    return 1 + int(params["tells_torque"])


def _shapes(params: Params, _n_features: int, n_outputs: int) -> dict[str, Shape]:
    elements = int(params["elements"])
    n_terms = count_terms(elements)
    learnt = {
        "scales": (len(SCALES),),
        "noise": (len(NOISE),),
        "widths": (elements,),
        "torque": (n_terms,),
        "outputs": (n_told(params), n_terms + 2),
        "misfit": (n_told(params),),
    }
    return only_joint("motor_side", learnt, n_outputs)


def pack(params: Params, arrays: Mapping[str, Array], _k: int, _n: int, **on_top: Any) -> Memory:
    """Memory of `filter_row`, with fields of a model on top or without."""
    middle, half_range, torque, _dt = arrays["scales"].tolist()
    _, rest_deviation, *_, load_mean, load_deviation = arrays["noise"].tolist()
    elements = int(params["elements"])
    # Before the first row, elements may be deflected in any way.
    mean = np.array([*[0.0] * elements, load_mean, 0.0])
    variance = [1.0 / 3.0] * elements + [load_deviation**2, rest_deviation**2]
    return at.pack_filter(
        LAYOUT,
        take_inputs=take_inputs,
        tell=tell,
        elements=elements,
        middle=middle,
        half_range=half_range,
        torque_scale=torque,
        responses=arrays["outputs"],
        misfit=arrays["misfit"],
        n_states=elements + 2,
        filter=elastic_filter(arrays).memory(mean, np.diag(variance)),
        **on_top,
    )


FAMILY: Final = at.filter_family(
    "motor_side",
    rules={
        "elements": integer(1, 12),
        "load_drift": number(0.0, 1e3),
        "torque_noise": number(1e-6, 1e3),
        "tells_torque": one_of(False, True),
    },
    shapes=_shapes,
    pack=pack,
    inputs=lambda _params: (DRIVER, TORQUE),
    beside=lambda params: {"torque": ()} if params["tells_torque"] else {},
)


N_SIGNALS: Final = 2
"""Driver and torque, of which trees see plays."""
_PLAYS: Final = "plays", "time_constants"


@compiled
def sight(
    numbers: Integers, memory: Array, dt: float, x: Array, out: Array, sighted: Array
) -> None:
    """Show a model signals, their plays and low-passes, states and angle of the filter."""
    signals = part_numbers(numbers, at.SIGNALS)
    expand(signals, part_memory(numbers, memory, at.SIGNALS), dt, x, sighted)
    f = unpack_filter(part_numbers(numbers, at.FILTER), part_memory(numbers, memory, at.FILTER))
    last, n_states = sighted.shape[0] - 1, f.n_states
    copy(f.x, vector(sighted, last - n_states, n_states), n_states)
    sighted[last] = out[0]


def _bank(params: Params) -> Params:
    """Parameters of the plays, of those of the family."""
    return {**play_bank.BARE, **{name: params[name] for name in _PLAYS}}


def _sizes(params: Params) -> tuple[int, int]:
    n_plays = play_bank.n_seen(_bank(params), N_SIGNALS)
    return n_plays + int(params["elements"]) + 3, n_told(params)


HYBRID_ROWS: Final = replace(
    at.hybrid_family(
        "motor_side.hybrid_rows",
        FAMILY,
        pack,
        sight,
        BESIDE,
        _sizes,
        rules={name: play_bank.FAMILY.rules[name] for name in _PLAYS},
        scales={"centre": (N_SIGNALS,), "inverse_half_range": (N_SIGNALS,)},
        signals=lambda params, arrays: play_bank.pack(_bank(params), arrays, N_SIGNALS, 0),
    ),
    states_deviation=lambda _params: False,
)
"""The filter, and trees that learn what it leaves."""
