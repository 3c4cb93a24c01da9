"""An arm's CRTK interface on ROS topics, so that any client can be tried against it."""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from functools import partial
from typing import Any, Final, Self

import numpy as np
from scipy.spatial.transform import Rotation

from truejoint.array_types import Array
from truejoint.crtk import messages
from truejoint.crtk.arm import Arm
from truejoint.crtk.handle import Motion
from truejoint.crtk.messages import JOINT_STATE, OPERATING_STATE, RAVEN_STATE, STRING_STAMPED
from truejoint.crtk.ros.transport import Publisher, Transport
from truejoint.crtk.topics import topic_columns
from truejoint.errors import CommandRefused, MotionStopped, TruejointError
from truejoint.robots.blocks import StateBlock, TruthBlock

_POSE: Final = "geometry_msgs/PoseStamped"
_TRANSFORM: Final = "geometry_msgs/TransformStamped"
_COMMANDS: Final = (
    "servo_jp", "servo_jr", "servo_jv", "servo_cp", "servo_cr", "move_jp", "move_jr", "move_cp",
    "hold",
)  # fmt: skip
_TOPICS: Final = {"ravenstate": messages.RAVEN_TOPIC, "truth": messages.TRUTH_TOPIC}
_IDLE: Final = 0.01  # [s] between reports of an arm that does not work
_DRIFT: Final = 0.1  # [s] by which its clock may be off ROS's

_log = logging.getLogger(__name__)


