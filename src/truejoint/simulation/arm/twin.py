"""`ArmTwin`: a virtual arm on cables, without the homing of one robot."""

import math
from typing import Any, ClassVar, Final

import numpy as np

from truejoint.array_types import Array
from truejoint.robots.blocks import QUANTITIES, TruthBlock
from truejoint.simulation.arm import kernel
from truejoint.simulation.arm.plant import Hardware, build_plant, build_state
from truejoint.simulation.twin import Twin, TwinOutput

# Share of a step that a time stamp may be late or early by.
_LATEST: Final = 0.45
# Range in which the arm was left, as a share of the soft limits on either side of home.
_LEFT_SPREAD: Final = 0.05


class ArmTwin(Twin):
    """Digital twin of an arm of seven joints, the first few on cables that give way.

    The seed is that of homing, friction and clocks. A subclass has `_hardware` and `homing`.
    """

    REPORTS_MOTORS: ClassVar[bool] = True
    """Whether the robot's state message has the motor angles."""
    _NOTED: ClassVar[tuple[str, ...]] = ("_state", "_ticks")

    parameters: Any

    def _hardware(self) -> Hardware:
        """Give the hardware of `parameters` and `robot`."""
        raise NotImplementedError

    def _build(self) -> None:
        self._n = n = self.parameters.ON_CABLES
        self._plant = build_plant(self.parameters, self.robot, self._hardware())
        streams = (np.random.default_rng([self.seed, part]) for part in range(3))
        self._rng, self._tool_rng, self._stamp_rng = streams
        self._streams = (self._stamp_rng,)
        span = (self.robot.upper - self.robot.lower)[:n]
        pose = self.robot.home[:n] + _LEFT_SPREAD * span * self._rng.uniform(-1.0, 1.0, n)
        pose = np.clip(pose, *self._plant.stops.T)
        self._state = build_state(self._plant, pose, self.seed)

    @property
    def encoder_zero(self) -> Array:
        """Angles (7,) of the motor shafts that the last homing counts from [rad]."""
        return self._state.encoder_zero.copy()

    def idle(self, duration: float) -> None:
        """Let `duration` [s] pass as the base does: cables hardly creep, grease cools."""
        super().idle(duration)
        self._state.ticks[kernel.CLOCK] = self._ticks
        self._state.slow[kernel.LOAD] = self._load
        self._state.speed[:] = 0.0
        kernel.age(self._plant, self._state, float(duration))
        # The external encoders' clock ran on, with nobody reading.
        period = self._plant.truth_period
        late = max(0.0, self.time - self._state.slow[kernel.NEXT_TRUTH])
        self._state.slow[kernel.NEXT_TRUTH] += math.ceil(late / period) * period

    def _take_up(self) -> Array:
        """Take up the position (7,) that the encoders say, without a step in the set-point."""
        count = kernel.TURN / self._plant.counts
        angle = np.floor(self._state.motor / count) * count - self._state.encoder_zero
        start: Array = self._plant.joint_from_motor @ angle
        self._state.command[:] = self._plant.motor_from_joint @ start
        return start

    def _register(self, position: Array) -> None:
        """Let the motor encoders say from now on that the arm is at a position (7,)."""
        state, plant = self._state, self._plant
        count = kernel.TURN / plant.counts
        state.encoder_zero[:] = state.counts * count - plant.motor_from_joint @ position
        state.integral[:] = 0.0
        tool = self.parameters.tool.registration_sd
        state.tool[kernel.REGISTERED] = tool * self._tool_rng.standard_normal(7 - self._n)
        state.tool[kernel.WANDER] = 0.0
        self.homing_count += 1

    def _follow(self, goal: Array) -> TwinOutput:
        n, channels = len(goal), self.robot.channels
        self._state.slow[kernel.LOAD] = self._load
        # The shortest time between two readings is a tenth of their period (see the kernel).
        shortest = 0.1 * self._plant.truth_period
        most = int(n * kernel.DT / shortest) + 16
        rows = kernel.Rows(
            joint=np.empty((n, self._n)),
            truth_t=np.empty(most),
            truth=np.empty((most, self._n)),
            **{name: np.zeros((n, len(channels))) for name in QUANTITIES},
        )
        kernel.advance(self._plant, self._state, goal, rows)
        self._ticks += n
        m = int(self._state.ticks[kernel.TRUTH_ROWS])
        truth = TruthBlock(rows.truth_t[:m].copy(), self.robot.positioning, rows.truth[:m].copy())
        jitter = self.parameters.state_stream.jitter / kernel.DT
        # Less than half a step, so that stamps keep their order.
        late = np.clip(jitter * self._stamp_rng.standard_normal(n), -_LATEST, _LATEST)
        reported = {name: getattr(rows, name) for name in (*QUANTITIES, "joint")}
        if not self.REPORTS_MOTORS:
            reported |= dict.fromkeys(("motor", "motor_velocity"), np.zeros((n, 0)))
        return TwinOutput(
            t=(np.arange(self._ticks - n, self._ticks) + late) * kernel.DT,
            name=channels,
            truth=truth,
            **reported,
        )
