"""What runs of a jaw under loads: a filter with friction and load in its state, and gated plays.

Slider, cables and jaw hold friction that depends on which way they last moved. A few elastoplastic
elements, each a bristle that bends with the reset cable's motion until it slides, stand for it.
What the motor's side reads, against what it should, corrects their deflections and the load: fast
and small as friction, slow and lasting as a load.

A load stretches the drive cable beyond what it is stretched unloaded, which is the filter's last
state. A rope's strands bed in as it is pulled, so its stiffness grows with its tension ``T``:
``dT/ds = K_d + k T``, of which the spring sets what is there unloaded, ``K_sp x2``. While the jaw
stands, its friction may hide a part of a load; so may the slider's a part of the angle.

Plays on both sides are believed while they agree, on the reset cable alone under a load. While the
motor stands, a difference between the two that changes is a load's doing, or that of friction which
a load has turned round. So what is believed of the difference may then fall, and not grow.
"""

from collections.abc import Mapping
from math import exp, expm1, nan, sqrt
from typing import Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled, vector
from truejoint.errors import CalibrationError
from truejoint.estimators import filtered as at
from truejoint.estimators.family import Family, Shape, only_joint
from truejoint.estimators.jaw.signals import MECHANISM_RULES, MOTOR, RESET, SLIDING, stand
from truejoint.estimators.plays import run as plays
from truejoint.estimators.plays.run import jaw_bank, play_bank_row
from truejoint.estimators.rules import POSITIVE, Params, is_number, number, numbers
from truejoint.filters import StateSpaceModel, UnscentedFilter
from truejoint.filters.fields import unpack_filter
from truejoint.layout import Layout, Memory, part_memory, part_numbers

DEGREE: Final = 4
"""Highest power of ``x2`` in both polynomials."""

UNSHOWN: Final = 2.0 / sqrt(3.0)
"""Deviation of a load that nothing has shown, in sizes of the jaw's friction: motor and reset cable
stand, and it may be anything from nothing to twice the friction."""
SHOWN: Final = 0.4
"""The same of a load that has moved the reset cable: it came past where it now rests, or nearly
there, and friction holds some of what is left."""
TURNING: Final = 0.5
"""The same while the motor moves and the reset cable does not yet: friction is turning round."""
HIDDEN_ANGLE: Final = 0.3
"""The same of the angle and the slider's friction, while the reset cable stands."""

_LARGEST: Final = 1e30
_FARTHEST: Final = 3.0
"""Largest displacements of training beyond which no cable is: further out by its whole range."""


@compiled
def transition(x: Array, u: Array, _dt: float, parameters: Array, out: Array) -> None:
    """Bend each element by the reset cable's motion ``u[0]`` [m]; the stretch stays.

    `parameters` begins with the number of elements and their widths [m].
    """
    n = int(parameters[0])
    for i in range(n):
        out[i] = min(max(x[i] + u[0] / parameters[1 + i], -1.0), 1.0)
    out[n] = x[n]


@compiled
def response(place: float, x: Array, elements: int, weights: Array) -> float:
    """Sum of a constant, powers of a scaled place, and the elements' deflections in `x`."""
    total = weights[0]
    power = 1.0
    for i in range(DEGREE):
        power = power * place
        total = total + weights[1 + i] * power
    for i in range(elements):
        total = total + weights[1 + DEGREE + i] * x[i]
    return float(total)


@compiled
def measurement(x: Array, u: Array, parameters: Array, out: Array) -> None:
    """Drive cable's displacement [m] where the reset cable's is ``u[1]`` [m].

    `parameters` goes on with the inverse scale, constant and powers of a polynomial, and a weight
    for each element.
    """
    n = int(parameters[0])
    weights = parameters[2 + n : 3 + 2 * n + DEGREE]
    out[0] = response(u[1] * parameters[1 + n], x, n, weights) + x[n]


@compiled
def process_noise(_x: Array, _u: Array, dt: float, parameters: Array, out: Array) -> None:
    """Random walks: the last two parameters are variances per second of elements and stretch."""
    n = int(parameters[0])
    for i in range(n):
        out[i, i] = parameters[3 + 2 * n + DEGREE] * dt
    out[n, n] = parameters[4 + 2 * n + DEGREE] * dt


@compiled
def stiffening(stretch: float, growth: float) -> float:
    """Exponent by which a `stretch` [m] raises the stiffness; bounded, whatever comes in."""
    return min(max(growth * stretch, -50.0), 50.0)


