"""A motion under way, as its command returns it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field

from truejoint.errors import CommandRefused, MotionStopped


@dataclass(eq=False)
class Motion:
    """A motion that an `Arm` was told to make: how far it is, and whether it is over.

    Attributes
    ----------
    command : str
        Name of the command, for instance ``"move_jp"``.
    duration : float
        From rest to rest [s], on the robot's clock.
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
    _stop: Callable[[Motion, str], None] = field(repr=False)
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
        return MotionStopped(
            f"{self.command} stopped at t = {t:.3f} s, {self.progress:.0%} done: {why}"
        )
