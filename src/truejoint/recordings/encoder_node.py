"""Temporary joint encoders on a serial line as a ROS topic."""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any, Self

from truejoint.crtk.messages import JOINT_STATE, TRUTH_TOPIC, joint_state_fields, profile_of
from truejoint.crtk.ros.transport import Transport
from truejoint.errors import RecordingError
from truejoint.recordings.joint_encoders import JointEncoders
from truejoint.robots import Robot
from truejoint.robots.blocks import TruthBlock

_log = logging.getLogger(__name__)


class EncoderNode:
    """Publishes what joint encoders read, from entering to leaving, once the arm has homed.

    The arm's ``operating_state`` says when it homes: the encoders are registered at the hard stops
    meanwhile. Positions go out on `TRUTH_TOPIC`, without names as RAVEN-II's encoders publish them,
    from the zero that the profile's readers expect. Where the registration fails, that is said in
    the log, and nothing is published until the arm homes again.

    Parameters
    ----------
    transport : Transport
    encoders : JointEncoders
        Not entered yet; stamped by the transport's clock (``clock=transport.now``).
    robot : Robot
    profile : str
        How its messages differ from CRTK, by name (`truejoint.crtk.messages.PROFILES`).
    namespace : str
        Of the arm's topics; by default what the profile says.
    say : callable
        Is given a line about what is waited for, and what has changed.

    Attributes
    ----------
    published : int
        Messages so far.

    Raises
    ------
    RobotError
        If there is no such profile.
    RecordingError
        On entering, if the port cannot be opened.

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
        self._open = ExitStack()
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
