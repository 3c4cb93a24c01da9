"""Pages of an arm that works, and of a recording."""

import logging
import math
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import replace
from functools import cache, partial
from typing import Any, Final, Self

import numpy as np

from truejoint.calibration import Calibration
from truejoint.crtk.arm import Arm, as_arm
from truejoint.drawing import Panel
from truejoint.errors import TruejointError
from truejoint.monitor.page import FRAME_RATE, LOOPBACK, PORT, WINDOW, Page, chosen
from truejoint.monitor.panels import COLOURS, EVERY, overview
from truejoint.monitor.process import PageProcess
from truejoint.monitor.samples import MOST_ROWS, Condition, LiveSamples, Samples
from truejoint.recordings.table.recording import Recording, as_recording
from truejoint.robots.blocks import StateBlock, TruthBlock
from truejoint.threads import short_turns

_SPEEDS: Final = ("0.25", "1", "2", "5", "20")

_log = logging.getLogger(__name__)


class _Pictures:
    """Makes pictures by `_frame` in a thread, from `_start` until its `with` block is left."""

    _page: Any
    _frame: Callable[[], None]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Take the page down."""
        self._closed.set()
        self._thread.join(2.0)
        self._page.close()

    def _failed(self, error: Exception) -> None:
        self._page.stopped(error)

    def _start(self) -> None:
        self.url = self._page.url
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._loop, name="monitor", daemon=True)
        self._thread.start()

    def _loop(self) -> None:
        due = time.monotonic()
        while not self._closed.wait(max(due - time.monotonic(), 0.0)):
            try:
                self._frame()
            except Exception as error:  # noqa: BLE001  # whatever it is, the arm goes on
                if not self._closed.is_set():  # which a picture that was long under way has missed
                    self._failed(error)
                return
            due = max(due + 1.0 / FRAME_RATE, time.monotonic())


class ArmPage(_Pictures):
    """A page in the browser that shows an arm while it works.

    It takes the arm's reports from a subscription that only keeps them, and corrects every sample
    in another thread. A second process draws 25 pictures a second: reported, corrected and true
    pose, positions, corrections with their interval, efforts, and how evenly messages come. Its
    buttons pause and resume the arm. It listens on this computer alone, and loads nothing from
    elsewhere.

    Parameters
    ----------
    arm : Arm
        Any; it may be used and moved meanwhile as ever.
    calibration : Calibration, optional
        Calibration of this arm.
    host : str
        Address at which the page listens. Beyond loopback its address holds a token, without which
        nobody opens it, and it offers to pause the arm alone.
    port : int
        0 for any that is free.
    remote_control : bool
        Whether the page offers to resume the arm beyond loopback, too.

    Attributes
    ----------
    url : str
        Address of the page.

    Raises
    ------
    CalibrationError
        If the calibration is of another arm.
    TruejointError
        If viser is not installed or the port is taken.

    Notes
    -----
    While the page is open, threads of this process take turns after 0.1 ms rather than Python's 5
    (`truejoint.threads.short_turns`), so that correcting holds up no loop that runs beside it.

    Examples
    --------
    >>> with ArmPage(arm, port=0) as page:
    ...     page.url[:17]
    'http://127.0.0.1:'
    """

    def __init__(
        self,
        arm: Arm,
        calibration: Calibration | None = None,
        *,
        host: str = LOOPBACK,
        port: int = PORT,
        remote_control: bool = False,
    ) -> None:
        self._arm = as_arm(arm)
        self._live = LiveSamples(arm.robot, calibration)
        self._inbox: deque[tuple[float, StateBlock | TruthBlock]] = deque(maxlen=2 * MOST_ROWS)
        self._last_arrival = math.nan
        self._refusal = ""
        self._page: PageProcess = PageProcess(
            arm.robot, self._command, host=host, port=port, remote_control=remote_control
        )
        self._turns = ExitStack()
        self._turns.enter_context(short_turns())
        arm.subscribe(self._receive)
        self._start()

    def close(self) -> None:
        """Take the page down; the arm goes on."""
        self._arm.unsubscribe(self._receive)
        super().close()
        self._turns.close()

    def _receive(self, block: StateBlock | TruthBlock) -> None:
        """Keep a block; in the arm's own thread, so no more than that."""
        self._inbox.append((time.perf_counter(), block))

    def _command(self, name: str) -> None:
        try:
            self._arm.state_command(name)
        except Exception as error:  # noqa: BLE001  # whatever a back end raises, who asked hears it
            self._page.say(error)

    def _frame(self) -> None:
        condition = Condition.of(self._arm)
        row = self._row(condition)
        if self._refusal:
            reasons = filter(None, (condition.reason, self._refusal))
            condition = replace(condition, reason="; ".join(reasons))
        self._page.show(row, condition)

    def _failed(self, error: Exception) -> None:
        self._arm.unsubscribe(self._receive)
        self._inbox.clear()
        _log.warning("the monitor's page has stopped, the arm goes on: %s", error)
        super()._failed(error)

    def _row(self, condition: Condition) -> Samples | None:
        states, truths, longest = [], [], math.nan
        for _ in range(len(self._inbox)):
            arrived, block = self._inbox.popleft()
            if isinstance(block, TruthBlock):
                truths.append(block)
            elif len(block.t):
                states.append(block)
                longest = np.fmax(longest, arrived - self._last_arrival)
                self._last_arrival = arrived
        if not condition.is_fresh:
            self._last_arrival = math.nan  # it stands: no interval of its loop
        if not states:
            return None
        with suppress(Exception):  # no answer now: homed as it last said
            self._live.set_homing(self._arm.operating_state().is_homed, self._arm.homing_id)
        try:
            return self._live.row(states, truths, float(longest), is_braked=condition.is_braked)
        except TruejointError as error:
            self._refusal = str(error)
            self._live = LiveSamples(self._arm.robot)
            return None


