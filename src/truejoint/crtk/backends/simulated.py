"""The simulated back end: an arm on any digital twin."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Final

from truejoint.array_types import Array
from truejoint.crtk.arm import Arm
from truejoint.crtk.protocol import Listener
from truejoint.crtk.states import OperatingState, StateCommand, next_state
from truejoint.errors import CommandRefused, MotionStopped
from truejoint.robots import Robot
from truejoint.robots.catalogue import DEFAULT
from truejoint.robots.joint_rows import GRAIN, SETPOINT_DT
from truejoint.simulation import Twin, TwinOutput, make_twin


class SimulatedBackend:
    """Executes an arm's commands on a digital twin, far faster than real time.

    Parameters
    ----------
    twin : Twin
        Kept by reference: its load may be changed while the arm works.

    Examples
    --------
    >>> SimulatedBackend(truejoint.simulation.make_twin("raven2", seed=1)).robot.name
    'raven2'
    """

    def __init__(self, twin: Twin) -> None:
        self.twin = twin
        self.robot: Final[Robot] = twin.robot
        self._state = OperatingState("DISABLED", is_homed=False, is_busy=False, t=twin.time)
        self._listener: Listener | None = None
        self._lock = threading.RLock()  # of the twin, whose time one thread at a time lets pass
        self._now = twin.time  # when a piece of it ended last: it may try a motion before it does
        self._queue = threading.RLock()  # of those who wait for it: who drives the arm lets them in

    @property
    def time(self) -> float:
        """Simulated time [s]; while a piece of it is worked on, when the one before ended."""
        if self._lock.acquire(blocking=False):
            try:
                self._now = self.twin.time
            finally:
                self._lock.release()
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
        with self._queue, self._lock:
            after = next_state(self._state, command)
            homing = command == "home"
            self._state = replace(after, is_homed=False, is_busy=True) if homing else after
        if homing:
            self._home(timeout)

    def servo_jp(self, position: Array, go_on: Callable[[], bool]) -> int:
        """Run the twin along set-points (n, n_joints) [rad or m] at 1 kHz, all or none.

        For others the clock leaps. A leap that is stopped in the middle is taken back: the arm
        stands when who stopped it read the clock.
        """
        self._give_way()
        with self._turn():
            if not go_on():
                return 0
            back = self.twin.saved() if len(position) * SETPOINT_DT > GRAIN else None
            output, load = self.twin.run(position), self.twin.load
            now = self.twin.time
            if back is not None and not go_on():
                back()
                self.twin.load = load  # another's to change meanwhile
                return 0
            self._now = now  # right after the asking: nobody reads the old time and is not heard
        self._deliver(output)
        return len(position)

    def flush(self) -> None:
        """Return at once: what is sent is executed."""

    def wait(self, duration: float) -> None:
        """Let `duration` [s] pass with the brakes on."""
        with self._turn():
            self.twin.idle(duration)

    def _home(self, timeout: float) -> None:
        start, last, pieces = self.twin.time, None, self.twin.homing()
        try:
            while (piece := self._piece(pieces)) is not None:
                last = piece
                self._passed(piece)
                if self.twin.time - start > timeout:
                    raise CommandRefused(f"'home' stopped: not done after {timeout:g} s")
        finally:
            with self._lock:
                pieces.close()
                self._state = replace(self._state, is_busy=False)
        # Positions before the registration mean nothing, so only the end pose is reported.
        if last is not None and self._listener is not None:
            self._listener(last.rows(slice(-1, None)))

    def _piece(self, pieces: Iterator[TwinOutput]) -> TwinOutput | None:
        """Next piece of the homing; after the last one the arm is homed."""
        self._give_way()
        with self._turn():
            state = self._state.state
            if state != "ENABLED":
                raise MotionStopped(
                    f"'home' stopped at t = {self.twin.time:.3f} s: {state}; the arm is not homed"
                )
            piece = next(pieces, None)
            if piece is None:
                self._state = replace(self._state, is_homed=True)
        return piece

    @contextmanager
    def _turn(self) -> Iterator[None]:
        """Let time of the twin pass, and no other thread meanwhile."""
        with self._lock:
            try:
                yield
            finally:
                self._now = self.twin.time

    def _give_way(self) -> None:
        """Let those in who wait for the twin; a lock that is free again would not."""
        with self._queue:
            pass

    def _passed(self, piece: TwinOutput) -> None:
        """Note that a piece of the homing is over; it takes no longer than to compute it."""

    def _deliver(self, output: TwinOutput) -> None:
        if self._listener is None:
            return
        self._listener(output)
        if len(output.truth.t):
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

    Parameters, and what is raised, are those of `truejoint.simulation.make_twin`. An arm on a
    twin of one's own making is ``Arm(SimulatedBackend(twin))``.

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
