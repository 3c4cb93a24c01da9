"""`Raven2Twin`: a virtual RAVEN-II arm that errs the way the real one does."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truejoint.errors import CommandRefused, TruejointError
from truejoint.robots import Robot, get_robot
from truejoint.robots.raven2 import CHANNELS, HOMING_RAMP, HOMING_RETURN, HOMING_SETTLE, drives
from truejoint.simulation import _twin_kernel as kernel
from truejoint.simulation._twin_plant import POSITIONING, build_plant, build_state
from truejoint.simulation.twin_parameters import TwinParameters

Array = NDArray[np.float64]

MAX_LOAD: Final = 2.0
"""Heaviest load that the arm carries [kg]; the shoulder's motor gives up a little above."""

# Where the arm was left, as a share of the soft limits on either side of the home pose.
_LEFT_SPREAD: Final = 0.05
# The insertion needs 17 s from its far end, the others less.
_SEARCH_LIMIT: Final = 25.0  # s
_SEARCH_PIECE: Final = 500  # rows


@dataclass(frozen=True, eq=False)
class TwinOutput:
    """What a stretch of time looked like.

    State arrays have one row per millisecond and one column per channel of the robot's state
    message (shoulder, elbow, insertion, unused, roll, wrist, jaw1, jaw2); the unused one is zero.

    Attributes
    ----------
    t : ndarray, shape (n,)
        Time stamps [s].
    measured, velocity : ndarray, shape (n, 8)
        Joint positions [rad, m] and velocities that the robot derives from its motor encoders.
    motor, motor_velocity : ndarray, shape (n, 8)
        Motor shafts [rad, rad/s]; the velocity is the first difference of the encoder.
    effort : ndarray, shape (n, 8)
        Torque command at the capstan [Nm].
    setpoint : ndarray, shape (n, 8)
        Commanded joint positions [rad, m].
    truth_t : ndarray, shape (m,)
        Time stamps [s] of the external joint encoders, on their own clock.
    truth : ndarray, shape (m, 3)
        External encoders of the positioning joints [rad, rad, m].
    joint : ndarray, shape (n, 3)
        Where the positioning joints really are [rad, rad, m]; no robot knows this.

    Examples
    --------
    >>> twin = Raven2Twin(seed=1)
    >>> twin.home().joined(twin.run(twin.robot.home[None])).measured.shape
    (12757, 8)
    """

    t: Array
    measured: Array
    velocity: Array
    motor: Array
    motor_velocity: Array
    effort: Array
    setpoint: Array
    truth_t: Array
    truth: Array
    joint: Array

    def joined(self, later: TwinOutput) -> TwinOutput:
        """Put a `later` stretch of time after this one."""
        return _joined([self, later])


