"""What an arm hands out and keeps: a motion under way, and who hears of its blocks."""

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, field

from truejoint.crtk.protocol import Listener
from truejoint.errors import CommandRefused, MotionStopped
from truejoint.robots.blocks import StateBlock, TruthBlock


@dataclass(eq=False)
class Motion:
    """A motion that an `Arm` was told to make: how far it is, and whether it is over.

    Attributes
    ----------
    command : str
        Name of the command, for instance ``"move_jp"``.
    duration : float
        Time from rest to rest [s], on the robot's clock.
    elapsed : float
        How much of it has been sent to the robot [s].
    over : threading.Event
        Set once it has ended, however that was.
    thread : threading.Thread, optional
        Thread that drives the arm; it has ended once a wait for the motion returns.

    Examples
    --------
    >>> motion = arm.move_jp(arm.robot.home)
    >>> motion.wait()
    >>> motion.is_busy(), motion.progress
    (False, 1.0)
    """

    command: str
    duration: float
    _stop: "Callable[[Motion, str], None]" = field(repr=False)
    elapsed: float = 0.0
    over: threading.Event = field(default_factory=threading.Event, repr=False)
    thread: threading.Thread | None = field(default=None, repr=False)
    _error: BaseException | None = field(default=None, repr=False)

    @property
    def progress(self) -> float:
        """Share that has been sent, from 0 to 1."""
        return min(self.elapsed / self.duration, 1.0) if self.duration > 0.0 else 1.0

    @property
    def time_left(self) -> float:
        """Time until the last set-point is sent [s], on the robot's clock; 0 once it is over."""
        return 0.0 if self.over.is_set() else max(self.duration - self.elapsed, 0.0)

    def is_busy(self) -> bool:
        """Whether the arm is still at it."""
        return not self.over.is_set()

    def wait(self, timeout: float | None = None) -> None:
        """Return once the motion has ended as planned.

        Raises MotionStopped if it was stopped, whatever else ended it, and CommandRefused when it
        is not over after `timeout` [s] of this computer's clock; it then goes on. An interrupt
        (Ctrl-C) meanwhile pauses the arm.
        """
        try:
            over = self.over.wait(timeout)
        except BaseException:
            self._stop(self, "pause")
            raise
        if not over:
            raise CommandRefused(
                f"{self.command} is not over after {timeout:g} s ({self.progress:.0%} done); it "
                "goes on: wait longer or cancel it"
            )
        if self.thread is not None:
            self.thread.join()
        if self._error is not None:
            raise self._error

    def cancel(self) -> None:
        """Brake and hold, the arm staying enabled; returns once it stands, also if it is over."""
        self._stop(self, "hold")

    def ended(self, error: BaseException | None) -> None:
        """Mark as over, as planned or by `error`; the arm's to call."""
        self._error = error
        self.over.set()

    def stopped(self, why: str, t: float) -> MotionStopped:
        """Error that says that, when and how far along it was stopped."""
        done = f", {self.progress:.0%} done" if math.isfinite(self.duration) else ""
        return MotionStopped(f"{self.command} stopped at t = {t:.3f} s{done}: {why}")


@dataclass(eq=False)
class Subscription:
    """Calls `callback` with blocks that span up to `every` seconds, the states first."""

    callback: Listener
    every: float
    _states: list[StateBlock] = field(default_factory=list)
    _truths: list[TruthBlock] = field(default_factory=list)
    _lock: threading.RLock = field(default_factory=threading.RLock)  # blocks stay in order

    def __call__(self, block: StateBlock | TruthBlock) -> None:
        """Deliver a block, or keep it until there is enough."""
        if self.every <= 0.0:
            self.callback(block)
            return
        with self._lock:
            if isinstance(block, TruthBlock):
                self._truths.append(block)
                return
            # A truth that came with an earlier state is delivered with it.
            if self._states and block.t.size and block.t[-1] - self._states[0].t[0] > self.every:
                self.flush()
            self._states.append(block)

    def flush(self) -> None:
        """Deliver what is kept."""
        with self._lock:
            states, self._states = self._states, []
            truths, self._truths = self._truths, []
            if states:
                self.callback(StateBlock.joined(states))
            if truths:
                self.callback(TruthBlock.joined(truths))
