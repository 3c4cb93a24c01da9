"""An arm's CRTK interface on ROS topics, so that any client can be tried against it."""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any, Final, Self

import numpy as np
from scipy.spatial.transform import Rotation

from truejoint.array_types import Array
from truejoint.crtk.arm import Arm
from truejoint.crtk.handle import Motion
from truejoint.crtk.messages import (
    JOINT_STATE,
    OPERATING_STATE,
    RAVEN_STATE,
    RAVEN_TOPIC,
    RUN_LEVELS,
    STRING_STAMPED,
    TRUTH_TOPIC,
    joint_state_fields,
    profile_of,
    raven_state_fields,
)
from truejoint.crtk.ros.transport import Publisher, Transport
from truejoint.crtk.states import OperatingState
from truejoint.crtk.topics import topic_columns
from truejoint.errors import CommandRefused, MotionStopped, TruejointError
from truejoint.robots.blocks import StateBlock, TruthBlock

_POSE: Final = "geometry_msgs/PoseStamped"
_TRANSFORM: Final = "geometry_msgs/TransformStamped"
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

    Parameters
    ----------
    arm : Arm
        In real time.
    transport : Transport
    profile : str
        How its messages differ from CRTK, by name (`truejoint.crtk.messages.PROFILES`).
    namespace : str
        Namespace of the topics; by default the profile's.
    rate : float
        Most state messages a second [Hz].

    Raises
    ------
    RobotError
        If there is no such profile.
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
        self._profile = profile_of(arm.robot, profile)
        self._namespace = namespace
        self._every = max(1, math.ceil(arm.rate / rate - 1e-9))
        self._rows = 0
        self._epoch: float | None = None
        self._spoken = threading.Event()
        self._closed = threading.Event()
        self._move: Motion | None = None
        self._publishers: dict[str, Publisher] = {}
        self._endings: list[Callable[[], None]] = []
        self._threads: list[threading.Thread] = []
        self._pose_kind = _TRANSFORM if self._profile.swapped else _POSE
        self._is_raven = arm.robot.name == "raven2"

    def __enter__(self) -> Self:
        try:
            self._open()
        except BaseException:
            self._close()
            raise
        self._arm.subscribe(self._report)
        thread = threading.Thread(target=self._report_idle, name="idle reports", daemon=True)
        self._threads.append(thread)
        thread.start()
        return self

    def _open(self) -> None:
        kinds = {
            "measured_js": JOINT_STATE, "setpoint_js": JOINT_STATE,
            "operating_state": OPERATING_STATE,
        }  # fmt: skip
        if self._arm.robot.kinematics is not None:
            kinds["measured_cp"] = self._pose_kind
        for name, kind in kinds.items():
            self._publishers[name] = self._transport.publisher(self._name(name), kind)
        if self._is_raven:
            made = self._transport.publisher(RAVEN_TOPIC, RAVEN_STATE)
            self._publishers["ravenstate"] = made
        self._publishers["truth"] = self._transport.publisher(TRUTH_TOPIC, JOINT_STATE)
        self._listen()

    def __exit__(self, *_: object) -> None:
        self._closed.set()
        self._arm.unsubscribe(self._report)
        while self._endings:
            self._endings.pop()()
        with suppress(TruejointError):
            self._arm.pause()
        for thread in self._threads:
            thread.join(1.0)
        self._close()

    def _close(self) -> None:
        """Give all topics up."""
        while self._endings:
            self._endings.pop()()
        for publisher in self._publishers.values():
            publisher.close()

    @property
    def topics(self) -> tuple[str, ...]:
        """Topics that it publishes."""
        return tuple(publisher.topic for publisher in self._publishers.values())

    def _name(self, crtk: str) -> str:
        return self._profile.topic(self._arm.robot.arm, crtk, self._namespace)

    # Commands.

    def _listen(self) -> None:
        arm = self._arm
        joints: Mapping[str, Callable[[Array], Motion | None]] = {
            "servo_jp": arm.servo_jp, "servo_jr": arm.servo_jr,
            "move_jp": arm.move_jp, "move_jr": arm.move_jr,
        }  # fmt: skip
        for name, act in joints.items():
            self._on(name, JOINT_STATE, lambda message: np.array(message.position), act)
        self._on("servo_jv", JOINT_STATE, lambda message: np.array(message.velocity), arm.servo_jv)
        poses: Mapping[str, Callable[[Array], Motion | None]] = {
            "servo_cp": arm.servo_cp, "servo_cr": arm.servo_cr, "move_cp": arm.move_cp,
        }  # fmt: skip
        for name, act in poses.items():
            self._on(name, self._pose_kind, matrix_of, act)
        self._on("hold", "std_msgs/Empty", lambda _: None, lambda _: arm.hold())
        topic = self._name("state_command")
        self._endings.append(self._transport.subscribe(topic, STRING_STAMPED, self._on_command))

    def _on(
        self,
        name: str,
        kind: str,
        value: Callable[[Any], Any],
        act: Callable[[Any], Motion | None],
    ) -> None:
        """Act on the messages of a topic, one after the other."""

        def receive(message: Any) -> None:
            try:
                motion = act(value(message))
            except (TruejointError, ValueError) as refusal:
                _log.warning("%s: %s", self._name(name), refusal)
                return
            if motion is not None:
                self._move = motion

        self._endings.append(self._transport.subscribe(self._name(name), kind, receive))

    def _on_command(self, message: Any) -> None:
        """Carry a state command out in a thread of its own, so that a homing can be paused."""
        thread = threading.Thread(target=self._command, args=(message.string,), daemon=True)
        self._threads = [*(t for t in self._threads if t.is_alive()), thread]
        thread.start()

    def _command(self, command: str) -> None:
        try:
            self._arm.state_command(command)
        except TruejointError as refusal:
            level = logging.INFO if isinstance(refusal, MotionStopped) else logging.WARNING
            _log.log(level, "%s: %s", self._name("state_command"), refusal)

    # Reports.

    def _state(self) -> OperatingState:
        """State, busy with a move or a homing, not with a stream of set-points."""
        now = self._arm.operating_state()
        moves = self._move is not None and self._move.is_busy()
        busy = now.is_busy and (moves or not now.is_homed)
        return OperatingState(now.state, now.is_homed, busy, now.t)

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
            self._publish_pose(block, t)
        if self._is_read("ravenstate"):
            levels = "stopped", "pedal up", "pedal down"
            state = self._arm.operating_state()
            level = levels[0 if state.state in ("DISABLED", "FAULT") else 1 + state.is_ready]
            fields = raven_state_fields(robot, columns)
            values = {name: array[0] for name, array in fields.items()}
            self._publish("ravenstate", t, runlevel=RUN_LEVELS[level], **values)

    def _publish_joints(
        self, crtk: str, t: float, quantity: str, columns: Mapping[str, Array]
    ) -> None:
        topic = self._publishers[crtk].topic
        robot, profile = self._arm.robot, self._profile
        names, fields = joint_state_fields(robot, quantity, topic, columns, profile)
        values = {name: array[0].tolist() for name, array in fields.items()}
        self._publish(crtk, t, name=list(names), **values)

    def _publish_operating_state(self, t: float) -> None:
        now = self._state()
        self._publish(
            "operating_state", t, state=now.state, is_homed=now.is_homed, is_busy=now.is_busy
        )

    def _publish_pose(self, block: StateBlock, t: float) -> None:
        columns = topic_columns(self._arm.robot, "measured_cp", block)
        message = self._transport.stamped(self._pose_kind, self._stamp(t))
        place, turn = _parts(message)
        place.x, place.y, place.z = (float(columns[axis][0]) for axis in ("x", "y", "z"))
        turn.x, turn.y, turn.z, turn.w = (
            float(columns[axis][0]) for axis in ("qx", "qy", "qz", "qw")
        )
        self._publishers["measured_cp"].publish(message)

    def _is_read(self, name: str) -> bool:
        made = self._publishers.get(name)
        return made is not None and made.readers > 0

    def _publish(self, crtk: str, t: float, **values: Any) -> None:
        kinds = {
            "operating_state": OPERATING_STATE, "ravenstate": RAVEN_STATE,
        }  # fmt: skip
        message = self._transport.stamped(kinds.get(crtk, JOINT_STATE), self._stamp(t))
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
