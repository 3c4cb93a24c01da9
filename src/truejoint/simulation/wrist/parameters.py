"""Parameters of an instrument's cables, and the arrays that its compiled dynamics read."""

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, Final, Literal, NamedTuple

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.robots.blocks import SETPOINT_DT
from truejoint.robots.cable_mechanism import CableMechanism, Node
from truejoint.schema import Bounds
from truejoint.simulation.friction import ContactLaw
from truejoint.simulation.parameter_file import Parameters


class Cables(NamedTuple):
    """Every cable: stiffness [N/m], pretension [N], friction at its nodes, shares of compliance."""

    stiffness: Annotated[float, Bounds(1e3, 1e6)]
    pretension: Annotated[float, Bounds(0.1, 100.0)]
    guide_friction: Annotated[float, Bounds(0.0, 1.0)]
    wrist_friction: Annotated[float, Bounds(0.0, 0.5)]
    shaft_compliance: Annotated[float, Bounds(0.01, 100.0)]


class Variation(NamedTuple):
    """How far single cables and pulleys stray: shares, eccentricity in m; drawn with `seed`."""

    seed: Annotated[int, Bounds(0, 2**31 - 1)]
    stiffness: Annotated[float, Bounds(0.0, 0.3)]
    moment: Annotated[float, Bounds(0.0, 0.1)]
    capstan: Annotated[float, Bounds(0.0, 0.1)]
    eccentricity: Annotated[float, Bounds(0.0, 5e-4)]


class JointFriction(NamedTuple):
    """Friction of the pins; `tension_share` is of radius and tensions, `constant` of their own."""

    law: Literal["dahl", "maxwell_slip"]
    tension_share: Annotated[float, Bounds(0.0, 1.0)]
    constant: Annotated[float, Bounds(0.0, 20.0)]
    presliding: Annotated[float, Bounds(5e-4, 0.05)]
    viscous: Annotated[float, Bounds(0.0, 1e-2)]


class Stops(NamedTuple):
    """Stops of every joint, `beyond` its limit [rad]: stiffness [Nm/rad], damping [Nm s/rad]."""

    beyond: Annotated[float, Bounds(0.0, 1.0)]
    stiffness: Annotated[float, Bounds(0.1, 1e3)]
    damping: Annotated[float, Bounds(0.0, 1e-2)]


class Motor(NamedTuple):
    """Every motor: position loop [Hz], friction [Nm, Nm s/rad], presliding [rad]."""

    bandwidth: Annotated[float, Bounds(1.0, 200.0)]
    damping_ratio: Annotated[float, Bounds(0.2, 3.0)]
    coulomb: Annotated[float, Bounds(0.0, 1.0)]
    viscous: Annotated[float, Bounds(0.0, 1.0)]
    presliding: Annotated[float, Bounds(1e-5, 0.1)]

    @property
    def lag(self) -> float:
        """Time by which a motor follows a set-point that moves evenly [s]."""
        return self.damping_ratio / (math.pi * self.bandwidth)


class Sensors(NamedTuple):
    """Noise [rad, Nm] of what is read; the deviation of an effort's gain is a share."""

    motor_noise: Annotated[float, Bounds(0.0, 0.1)]
    effort_noise: Annotated[float, Bounds(0.0, 1.0)]
    effort_gain: Annotated[float, Bounds(0.0, 0.5)]
    reference_noise: Annotated[float, Bounds(0.0, 0.1)]


class Homing(NamedTuple):
    """Standard deviations [rad] of the motors' zeros: as assembled, and at every homing."""

    assembly: Annotated[float, Bounds(0.0, 0.5)]
    registration: Annotated[float, Bounds(0.0, 0.5)]


@dataclass(frozen=True)
class WristParameters(Parameters):
    """Cables, friction and sensors of an instrument; an attribute for each section."""

    SPECIMENS: ClassVar[tuple[str, ...]] = "nominal", "cable_only", "endowrist"

    cables: Cables
    variation: Variation
    joint_friction: JointFriction
    stops: Stops
    motor: Motor
    sensors: Sensors
    homing: Homing


SUBSTEPS: Final = 4  # of the integrator in a set-point's period: 4 kHz