class Raven2Twin:
    """Digital twin of one RAVEN-II arm; its time passes only while `home`, `run` or `idle` run.

    The same seed and the same calls give the same numbers, bit for bit, and however a motion is
    cut into calls of `run`, it is the same motion.

    Parameters
    ----------
    parameters : TwinParameters, optional
        Physics; the shipped one by default.
    arm : str
        As in `truejoint.robots.get_robot`.
    seed : int
        Of everything random: homing, friction, clocks. 0 or more.
    load : float
        Mass that hangs on the tool [kg].

    Raises
    ------
    TruejointError
        If the seed or the load is out of range, or the parameters cannot be simulated at 1 kHz.
    RobotError
        If the arm is unknown.

    Examples
    --------
    >>> twin = Raven2Twin(seed=1)
    >>> twin.home().t.shape
    (12756,)
    """

    def __init__(
        self,
        parameters: TwinParameters | None = None,
        *,
        arm: str = "left",
        seed: int = 0,
        load: float = 0.0,
    ) -> None:
        if isinstance(seed, bool) or not 0 <= seed < 2**63:
            raise TruejointError(f"seed is {seed!r}; give a whole number from 0 to 2**63 - 1")
        self._parameters = TwinParameters.load() if parameters is None else parameters
        self._robot = get_robot("raven2", arm)
        self._drives = drives("right" if self._robot.arm == "right" else "left")
        self._plant = build_plant(self._parameters, self._robot)
        self._homings = 0
        rng = np.random.default_rng([seed, 0])
        span = (self._robot.upper - self._robot.lower)[:POSITIONING]
        spread = _LEFT_SPREAD * span * rng.uniform(-1.0, 1.0, POSITIONING)
        pose = self._robot.home[:POSITIONING] + spread
        self._rng = rng
        self._state = build_state(self._plant, pose, seed, _checked_load(load))
        self._channels = [self._robot.channels.index(name) for name in self._robot.joint_names]

    @property
    def robot(self) -> Robot:
        """The arm that this is the twin of."""
        return self._robot

    @property
    def parameters(self) -> TwinParameters:
        """The physics of the twin."""
        return self._parameters

    @property
    def time(self) -> float:
        """Time since the robot was switched on [s]."""
        return float(self._state.ticks[kernel.CLOCK]) * kernel.STEP

    @property
    def homing_count(self) -> int:
        """How often the arm has been homed."""
        return self._homings

    @property
    def load(self) -> float:
        """Mass that hangs on the tool [kg]."""
        return float(self._state.slow[kernel.LOAD])

    @load.setter
    def load(self, mass: float) -> None:
        self._state.slow[kernel.LOAD] = _checked_load(mass)

    def run(self, setpoint: ArrayLike) -> TwinOutput:
        """Follow a joint trajectory, one row a millisecond.

        Parameters
        ----------
        setpoint : array_like, shape (n, 7)
            Joint positions [rad, insertion m] in the robot's joint order, in the coordinates of
            `TwinOutput.measured`.

        Raises
        ------
        CommandRefused
            If the shape is wrong or a value is not finite.
        """
        goal = np.ascontiguousarray(setpoint, dtype=np.float64)
        n_joints = len(self._robot.joints)
        if goal.ndim != 2 or goal.shape[1] != n_joints:
            raise CommandRefused(
                f"setpoint has shape {goal.shape}; it must be (n, {n_joints}), one row per ms"
            )
        if not np.isfinite(goal).all():
            row, column = np.argwhere(~np.isfinite(goal))[0]
            raise CommandRefused(
                f"setpoint of {self._robot.joint_names[column]} in row {row} is "
                f"{goal[row, column]}; every setpoint must be finite"
            )
        return self._advance(goal)

    def home(self) -> TwinOutput:
        """Find the hard stops, register both kinds of encoder there, go to the home pose.

        As uw-biorobotics/raven2:src/raven/homing.cpp does it: each positioning joint moves
        towards its stop until its torque command says that it has arrived; after 0.2 s its
        motor encoder is set to the stop's nominal position, and all return within 2.5 s. The tool's
        joints are registered without error. Rows before the registration are meaningless,
        as on the robot.
        """
        search = self._search_stops()
        self._register()
        stop = search.measured[-1, self._channels].copy()
        stop[:POSITIONING] = [drive.hard_stop for drive in self._drives[:POSITIONING]]
        stop[POSITIONING:] = self._robot.home[POSITIONING:]
        steps = round(HOMING_RETURN / kernel.STEP)
        blend = 0.5 * (1.0 - np.cos(np.pi * np.arange(1, steps + 1) / steps))
        path = stop + blend[:, None] * (self._robot.home - stop)
        hold = np.tile(self._robot.home, (round(1.0 / kernel.STEP), 1))
        self._homings += 1
        return search.joined(self._advance(np.vstack([path, hold])))

    def idle(self, duration: float) -> None:
        """Let time pass with the brakes on: cables hardly creep, grease cools; no rows.

        Parameters
        ----------
        duration : float
            [s], rounded to milliseconds.

        Raises
        ------
        TruejointError
            If the duration is negative or not finite.
        """
        if not (math.isfinite(duration) and duration >= 0.0):
            raise TruejointError(f"duration is {duration}; give a finite number of seconds >= 0")
        self._state.ticks[kernel.CLOCK] += round(duration / kernel.STEP)
        self._state.speed[:] = 0.0
        kernel.age(self._plant, self._state, float(duration))
        # The external encoders' clock ran on, with nobody reading.
        self._state.slow[kernel.NEXT_TRUTH] += math.ceil(
            max(0.0, self.time - self._state.slow[kernel.NEXT_TRUTH])
            / self._plant.constants[kernel.TRUTH_PERIOD]
        ) * float(self._plant.constants[kernel.TRUTH_PERIOD])

    def _search_stops(self) -> TwinOutput:
        """Move to the hard stops and settle there; the encoders are not touched."""
        start = self._current_position()
        # The robot takes up the position that it has, without a step in the set point's speed.
        self._state.command[:] = self._plant.motor_from_joint @ start
        limits = [drive.homing_effort for drive in self._drives[:POSITIONING]]
        steps = round(_SEARCH_LIMIT / kernel.STEP)
        found = np.full(POSITIONING, steps)
        done, outputs = 0, []
        while (found == steps).any() and done < steps:
            # A joint that stands at its stop loads the others through the cables: once one
            # arrives, the piece of time is run again with that joint held.
            saved = _copied(self._state)
            piece = self._ramp(start, found, steps)[done : done + _SEARCH_PIECE]
            output = self._advance(piece)
            arrived = _first_above(output.effort, limits, found == steps)
            if arrived is None:
                outputs.append(output)
                done += len(piece)
            else:
                self._state = saved
                found[arrived[0]] = done + arrived[1]
        if (found == steps).any():
            names = [self._robot.joint_names[k] for k in range(POSITIONING) if found[k] == steps]
            raise TruejointError(
                f"homing found no hard stop for {', '.join(names)} within {_SEARCH_LIMIT:g} s; "
                "the parameters make friction too strong for the motor"
            )
        last = int(found.max()) + round(HOMING_SETTLE / kernel.STEP)
        outputs.append(self._advance(self._ramp(start, found, steps + _SEARCH_PIECE)[done:last]))
        return _joined(outputs)

    def _ramp(self, start: Array, found: NDArray[np.int64], steps: int) -> Array:
        """Setpoints (steps, 7) towards the stops, each joint held from its index `found` on."""
        t = np.arange(1, steps + 1) * kernel.STEP
        # The speed builds up along a quarter of a sine within HOMING_RAMP.
        slow = (1.0 - np.cos(np.pi / HOMING_RAMP * np.minimum(t, HOMING_RAMP) / 2)) * (
            2.0 * HOMING_RAMP / np.pi
        )
        travelled = slow + np.maximum(0.0, t - HOMING_RAMP)
        path = np.tile(start, (steps, 1))
        for k in range(POSITIONING):
            way = travelled.copy()
            way[found[k] :] = travelled[min(found[k], steps - 1)]
            path[:, k] += self._drives[k].homing_speed * way
        return path

    def _register(self) -> None:
        """Set the motor encoders' zeros, the arm standing at its hard stops."""
        homing = self._parameters.homing
        nominal = self._robot.home.copy()
        nominal[:POSITIONING] = [drive.hard_stop for drive in self._drives[:POSITIONING]]
        nominal[:POSITIONING] += np.array(homing.registration_bias) + np.array(
            homing.registration_sd
        ) * self._rng.standard_normal(POSITIONING)
        state, plant = self._state, self._plant
        angle = plant.motor_from_joint @ nominal
        count = kernel.TURN / plant.constants[kernel.COUNTS]
        state.encoder_zero[:] = state.counts * count - angle
        state.integral[:] = 0.0
        # The robot restarts its set point at the nominal stop.
        nominal[:POSITIONING] = [drive.hard_stop for drive in self._drives[:POSITIONING]]
        state.command[:] = plant.motor_from_joint @ nominal

    def _current_position(self) -> Array:
        """Joint positions (7,) [rad, m] that the motor encoders say now."""
        count = kernel.TURN / self._plant.constants[kernel.COUNTS]
        angle = np.floor(self._state.motor / count) * count - self._state.encoder_zero
        return np.asarray(self._plant.joint_from_motor @ angle)

    def _advance(self, goal: Array) -> TwinOutput:
        """One compiled call over the rows of `goal` (n, 7)."""
        n, start = len(goal), int(self._state.ticks[kernel.CLOCK])
        rows = _empty_rows(n, float(self._plant.constants[kernel.TRUTH_PERIOD]))
        kernel.advance(self._plant, self._state, goal, rows)
        m = int(self._state.ticks[kernel.TRUTH_ROWS])
        stamps = np.arange(start, start + n, dtype=np.float64) * kernel.STEP
        return TwinOutput(
            t=stamps,
            measured=rows.measured,
            velocity=rows.velocity,
            motor=rows.motor,
            motor_velocity=rows.motor_velocity,
            effort=rows.effort,
            setpoint=rows.setpoint,
            truth_t=rows.truth_t[:m].copy(),
            truth=rows.truth[:m].copy(),
            joint=rows.joint,
        )