class RecordingPage(_Pictures):
    """A page in the browser that shows a recording, to be played and scrubbed through.

    Parameters
    ----------
    recording : Recording
    calibration : Calibration, optional
        Calibration of the recorded arm.
    host, port
        As those of `ArmPage`.

    Attributes
    ----------
    url : str
        Address of the page.

    Raises
    ------
    RecordingError
        If no measured position is in it.
    CalibrationError
        If the calibration is not for it.
    TruejointError
        If viser is not installed or the port is taken.

    Examples
    --------
    >>> with RecordingPage(test, model, port=0) as page:
    ...     page.url[:17]
    'http://127.0.0.1:'
    """

    def __init__(
        self,
        recording: Recording,
        calibration: Calibration | None = None,
        *,
        host: str = LOOPBACK,
        port: int = PORT,
    ) -> None:
        self._samples = Samples.of_recording(as_recording(recording), calibration)
        t = self._samples.t
        self._begin, self._end = round(float(t[0]), 2), round(float(t[-1]), 2)  # as they are shown
        self._t = min(self._begin + WINDOW, self._end)  # so that there is something to see
        self._drawn = math.nan
        self._last = time.monotonic()
        self._overview = cache(partial(overview, self._samples, recording.robot))
        self._page: Page = Page(
            recording.robot, self._samples.joints, self._add_controls, self._whole, host=host,
            port=port,
        )  # fmt: skip
        self._start()

    def _scrub(self, event: Any) -> None:
        if event.client is not None:  # moved by a person, not by `_frame`
            self._t = min(max(self._begin, float(self._slider.value)), self._end)  # also of NaN

    def _add_controls(self, gui: Any) -> None:
        self._slider = gui.add_slider("Time [s]", self._begin, self._end, 0.01, self._t)
        self._slider.on_update(self._scrub)
        self._play = gui.add_checkbox("Play", initial_value=False)
        self._speed = gui.add_dropdown("Speed", _SPEEDS, initial_value="1")

    def _whole(self, shown: Samples, joint: str) -> list[Panel]:
        """Give an overview of the whole recording, with a curve of what the other plots show."""
        known = (*self._samples.calibrated, *self._samples.joints)
        whole = self._overview(known[0] if joint == EVERY else joint)
        line = whole.curves[0]
        is_shown = (line.x > shown.t[0]) & (line.x <= shown.t[-1])
        values, colour = np.where(is_shown, line.y, np.nan), COLOURS["corrected"]
        part = replace(line, y=values, label="shown below", colour=colour)
        return [replace(whole, curves=[line, part])]

    def _frame(self) -> None:
        now = time.monotonic()
        passed, self._last = now - self._last, now
        if self._play.value:
            self._t = self._t if self._t < self._end else self._begin  # played to its end: again
            self._t = min(self._t + passed * float(chosen(self._speed)), self._end)
            self._slider.value = self._t
            self._play.value = self._t < self._end
        if self._t == self._drawn:
            return
        self._drawn = self._t
        condition, at_once = Condition("recording", t=self._t), not self._play.value
        self._page.render(self._samples.window(self._t, WINDOW), condition, at_once=at_once)
