"""An arm's CRTK interface on ROS topics, so that any client can be tried against it."""

import logging
import math
import re
import threading
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from functools import partial
from typing import Any, Final, Self

import numpy as np
from scipy.spatial.transform import Rotation

from truejoint.array_types import Array
from truejoint.crtk import cartesian, messages
from truejoint.crtk.arm import Arm
from truejoint.crtk.handle import Motion
from truejoint.crtk.messages import JOINT_STATE, RAVEN_STATE, STRING_STAMPED
from truejoint.crtk.ros.transport import Publisher, Transport
from truejoint.crtk.setpoint_follower import SetpointFollower
from truejoint.errors import CommandRefused, MotionStopped, RosError, TruejointError
from truejoint.robots.blocks import StateBlock, TruthBlock, check_range, checked_vector
from truejoint.toml_file import shipped_table

_TWIST: Final = "geometry_msgs/TwistStamped"
_POSE: Final = "geometry_msgs/PoseStamped"
_WRENCH: Final = "geometry_msgs/WrenchStamped"
_TOPICS: Final = {"ravenstate": messages.RAVEN_TOPIC, "truth": messages.TRUTH_TOPIC}
_JAW: Final = "jaw/"  # the grasper, whose one position is the opening
_RATIO: Final = "trajectory_j/ratio"  # of the moves' speed; dVRK's own too
_TABLE: Final = shipped_table(__package__, "topics.toml")
_COMMANDS, _OF_JAW, _RELATIVE = (_TABLE[key] for key in ("commands", "of_jaw", "relative"))
_NOT_OFFERED: Final[Mapping[str, str]] = _TABLE["not_offered"]
_OF_DVRK: Final[Mapping[str, str]] = _TABLE["of_dvrk"]
_QUERIES: Final[Mapping[str, str]] = _TABLE["queries"]
_SAID_APART: Final = ("truth", "operating_state", _RATIO)  # not with each state message
_LATE: Final = 0.5  # [s] by which the stamp of a set-point may be off the clock
_LOG: Final = 1.0  # [s] between two equal lines of the log
_STATE: Final = 0.1  # [s] between two operating states that are the same
_VELOCITY: Final = 0.05  # [s] for which a velocity holds at most
_IDLE: Final = 0.01  # [s] between reports of an arm that does not work
_WINDOW: Final = 0.25  # [s] of which the least late report says how far its clock is behind ROS's
_SLIP: Final = 0.05  # [s] by which it may fall further behind until stamps follow
_READERS: Final = 0.05  # [s] between two looks at which topics somebody reads

_log = logging.getLogger(__name__)


