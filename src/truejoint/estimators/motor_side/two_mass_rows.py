"""Joints of two masses, motor and link, with a cable between: what their filters are made of.

Everything is in units of the calibration: positions from the middle of a joint's range in half
ranges, efforts in their standard deviations, positive where they drive the position up.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import nan
from typing import Final, Self

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled, matrix, unrolled, vector
from truejoint.errors import CalibrationError
from truejoint.estimators.family import Family, Params, Rule, Shape
from truejoint.estimators.filtered import advance
from truejoint.filters import StateSpaceModel, UnscentedFilter
from truejoint.filters import fields as at
from truejoint.filters.kernels import restart
from truejoint.layout import PART_SIZE, Layout, Memory, part_memory, part_numbers

MAX_JOINTS: Final = 8
STATES: Final = ("motor", "motor_velocity", "link", "link_velocity", "load")
PARAMETERS: Final = (
    "motor_inertia", "link_inertia",  # [effort s^2 / half range]
    "stiffness", "damping",  # of the cable [effort / half range], [effort s / half range]
    "motor_coulomb", "motor_viscous", "link_coulomb", "link_viscous",  # [effort], [effort s / ...]
    "effort_density", "load_density",  # of the effort's noise [s]; of the load's drift [1/s]
    "slow",  # velocity below which Coulomb friction holds rather than slides [half ranges / s]
)  # fmt: skip
"""Numbers of a joint, all above 0, in the order of the model file."""

_LARGEST: Final = 1e12
_FARTHEST: Final = 3.0
"""Half ranges from the middle, beyond which no motor is: further out by its whole range."""
_STRONGEST: Final = 100.0
"""Standard deviations of the effort beyond which none is."""
_OWN: Final = 1e-2
"""Share of a noise's variance that no other state has part in; without, rounding to single
precision makes no covariance of noise from one source."""
_RESOLUTION: Final = 1e-3  # standard deviation of the motor's position [half ranges]

_MOTOR_INERTIA, _LINK_INERTIA, _STIFFNESS, _DAMPING = 0, 1, 2, 3
_MOTOR_COULOMB, _MOTOR_VISCOUS, _LINK_COULOMB, _LINK_VISCOUS = 4, 5, 6, 7
_EFFORT_DENSITY, _LOAD_DENSITY, _SLOW = 8, 9, 10
N_STATES: Final = len(STATES)
LINK: Final = STATES.index("link")
_LOAD: Final = STATES.index("load")


@compiled
def motor_resistance(x: Array, dt: float, p: Array) -> float:
    """Effort that a change of the motor's velocity takes, beside the cable's.

    Coulomb friction sinks to 0 below a slow velocity.
    """
    sliding = p[_MOTOR_COULOMB] / (abs(x[1]) + p[_SLOW])
    return float(p[_MOTOR_INERTIA] / dt + sliding + p[_MOTOR_VISCOUS])


@compiled
def link_resistance(x: Array, dt: float, p: Array) -> float:
    """Effort that a change of the link's velocity takes, beside the cable's."""
    sliding = p[_LINK_COULOMB] / (abs(x[3]) + p[_SLOW])
    return float(p[_LINK_INERTIA] / dt + sliding + p[_LINK_VISCOUS])


@compiled
def transition(x: Array, u: Array, dt: float, parameters: Array, out: Array) -> None:
    """Move motor and link by an implicit step of Euler, stable however stiff the cable.

    ``J_m a_m = u - friction(v_m) - T`` and ``J_l a_l = T - friction(v_l) - load`` where the cable
    carries ``T = k (q_m - q_l) + b (v_m - v_l)``; the load stays.
    """
    cable = parameters[_DAMPING] + parameters[_STIFFNESS] * dt
    motor = motor_resistance(x, dt, parameters)
    link = link_resistance(x, dt, parameters)
    tension = parameters[_STIFFNESS] * (x[0] - x[2])
    driving = parameters[_MOTOR_INERTIA] / dt * x[1] + u[0] - tension
    driven = parameters[_LINK_INERTIA] / dt * x[3] + tension - x[4]
    share = 1.0 / (motor * link + cable * (motor + link))
    out[1] = share * (link * driving + cable * (driving + driven))
    out[3] = share * (motor * driven + cable * (driving + driven))
    out[0] = x[0] + dt * out[1]
    out[2] = x[2] + dt * out[3]
    out[4] = x[4]


@compiled
def process_noise(x: Array, _u: Array, dt: float, parameters: Array, out: Array) -> None:
    """Covariance of what white noise of the effort moves over `dt`, and of the load's drift."""
    cable = parameters[_DAMPING] + parameters[_STIFFNESS] * dt
    motor = motor_resistance(x, dt, parameters)
    link = link_resistance(x, dt, parameters)
    share = 1.0 / (motor * link + cable * (motor + link))
    variance = parameters[_EFFORT_DENSITY] / dt
    for i in range(4):
        for j in range(4):
            moved = share * (link + cable if i < 2 else cable) * (dt if i % 2 == 0 else 1.0)
            other = share * (link + cable if j < 2 else cable) * (dt if j % 2 == 0 else 1.0)
            out[i, j] = variance * moved * other
        out[i, i] *= 1.0 + _OWN
    out[4, 4] = parameters[_LOAD_DENSITY] * dt


