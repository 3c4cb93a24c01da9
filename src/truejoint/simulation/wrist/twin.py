"""The virtual wrist: joint angles wanted in, what its sensors and an oracle would show out."""

import math
from collections.abc import Callable, Generator
from typing import ClassVar, Final

import numpy as np

from truejoint.array_types import Array
from truejoint.errors import RobotError
from truejoint.robots.blocks import SETPOINT_DT, TruthBlock
from truejoint.simulation.parameter_file import random_streams
from truejoint.simulation.twin import Twin, TwinOutput, glide_at, hold, shaped
from truejoint.simulation.wrist.parameters import SUBSTEPS, WristParameters, plant_constants
from truejoint.simulation.wrist.plant import advance, at_rest, empty_log, new_work
from truejoint.units import GRAVITY

_SETTLING: Final = 0.5  # [s] at rest
_HOMING_SPEED: Final = math.radians(30.0)  # [rad/s]
_BEYOND: Final = 0.2  # [rad] that a set-point may lie beyond a limit, where a loop asks for it


class WristTwin(Twin):
    """Digital twin of an instrument's wrist, or of any robot that states its cables.

    A `truejoint.simulation.Twin`. What it measures are motors and their efforts; the measured
    joints are those of cables that give nowhere. What only a simulation knows is in `extra`:
    ``truth_exact/<joint>``, ``truth_load/grip`` and ``truth_load/<arm>``, torques [Nm]. Joints end
    at stops, a little beyond their limits.

    The load hangs on the tip and pulls the first arm's joints down. `tip_force` may give forces
    (n, n_arms) [N], one column for each of the mechanism's arms, and `held` the opening [rad] (n,)
    of what is between the jaws, both at times (n,) [s] of the twin; without `held` the jaws meet
    each other. The seed is that of sensors and homing; single parts are drawn with
    ``variation.seed``.

    Raises RobotError if the robot states no cables, or a load has no arm to pull at.
    """

    ROBOT: ClassVar[str] = "wrist"
    PARAMETERS: ClassVar[type[WristParameters]] = WristParameters
    MAX_LOAD: ClassVar[float] = 0.3  # cables go slack above
    _NOTED: ClassVar[tuple[str, ...]] = (
        "_state", "_work", "_ticks", "_command", "_goal", "_reading",
    )  # fmt: skip

    parameters: WristParameters

    def _build(self) -> None:
        mechanism, transmission = self.robot.mechanism, self.robot.transmission
        if mechanism is None or transmission is None:
            raise RobotError(f"{self.robot.title} states no cables; add [mechanism]")
        self._transmission = transmission
        self._arms = {name: mechanism.row(arm) for name, arm in mechanism.arms.items()}
        self._meets = mechanism.contact is not None
        self.tip_force: Callable[[Array], Array] | None = None
        self.held: Callable[[Array], Array] | None = None
        limits = self.robot.lower, self.robot.upper
        self._reach = limits[0] - _BEYOND, limits[1] + _BEYOND
        self._constants, self._drawn = plant_constants(self.parameters, mechanism, limits)
        self._state, self._work = at_rest(self._constants), new_work(self._constants)
        # A stream each, so that changing one sensor leaves the others alone; the third is spare.
        self._streams = random_streams(4, self.seed)
        self._noise = dict(zip(("motor", "effort", "", "truth"), self._streams, strict=True))
        self._zero = self._registered()
        self._command = np.zeros(len(self.robot.joints))
        self._goal = self._zero.copy()  # of the motors, where they stand
        self._state.motor[:] = self._goal
        self._reading = np.zeros(self._constants.n_motors)

    def _checked_load(self, mass: float) -> float:
        if super()._checked_load(mass) and not self._arms:
            raise RobotError(
                f"{self.robot.title} states no arm that a load pulls at; add [mechanism.arms]"
            )
        return float(mass)

    @property
    def commanded(self) -> Array:
        """Joint angles (n_joints,) [rad] of the latest set-point."""
        return self._command

    def homing(self) -> Generator[TwinOutput]:
        """Go to the zeros, engage the instrument there anew, and go to the home pose.

        Each engagement leaves other zeros of the motors (``homing.registration``).
        """
        zero, home = np.zeros_like(self._command), self.robot.home
        way = glide_at(_HOMING_SPEED, self._command, zero)
        yield from self._go(way, hold(zero, _SETTLING))
        self.homing_count += 1
        before, self._zero = self._zero, self._registered()
        # The motors stand still while their zeros change.
        self._reading = self._reading + before - self._zero
        yield from self._go(glide_at(_HOMING_SPEED, zero, home), hold(home, _SETTLING))

    def _follow(self, joints: Array) -> TwinOutput:
        t = self._times(len(joints))
        goal = self._transmission.motor_from_joint(joints) + self._zero
        goal = np.ascontiguousarray(np.vstack([self._goal, goal]))
        force, held = self._acting(t)
        log = empty_log(len(joints), self._constants)
        arms = np.array(list(self._arms.values())).reshape(-1, len(self.robot.joints))
        advance(
            self._constants, self._state, self._work, goal,
            np.ascontiguousarray(force @ arms), held,
            SUBSTEPS, log,
        )  # fmt: skip
        self._check_finite(log.joint, t[1:], "its step")
        motor = log.motor - self._zero + self._white("motor", log.motor.shape, "motor_noise")
        before = np.vstack([self._reading, motor])
        speed = np.diff(before, axis=0) / SETPOINT_DT
        if len(joints):
            self._command, self._goal, self._reading = joints[-1], goal[-1], motor[-1]
        self._ticks += len(joints)
        effort = log.effort * (1.0 + self._drawn.effort_gain)
        effort += self._white("effort", effort.shape, "effort_noise")
        reference = log.joint + self._white("truth", log.joint.shape, "reference_noise")
        names = self.robot.joint_names
        exact = {f"truth_exact/{name}": log.joint[:, k].copy() for k, name in enumerate(names)}
        grips = {"truth_load/grip": log.grip} if self._meets else {}
        pulls = {
            f"truth_load/{name}": pull * float(np.abs(arm).sum())
            for (name, arm), pull in zip(self._arms.items(), force[1:].T, strict=True)
        }
        return TwinOutput(
            t=t[1:],
            name=self.robot.channels,
            measured=self._transmission.joint_from_motor(motor),
            velocity=self._transmission.joint_from_motor(speed),
            effort=effort,
            setpoint=joints,
            motor=motor,
            motor_velocity=speed,
            extra={**exact, **grips, **pulls},
            truth=TruthBlock(t[1:], self.robot.positioning, reference),
            joint=log.joint,
        )

    def _registered(self) -> Array:
        """Zeros (n_motors,) [rad] of an engagement: the assembly's, and its own error."""
        rng = np.random.default_rng((self.seed, self.homing_count))
        spread = self.parameters.homing.registration
        return np.asarray(
            self._drawn.motor_zero + spread * rng.standard_normal(len(self._drawn.motor_zero))
        )

    def _acting(self, t: Array) -> tuple[Array, Array]:
        """Give forces at the tip (n, n_arms) [N] and the opening at which jaws meet (n,) [rad]."""
        force = np.zeros((len(t), len(self._arms)))
        if self._arms:
            force[:, 0] = -GRAVITY * self._load
        if self.tip_force is not None:
            force += shaped(self.tip_force(t), force.shape, "tip_force")
        held = np.zeros(len(t))
        if self.held is not None:
            if not self._meets:
                raise RobotError(
                    f"{self.robot.title} states no jaws that hold; add [mechanism.contact]"
                )
            held = shaped(self.held(t), held.shape, "held")
        return force, np.ascontiguousarray(held)

    def _white(self, stream: str, shape: tuple[int, ...], noise: str) -> Array:
        size: float = getattr(self.parameters.sensors, noise)
        return np.asarray(size * self._noise[stream].standard_normal(shape))
