"""The simulated back end at the pace of the wall clock, as a robot's control computer runs."""

import math
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from copy import deepcopy
from itertools import islice
from typing import Final

import numpy as np

from truejoint.array_types import Array
from truejoint.crtk.backends.simulated import SimulatedBackend
from truejoint.crtk.protocol import ARRIVAL, STRETCH
from truejoint.crtk.states import OperatingState
from truejoint.errors import CommandRefused, TruejointError
from truejoint.robots.blocks import SETPOINT_DT, StateBlock
from truejoint.simulation import Twin, TwinOutput

_AHEAD: Final = 5e-3
"""Time of the set-points that may wait to be executed while more are asked for, and that a late
clock makes up for at once [s]."""
_HOPELESS: Final = 0.1  # lateness [s] after which the clock is taken up anew


class PacedBackend(SimulatedBackend):
    """A digital twin that takes a millisecond for a millisecond, and reports all the time.

    A thread runs the twin along the set-points sent, else holding the last one; once homed, state
    messages come one at a time, `rate` a second, or some at once where the computer is late. Close
    the arm to end it.

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

    stretch = STRETCH

    def __init__(self, twin: Twin, *, rate: float = 1.0 / SETPOINT_DT, homed: bool = False) -> None:
        super().__init__(twin, rate=rate)
        self.period: Final = 1.0 / self.rate
        self._most = max(round(_AHEAD * self.rate), 1)  # set-points that wait
        rehearsal = deepcopy(twin)  # so that all is compiled before others wait for its messages
        rehearsal.home()
        rehearsal.idle(0.0)
        if homed:
            self._last = twin.home().rows(slice(-1, None))
            self._state = OperatingState("ENABLED", is_homed=True, is_busy=False, t=twin.time)
        self._waiting: deque[Array] = deque()
        self._moved = threading.Condition()
        self._closed = threading.Event()
        self._hold = self.robot.home
        self._failure: BaseException | None = None
        self._due = 0.0
        self._streamed = -math.inf  # when the last set-point was executed [s]
        self._thread = threading.Thread(target=self._loop, name="paced arm", daemon=True)
        self._thread.start()

    def disconnect(self) -> None:
        """Deliver no more blocks, and end the loop."""
        super().disconnect()
        self._closed.set()
        if threading.current_thread() is not self._thread:
            self._thread.join(1.0)

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
        due = time.perf_counter() + self.period
        while not self._closed.is_set():
            late = time.perf_counter() - due
            if late < 0.0:
                time.sleep(-late)
            elif late > _HOPELESS:
                due, late = due + late, 0.0
            periods = min(1 + int(max(late, 0.0) / self.period), self._most)
            try:
                due += self._pass(periods) * self.period
            except BaseException as error:  # noqa: BLE001  # a subscriber's: the arm stops
                self._failure = error
                with suppress(TruejointError):
                    SimulatedBackend.state_command(self, "pause", 1.0)
                return

    def _pass(self, most: int) -> int:
        """Go along waiting set-points, hold the last or stand braked; gives how many periods."""
        setpoints, periods = list[Array](), most
        with self._advancing_twin():
            if self._state.is_busy:
                return most  # homing lets the time pass itself
            if self._state.is_ready:
                with self._moved:
                    setpoints = list(islice(self._waiting, most))
                self._hold = setpoints[-1] if setpoints else self._hold
                # Amid a stream the next one is about to come.
                rests = self.twin.time - self._streamed > _HOPELESS
                path = setpoints or [self._hold] * (most if rests else 1)
                output: StateBlock | None = self._run(np.array(path))
                periods = len(path)
                self._streamed = self.twin.time if setpoints else self._streamed
            else:
                output = self._stand(most * self.period)
        self._deliver(output)
        with self._moved:  # who waits for a set-point finds it reported
            for setpoint in setpoints:
                if self._waiting and self._waiting[0] is setpoint:
                    self._waiting.popleft()
            self._moved.notify_all()
        return periods

    def _passed(self, piece: TwinOutput) -> None:
        duration = len(piece.t) * SETPOINT_DT
        now = time.perf_counter()
        self._due = max(self._due, now - _HOPELESS) + duration
        if self._due > now:
            self._closed.wait(self._due - now)
        self._hold = self.robot.home
