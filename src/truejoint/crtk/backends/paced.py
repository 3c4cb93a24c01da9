"""The simulated back end at the pace of the wall clock, as a robot's control computer runs."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Final

import numpy as np

from truejoint.array_types import Array
from truejoint.crtk.backends.simulated import SimulatedBackend
from truejoint.crtk.protocol import ARRIVAL
from truejoint.crtk.states import OperatingState
from truejoint.errors import CommandRefused, TruejointError
from truejoint.robots.blocks import SETPOINT_DT, StateBlock
from truejoint.simulation import Twin, TwinOutput

_AHEAD: Final = 5e-3
"""Time of the set-points that may wait to be executed while more are asked for [s]."""
_HOPELESS: Final = 0.1  # lateness [s] after which the clock is taken up anew
_KEPT: Final = 1_200_000  # periods, twenty minutes
_LATE: Final = 1.5  # periods


@dataclass(frozen=True)
class LoopTiming:
    """How evenly a loop has run; times are between the starts of two passes.

    Attributes
    ----------
    periods : int
        How many were looked at.
    median, p99, worst : float
        [s].
    late_share : float
        Share of periods more than half as long again as they are to be.
    restarts : int
        How often the loop fell so far behind that its clock was taken up anew.

    Examples
    --------
    >>> LoopTiming.of(np.array([0.0, 0.001, 0.003]), 0.001).late_share
    0.5
    """

    periods: int
    median: float
    p99: float
    worst: float
    late_share: float
    restarts: int = 0

    @classmethod
    def of(cls, starts: Array, period: float, restarts: int = 0) -> LoopTiming:
        """Judge a loop of a `period` [s] whose passes started at `starts` (n,) [s], n >= 2."""
        periods = np.diff(starts)
        median, p99 = np.quantile(periods, [0.5, 0.99])
        late = float((periods > _LATE * period).mean())
        return cls(len(periods), float(median), float(p99), float(periods.max()), late, restarts)


class PacedBackend(SimulatedBackend):
    """A digital twin that takes a millisecond for a millisecond, and reports all the time.

    A thread runs the twin along the set-points sent, else holding the last one; once homed, state
    messages come one at a time, `rate` a second. Close the arm to end it.

    Parameters
    ----------
    twin : Twin
        Kept by reference.
    rate : float
        As that of `SimulatedBackend`.
    homed : bool
        Begin enabled and homed, as if the robot had been before; that takes as long as it computes.

    Examples
    --------
    >>> arm = truejoint.crtk.Arm(PacedBackend(truejoint.simulation.make_twin(seed=1)))
    >>> arm.enable()
    >>> arm.close()
    """

    def __init__(self, twin: Twin, *, rate: float = 1.0 / SETPOINT_DT, homed: bool = False) -> None:
        super().__init__(twin, rate=rate)
        self.period: Final = 1.0 / self.rate
        self._most = max(round(_AHEAD * self.rate), 1)  # set-points that wait
        if homed:
            self._last = twin.home().rows(slice(-1, None))
            self._state = OperatingState("ENABLED", is_homed=True, is_busy=False, t=twin.time)
        self._waiting: deque[Array] = deque()
        self._moved = threading.Condition()
        self._starts = np.empty(_KEPT)  # of the latest passes, a ring
        self._passes = 0
        self._restarts = 0
        self._closed = threading.Event()
        self._hold = self.robot.home
        self._failure: BaseException | None = None
        self._due = 0.0
        self._thread = threading.Thread(target=self._loop, name="paced arm", daemon=True)
        self._thread.start()

    def disconnect(self) -> None:
        """Deliver no more blocks, and end the loop."""
        super().disconnect()
        self._closed.set()
        if threading.current_thread() is not self._thread:
            self._thread.join(1.0)

    def timing(self) -> LoopTiming:
        """How evenly the loop has run up to now; CommandRefused if it has hardly begun."""
        passes = self._passes
        if passes < 2:
            raise CommandRefused("timing refused: the loop has not run yet")
        first = passes - min(passes, _KEPT)
        starts = self._starts[np.arange(first, passes) % _KEPT]
        return LoopTiming.of(starts, self.period, self._restarts)

    def servo_jp(self, position: Array, go_on: Callable[[], bool]) -> int:
        """Queue set-points (n, n_joints) [rad or m]; returns when nearly all are executed.

        Those that still wait when it is not to go on are not taken, but for the next few.
        """
        with self._moved:
            self._waiting.extend(position)
            return len(position) - self._wait_for(self._most, go_on)

    def flush(self, timeout: float = ARRIVAL, go_on: Callable[[], bool] = lambda: True) -> str:
        """Return once all set-points are executed."""
        del timeout, go_on  # they are, within some periods
        with self._moved:
            self._wait_for(0, lambda: True)
        return ""

    def wait(self, duration: float) -> None:
        """Let `duration` [s] of the wall clock pass."""
        self._closed.wait(duration)

    def _wait_for(self, most: int, go_on: Callable[[], bool]) -> int:
        """Wait until no more than `most` set-points wait; gives how many were dropped instead."""
        dropped = 0
        while len(self._waiting) > most:
            if not go_on():
                self._waiting.pop()
                dropped += 1
                continue
            if self._failure is not None:
                raise self._failure
            if self._closed.is_set():
                self._waiting.clear()
                raise CommandRefused("servo_jp refused: the arm is closed")
            if not self._state.is_ready:
                self._waiting.clear()
                raise CommandRefused(f"servo_jp stopped: the arm is {self._state.state}")
            self._moved.wait(self.grain)
        return dropped

    def _loop(self) -> None:
        """Each period go to a set-point, hold the last one, or stand on the brakes."""
        due = time.perf_counter()
        while not self._closed.is_set():
            due += self.period
            late = time.perf_counter() - due
            if late < 0.0:
                time.sleep(-late)
            elif late > _HOPELESS:
                due, self._restarts = due + late, self._restarts + 1
            self._starts[self._passes % _KEPT] = time.perf_counter()
            self._passes += 1
            try:
                with self._advancing_twin():
                    if self._state.is_busy:
                        continue  # homing lets the time pass itself
                    if self._state.is_ready:  # to the next set-point, or hold the last one
                        with self._moved:
                            self._hold = self._waiting[0] if self._waiting else self._hold
                        output: StateBlock | None = self._run(self._hold[None])
                    else:
                        output = self._stand(self.period)
                self._deliver(output)
                with self._moved:  # who waits for a set-point finds it reported
                    if self._waiting and self._waiting[0] is self._hold:
                        self._waiting.popleft()
                    self._moved.notify_all()
            except BaseException as error:  # noqa: BLE001  # a subscriber's: the arm stops
                self._failure = error
                with suppress(TruejointError):
                    SimulatedBackend.state_command(self, "pause", 1.0)
                return

    def _passed(self, piece: TwinOutput) -> None:
        """Let the time of a piece of the homing pass."""
        duration = len(piece.t) * SETPOINT_DT
        now = time.perf_counter()
        self._due = max(self._due, now - _HOPELESS) + duration
        if self._due > now:
            self._closed.wait(self._due - now)
        self._hold = self.robot.home