class PlantConstants(NamedTuple):
    """C cables of N nodes at most, J joints, M motors."""

    dt: float  # [s] of a step
    motor_of: Integers  # (C,), -1 where a cable ends at a spring
    capstan: Array  # (C,) [m] that a cable gets per radian of its motor, with its sign
    n_moved: Integers  # (C,) joints that a cable turns, which the next four list first
    moved: Integers  # (C, J)
    moments: Array  # (C, J) [m/rad]
    sine: Array  # (C, J) [m] of an eccentric pulley's part in sin of a joint
    cosine: Array  # (C, J) [m] and in cos - 1
    n_nodes: Integers  # (C,)
    stiffness: Array  # (C, N + 1) [N/m] of the segments
    slack: Array  # (C, N + 1) [m] of stretch at pretension
    ratio: Array  # (C, N) of the tensions before and behind, at the zeros
    wrap_joint: Integers  # (C, N), -1 where no joint changes it
    wrap_slope: Array  # (C, N) mu, with the sign in which the joint adds to it
    inertia: Array  # (J,) [kg m2]
    damping: Array  # (J,) [Nm s/rad]
    friction: Array  # (J,) [Nm] constant
    per_tension: Array  # (J,) [m] friction per tension on the pin
    presliding: float  # [rad]
    is_maxwell_slip: bool
    law: ContactLaw
    opening: Array  # (J,) of the jaws, per joint; zeros where nothing meets
    contact: Array  # (2,) stiffness [Nm/rad], damping [Nm s/rad]
    lowest: Array  # (J,) [rad] where a joint meets its stops,
    highest: Array  # (J,)
    stop: Array  # (2,) which have this stiffness [Nm/rad] and damping [Nm s/rad]
    n_motors: int
    motor_step: Array  # (2, 2): how far angle and speed are off, a step later
    motor_lag: float  # [s] by which a motor follows a ramp
    motor: Motor  # friction of every motor


class Drawn(NamedTuple):
    """Parts and sensors of one instrument, in the order of the draws."""

    groove: Array  # (C, J) moments as shares of the nominal ones
    capstan: Array  # (M,) radii alike
    eccentricity: Array  # (C, J) [m]
    phase: Array  # (C, J) [rad] of these
    stiffness: Array  # (C,) [N/m] of whole cables
    effort_gain: Array  # (M,)
    motor_zero: Array  # (M,) [rad]


def plant_constants(
    p: WristParameters,
    mechanism: CableMechanism,
    limits: tuple[Array, Array],
    substeps: int = SUBSTEPS,
) -> tuple[PlantConstants, Drawn]:
    """Constants of one instrument, its single parts drawn with ``variation.seed``.

    Its joints meet stops beyond `limits`, lower and upper (n_joints,) [rad], if these are finite.
    """
    from scipy.linalg import expm  # noqa: PLC0415  # takes longer to import than the rest

    cables, motors = mechanism.cables, tuple(mechanism.motors)
    drawn, (lower, upper) = _drawn(p, mechanism), limits
    side = np.sign(mechanism.moments)
    moved = np.argsort(side == 0.0, axis=1, kind="stable")
    stiffness = _stiffness(p, mechanism, drawn.stiffness)
    wrap_joint, wrap, slope = _wraps(p, mechanism)
    eccentric = side * drawn.eccentricity
    pins = list(mechanism.pins.values())
    radii = mechanism.radii * drawn.capstan
    motor_of = np.array([motors.index(c.motor) if c.motor else -1 for c in cables])
    met = mechanism.contact
    dt, f = SETPOINT_DT / substeps, p.joint_friction
    w, z = 2.0 * math.pi * p.motor.bandwidth, p.motor.damping_ratio
    constants = PlantConstants(
        dt=dt,
        motor_of=motor_of,
        capstan=np.where(motor_of >= 0, np.array([c.sign for c in cables]) * radii[motor_of], 0.0),
        n_moved=np.count_nonzero(side, axis=1),
        moved=moved,
        moments=np.take_along_axis(mechanism.moments * drawn.groove, moved, 1),
        sine=np.take_along_axis(eccentric * np.cos(drawn.phase), moved, 1),
        cosine=np.take_along_axis(eccentric * np.sin(drawn.phase), moved, 1),
        n_nodes=np.array([len(cable.nodes) for cable in cables]),
        stiffness=stiffness,
        slack=p.cables.pretension / stiffness,
        ratio=np.exp(wrap),
        wrap_joint=wrap_joint,
        wrap_slope=slope,
        inertia=np.array([pin.inertia for pin in pins]),
        damping=np.full(len(pins), f.viscous),
        friction=f.constant * np.array([pin.friction for pin in pins]),
        per_tension=f.tension_share * np.array([pin.radius for pin in pins]),
        presliding=f.presliding,
        is_maxwell_slip=f.law == "maxwell_slip",
        law=ContactLaw(0.0, f.presliding, 1.0, 1.0, 0.0),
        opening=np.zeros(len(pins)) if met is None else mechanism.row(met.opening),
        lowest=lower - p.stops.beyond,
        highest=upper + p.stops.beyond,
        stop=np.array([p.stops.stiffness, p.stops.damping]),
        contact=np.zeros(2) if met is None else np.array([met.stiffness, met.damping]),
        n_motors=len(motors),
        # Over `dt` of e'' = -w**2 e - 2 z w e', exact.
        motor_step=np.ascontiguousarray(expm(np.array([[0.0, 1.0], [-w * w, -2.0 * z * w]]) * dt)),
        motor_lag=p.motor.lag,
        motor=p.motor,
    )
    return constants, drawn