def _empty_rows(n: int, truth_period: float) -> kernel.Rows:
    # The clock's shortest interval is a tenth of its period (see the kernel).
    m = int(n * kernel.STEP / (0.1 * truth_period)) + 16
    wide = [np.zeros((n, len(CHANNELS))) for _ in range(6)]
    return kernel.Rows(
        measured=wide[0],
        velocity=wide[1],
        motor=wide[2],
        motor_velocity=wide[3],
        effort=wide[4],
        setpoint=wide[5],
        joint=np.empty((n, POSITIONING)),
        truth_t=np.empty(m),
        truth=np.empty((m, POSITIONING)),
    )


def _first_above(
    effort: Array, limits: list[float], wanted: NDArray[np.bool_]
) -> tuple[int, int] | None:
    """Which of the `wanted` joints first reaches its limit, and in which row; None if none."""
    above = (np.abs(effort[:, :POSITIONING]) >= limits) & wanted
    if not above.any():
        return None
    row = int(np.argmax(above.any(axis=1)))
    return int(np.argmax(above[row])), row


def _joined(outputs: list[TwinOutput]) -> TwinOutput:
    return TwinOutput(
        **{
            f.name: np.concatenate([getattr(o, f.name) for o in outputs])
            for f in fields(TwinOutput)
        }
    )


def _copied(state: kernel.State) -> kernel.State:
    copies = {name: array.copy() for name, array in state._asdict().items()}
    return kernel.State(**copies)


def _checked_load(mass: float) -> float:
    if not 0.0 <= mass <= MAX_LOAD:  # also false for NaN
        raise TruejointError(f"load is {mass} kg; it must lie in [0, {MAX_LOAD:g}] kg")
    return float(mass)
