"""`Raven2Twin`: a virtual RAVEN-II arm that errs the way the real one does."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator
from typing import ClassVar, Final

import numpy as np

from truejoint.array_types import Array
from truejoint.errors import TruejointError
from truejoint.robots.blocks import QUANTITIES, TruthBlock
from truejoint.robots.raven2.arm import CHANNELS
from truejoint.robots.raven2.hardware import HOMING_RAMP, HOMING_RETURN, HOMING_SETTLE, drives
from truejoint.simulation.raven2 import kernel
from truejoint.simulation.raven2.parameters import Raven2Parameters
from truejoint.simulation.raven2.plant import POSITIONING, build_plant, build_state
from truejoint.simulation.twin import Twin, TwinOutput, glide, hold

# Share of a step that a time stamp may be late or early by.
_LATEST: Final = 0.45
# Range in which the arm was left, as a share of the soft limits on either side of home.
_LEFT_SPREAD: Final = 0.05
# The insertion needs 17 s from its far end, the others less.
_SEARCH_LIMIT: Final = 25.0  # s
_SEARCH_PIECE: Final = 500  # rows


class Raven2Twin(Twin):
    """Digital twin of one RAVEN-II arm; a `truejoint.simulation.Twin`.

    State arrays have one column per channel of the robot's state message (shoulder, elbow,
    insertion, unused, roll, wrist, jaw1, jaw2).

    The seed is that of homing, friction and clocks.

    Raises TruejointError if the seed or the load is out of range, or the parameters cannot be
    simulated at 1 kHz, and RobotError if the arm is unknown.

    Examples
    --------
    >>> twin = Raven2Twin(seed=1)
    >>> twin.home().t.shape
    (12756,)
    """

    ROBOT: ClassVar[str] = "raven2"
    PARAMETERS: ClassVar[type[Raven2Parameters]] = Raven2Parameters
    MAX_LOAD: ClassVar[float] = 2.0  # the shoulder's motor gives up a little above
    _NOTED: ClassVar[tuple[str, ...]] = ("_state", "_ticks")

    parameters: Raven2Parameters

    def _build(self) -> None:
        self._drives = drives(self.robot.arm)
        self._plant = build_plant(self.parameters, self.robot)
        streams = (np.random.default_rng([self.seed, part]) for part in range(3))
        self._rng, self._tool_rng, self._stamp_rng = streams
        self._streams = (self._stamp_rng,)
        span = (self.robot.upper - self.robot.lower)[:POSITIONING]
        spread = _LEFT_SPREAD * span * self._rng.uniform(-1.0, 1.0, POSITIONING)
        pose = self.robot.home[:POSITIONING] + spread
        self._state = build_state(self._plant, pose, self.seed)
        stops = [drive.hard_stop for drive in self._drives[:POSITIONING]]
        self._nominal_stop = np.concatenate([stops, self.robot.home[POSITIONING:]])

    @property
    def encoder_zero(self) -> Array:
        """Angles (7,) of the motor shafts that the last homing counts from [rad]."""
        return self._state.encoder_zero.copy()

    def homing(self) -> Generator[TwinOutput]:
        """Find the hard stops, register both kinds of encoder there, go to the home pose.

        As uw-biorobotics/raven2:src/raven/homing.cpp does it: each positioning joint moves
        towards its stop until its torque command says that it has arrived; after 0.2 s its
        motor encoder is set to the stop's nominal position, and all return within 2.5 s. The tool's
        joints are held where their own homing leaves them, near home. Rows before the
        registration are meaningless, as on the robot.
        """
        yield from self._search_stops()
        # The motor encoders' zeros are set, the arm standing at its hard stops.
        homing, state, plant = self.parameters.homing, self._state, self._plant
        wrong = self._nominal_stop.copy()
        wrong[:POSITIONING] += np.array(homing.registration_bias) + np.array(
            homing.registration_sd
        ) * self._rng.standard_normal(POSITIONING)
        count = kernel.TURN / plant.counts
        state.encoder_zero[:] = state.counts * count - plant.motor_from_joint @ wrong
        state.integral[:] = 0.0
        registered = np.array(self.parameters.tool.registration_sd)
        state.tool[kernel.REGISTERED] = registered * self._tool_rng.standard_normal(4)
        state.tool[kernel.WANDER] = 0.0
        # The robot restarts its set point at the nominal stop.
        state.command[:] = plant.motor_from_joint @ self._nominal_stop
        home = self.robot.home
        self.homing_count += 1
        yield from self._go(glide(self._nominal_stop, home, HOMING_RETURN), hold(home, 1.0))

    def idle(self, duration: float) -> None:
        """Let `duration` [s] pass with the brakes on: cables hardly creep, grease cools; no rows.

        Raises TruejointError if the duration is negative or not finite.
        """
        super().idle(duration)
        self._state.ticks[kernel.CLOCK] = self._ticks
        self._state.slow[kernel.LOAD] = self._load
        self._state.speed[:] = 0.0
        kernel.age(self._plant, self._state, float(duration))
        # The external encoders' clock ran on, with nobody reading.
        period = self._plant.truth_period
        late = max(0.0, self.time - self._state.slow[kernel.NEXT_TRUTH])
        self._state.slow[kernel.NEXT_TRUTH] += math.ceil(late / period) * period

    def _search_stops(self) -> Iterator[TwinOutput]:
        """Move to the hard stops and settle there; the encoders are not touched."""
        # The robot takes up the position that its motor encoders say now, without a step in the set
        # point's speed.
        count = kernel.TURN / self._plant.counts
        angle = np.floor(self._state.motor / count) * count - self._state.encoder_zero
        start = self._plant.joint_from_motor @ angle
        self._state.command[:] = self._plant.motor_from_joint @ start
        limits = [drive.homing_effort for drive in self._drives[:POSITIONING]]
        speed = np.array([drive.homing_speed for drive in self._drives[:POSITIONING]])
        steps = round(_SEARCH_LIMIT / kernel.DT)
        stop_row = np.full(POSITIONING, steps)
        # The speed builds up along a quarter of a sine within HOMING_RAMP.
        t = np.arange(1, steps + _SEARCH_PIECE + 1) * kernel.DT
        slow = (1.0 - np.cos(np.pi / HOMING_RAMP * np.minimum(t, HOMING_RAMP) / 2)) * (
            2.0 * HOMING_RAMP / np.pi
        )
        travelled = slow + np.maximum(0.0, t - HOMING_RAMP)

        def path(first: int, last: int) -> Array:
            """Set-points of rows towards the stops, each joint held from `stop_row` on."""
            rows = np.tile(start, (last - first, 1))
            way = travelled[np.minimum(np.arange(first, last)[:, None], stop_row)]
            rows[:, :POSITIONING] += speed * way
            return rows

        done = 0
        while (stop_row == steps).any() and done < steps:
            # A joint that stands at its stop loads the others through the cables: a piece of time
            # is tried, and run again with a joint held from where it arrives.
            back = self.saved()
            piece = path(done, min(done + _SEARCH_PIECE, steps))
            output = self._follow(piece)
            above = (np.abs(output.effort[:, :POSITIONING]) >= limits) & (stop_row == steps)
            after = self._stamp_rng.bit_generator.state
            back()
            if above.any():
                row = int(np.argmax(above.any(axis=1)))
                stop_row[np.argmax(above[row])] = done + row
                self._stamp_rng.bit_generator.state = after
            else:
                yield from self._go(piece)
                done += len(piece)
        if (stop_row == steps).any():
            names = [self.robot.joint_names[k] for k in range(POSITIONING) if stop_row[k] == steps]
            raise TruejointError(
                f"homing found no hard stop for {', '.join(names)} within {_SEARCH_LIMIT:g} s; "
                "the parameters make friction too strong for the motor"
            )
        last = int(stop_row.max()) + round(HOMING_SETTLE / kernel.DT)
        yield from self._go(path(done, last))

    def _follow(self, goal: Array) -> TwinOutput:
        n = len(goal)
        self._state.slow[kernel.LOAD] = self._load
        # The shortest time between two readings is a tenth of their period (see the kernel).
        shortest = 0.1 * self._plant.truth_period
        most = int(n * kernel.DT / shortest) + 16
        rows = kernel.Rows(
            joint=np.empty((n, POSITIONING)),
            truth_t=np.empty(most),
            truth=np.empty((most, POSITIONING)),
            **{name: np.zeros((n, len(CHANNELS))) for name in QUANTITIES},
        )
        kernel.advance(self._plant, self._state, goal, rows)
        self._ticks += n
        m = int(self._state.ticks[kernel.TRUTH_ROWS])
        truth = TruthBlock(rows.truth_t[:m].copy(), self.robot.positioning, rows.truth[:m].copy())
        jitter = self.parameters.state_stream.jitter / kernel.DT
        # Less than half a step, so that stamps keep their order.
        late = np.clip(jitter * self._stamp_rng.standard_normal(n), -_LATEST, _LATEST)
        return TwinOutput(
            t=(np.arange(self._ticks - n, self._ticks) + late) * kernel.DT,
            name=CHANNELS,
            truth=truth,
            **{name: getattr(rows, name) for name in (*QUANTITIES, "joint")},
        )
