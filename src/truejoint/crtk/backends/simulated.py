"""The simulated back end: an arm on any digital twin."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from numbers import Real
from pathlib import Path
from typing import Final

import numpy as np

from truejoint.array_types import Array
from truejoint.crtk.arm import Arm
from truejoint.crtk.protocol import ARRIVAL, Listener
from truejoint.crtk.states import OperatingState, StateCommand, next_state
from truejoint.errors import CommandRefused, MotionStopped, RobotError, other_kind
from truejoint.robots import Robot
from truejoint.robots.blocks import GRAIN, SETPOINT_DT, StateBlock
from truejoint.robots.catalogue import DEFAULT
from truejoint.simulation import Twin, TwinOutput, make_twin


class SimulatedBackend:
    """Executes an arm's commands on a digital twin, far faster than real time.

    Once homed it reports whenever time has passed: what it measures at each set-point, and after
    a `wait` on the brakes, which hold the motors, what it measured last.

    Parameters
    ----------
    twin : Twin
        Kept by reference: its load may be changed while the arm works.
    rate : float
        Set-points and state messages a second [Hz], of which the twin's own 1 kHz is a multiple;
        between two set-points the last one holds.

    Raises
    ------
    RobotError
        If `rate` does not divide 1 kHz.

    Examples
    --------
    >>> SimulatedBackend(truejoint.simulation.make_twin("raven2", seed=1)).robot.name
    'raven2'
    """

    stretch: float = 2.0  # a piece takes a few milliseconds, and can be taken back

    def __init__(self, twin: Twin, *, rate: float = 1.0 / SETPOINT_DT) -> None:
        if not hasattr(twin, "home"):  # as anything may have that stands for one
            raise RobotError(other_kind(twin, "Twin", "make_twin(robot) gives one"))
        self.twin = twin
        self.robot: Final[Robot] = twin.robot
        ticks = 1.0 / (rate * SETPOINT_DT) if isinstance(rate, Real) and rate > 0.0 else 0.0
        if not (ticks >= 1.0 - 1e-9 and abs(ticks - round(ticks)) < 1e-6 * ticks):
            raise RobotError(
                f"simulated arm: {rate!s:.40} set-points a second; a twin runs at "
                f"{1 / SETPOINT_DT:g} Hz: give that, or a half, a third, ... of it"
            )
        self._ticks = round(ticks)  # of the twin, a set-point
        self.rate: Final = float(rate)
        self.grain: Final = max(GRAIN, self._ticks * SETPOINT_DT)
        self._last: StateBlock | None = None  # message since the homing
        self._state = OperatingState("DISABLED", is_homed=False, is_busy=False, t=twin.time)
        self._listener: Listener | None = None
        self._twin_lock = threading.RLock()  # one thread at a time lets its time pass
        self._now = twin.time  # when a piece of it ended last: it may try a motion before it does
        self._entry_lock = threading.RLock()  # held by those who wait for the twin

    @property
    def time(self) -> float:
        """Simulated time [s]; while a piece of it is worked on, when the one before ended."""
        if self._twin_lock.acquire(blocking=False):
            try:
                self._now = self.twin.time
            finally:
                self._twin_lock.release()
        return self._now

    @property
    def homing_id(self) -> str:
        """Seed of the twin and number of its homing."""
        return f"seed {self.twin.seed}, homing {self.twin.homing_count}"

    def connect(self, listener: Listener) -> None:
        """Deliver all blocks from now on to `listener`; raises CommandRefused if there is one."""
        if self._listener is not None:
            raise CommandRefused(
                f"{self.robot.title} refused: another Arm controls it; close that one first"
            )
        self._listener = listener
        if self._last is not None and self._state.is_homed:
            listener(self._last)  # one who comes later knows where the arm is

    def disconnect(self) -> None:
        """Deliver no more blocks."""
        self._listener = None

    def operating_state(self) -> OperatingState:
        """State of the simulated controller."""
        return replace(self._state, t=self.time)

    def state_command(self, command: StateCommand, timeout: float) -> None:
        """Carry out a state command; raises CommandRefused where the state forbids it.

        Homing gives up after `timeout` [s] of simulated time, and where the arm is paused or
        disabled meanwhile.
        """
        with self._entry_lock, self._twin_lock:
            after = next_state(self._state, command)
            homing = command == "home"
            self._state = replace(after, is_homed=False, is_busy=True) if homing else after
        if homing:
            self._home(timeout)

    def servo_jp(self, position: Array, go_on: Callable[[], bool]) -> int:
        """Run the twin along set-points (n, n_joints) [rad or m] at `rate`, all or none.

        For others the clock leaps. A leap that is stopped in the middle is taken back: the arm
        stands when who stopped it read the clock.
        """
        with self._advancing_twin():
            if not go_on():
                return 0
            back = self.twin.saved() if len(position) > self.grain * self.rate else None
            output, now = self._run(position), self.twin.time
            if back is not None and not go_on():
                back()
                return 0
            self._now = now  # right after the asking: nobody reads the old time and is not heard
        self._deliver(output)
        return len(position)

    def flush(self, timeout: float = ARRIVAL, go_on: Callable[[], bool] = lambda: True) -> str:
        """Return at once: what is sent is executed."""
        del timeout, go_on
        return ""

    def wait(self, duration: float) -> None:
        """Let `duration` [s] pass with the brakes on, and report where they hold the motors."""
        with self._advancing_twin():
            standing = self._stand(duration)
        self._deliver(standing)

    def _run(self, position: Array) -> TwinOutput:
        """Follow set-points (n, n_joints) [rad or m]; a row for each."""
        if self._ticks == 1:
            return self.twin.run(position)
        return self.twin.run(np.repeat(position, self._ticks, axis=0)).every(self._ticks)

    def _stand(self, duration: float) -> StateBlock | None:
        """Let time [s] pass with the brakes on; what a homed arm then reports."""
        before = self.twin.time
        self.twin.idle(duration)
        last, passed = self._last, self.twin.time - before
        if last is None or not self._state.is_homed or not passed > 0.0:
            return None
        still = np.zeros_like(last.velocity), np.zeros_like(last.motor_velocity)
        return replace(last, t=last.t + passed, velocity=still[0], motor_velocity=still[1])

    def _home(self, timeout: float) -> None:
        start, last, pieces = self.twin.time, None, self.twin.homing()
        try:
            while True:
                with self._advancing_twin():
                    state = self._state.state
                    if state != "ENABLED":
                        raise MotionStopped(
                            f"'home' stopped at t = {self.twin.time:.3f} s: {state}; the arm is "
                            "not homed"
                        )
                    piece = next(pieces, None)
                    if piece is None:
                        self._state = replace(self._state, is_homed=True)
                        break
                last = piece
                self._passed(piece)
                if self.twin.time - start > timeout:
                    raise CommandRefused(f"'home' stopped: not done after {timeout:g} s")
        finally:
            with self._twin_lock:
                pieces.close()
                self._state = replace(self._state, is_busy=False)
        # Positions before the registration mean nothing, so only the end pose is reported.
        if last is not None:
            self._deliver(last.rows(slice(-1, None)))

    @contextmanager
    def _advancing_twin(self) -> Iterator[None]:
        """Let time of the twin pass, after those who wait for it; no other thread meanwhile."""
        with self._entry_lock:  # a lock that is free again would not let them in
            pass
        with self._twin_lock:
            try:
                yield
            finally:
                self._now = self.twin.time

    def _passed(self, piece: TwinOutput) -> None:
        """Note that a piece of the homing is over; it takes no longer than to compute it."""

    def _deliver(self, output: StateBlock | None) -> None:
        if output is None:
            return
        self._last = output.rows(slice(-1, None))
        if self._listener is None:
            return
        self._listener(output)
        if isinstance(output, TwinOutput) and len(output.truth.t):
            self._listener(output.truth)


def simulated_arm(
    robot: str = DEFAULT,
    arm: str = "",
    *,
    parameters: str | Path = "nominal",
    seed: int = 0,
    load: float = 0.0,
) -> Arm:
    """Arm on a digital twin; disabled and not homed, as a robot that was just switched on.

    Parameters, and what is raised, are those of `truejoint.simulation.make_twin`. An arm on a twin
    of yours is ``Arm(SimulatedBackend(twin))``.

    Examples
    --------
    >>> arm = simulated_arm("forceps", seed=1)
    >>> arm.enable()
    >>> arm.home()
    >>> arm.move_jp([0.1]).wait()
    >>> print(arm.measured_js().position.round(2))
    [0.1]
    """
    return Arm(SimulatedBackend(make_twin(robot, arm, parameters=parameters, seed=seed, load=load)))
