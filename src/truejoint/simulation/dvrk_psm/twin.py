"""`DvrkPsmTwin`: a virtual PSM with an instrument, its parameters and its hardware."""

from collections.abc import Generator
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Final, NamedTuple

import numpy as np

from truejoint.array_types import Array
from truejoint.schema import Bounds
from truejoint.simulation.arm.parameters import ArmParameters, Numbers
from truejoint.simulation.arm.plant import Hardware, gravity_potential
from truejoint.simulation.arm.twin import ArmTwin
from truejoint.simulation.twin import TwinOutput, glide, hold
from truejoint.units import GRAVITY

_RETURN: Final = 2.5  # [s] from where the arm was left to its home pose
_PITCH, _YAW = 4, 5  # of the wrist
_BOWS: Final = 2.0  # periods of a potentiometer's linearity error along its joint's range


class Drive(NamedTuple):
    """What the arm's own software knows: motors, gears, encoders, gains at the joints."""

    ratio: Annotated[Numbers, Bounds(1.0, 1e4)]
    counts: Annotated[Numbers, Bounds(10.0, 1e7)]
    p_gain: Annotated[Numbers, Bounds(0.0, 1e5)]
    d_gain: Annotated[Numbers, Bounds(0.0, 1e4)]
    max_torque: Annotated[Numbers, Bounds(1e-3, 10.0)]
    torque_step: Annotated[Numbers, Bounds(1e-9, 1e-2)]


class Pulleys(NamedTuple):
    """Real against nominal transmission: scale, run-out, and the wrist's coupling."""

    scale: Annotated[Numbers, Bounds(-0.2, 0.2)]
    radius: Annotated[Numbers, Bounds(1e-3, 1.0)]
    run_out: Annotated[Numbers, Bounds(0.0, 1e-3)]
    phase: Annotated[Numbers, Bounds(-7.0, 7.0)]
    yaw_per_pitch: Annotated[float, Bounds(-2.0, 2.0)]
    yaw_per_pitch_error: Annotated[float, Bounds(-0.5, 0.5)]


class Mass(NamedTuple):
    """Mass [kg] that the arm's counterweights leave."""

    carriage: Annotated[float, Bounds(0.0, 2.0)]


class Potentiometers(NamedTuple):
    """How the potentiometers at the motors err; the encoders are preloaded from them."""

    offset: Annotated[Numbers, Bounds(-0.5, 0.5)]
    scale: Annotated[Numbers, Bounds(-0.1, 0.1)]
    linearity: Annotated[Numbers, Bounds(0.0, 0.1)]
    noise: Annotated[Numbers, Bounds(0.0, 0.1)]


class Reference(NamedTuple):
    """Resolution of the temporary joint encoders."""

    resolution: Annotated[Numbers, Bounds(1e-9, 1e-2)]


@dataclass(frozen=True)
class DvrkPsmParameters(ArmParameters):
    """Everything that makes the twin of a PSM err; one attribute per section."""

    SPECIMENS: ClassVar[tuple[str, ...]] = ("nominal",)
    ON_CABLES: ClassVar[int] = 6
    OF_ALL: ClassVar[tuple[str, ...]] = ("drive", "potentiometers")

    drive: Drive
    pulleys: Pulleys
    mass: Mass
    potentiometers: Potentiometers
    reference: Reference


class DvrkPsmTwin(ArmTwin):
    """Digital twin of a PSM of the da Vinci Research Kit with a needle driver.

    The two motors that share the wrist's yaw and the jaw are simulated as their mean and half their
    difference.
    """

    ROBOT: ClassVar[str] = "dvrk_psm"
    PARAMETERS: ClassVar[type[DvrkPsmParameters]] = DvrkPsmParameters
    MAX_LOAD: ClassVar[float] = 0.5  # kg; the insertion's motor gives up a little above
    REPORTS_MOTORS: ClassVar[bool] = False

    parameters: DvrkPsmParameters

    def _build(self) -> None:
        super()._build()
        self._pot_rng = np.random.default_rng([self.seed, 3])
        self._streams = (*self._streams, self._pot_rng)

    def homing(self) -> Generator[TwinOutput]:
        """Preload the motor encoders from the potentiometers, and go to the home pose.

        A PSM looks for no stops: its potentiometers are absolute. What they are off by where the
        arm was left, all positions are off by until the next homing.
        """
        read = self._potentiometers(self._plant.joint_from_motor @ self._state.motor, self._rng)
        self._register(read)
        self._state.command[:] = self._plant.motor_from_joint @ read
        home = self.robot.home
        yield from self._go(glide(read, home, _RETURN), hold(home, 1.0))

    def _potentiometers(self, position: Array, rng: np.random.Generator) -> Array:
        """Read the potentiometers, shape of `position` (..., 7) that the motors are at."""
        pots, lower, upper = self.parameters.potentiometers, self.robot.lower, self.robot.upper
        bow = np.sin(2.0 * np.pi * _BOWS * (position - lower) / (upper - lower))
        noise = np.array(pots.noise) * rng.standard_normal(position.shape)
        read: Array = position * (1.0 + np.array(pots.scale)) + pots.offset + noise
        return read + pots.linearity * bow

    def _follow(self, goal: Array) -> TwinOutput:
        """Report efforts that act on the joints, and potentiometers, in the joints' positions.

        The cables of the yaw pull at the pitch.
        """
        output = super()._follow(goal)
        effort = output.effort.copy()
        effort[:, _PITCH] += self.parameters.pulleys.yaw_per_pitch * effort[:, _YAW]
        zero = self._plant.joint_from_motor @ self._state.encoder_zero
        read = self._potentiometers(output.measured + zero, self._pot_rng)
        names = [f"pot/{joint}" for joint in self.robot.joint_names]
        return replace(output, effort=effort, extra=dict(zip(names, read.T, strict=True)))

    def _hardware(self) -> Hardware:
        p, robot, n = self.parameters, self.robot, self.parameters.ON_CABLES
        ratio, none = np.array(p.drive.ratio), np.zeros(n)
        cable = np.eye(7)
        cable[_YAW, _PITCH] = p.pulleys.yaw_per_pitch
        coupling_error = np.zeros((n, n))
        coupling_error[_YAW, _PITCH] = p.pulleys.yaw_per_pitch_error
        margin = 0.05 * (robot.upper - robot.lower)
        stops = np.column_stack([robot.lower - margin, robot.upper + margin])[:n]
        gains = np.column_stack([p.drive.p_gain, p.drive.d_gain, np.zeros(7)])
        return Hardware(
            matrix=ratio[:, None] * cable,
            ratio=ratio,
            gear=ratio,  # so that efforts are those at the joints
            radius=np.array(p.pulleys.radius),
            gains=gains / ratio[:, None],
            effort_limit=np.array(p.drive.max_torque) * ratio,
            effort_step=np.array(p.drive.torque_step) * ratio,
            counts=np.array(p.drive.counts),
            coupling_error=coupling_error,
            scale=np.array(p.pulleys.scale),
            anchor=(none, none),
            stops=stops,
            run_out=((np.array(p.pulleys.run_out), np.array(p.pulleys.phase)), (none, none)),
            sideways=np.zeros((n, n)),
            aligned=none,
            free_run=np.ones(n),
            gravity=gravity_potential(
                robot, np.array([0.0, 0.0, p.mass.carriage]), np.zeros((3, 3)), (0.0, 0.0, -GRAVITY)
            ),
            truth_step=np.array(p.reference.resolution),
        )