class ArmServer:
    """Publishes what an arm reports, and carries out what is asked of it, from entering to leaving.

    Of RAVEN-II there is also ``/ravenstate``, of an arm with joint sensors ``/ext_jpos``, and but
    for a profile that swaps arms what dvrk_python asks of an arm, in ``local/``, ``body/`` and
    ``spatial/``, and of its grasper, in ``jaw/``. Of `_COMMANDS` the newest pre-empts the others.
    The log says what is refused; that changes nothing. An arm that stands paused goes on to report.

    The arm runs in real time. Of states that come at once, as where the computer is late, the
    newest is published. `profile` names how its messages differ from CRTK
    (`truejoint.crtk.messages.PROFILES`), `namespace` is that of the topics, by default the
    profile's, and `rate` the most state messages a second [Hz]. Raises RobotError if there is no
    such profile.
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
        self._cell = -1  # of time, that the last state message was of
        self._epoch = math.inf  # what the arm's clock is behind ROS's [s]
        self._least = -math.inf, math.inf  # since when, and how late the least late report was [s]
        self._spoken = threading.Event()
        self._closed = threading.Event()
        self._move: Motion | None = None
        self._top = np.array([joint.max_speed for joint in arm.robot.joints])
        self._follower = SetpointFollower(arm, self._warn)
        self._commanding = threading.Lock()
        self._newest: dict[str, float] = {}  # stamp of the newest set-point by command [s]
        self._warned: dict[str, float] = {}  # when, by line without numbers [s]
        self._velocity_t = -math.inf
        self._read: tuple[float, list[str]] = (-math.inf, [])  # since when [s], topics with readers
        self._state_said: tuple[float, dict[str, Any]] = (-math.inf, {})
        self._threads: list[threading.Thread] = []
        swapped = self._profile.swapped
        self._pose_kind = "geometry_msgs/TransformStamped" if swapped else _POSE
        spaces = [space for space, of in self._profile.arms.items() if of == arm.robot.arm]
        self._grasper = "".join(self._profile.grasper.get(space, "") for space in spaces)
        # Set-points first, so that whoever joins the two has both.
        self._kinds = dict.fromkeys(("setpoint_js", "measured_js", "truth"), JOINT_STATE)
        self._kinds["operating_state"] = self._profile.operating_state
        if arm.robot.kinematics is not None:
            self._kinds |= dict.fromkeys(("measured_cp", "setpoint_cp"), self._pose_kind)
            self._kinds |= {"measured_cv": _TWIST, **({} if swapped else _OF_DVRK)}
        if self._profile.actuators:
            self._kinds[messages.POT_TOPIC] = JOINT_STATE
        if arm.robot.name == "raven2":
            self._kinds["ravenstate"] = RAVEN_STATE
        self._jaws = arm.robot.grasper
        if self._jaws:
            self._kinds[_JAW + "measured_js"] = JOINT_STATE
            if not self._grasper:  # RAVEN's says less
                self._kinds[_JAW + "setpoint_js"] = JOINT_STATE
        self._publishers: dict[str, Publisher] = {}

    def __enter__(self) -> Self:
        subscribe = self._transport.subscribe
        with ExitStack() as writing, ExitStack() as reading:  # closed where something fails
            for name, kind in self._kinds.items():
                topic, is_ratio = _TOPICS.get(name) or self._name(name), name == _RATIO
                made = self._transport.publisher(topic, kind, latched=is_ratio)
                self._publishers[name] = made
                writing.callback(made.close)
                if is_ratio:
                    message = self._transport.message(kind)
                    message.data = 1.0
                    made.publish(message)
            of_jaw = [_JAW + name for name in _OF_JAW] if self._jaws else []
            for name in (*_COMMANDS, *of_jaw, *_NOT_OFFERED):
                kind = _NOT_OFFERED.get(name) or self._kind(name)
                command, receive = name.removeprefix(_JAW), partial(self._receive, name)
                is_stream = command.startswith(("servo", "interpolate"))
                newest = is_stream and command not in _RELATIVE
                reading.callback(subscribe(self._name(name), kind, receive, newest=newest))
            topic = self._name("state_command")
            reading.callback(subscribe(topic, STRING_STAMPED, self._on_command))
            try:  # ROS may not know the services' types
                for name, kind in _QUERIES.items() if "jacobian" in self._kinds else ():
                    answer = partial(self._answer, name)
                    reading.callback(self._transport.serve(self._name(name), kind, answer))
            except RosError as lack:
                _log.warning("no kinematics as services: %s", lack)
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
        if self._grasper and crtk.startswith(_JAW):
            return f"/{self._grasper}/{crtk.removeprefix(_JAW)}"
        return self._profile.topic(self._arm.robot.arm, crtk, self._namespace)

    def _kind(self, command: str) -> str:
        """Type of a command's messages; RAVEN's poses and twists are TransformStamped."""
        if command.endswith(("_cp", "_cr", "_cv")):
            return _TWIST if command == "servo_cv" and self._pose_kind == _POSE else self._pose_kind
        return "std_msgs/Empty" if command == "hold" else JOINT_STATE

    # Commands.

    def _receive(self, name: str, message: Any) -> None:
        """Carry out a message of a topic of `_COMMANDS`; each pre-empts what goes on."""
        try:
            if name in _NOT_OFFERED or (name == "servo_cv" and self._profile.swapped):
                raise CommandRefused(f"{name} refused: a simulated arm does not offer it")
            with self._commanding:  # each topic has a thread of its own
                if name == "hold":
                    self._end_all(self._transport.now())
                    self._arm.hold()
                elif name.removeprefix(_JAW).startswith("move"):
                    self._go(name, message)
                else:
                    self._follow(name, message)
        except (TruejointError, ValueError) as refusal:
            self._warn(name, str(refusal))

    def _go(self, name: str, message: Any) -> None:
        """Begin a move; set-points that were sent before it are passed over."""
        self._target(name, message)
        self._end_all(self._transport.seconds(message) or math.inf)
        if name == "move_cp":
            self._move = self._arm.move_cp(matrix_of(message))
        else:
            self._move = self._arm.move_jp(self._target(name, message))  # from where it is now

    def _end_all(self, t: float) -> None:
        """Let the arm stand; set-points from before `t` [s] count no more."""
        self._newest["move"] = min(t, self._transport.now())
        self._follower.stop()
        self._end_move()

    def _end_move(self) -> bool:
        """End a move; whether one was under way."""
        move = self._move
        if move is None or not move.is_busy():
            return False
        move.cancel()
        return True

    def _follow(self, name: str, message: Any) -> None:
        """Follow a set-point, unless a newer one has come."""
        t = self._transport.seconds(message)
        is_old = name.removeprefix(_JAW) not in _RELATIVE and t < self._newest.get(name, 0.0)
        is_old |= t < self._newest.get("move", 0.0)
        if t and (is_old or abs(self._transport.now() - t) > _LATE):
            self._warn(
                name,
                "a set-point is older than another, or its stamp is off by more than "
                f"{_LATE:g} s; it is passed over",
            )
            return
        self._newest[name] = t
        target = self._target(name, message)
        if self._end_move():
            target = self._target(name, message)  # from where that has left it
        self._follower.ask(target, name, t)

    def _target(self, name: str, message: Any) -> Array:
        """Set-point (n_joints,) [rad or m] that is asked for; or TruejointError or ValueError."""
        robot, goal = self._arm.robot, self._follower.goal(name)
        if name.endswith(("_cp", "_cr")):
            kinematics, pose = robot.known_kinematics(name), matrix_of(message)
            if name.endswith("_cr"):
                pose = cartesian.moved(cartesian.pose(kinematics, goal), pose)
            target = cartesian.joints_at(kinematics, pose, goal)
        elif name == "servo_cv":
            rows = cartesian.jacobian(robot.known_kinematics(name), goal)
            twist = np.array([getattr(part, axis) for part in _parts(message) for axis in "xyz"])
            if not np.isfinite(twist).all():
                raise CommandRefused(f"{name} refused: twist {twist.tolist()}; send finite values")
            velocity = np.linalg.lstsq(rows, twist, rcond=None)[0]
            slower = max(float(np.max(np.abs(velocity) / self._top)), 1.0)
            target = goal + velocity / slower * self._velocity_time()
        else:
            target = self._joint_target(name, message, goal)
        check_range(robot, target[None], name)
        return target

    def _joint_target(self, name: str, message: Any, goal: Array) -> Array:
        robot, command = self._arm.robot, name.removeprefix(_JAW)
        values = np.array(message.velocity if command == "servo_jv" else message.position)
        named = [self._profile.joint(each) for each in message.name]
        if sorted(named) == sorted(robot.joint_names) and tuple(named) != robot.joint_names:
            order = ", ".join(robot.joint_names)
            raise CommandRefused(f"{name} refused: values go by their place, for {order}")
        is_relative = command in (*_RELATIVE, "move_jr")
        rest = np.zeros_like(goal) if is_relative else goal.copy()
        if name != command:  # the opening, which is the sum of what its jaws turn by
            if values.shape != (1,):
                raise CommandRefused(f"{name} refused: {len(values)} values; want the opening")
            jaws = robot.index(self._jaws)
            rest[jaws] += (values[0] - rest[jaws].sum()) / len(jaws)
            values = rest
        values = self._profile.joint_values(command, values, rest)
        target = checked_vector(robot, values, name)
        if command == "servo_jv":
            target = np.clip(target, -self._top, self._top) * self._velocity_time()
        return goal + target if is_relative else target

    def _velocity_time(self) -> float:
        """Time [s] that has passed since the last velocity, for which it held."""
        now, last = self._arm.time, self._velocity_t
        self._velocity_t = now
        return now - last if 0.0 < now - last < _VELOCITY else 1.0 / self._arm.rate

    def _warn(self, name: str, text: str) -> None:
        """Say a line in the log, unless the same but for its numbers was said just before."""
        now, line = self._transport.now(), re.sub(r"[-+.e\d]+", "", f"{name}{text}")
        if not 0.0 <= now - self._warned.get(line, -math.inf) < _LOG:
            self._warned[line] = now
            _log.warning("%s: %s", self._name(name), text)

    def _on_command(self, message: Any) -> None:
        """Carry a state command out in a thread of its own, so that a homing can be paused."""

        def carry_out() -> None:
            try:
                # A stream's last moments are not in its way.
                if message.string in ("home", "unhome"):
                    self._follower.stop()
                self._arm.state_command(message.string)
            except TruejointError as refusal:
                level = logging.INFO if isinstance(refusal, MotionStopped) else logging.WARNING
                _log.log(level, "%s: %s", self._name("state_command"), refusal)

        thread = threading.Thread(target=carry_out, daemon=True)
        self._threads = [*(t for t in self._threads if t.is_alive()), thread]
        thread.start()

    def _answer(self, name: str, request: Any, response: Any) -> None:
        """Fill in what a query of crtk_msgs is answered; its ``message`` says why there is none."""
        robot = self._arm.robot
        try:
            kinematics = robot.known_kinematics(name)
            joint = checked_vector(robot, request.jp, name)
            if name == "inverse_kinematics":
                reached = cartesian.joints_at(kinematics, matrix_of(request.cp), joint)
                check_range(robot, reached[None], name)
                response.jp = reached.tolist()
            else:
                _fill(response.cp, cartesian.place_and_turn(cartesian.pose(kinematics, joint)))
            response.result = True
        except (TruejointError, ValueError) as refusal:
            response.result, response.message = False, str(refusal)

    # Reports.

    def _report(self, block: StateBlock | TruthBlock) -> None:
        if isinstance(block, TruthBlock):
            columns = {f"truth/{n}": block.position[:, k] for k, n in enumerate(block.name)}
            for row, t in enumerate(block.t):
                single = {name: values[row : row + 1] for name, values in columns.items()}
                self._publish("truth", float(t), **self._joint_state("truth", "truth", single))
            return
        t = float(block.t[-1])
        cell = math.floor(t * self._arm.rate / self._every)
        if cell == self._cell and self._every > 1:
            return
        self._cell = cell
        self._publish_state(block.rows(slice(-1, None)) if len(block.t) > 1 else block, t)
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
        if not 0.0 <= t - self._read[0] < _READERS:
            named = [name for name in self._publishers if name not in _SAID_APART]
            self._read = t, [name for name in named if self._publishers[name].readers > 0]
        for name in self._read[1]:
            made = self._publishers[name]
            if name.endswith("_js"):
                self._publish(name, t, **self._joint_values(name, columns))
            elif name.endswith(("_cp", "_cv")):
                message = self._transport.stamped(self._kinds[name], self._stamp(t))
                _fill(message, self._tool(name, block))
                made.publish(message)
            elif name.endswith("jacobian"):
                joint, frame = block.measured[0, robot.joint_channels], name.rpartition("/")[0]
                rows = cartesian.jacobian(robot.known_kinematics(name), joint, frame)
                made.publish(self._array(rows))
            elif self._kinds[name] == _WRENCH:  # no twin knows it: stamp 0, not valid
                made.publish(self._transport.message(_WRENCH))
            elif name == "ravenstate":
                state = self._arm.operating_state()
                level = "pedal down" if state.is_ready else "pedal up"
                level = "stopped" if state.state in ("DISABLED", "FAULT") else level
                arrays = messages.raven_state_fields(robot, columns)
                whole = {field: array[0] for field, array in arrays.items()}
                self._publish(name, t, runlevel=messages.RUN_LEVELS[level], **whole)

    def _joint_values(self, name: str, columns: Mapping[str, Array]) -> dict[str, Any]:
        """Fields of the joint state on a topic, from the columns (1,) of a state message."""
        names, quantity = self._arm.robot.joint_names, name.removeprefix(_JAW).partition("_")[0]
        if name.startswith(_JAW):
            jaws = [float(columns[f"{quantity}/{jaw}"][0]) for jaw in self._jaws]
            opening = {"name": ["jaw"], "position": [sum(jaws)]}
            return {"position": [sum(jaws), *jaws]} if self._grasper else opening
        if name == messages.POT_TOPIC:
            return self._joint_state(name, "pot", columns)
        if quantity == "measured":
            return self._joint_state(name, quantity, columns)
        position = [float(columns[f"setpoint/{joint}"][0]) for joint in names]
        if self._profile.no_setpoint:  # it has the last increment, which is nearly nothing
            position = [0.0] * len(names)
        return {"name": [*names], "position": position}

    def _tool(self, name: str, block: StateBlock) -> tuple[Array, Array]:
        """Place and quaternion of the tool, or both its velocities, of one state message."""
        robot, channels = self._arm.robot, self._arm.robot.joint_channels
        kinematics = robot.known_kinematics(name)
        joint = (block.setpoint if "setpoint" in name else block.measured)[0, channels]
        if name.endswith("_cp"):
            return cartesian.place_and_turn(cartesian.pose(kinematics, joint))
        twist = cartesian.jacobian(kinematics, joint) @ block.velocity[0, channels]
        return twist[:3], twist[3:]

    def _array(self, rows: Array) -> Any:
        """Message of a matrix (m, n), row by row."""
        message = self._transport.message("std_msgs/Float64MultiArray")
        for label, size in zip(("rows", "columns"), rows.shape, strict=True):
            dimension = self._transport.message("std_msgs/MultiArrayDimension")
            dimension.label, dimension.size = label, size
            dimension.stride = rows.size if label == "rows" else size
            message.layout.dim.append(dimension)
        message.data = rows.ravel().tolist()
        return message

    def _joint_state(
        self, crtk: str, quantity: str, columns: Mapping[str, Array]
    ) -> dict[str, Any]:
        topic, robot = self._publishers[crtk].topic, self._arm.robot
        names, fields = messages.joint_state_fields(robot, quantity, topic, columns, self._profile)
        return {"name": [*names], **{name: array[0].tolist() for name, array in fields.items()}}

    def _publish_operating_state(self, t: float) -> None:
        """State, busy with a move or a homing, not with a stream of set-points."""
        now = self._arm.operating_state()
        moves = self._move is not None and self._move.is_busy()
        busy = now.is_busy and (moves or not now.is_homed)
        fields = {"state": now.state, "is_homed": now.is_homed, "is_busy": busy}
        last, said = self._state_said
        if self._profile.repeats_state or fields != said or not 0.0 <= t - last < _STATE:
            self._state_said = t, fields
            self._publish("operating_state", t, **fields)

    def _publish(self, crtk: str, t: float, **values: Any) -> None:
        message = self._transport.stamped(self._kinds[crtk], self._stamp(t))
        for field, value in values.items():
            setattr(message, field, value)
        self._publishers[crtk].publish(message)

    def _stamp(self, t: float) -> float:
        """Time of ROS's clock at which the arm's shows `t`; of late reports, when they were due."""
        epoch = self._transport.now() - t
        begin, least = self._least
        is_over = not 0.0 <= t - begin < _WINDOW
        self._least = (t, epoch) if is_over else (begin, min(least, epoch))
        has_slipped = is_over and least - self._epoch > _SLIP
        self._epoch = min(least if has_slipped else self._epoch, epoch)
        return self._epoch + t


def matrix_of(message: Any) -> Array:
    """Pose (4, 4) [m] of a message; raises CommandRefused if its quaternion is no turn."""
    place, turn = _parts(message)
    quaternion = np.array([turn.x, turn.y, turn.z, turn.w])
    if not (np.isfinite(quaternion).all() and abs(np.linalg.norm(quaternion) - 1.0) < 1e-3):
        raise CommandRefused(f"pose refused: quaternion {quaternion.tolist()} is no turn")
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat(quaternion).as_matrix()
    pose[:3, 3] = place.x, place.y, place.z
    return pose


def _parts(message: Any) -> tuple[Any, Any]:
    """Two vectors of a Pose, a stamped one, a transform or a twist: what moves, what turns."""
    if hasattr(message, "twist"):
        return message.twist.linear, message.twist.angular
    if hasattr(message, "transform"):
        return message.transform.translation, message.transform.rotation
    pose = getattr(message, "pose", message)
    return pose.position, pose.orientation


def _fill(message: Any, numbers: tuple[Array, Array]) -> None:
    """Set the two vectors of a message, each with as many axes as it has values."""
    for vector, values in zip(_parts(message), numbers, strict=True):
        for axis, value in zip("xyzw", values, strict=False):
            setattr(vector, axis, float(value))