@compiled
def measurement(x: Array, _u: Array, _parameters: Array, out: Array) -> None:
    """Position of the motor."""
    out[0] = x[0]


@dataclass(frozen=True, eq=False)
class TwoMassJoint:
    """Identified joint, in units of the calibration."""

    parameters: Array  # (len(PARAMETERS),)
    mean_effort: float  # what the load is expected to be at first
    velocity: float  # root mean square of the motor's [half ranges / s]

    @classmethod
    def of_row(cls, row: Array) -> Self:
        """Joint of a row of a fitted filter's ``dynamics``; CalibrationError if it makes none."""
        positive = np.delete(row, len(PARAMETERS))
        good = ((positive >= 1.0 / _LARGEST) & (positive <= _LARGEST)).all()
        if not good or abs(row[-2]) > _STRONGEST:
            raise CalibrationError(
                f"two_mass: an inertia, stiffness, friction or noise is not from {1 / _LARGEST:g} "
                f"to {_LARGEST:g}, or the mean effort above {_STRONGEST:g}; fit it again"
            )
        return cls(row[: len(PARAMETERS)], float(row[-2]), float(row[-1]))

    def row(self) -> Array:
        """Numbers of the joint, as `of_row` takes them."""
        return np.append(self.parameters, [self.mean_effort, self.velocity])

    def unscented(self) -> UnscentedFilter:
        """Build the filter of the joint."""
        effort = (-_STRONGEST, _STRONGEST)
        return UnscentedFilter(
            StateSpaceModel(
                transition=transition,
                measurement=measurement,
                process_noise=process_noise,
                measurement_noise=[[_RESOLUTION**2]],
                states=STATES,
                measurements=("position",),
                inputs=("effort",),
                parameters=self.parameters,
                possible={
                    "position": (-_FARTHEST, _FARTHEST),
                    "effort": effort,
                    "load": effort,
                    "link": (-2.0 * _FARTHEST, 2.0 * _FARTHEST),
                },
            ),
            square_root=True,  # in single precision too
        )

    def prior(self) -> tuple[Array, Array]:
        """Mean (5,) and covariance before the first row, of positions beside the motor's own.

        The cable carries a load and, either way, as much friction.
        """
        stretch = 1.0 / float(self.parameters[_STIFFNESS])
        mean = np.array([0.0, 0.0, -stretch * self.mean_effort, 0.0, self.mean_effort])
        near, speed = _RESOLUTION**2, self.velocity**2
        covariance = np.diag([near, speed, near + 2.0 * stretch**2, speed, 1.0])
        covariance[0, LINK] = covariance[LINK, 0] = near
        covariance[_LOAD, LINK] = covariance[LINK, _LOAD] = -stretch
        return mean, covariance

    def memory(self) -> Memory:
        """Lay out the row that tells the link's position of this joint alone, in its units."""
        one = np.ones(1)
        arrays = {"inverse_half_range": one, "effort_share": one, "coef": np.ones((1, 1))}
        arrays |= {"middle": np.zeros(1), "intercept": np.zeros(1)}
        return _pack({}, {**arrays, "dynamics": self.row()[None]}, 2, 1)