def _drawn(p: WristParameters, mechanism: CableMechanism) -> Drawn:
    """Draw an instrument's parts and sensors with ``variation.seed``."""
    v, rng = p.variation, np.random.default_rng(p.variation.seed)
    cables, motors = mechanism.cables, tuple(mechanism.motors)
    n_cables, n_motors = len(cables), len(motors)
    # The two cables of a loop lie in the same grooves, so that their radii are one draw a motor.
    loop = np.array([motors.index(c.motor) if c.motor else n_motors + n
                     for n, c in enumerate(cables)])  # fmt: skip
    shape = int(loop.max()) + 1, len(mechanism.joint_names)
    groove = 1.0 + v.moment * rng.standard_normal(shape)
    capstan = 1.0 + v.capstan * rng.standard_normal(n_motors)
    size = v.eccentricity * np.abs(rng.standard_normal(shape))
    phase = rng.uniform(-math.pi, math.pi, shape)
    # What is drawn between gains and zeros is of no sensor any more: a seed's instrument stays.
    sizes = n_cables, n_motors, 2 * n_cables, n_motors
    stiffness, gain, _, zero = (rng.standard_normal(size) for size in sizes)
    return Drawn(
        groove[loop], capstan, size[loop], phase[loop],
        p.cables.stiffness * (1.0 + v.stiffness * stiffness),
        p.sensors.effort_gain * gain,
        p.homing.assembly * zero,
    )  # fmt: skip


def _stiffness(p: WristParameters, mechanism: CableMechanism, whole: Array) -> Array:
    """Stiffness (C, N + 1) [N/m] of segments, of cables that have `whole` (C,) [N/m]; ones else."""
    cables = mechanism.cables
    stiffness = np.ones((len(cables), 1 + max(len(cable.nodes) for cable in cables)))
    for c, cable in enumerate(cables):
        shares = np.array(cable.segments)
        shares[1:-1] *= p.cables.shaft_compliance
        compliance = shares / (shares.sum() * whole[c])
        if cable.spring:
            compliance[0] += 1.0 / cable.spring
        stiffness[c, : len(compliance)] = 1.0 / compliance
    return stiffness


def _wraps(p: WristParameters, mechanism: CableMechanism) -> tuple[Integers, Array, Array]:
    """Joint at each node of each cable (C, N), -1 for none, its mu times wrap, and mu as signed."""
    n_nodes = max(len(cable.nodes) for cable in mechanism.cables)
    missing = Node(0.0)
    nodes = [[*c.nodes, *[missing] * (n_nodes - len(c.nodes))] for c in mechanism.cables]
    joints = ("", *mechanism.joint_names)
    joint_of = np.array([[joints.index(n.joint) - 1 for n in row] for row in nodes], np.int64)
    is_turned = joint_of >= 0
    mu = np.where(is_turned, p.cables.wrist_friction, p.cables.guide_friction)
    side = np.take_along_axis(np.sign(mechanism.moments), joint_of, 1)
    wrap = mu * np.array([[node.wrap for node in row] for row in nodes], np.float64)
    return joint_of, wrap, np.where(is_turned, -mu * side, 0.0)