@compiled
def external_torque(stretch: float, tension: float, cable: Array) -> float:
    """Torque on the jaw from outside [Nm].

    Of the drive cable's `stretch` beyond that without a load [m] and its `tension` without one [N],
    both from the jaw's zero. `cable` begins with ``K_d`` [N/m], its growth ``k`` [N/m per N] and
    the jaw's radius [m].
    """
    stiffness = cable[0] + cable[1] * tension
    return float(-stiffness / cable[1] * expm1(stiffening(stretch, cable[1])) * cable[2])


@compiled
def hidden_load(dt: float, drive: float, reset: float, hold: Array) -> float:
    """Deviation of what the jaw's friction may hide of a load, in sizes of that friction.

    Of the drive cable's place by the motor and the reset cable's [m]. `hold` (5,) changes: places
    and standstill of reset and drive cable, as `stand` takes them, and what share of a load the
    reset cable has not shown since the motor stands.
    """
    before = hold[0]
    standing = stand(dt, reset, hold[0:2])
    motor_stands = stand(dt, drive, hold[2:4]) >= 1.0
    if dt == 0.0 or not motor_stands:
        hold[4] = 1.0
    else:
        hold[4] = hold[4] * exp(-abs(hold[0] - before) / SLIDING)
    if not motor_stands:
        return float(TURNING * standing)
    unshown, shown = UNSHOWN * hold[4], SHOWN * (1.0 - hold[4])
    return float(standing * sqrt(unshown * unshown + shown * shown))


@compiled
def judge(
    dt: float,
    drive: float,
    reset: float,
    stretch: float,
    stretch_variance: float,
    cable: Array,
    hold: Array,
    load: Array,
) -> float:
    """Load on the jaw [Nm] and its deviation into `load` (2,); gives the variance hidden in angle.

    `cable` (8,) goes on with the spring's stiffness [N/m], the share that the torque may be off by,
    friction of the jaw [Nm] and of the slider, in terms of the angle [rad], and the largest load
    [Nm]. `drive`, `reset` [m] and `hold` (5,) are as `hidden_load` takes them.
    """
    hidden = hidden_load(dt, drive, reset, hold) * cable[5]
    tension = cable[3] * reset
    torque = external_torque(stretch, tension, cable)
    slope = (cable[0] + cable[1] * tension) * exp(stiffening(stretch, cable[1])) * cable[2]
    off = cable[4] * torque
    load[0] = torque
    load[1] = sqrt(slope * slope * max(stretch_variance, 0.0) + off * off + hidden * hidden)
    return float((HIDDEN_ANGLE * hold[1] * cable[6]) ** 2)


def jaw_friction(params: Params, arrays: Mapping[str, Array]) -> float:
    """Friction torque of the jaw [Nm] that the unloaded motion shows.

    Turning round, the drive side moves by both frictions, ``F_s (1/K_r + 1/K_d) + tau/(K_d r)``
    each way, and the angle by the slider's alone, ``F_s / (K_r r)``; both cables are one rope's.
    """
    drive, angle = (float(arrays[name][1 + DEGREE :].sum()) for name in ("drive", "angle"))
    radius = float(params["jaw_radius"])
    return max((drive - 2.0 * radius * angle) * float(params["drive_stiffness"]) * radius, 0.0)


def friction_filter(params: Params, arrays: Mapping[str, Array]) -> UnscentedFilter:
    """Build the filter of a fitted `FrictionFilter`; raises CalibrationError or FilterError."""
    for name in ("scale", "misfit", "dt"):
        if not all(is_number(value, 1.0 / _LARGEST, _LARGEST) for value in arrays[name]):
            raise CalibrationError(f"friction_filter: {name} is not above 0; fit it again")
    widths = params["widths"]
    n = len(widths)
    last = [params["friction_drift"] ** 2, params["stretch_drift"] ** 2]
    parameters = np.concatenate([[float(n)], widths, arrays["scale"], arrays["drive"], last])
    # A misfit that lasts for a time tells in each row what it told in the row before.
    repeated = max(params["error_time"] / float(arrays["dt"][0]), 1.0)
    reset = _FARTHEST / float(arrays["scale"][0])
    powers = np.concatenate([_FARTHEST ** np.arange(DEGREE + 1.0), np.ones(n)])
    drive = float(np.abs(arrays["drive"]) @ powers) + reset
    largest = {"reset": reset, "reset_motion": 2.0 * reset, "drive": drive, "stretch": drive}
    model = StateSpaceModel(
        transition=transition,
        measurement=measurement,
        process_noise=process_noise,
        measurement_noise=[[arrays["misfit"][0] ** 2 * repeated]],
        states=(*(f"friction_{i}" for i in range(n)), "stretch"),
        measurements=("drive",),
        inputs=("reset_motion", "reset"),
        parameters=parameters,
        possible={name: (-bound, bound) for name, bound in largest.items()},
    )
    return UnscentedFilter(model)