class ArmServer:
    """Publishes what an arm reports, and carries out what is asked of it, from entering to leaving.

    Written are ``measured_js``, ``setpoint_js``, ``measured_cp``, ``operating_state``, of RAVEN-II
    also ``/ravenstate``, of an arm with joint sensors ``/ext_jpos``; read are ``state_command``,
    ``hold``, ``servo_jp``, ``servo_jr``, ``servo_jv``, ``servo_cp``, ``servo_cr``, ``move_jp``,
    ``move_jr`` and ``move_cp``. What is refused is said in the log. An arm that stands
    paused goes on to report.

    The arm runs in real time. `profile` names how its messages differ from CRTK
    (`truejoint.crtk.messages.PROFILES`), `namespace` is that of the topics, by default the
    profile's, and `rate` the most state messages a second [Hz].

    Raises RobotError if there is no such profile.
    """

    def __init__(
        self,
        arm: Arm,
        transport: Transport,
        profile: str = "",
        *,
        namespace: str = "",
        rate: float = 1000.0,
    ) -> None:
        self._arm, self._transport = arm, transport
        self._profile = messages.profile_of(arm.robot, profile)
        self._namespace = namespace
        self._every = max(1, math.ceil(arm.rate / rate - 1e-9))
        self._rows = 0
        self._epoch: float | None = None
        self._spoken = threading.Event()
        self._closed = threading.Event()
        self._move: Motion | None = None
        self._threads: list[threading.Thread] = []
        self._pose_kind = _TRANSFORM if self._profile.swapped else _POSE
        self._kinds = {
            "measured_js": JOINT_STATE, "setpoint_js": JOINT_STATE,
            "operating_state": OPERATING_STATE, "truth": JOINT_STATE,
        }  # fmt: skip
        if arm.robot.kinematics is not None:
            self._kinds["measured_cp"] = self._pose_kind
        if arm.robot.name == "raven2":
            self._kinds["ravenstate"] = RAVEN_STATE
        self._publishers: dict[str, Publisher] = {}

    def __enter__(self) -> Self:
        subscribe = self._transport.subscribe
        with ExitStack() as writing, ExitStack() as reading:  # closed where something fails
            for name, kind in self._kinds.items():
                made = self._transport.publisher(_TOPICS.get(name) or self._name(name), kind)
                self._publishers[name] = made
                writing.callback(made.close)
            for name in _COMMANDS:
                kind = self._pose_kind if name.endswith(("_cp", "_cr")) else JOINT_STATE
                kind = "std_msgs/Empty" if name == "hold" else kind
                receive = partial(self._receive, name)
                reading.callback(subscribe(self._name(name), kind, receive))
            topic = self._name("state_command")
            reading.callback(subscribe(topic, STRING_STAMPED, self._on_command))
            self._reading, self._writing = reading.pop_all(), writing.pop_all()
        self._arm.subscribe(self._report)
        thread = threading.Thread(target=self._report_idle, name="idle reports", daemon=True)
        self._threads.append(thread)
        thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._closed.set()
        self._arm.unsubscribe(self._report)
        self._reading.close()
        with suppress(TruejointError):
            self._arm.pause()
        for thread in self._threads:
            thread.join(1.0)
        self._writing.close()

    @property
    def topics(self) -> tuple[str, ...]:
        """Topics that it publishes."""
        return tuple(publisher.topic for publisher in self._publishers.values())

    def _name(self, crtk: str) -> str:
        return self._profile.topic(self._arm.robot.arm, crtk, self._namespace)

    # Commands.

    def _receive(self, name: str, message: Any) -> None:
        """Carry out a message of a topic of `_COMMANDS`."""
        act = getattr(self._arm, name)
        try:
            if name == "hold":
                motion = act()
            elif name.endswith(("_cp", "_cr")):
                motion = act(matrix_of(message))
            else:
                motion = act(np.array(message.velocity if name == "servo_jv" else message.position))
        except (TruejointError, ValueError) as refusal:
            _log.warning("%s: %s", self._name(name), refusal)
            return
        self._move = motion or self._move

    def _on_command(self, message: Any) -> None:
        """Carry a state command out in a thread of its own, so that a homing can be paused."""

        def carry_out() -> None:
            try:
                self._arm.state_command(message.string)
            except TruejointError as refusal:
                level = logging.INFO if isinstance(refusal, MotionStopped) else logging.WARNING
                _log.log(level, "%s: %s", self._name("state_command"), refusal)

        thread = threading.Thread(target=carry_out, daemon=True)
        self._threads = [*(t for t in self._threads if t.is_alive()), thread]
        thread.start()

    # Reports.

    def _report(self, block: StateBlock | TruthBlock) -> None:
        if isinstance(block, TruthBlock):
            columns = {f"truth/{n}": block.position[:, k] for k, n in enumerate(block.name)}
            for row, t in enumerate(block.t):
                single = {name: values[row : row + 1] for name, values in columns.items()}
                self._publish_joints("truth", float(t), "truth", single)
            return
        for row in range(len(block.t)):
            self._rows += 1
            if self._rows % self._every:
                continue
            self._publish_state(block.rows(slice(row, row + 1)), float(block.t[row]))
            self._spoken.set()

    def _report_idle(self) -> None:
        """Report the operating state while the arm reports nothing else: it is not homed."""
        while not self._closed.is_set():
            if self._spoken.wait(_IDLE):
                self._spoken.clear()
                self._closed.wait(_IDLE)
                continue
            with suppress(CommandRefused):
                self._publish_operating_state(self._arm.time)

    def _publish_state(self, block: StateBlock, t: float) -> None:
        self._publish_operating_state(t)
        robot, columns = self._arm.robot, block.columns()
        if self._is_read("setpoint_js"):  # first, so that whoever joins the two has both
            setpoint = block.setpoint[0, robot.joint_channels]
            if self._profile.no_setpoint:  # it has the last increment, which is nearly nothing
                setpoint = np.zeros_like(setpoint)
            self._publish(
                "setpoint_js", t, name=list(robot.joint_names), position=setpoint.tolist()
            )
        if self._is_read("measured_js"):
            self._publish_joints("measured_js", t, "measured", columns)
        if self._is_read("measured_cp"):
            pose = topic_columns(robot, "measured_cp", block)
            message = self._transport.stamped(self._pose_kind, self._stamp(t))
            place, turn = _parts(message)
            place.x, place.y, place.z = (float(pose[axis][0]) for axis in "xyz")
            turn.x, turn.y, turn.z, turn.w = (float(pose[f"q{axis}"][0]) for axis in "xyzw")
            self._publishers["measured_cp"].publish(message)
        if self._is_read("ravenstate"):
            levels = "stopped", "pedal up", "pedal down"
            state = self._arm.operating_state()
            level = levels[0 if state.state in ("DISABLED", "FAULT") else 1 + state.is_ready]
            fields = messages.raven_state_fields(robot, columns)
            values = {name: array[0] for name, array in fields.items()}
            self._publish("ravenstate", t, runlevel=messages.RUN_LEVELS[level], **values)

    def _publish_joints(
        self, crtk: str, t: float, quantity: str, columns: Mapping[str, Array]
    ) -> None:
        topic = self._publishers[crtk].topic
        robot, profile = self._arm.robot, self._profile
        names, fields = messages.joint_state_fields(robot, quantity, topic, columns, profile)
        values = {name: array[0].tolist() for name, array in fields.items()}
        self._publish(crtk, t, name=list(names), **values)

    def _publish_operating_state(self, t: float) -> None:
        """State, busy with a move or a homing, not with a stream of set-points."""
        now = self._arm.operating_state()
        moves = self._move is not None and self._move.is_busy()
        busy = now.is_busy and (moves or not now.is_homed)
        self._publish("operating_state", t, state=now.state, is_homed=now.is_homed, is_busy=busy)

    def _is_read(self, name: str) -> bool:
        made = self._publishers.get(name)
        return made is not None and made.readers > 0

    def _publish(self, crtk: str, t: float, **values: Any) -> None:
        message = self._transport.stamped(self._kinds[crtk], self._stamp(t))
        for field, value in values.items():
            setattr(message, field, value)
        self._publishers[crtk].publish(message)

    def _stamp(self, t: float) -> float:
        """Time of ROS's clock at which the arm's shows `t`."""
        now = self._transport.now()
        if self._epoch is None or abs(now - (self._epoch + t)) > _DRIFT:
            self._epoch = now - t
        return self._epoch + t


def matrix_of(message: Any) -> Array:
    """Pose (4, 4) [m] that a PoseStamped or TransformStamped says.

    Raises CommandRefused where its quaternion is no turn.
    """
    place, turn = _parts(message)
    quaternion = np.array([turn.x, turn.y, turn.z, turn.w])
    if not (np.isfinite(quaternion).all() and abs(np.linalg.norm(quaternion) - 1.0) < 1e-3):
        raise CommandRefused(f"pose refused: quaternion {quaternion.tolist()} is no turn")
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat(quaternion).as_matrix()
    pose[:3, 3] = place.x, place.y, place.z
    return pose


def _parts(message: Any) -> tuple[Any, Any]:
    """Place and orientation of a PoseStamped or TransformStamped."""
    if hasattr(message, "pose"):
        return message.pose.position, message.pose.orientation
    return message.transform.translation, message.transform.rotation
