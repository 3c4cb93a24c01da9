"""Temporary joint encoders on a serial line, and as a ROS topic."""

import logging
import math
import re
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from typing import Any, Final, Self

import numpy as np

from truejoint.array_types import Array
from truejoint.crtk.messages import JOINT_STATE, TRUTH_TOPIC, joint_state_fields, profile_of
from truejoint.crtk.ros.transport import Transport
from truejoint.errors import RecordingError, words
from truejoint.extras import require
from truejoint.robots import Robot
from truejoint.robots.blocks import TruthBlock
from truejoint.robots.parts import JointEncoder

RECONNECT: Final = 0.5
"""Time between two tries to open a port that is gone [s]."""
REGISTRATION: Final = 60.0
"""Longest time that the counts during homing are kept for [s]."""
_LINE: Final = {"baudrate": 115200, "timeout": 0.1}
_MOST_WAITING: Final = 4096  # bytes without a whole message: garbage
_LARGEST: Final = 2**31
_log = logging.getLogger(__name__)


class JointEncoders:
    """Temporary joint encoders that send their counts as lines ``n1_n2_n3``.

    They count from where they were switched on. While the arm homes, each joint goes to its hard
    stop: `start_registration` before, `register` after, and the counts at the extreme become the
    known position of the stop. Only then are positions reported, stamped by `clock` [s] when a
    message is complete: by the arm's, for a recording. `port` is such as ``/dev/ttyACM0``, or what
    ``serial.serial_for_url`` takes; `encoders` are in the order of the numbers in a line, such as
    `Robot.encoders`.

    The line is read in a thread, from entering to leaving. A line that is no message is counted in
    `garbage`, and how often the port was gone, which is then opened again, in `disconnections`. If
    a listener raises, as a recorder does on a full disk, reading stops, and leaving raises the
    error. Raises TruejointError without pyserial, RecordingError without encoders and, on entering,
    if the port cannot be opened.

    Source: uw-biorobotics/raven2_CRTK_Python_controller:joint_encoder/
    func_raven_joint_encodersIII.py.
    """

    def __init__(
        self,
        port: str,
        encoders: Sequence[JointEncoder],
        *,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.port: Final = port
        self.messages = self.garbage = self.disconnections = 0
        self._serial: Any = require("serial", "serial", "a sensor on a serial line")
        self._clock = clock
        self._listeners: list[Callable[[TruthBlock], None]] = []
        self._over = threading.Event()
        self._waiting = b""
        self._error: Exception | None = None  # of a listener
        if not encoders:
            raise RecordingError(
                f"{port}: no encoders are stated for this robot; its file needs [[encoders]]"
            )
        self.encoders: Final = tuple(encoders)
        directions = np.array([e.direction for e in encoders])
        self._scale = np.array([e.resolution for e in encoders]) * directions
        self._stops = np.array([encoder.hard_stop for encoder in encoders])
        self._tolerance = np.array([e.tolerance for e in encoders])
        self._upwards = np.where([e.end == "upper" for e in encoders], 1, -1) * directions
        self._line = re.compile(rb"-?\d{1,10}" + rb"_-?\d{1,10}" * (len(encoders) - 1) + rb"\r?")
        self._readings: list[Array] | None = None
        self._began = math.nan
        self._zero: Array | None = None  # counts at the hard stops

    def __enter__(self) -> Self:
        try:
            line = self._serial.serial_for_url(self.port, **_LINE)
        except (self._serial.SerialException, ValueError) as error:
            raise RecordingError(
                f"{self.port}: cannot be opened ({words(error)}); check the "
                "cable, the name and who else uses it"
            ) from None
        self._over.clear()
        self._thread = threading.Thread(target=self._read, args=(line,), daemon=True)
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._over.set()
        self._thread.join()
        error, self._error = self._error, None
        if error is not None and kind is None:
            raise error

    def subscribe(self, callback: Callable[[TruthBlock], None]) -> None:
        """Call `callback` with a TruthBlock for each message, in the thread that reads."""
        self._listeners.append(callback)

    def unsubscribe(self, callback: Callable[[TruthBlock], None]) -> None:
        """Stop calling `callback`; one that is not subscribed is left alone."""
        if callback in self._listeners:
            self._listeners.remove(callback)

    def start_registration(self) -> None:
        """Keep the counts from now on, for at most 60 s: the arm is going to its hard stops."""
        self._zero, self._began, self._readings = None, self._clock(), []

    def register(self) -> Array:
        """Take the extremes since `start_registration` for the hard stops; gives their counts (n,).

        The mean of all within the tolerance. Raises RecordingError if nothing was read, or a joint
        did not move.
        """
        readings, self._readings = self._readings, None
        if not readings:
            raise RecordingError(
                f"{self.port}: no counts were read during the homing ({self.garbage} lines of "
                "garbage); check the cable and the encoders' power"
            )
        counts = np.array(readings)
        still = counts.max(axis=0) - counts.min(axis=0) <= self._tolerance
        if still.any():
            joint = self.encoders[int(np.argmax(still))].joint
            raise RecordingError(
                f"{self.port}: the encoder of {joint} did not move during the homing; check that "
                "it is fixed to the joint, and home again"
            )
        turned = counts * self._upwards
        at_stop = turned >= turned.max(axis=0) - self._tolerance
        self._zero = np.array([counts[rows, k].mean() for k, rows in enumerate(at_stop.T)])
        return self._zero

    def _read(self, line: Any) -> None:
        while not self._over.is_set():
            try:
                received = line.read(max(1, line.in_waiting))
            except (OSError, TypeError, self._serial.SerialException):
                with suppress(Exception):
                    line.close()
                self.disconnections += 1
                self._waiting, line = b"", None
                while line is None and not self._over.wait(RECONNECT):
                    with suppress(OSError, ValueError, self._serial.SerialException):
                        line = self._serial.serial_for_url(self.port, **_LINE)
                continue
            if received:
                try:
                    self._take(received)
                except Exception as error:  # noqa: BLE001  # a listener's, whatever it is
                    self._error = error
                    break
        if line is not None:
            line.close()

    def _take(self, received: bytes) -> None:
        now = self._clock()
        *lines, self._waiting = (self._waiting + received).split(b"\n")
        if len(self._waiting) > _MOST_WAITING:
            self._waiting = b""
            self.garbage += 1
        for line in lines:
            is_message = self._line.fullmatch(line)
            counts = [int(number) for number in line.split(b"_")] if is_message else [_LARGEST]
            if max(map(abs, counts)) >= _LARGEST:
                self.garbage += 1
                continue
            self.messages += 1
            values = np.array(counts, dtype=np.float64)
            readings = self._readings  # which `register` may take away meanwhile
            if readings is not None and now - self._began <= REGISTRATION:
                readings.append(values)
            if self._zero is None:
                continue
            position = self._stops + self._scale * (values - self._zero)
            joints = tuple(encoder.joint for encoder in self.encoders)
            block = TruthBlock(np.array([now]), joints, position[None])
            for listener in tuple(self._listeners):
                listener(block)


class EncoderNode:
    """Publishes what joint encoders read, from entering to leaving, once the arm has homed.

    The arm's ``operating_state`` says when it homes: the encoders are registered at the hard stops
    meanwhile. Positions go out on `TRUTH_TOPIC`, without names as RAVEN-II's encoders publish them,
    from the zero that the profile's readers expect. Where the registration fails, that is said in
    the log, and nothing is published until the arm homes again.

    `encoders` are not entered yet, and stamped by the transport's clock; `profile` and `namespace`
    are as in `truejoint.crtk.messages`; `say` is given a line about what is waited for, and what
    has changed; `published` counts the messages. Raises RobotError if there is no such profile,
    and RecordingError, on entering, if the port cannot be opened.

    References
    ----------
    uw-biorobotics/raven2_CRTK_Python_controller:joint_encoder/run_r2_joint_encodersIII_pub.py
    """

    def __init__(
        self,
        transport: Transport,
        encoders: JointEncoders,
        robot: Robot,
        profile: str = "",
        *,
        namespace: str = "",
        say: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._transport, self._encoders, self._robot, self._say = transport, encoders, robot, say
        self._profile = profile_of(robot, profile)
        self._state_topic = self._profile.topic(robot.arm, "operating_state", namespace)
        self._is_homing = False
        self.published = 0

    def __enter__(self) -> Self:
        with ExitStack() as opened:
            self._out = self._transport.publisher(TRUTH_TOPIC, JOINT_STATE)
            opened.callback(self._out.close)
            opened.enter_context(self._encoders)
            self._encoders.subscribe(self._publish)
            opened.callback(self._encoders.unsubscribe, self._publish)
            kind = self._profile.operating_state
            opened.callback(self._transport.subscribe(self._state_topic, kind, self._on_state))
            self._open = opened.pop_all()
        self._say(f"waiting for the arm to home: {self._state_topic}")
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    def _on_state(self, message: Any) -> None:
        if message.is_busy and not message.is_homed and not self._is_homing:
            self._is_homing = True
            self._encoders.start_registration()
            self._say("the arm homes: the encoders are registered")
        elif self._is_homing and not message.is_homed and not message.is_busy:
            self._is_homing = False  # it was stopped: the next homing is registered anew
        elif message.is_homed and self._is_homing:
            self._is_homing = False
            try:
                self._encoders.register()
            except RecordingError as error:
                _log.warning("%s", error)
            else:
                self._say(f"registered; positions go out on {TRUTH_TOPIC}")

    def _publish(self, block: TruthBlock) -> None:
        columns = {f"truth/{name}": block.position[:, k] for k, name in enumerate(block.name)}
        robot, profile = self._robot, self._profile
        fields = joint_state_fields(robot, "truth", TRUTH_TOPIC, columns, profile)[1]
        for t, position in zip(block.t.tolist(), fields["position"].tolist(), strict=True):
            message = self._transport.stamped(JOINT_STATE, t)
            message.position = position
            self._out.publish(message)
            self.published += 1