def friction_prior(elements: int) -> tuple[Array, Array]:
    """Mean (n + 1,) and covariance at first: unloaded, friction within half of what it can hold."""
    return np.zeros(elements + 1), np.diag([*([0.25] * elements), 4e-12])


LAYOUT: Final = at.filter_layout().declare(__package__, "filter")
LAST_RESET: Final = LAYOUT.at("reset")
unpack = LAYOUT.unpacker()


@compiled
def take_inputs(
    numbers: Integers, memory: Array, dt: float, x: Array, _out: Array, _half_width: Array
) -> None:
    """Measure the drive cable; the reset cable's motion and place act."""
    m = unpack(numbers, memory)
    f = unpack_filter(part_numbers(numbers, at.FILTER), part_memory(numbers, memory, at.FILTER))
    f.z[0] = x[0] * m.drive_factor
    f.u[0], f.u[1] = x[1] - m.reset if dt != 0.0 else 0.0, x[1]
    memory[LAST_RESET] = x[1]


@compiled
def tell(
    numbers: Integers, memory: Array, dt: float, x: Array, out: Array, half_width: Array
) -> None:
    """Tell the jaw's angle and load."""
    m = unpack(numbers, memory)
    f = unpack_filter(part_numbers(numbers, at.FILTER), part_memory(numbers, memory, at.FILTER))
    n, load, reset = m.elements, m.load, x[1]
    out[0] = response(reset * m.inverse_scale, f.x, n, m.angle)
    hidden = judge(dt, f.z[0], reset, f.x[n], f.covariance[n, n], m.cable, m.hold, load)
    load[1] *= m.beside_deviations
    if m.deviations > 0.0:
        variance = at.quadratic(m.angle[1 + DEGREE :], f.covariance, n) + m.misfit**2
        half_width[0] = m.deviations * sqrt(variance + hidden)
    if not abs(load[0]) <= m.cable[7]:
        half_width[0] = nan  # no load is as large: a sensor has slipped, or the cable is slack


def shapes(params: Params, _n_features: int, n_outputs: int) -> dict[str, Shape]:
    """Shapes of the learnt arrays."""
    count = 1 + DEGREE + len(params["widths"])
    learnt = {"angle": (count,), "drive": (count,), "scale": (1,), "misfit": (2,), "dt": (1,)}
    return only_joint("jaw_load", learnt, n_outputs)


def _pack(params: Params, arrays: Mapping[str, Array], _k: int, _n: int) -> Memory:
    elements, slider = len(params["widths"]), abs(float(arrays["angle"][1 + DEGREE :].sum()))
    names = ("drive_stiffness", "stiffness_growth", "jaw_radius", "spring_stiffness")
    cable = [params[name] for name in (*names, "stiffness_error")]
    return at.pack_filter(
        LAYOUT,
        take_inputs=take_inputs,
        tell=tell,
        elements=elements,
        drive_factor=params["wheel_radius"] / params["gear_ratio"],
        inverse_scale=arrays["scale"][0],
        misfit=arrays["misfit"][1],
        angle=arrays["angle"],
        beside_deviations=1.0,
        cable=[*cable, jaw_friction(params, arrays), slider, params["largest_load"]],
        filter=friction_filter(params, arrays).memory(*friction_prior(elements)),
    )


FAMILY: Final = at.filter_family(
    "jaw_load",
    rules={
        **dict.fromkeys(("stretch_drift", "friction_drift", "error_time"), POSITIVE),
        **dict.fromkeys(("drive_stiffness", "largest_load"), POSITIVE),
        "stiffness_growth": number(1e-3, 1e6),
        "stiffness_error": number(0.0, 1.0),
        **MECHANISM_RULES,
        "widths": numbers(16, 1e-9, 1.0, "lengths [m]"),
    },
    shapes=shapes,
    pack=_pack,
    inputs=lambda _params: (MOTOR, RESET),
    beside=lambda _params: {"load": ()},
    bears_load=lambda _params: True,
)