LAYOUT: Final = Layout()
N_JOINTS: Final = LAYOUT.integer("n_joints", "with a filter each")
LOST: Final = LAYOUT.scalar("lost", "1 where the row before had no estimate: start anew")
MIDDLE: Final = LAYOUT.array("middle", "of each motor's range [rad or m]")
INVERSE: Final = LAYOUT.array("inverse_half_range", "of each motor [1/rad or 1/m]")
EFFORT_SHARE: Final = LAYOUT.array("effort_share", "inverse standard deviation of each effort")
POSITION: Final = LAYOUT.array("position", "of each link, in half ranges")
COEF: Final = LAYOUT.array("coef", "of each output, of the links' positions")
INTERCEPT: Final = LAYOUT.array("intercept", "of each output [rad or m]")
FILTER: Final = LAYOUT.part("filter_0", "of a joint's motor and link")
for _i in range(1, MAX_JOINTS):
    LAYOUT.part(f"filter_{_i}", "of a joint's motor and link")


@compiled
def two_mass_row(
    numbers: Integers, memory: Array, dt: float, x: Array, out: Array, half_width: Array
) -> None:
    """Predict by the links' positions, of a filter for each joint."""
    n = numbers[N_JOINTS]
    middle, inverse = vector(memory, numbers[MIDDLE], n), vector(memory, numbers[INVERSE], n)
    share, position = vector(memory, numbers[EFFORT_SHARE], n), vector(memory, numbers[POSITION], n)
    anew = dt == 0.0 or memory[LOST] != 0.0
    memory[LOST] = 0.0
    for i in range(unrolled(numbers[N_JOINTS])):
        own = part_numbers(numbers, FILTER + PART_SIZE * i)
        state = part_memory(numbers, memory, FILTER + PART_SIZE * i)
        motor = (x[i] - middle[i]) * inverse[i]
        estimate = vector(state, own[at.X], N_STATES)
        if anew:
            restart(own, state)
            estimate[0] += motor
            estimate[LINK] += motor
        vector(state, own[at.Z], 1)[0] = motor
        vector(state, own[at.U], 1)[0] = x[n + i] * share[i]
        if not advance(own, state, 0.0 if anew else dt):
            memory[LOST] = 1.0
        position[i] = estimate[LINK]
    coef = matrix(memory, numbers[COEF], out.shape[0], n)
    for j in range(out.shape[0]):
        total = memory[numbers[INTERCEPT] + j]
        for i in range(n):
            total += coef[j, i] * position[i]
        out[j] = nan if memory[LOST] != 0.0 else total


def inputs(params: Params) -> tuple[str, ...]:
    """Features: the measured positions of the joints, then their efforts."""
    return tuple(f"{kind}/{joint}" for kind in ("measured", "effort") for joint in params["joints"])


def _are_joints(value: object) -> bool:
    return (
        isinstance(value, (tuple, list))
        and 1 <= len(value) <= MAX_JOINTS
        and all(isinstance(joint, str) and joint.isidentifier() for joint in value)
        and len(set(value)) == len(value)
    )


def _shapes(params: Params, _n_features: int, n_outputs: int) -> dict[str, Shape]:
    n = len(params["joints"])
    return {
        "middle": (n,),
        "inverse_half_range": (n,),
        "effort_share": (n,),
        "dynamics": (n, len(PARAMETERS) + 2),
        "coef": (n_outputs, n),
        "intercept": (n_outputs,),
    }


def _pack(_params: Params, arrays: Mapping[str, Array], _k: int, _n: int) -> Memory:
    own = dict(arrays)
    joints = [TwoMassJoint.of_row(row) for row in own.pop("dynamics")]
    parts = {f"filter_{i}": Layout().pack() for i in range(MAX_JOINTS)}
    for i, joint in enumerate(joints):
        parts[f"filter_{i}"] = joint.unscented().memory(*joint.prior())
    return LAYOUT.pack(n_joints=len(joints), position=np.zeros(len(joints)), **own, **parts)


FAMILY: Final = Family(
    "two_mass",
    rules={
        "joints": Rule(_are_joints, f"1 to {MAX_JOINTS} different names of joints"),
    },
    shapes=_shapes,
    pack=_pack,
    row=two_mass_row,
    remembers=True,
    inputs=inputs,
    targets=("position",),
)
