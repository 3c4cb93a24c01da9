"""An arm that follows set-points as they come from elsewhere, at any rate and with any delay."""

import math
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Final

import numpy as np

from truejoint.array_types import Array
from truejoint.crtk.arm import Arm
from truejoint.crtk.handle import Motion
from truejoint.errors import TruejointError
from truejoint.robots.blocks import check_range

LAPSE: Final = 0.02  # [s] without a new set-point: an arm that has reached the last one stands
_ENDING: Final = 0.1  # [s] that a stream may take to end before a set-point is lost; a pause waits
_PIECE: Final = 2e-3  # [s] of set-points that are sent at once: the newest one has to wait for them
_BURST: Final = 0.04  # [s] of set-points that one stands for where those between were passed over
_HASTE: Final = 0.95  # share of the time between stamps in which what came late is gone through


@dataclass(eq=False)
class _Stream:
    """Newest set-point (n_joints,) [rad or m] of a motion that follows them, and its stamp [s]."""

    goal: Array
    t: float
    is_ended: bool = False
    is_limited: bool = False
    motion: Motion | None = None

    @property
    def is_over(self) -> bool:
        """Whether no newer set-point will be looked at."""
        return self.is_ended or (self.motion is not None and not self.motion.is_busy())


class SetpointFollower:
    """Takes an arm to the newest set-point that was asked for, no joint faster than its top speed.

    A set-point that is further away than one period allows is approached at top speed, along a
    straight line of the joints. A newer one takes its place at once: none is queued. If others were
    passed over for it, it takes nearly the time that its stamp says, up to 40 ms: a link that
    jitters changes no speed. The motion ends once the newest is reached and no other comes within
    `LAPSE`. `say` is called with the command and a line where the arm cannot keep up.
    """

    def __init__(self, arm: Arm, say: Callable[[str, str], None]) -> None:
        self._arm, self._say = arm, say
        self._step = np.array([joint.max_speed for joint in arm.robot.joints]) / arm.rate
        self._asked = threading.Condition()  # of the stream
        self._stream: _Stream | None = None

    def goal(self, command: str) -> Array:
        """Set-point (n_joints,) that a relative `command` starts at; refused if not ready."""
        stream = self._stream
        if stream is not None and not stream.is_over:
            return stream.goal
        return self._arm.latest_setpoint(command, pre_empts=True)

    def ask(self, target: Array, command: str, t: float = 0.0) -> None:
        """Go to `target` (n_joints,) [rad or m] of `t` [s]; refused out of range or not ready."""
        check_range(self._arm.robot, target[None], command)
        with self._asked:
            stream = self._stream
            if stream is not None and not stream.is_over:
                stream.goal, stream.t = target, t
                self._asked.notify()
                return
        if stream is not None and stream.motion is not None:
            stream.motion.over.wait(_ENDING)  # it has reached its last one, and ends
        start = self._arm.latest_setpoint(command)
        self._stream = stream = _Stream(target, t)
        pieces = self._pieces(stream, start, command)
        try:
            stream.motion = self._arm.stream(pieces, math.inf, command)
        except BaseException:
            stream.is_ended = True
            raise

    def stop(self) -> None:
        """Follow no more: the arm brakes, and takes other commands."""
        stream = self._stream
        if stream is not None and stream.motion is not None:
            stream.is_ended = True
            with suppress(TruejointError):
                stream.motion.cancel()

    def _pieces(self, stream: _Stream, here: Array, command: str) -> Iterator[Array]:
        """Set-points (n, n_joints) from `here` (n_joints,), as long as new ones come."""
        rate, t = self._arm.rate, stream.t
        most = max(round(_PIECE * rate), 1)

        def is_news() -> bool:
            return stream.is_over or not np.array_equal(stream.goal, here)

        try:
            while True:
                with self._asked:
                    if not self._asked.wait_for(is_news, LAPSE) or stream.is_over:
                        stream.is_ended = True
                        return
                    goal, stamp = stream.goal, stream.t
                periods = max(math.ceil(float(np.max(np.abs(goal - here) / self._step)) - 1e-6), 1)
                if periods > most and not stream.is_limited:
                    stream.is_limited = True
                    self._say(
                        command, "a set-point is further away than the joints can go in a period; "
                        "the arm goes there at top speed",
                    )  # fmt: skip
                t = max(t, stamp - _BURST)
                periods = max(periods, round(_HASTE * (stamp - t) * rate))
                sent = min(periods, most)
                t += (stamp - t) * sent / periods
                share = np.arange(1, sent + 1)[:, None] / periods
                rows = goal - (1.0 - share) * (goal - here)
                here = rows[-1]
                yield rows
        finally:
            stream.is_ended = True