GATED_LAYOUT: Final = Layout().declare(__package__, "gated")
BELIEVED, RESET_PART, BOTH_PART = GATED_LAYOUT.places("believed reset both")
unpack_gated = GATED_LAYOUT.unpacker()

DOUBT: Final = 0.5
"""Share of what both sides differ by, and is believed, that may be a load's doing. It was chosen on
eighty virtual forceps of a mixed population; docs/results.md judges it on others."""

SIDES: Final[Mapping[str, int]] = {"reset": 1, "both": 2}
"""Number of features of each estimate, the last ones."""


@compiled
def gated_row(
    numbers: Integers, memory: Array, dt: float, x: Array, out: Array, half_width: Array
) -> None:
    """Predict by the reset cable, corrected by both sides as far as the two agree.

    Its deviation grows with what is believed of what the two differ by, as the reset cable is left
    alone, and, by as much as that one's friction makes it err, while it stands: a load may turn the
    jaw unseen.
    """
    m = unpack_gated(numbers, memory)
    bank, state = part_numbers(numbers, RESET_PART), part_memory(numbers, memory, RESET_PART)
    play_bank_row(bank, state, dt, vector(x, 1, 1), m.estimate, half_width)
    reset = m.estimate[0]
    bank, state = part_numbers(numbers, BOTH_PART), part_memory(numbers, memory, BOTH_PART)
    play_bank_row(bank, state, dt, x, m.estimate, half_width)
    difference = m.estimate[0] - reset
    believed = redescending(difference, m.gate)
    if stand(dt, x[0] * m.geared, m.motor_hold) >= 1.0 and dt != 0.0:
        believed = no_more(believed, m.believed)
    memory[BELIEVED] = believed
    out[0] = reset + believed
    standing = stand(dt, x[1], m.hold)
    if m.deviations > 0.0:
        doubted = 1.0 - believed / difference if believed != difference else 0.0
        alone = m.alone**2 * (doubted**2 + standing**2)
        half_width[0] = m.deviations * sqrt(m.misfit**2 + (DOUBT * believed) ** 2 + alone)


@compiled
def no_more(value: float, before: float) -> float:
    """`value` where it lies from 0 to what it was `before`, else the nearer of these two."""
    return min(max(value, min(before, 0.0)), max(before, 0.0))


@compiled
def redescending(difference: float, gate: float) -> float:
    """Hampel's function: the difference itself within the gate, falling to 0 at twice the gate."""
    size = abs(difference)
    if size <= gate:
        return difference
    if size >= 2.0 * gate:
        return 0.0
    return difference * (2.0 * gate - size) / size


def _gated_shapes(params: Params, _n_features: int, n_outputs: int) -> dict[str, Shape]:
    shapes: dict[str, Shape] = {"gate": (1,), "misfit": (2,)}
    for side, k in SIDES.items():
        learnt = plays.shapes(jaw_bank(tuple(params["plays"]), k), k, 1)
        shapes |= {f"{side}/{name}": shape for name, shape in learnt.items()}
    return only_joint("jaw_load.gated", shapes, n_outputs)


def _pack_gated(params: Params, arrays: Mapping[str, Array], _k: int, _n: int) -> Memory:
    def part(side: str, k: int) -> Memory:
        learnt = {n.removeprefix(f"{side}/"): a for n, a in arrays.items() if n.startswith(side)}
        return plays.pack(jaw_bank(tuple(params["plays"]), k), learnt, k, 1)

    motor, reset = arrays["both/inverse_half_range"]
    return GATED_LAYOUT.pack(
        gate=arrays["gate"][0],
        misfit=arrays["misfit"][0],
        alone=arrays["misfit"][1],
        geared=motor / reset if reset > 0.0 else 0.0,
        **{side: part(side, k) for side, k in SIDES.items()},
    )


GATED: Final = Family(
    "jaw_load.gated",
    rules={
        **dict.fromkeys(("gate", "smallest_gate"), POSITIVE),
        "plays": plays.FAMILY.rules["plays"],
    },
    shapes=_gated_shapes,
    pack=_pack_gated,
    row=gated_row,
    remembers=True,
    inputs=lambda _params: (MOTOR, RESET),
    targets=("position", "error"),
    bears_load=lambda _params: True,
    states_deviation=lambda _params: True,
)
