"""State messages of an arm's topics as rows of a recording's columns."""

import logging
import math
from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack
from functools import partial
from itertools import product
from typing import Any, Final

import numpy as np

from truejoint.array_types import Array
from truejoint.crtk import messages
from truejoint.crtk.messages import JOINT_STATE, RAVEN_STATE, RAVEN_TOPIC, Profile
from truejoint.crtk.protocol import SILENCE
from truejoint.crtk.ros.transport import Transport
from truejoint.errors import RobotError, meant
from truejoint.robots import Robot
from truejoint.robots.blocks import QUANTITIES

_FIELDS: Final = ("position", "velocity", "effort")
_RAVEN_FIELDS: Final = tuple(messages.RAVEN_FIELDS[name][0] for name in QUANTITIES)

_log = logging.getLogger(__name__)

Row = Callable[[Any, float, Mapping[str, Array]], None]


class StateStream:
    """Columns of every state message of an arm, from `start` to `close`.

    They are read from ``measured_js``, with the newest ``setpoint_js`` beside it unless that is
    `SILENCE` older; of a robot whose profile says that CRTK's messages lack effort and
    set-point, from its ``ravenstate``. The arm's topics are in `namespace`, for instance
    ``"/PSM1"``, by default the profile's. `on_row` is called with a state message, its stamp [s]
    and its columns, (1,) each. Messages with an invalid stamp are left out, and counted in
    `invalid`; `refusal` says why the latest could not be read, `stale` since when set-points have
    ceased, each empty where that is not so.
    """

    def __init__(
        self, transport: Transport, robot: Robot, profile: Profile, on_row: Row, namespace: str = ""
    ) -> None:
        self._transport, self._robot, self._profile = transport, robot, profile
        self._on_row = on_row
        self.namespace = namespace.rstrip("/")
        self.reads_raven = not self.namespace and profile.no_effort and profile.no_setpoint
        self.topic = RAVEN_TOPIC if self.reads_raven else self.name("measured_js")
        self.invalid = 0
        self.refusal = self.stale = ""
        self._setpoint: Mapping[str, Array] = {}
        self._told = math.nan  # stamp of that [s]
        self._topics = ExitStack()

    def name(self, crtk: str) -> str:
        """Topic of a CRTK name of this arm."""
        return self._profile.topic(self._robot.arm, crtk, self.namespace)

    def namespaces(self, kinds: Iterable[str], topic: str) -> str:
        """Say under which namespaces arms report, by topics' names, where a `topic` is not one."""
        ending = "/" + topic.rsplit("/", 1)[-1]
        spaces = sorted(name.removesuffix(ending) for name in kinds if name.endswith(ending))
        if not spaces:
            return "no arm reports: start the node of the robot, in this ROS master or domain"
        near = self.namespace and meant(self.namespace, spaces)
        return f"arms report under {', '.join(spaces)}:{near or ' give one'}"

    def start(self) -> None:
        """Begin to listen."""
        subscribe, begun = self._transport.subscribe, self._topics.callback
        raven, joints = (RAVEN_STATE, self._raven), (JOINT_STATE, self._measured)
        kind, read = raven if self.reads_raven else joints
        begun(subscribe(self.topic, kind, partial(self._take, read)))
        if not self._profile.no_setpoint:
            begun(subscribe(self.name("setpoint_js"), JOINT_STATE, self._on_setpoint))

    def close(self) -> None:
        """Listen no more."""
        self._topics.close()
        self._setpoint = {}

    def _measured(self, message: Any, t: float) -> Mapping[str, Array]:
        columns = self.columns_of(message, "measured")
        quantities = {name.partition("/")[0]: None for name in columns}
        unused = map("/".join, product(quantities, self._robot.unused_channels))
        return {**columns, **dict.fromkeys(unused, np.zeros(1)), **self._newest(t)}

    def _raven(self, message: Any, _: float) -> Mapping[str, Array]:
        fields = {name: np.array([getattr(message, name)]) for name in _RAVEN_FIELDS}
        return messages.raven_state_columns(self._robot, fields, QUANTITIES)

    def _on_setpoint(self, message: Any) -> None:
        t = self._transport.seconds(message)
        if not t > 0.0:
            return
        try:
            self._setpoint, self._told = self.columns_of(message, "setpoint"), t
        except RobotError as refusal:
            self.refusal = f"{self.name('setpoint_js')}: {refusal}"

    def _newest(self, t: float) -> Mapping[str, Array]:
        """Set-points beside a state of `t` [s]; none where the newest ones are of long before."""
        if not self._setpoint or abs(t - self._told) <= SILENCE:
            self.stale = ""
            return self._setpoint
        if not self.stale:
            self.stale = f"{self.name('setpoint_js')} has been silent since {self._told:.3f} s"
            _log.warning("%s, while %s goes on", self.stale, self.topic)
        return {}

    def columns_of(self, message: Any, quantity: str) -> dict[str, Array]:
        """Columns of a joint state; raises RobotError as `joint_state_columns`."""
        fields = {name: np.array([getattr(message, name)], dtype=float) for name in _FIELDS}
        return messages.joint_state_columns(
            self._robot, quantity, message.name, fields, self._profile
        )

    def _take(self, columns: Callable[[Any, float], Mapping[str, Array]], message: Any) -> None:
        t = self._transport.seconds(message)
        if not t > 0.0:
            self.invalid += 1
            return
        try:
            row = columns(message, t)
        except (RobotError, AttributeError) as refusal:  # a variant that lacks a field
            self.refusal = f"{self.topic}: {refusal}"
            return
        self.refusal = ""
        self._on_row(message, t, row)
